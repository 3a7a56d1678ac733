"""Reports of prompts: how often motion did what sentences asked for, and their JSON files."""

import dataclasses
from pathlib import Path

from t2m_jax.evaluation.report.record import fields_of, reading_report
from t2m_jax.files import load_json, save_json


@dataclasses.dataclass(frozen=True, kw_only=True)
class PromptCounts:
    """How often the motions of one content did what was asked."""

    name: str
    """Name of the content."""
    right: int
    """Motions that did it."""
    samples: int
    """Motions that were generated."""
    failures: tuple[str, ...]
    """The sentence of each other motion."""
    instead: tuple[tuple[str, int], ...] = ()
    """What the other motions did, and how often. Reports of version 0.1 do not have it."""

    def __post_init__(self) -> None:
        others = self.samples - self.right
        if self.right < 0 or len(self.failures) != others:
            raise ValueError(f"{self.right} of {self.samples} are right, and {len(self.failures)} failures are listed")
        if self.instead and sum(count for _, count in self.instead) != others:
            raise ValueError(f"instead: the sum is not {others}")


@dataclasses.dataclass(frozen=True, kw_only=True)
class PromptReport:
    """How often generated motion did what was asked."""

    group: str = "actions"
    """What was asked for. Version 0.1 had only actions and did not write it down."""
    motion: str | None = None
    """`cleaned` or `decoded`; None in reports of version 0.1."""
    contents: tuple[PromptCounts, ...]
    """What was counted."""
    num_samples: int
    """Motions of all contents."""
    prompt_following: float
    """Share of these motions that did what was asked."""

    def __post_init__(self) -> None:
        right, total = (sum(getattr(row, name) for row in self.contents) for name in ("right", "samples"))
        if total < 1 or total != self.num_samples or right / total != self.prompt_following:
            raise ValueError(f"num_samples, prompt_following: do not fit the contents, {right} of {total}")


def make_prompt_report(contents: tuple[PromptCounts, ...], *, group: str, motion: str) -> PromptReport:
    """Returns the report of some contents with at least one motion."""
    right, total = (sum(getattr(row, name) for row in contents) for name in ("right", "samples"))
    return PromptReport(
        group=group, motion=motion, contents=contents, num_samples=total, prompt_following=right / total
    )


def save_prompt_report(path: Path, report: PromptReport) -> None:
    """Writes a report as JSON, with the contents by name."""
    data = dataclasses.asdict(report)
    data["contents"] = {row.pop("name"): row | {"instead": dict(row["instead"])} for row in data["contents"]}
    save_json(path, data)


def load_prompt_report(path: Path) -> PromptReport:
    """Returns a report of `t2m evaluate prompts`.

    Raises:
        UserError: The file is missing, or is something else.
    """
    data = load_json(path)
    with reading_report(path, "with the counts of prompts", command="t2m evaluate prompts --json"):
        rows = [
            {"name": name, **row, "instead": list(row.get("instead", {}).items())}
            for name, row in data["contents"].items()
        ]
        report = fields_of(PromptReport, data | {"contents": rows})
    return report  # noqa: RET504 - for mypy, a `return` inside `with` may not be reached
