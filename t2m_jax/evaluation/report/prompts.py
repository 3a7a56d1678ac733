"""Reports of prompts: how often motion did what sentences asked for, and their JSON files."""

import dataclasses
from pathlib import Path

from t2m_jax.errors import UserError
from t2m_jax.evaluation.report.record import MAX_REPORT, fields_of, reading_report
from t2m_jax.files import load_json, save_json

DERIVED = ("num_samples", "prompt_following")
"""Entries of the file that follow from the contents."""


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

    def __post_init__(self) -> None:
        if self.num_samples < 1:
            raise ValueError("contents: there are no motions")

    @property
    def num_samples(self) -> int:
        """Motions of all contents."""
        return sum(row.samples for row in self.contents)

    @property
    def prompt_following(self) -> float:
        """Share of these motions that did what was asked."""
        return sum(row.right for row in self.contents) / self.num_samples


def save_prompt_report(path: Path, report: PromptReport) -> None:
    """Writes a report as JSON, with the contents by name."""
    data = dataclasses.asdict(report) | {name: getattr(report, name) for name in DERIVED}
    data["contents"] = {row.pop("name"): row | {"instead": dict(row["instead"])} for row in data["contents"]}
    save_json(path, data)


def load_prompt_report(path: Path) -> PromptReport:
    """Returns a report of `t2m evaluate prompts`.

    Raises:
        UserError: The file is missing, or is something else.
    """
    data = load_json(path, max_bytes=MAX_REPORT)
    with reading_report(path, "with the counts of prompts", command="t2m evaluate prompts --json"):
        rows = [
            {"name": name, **row, "instead": list(row.get("instead", {}).items())}
            for name, row in data["contents"].items()
        ]
        report = fields_of(PromptReport, data | {"contents": rows})
        for name in DERIVED:
            if data[name] != getattr(report, name):
                raise UserError(f"{name}: does not fit the contents")
    return report
