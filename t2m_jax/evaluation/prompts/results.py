"""How often motion did what sentences asked for: results, their table and their JSON file."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

from t2m_jax.errors import UserError
from t2m_jax.evaluation.report.record import MAX_REPORT, fields_of, names_of, reading_report
from t2m_jax.files.manifest import load_sealed_json, save_sealed_json
from t2m_jax.files.markdown import markdown_table


@dataclasses.dataclass(frozen=True, kw_only=True)
class PromptResult:
    """How often the motions of one test did what was asked."""

    name: str
    """Name of the test."""
    rule: str = ""
    """What counts, in words; not in files."""
    right: int
    """Motions that did it."""
    samples: int
    """Motions that were generated."""
    failures: tuple[str, ...]
    """The sentence of each other motion."""
    instead: tuple[tuple[str, int], ...]
    """What the other motions did, and how often."""

    def __post_init__(self) -> None:
        others = self.samples - self.right
        if self.right < 0 or len(self.failures) != others:
            raise ValueError(f"{self.right} of {self.samples} are right, and {len(self.failures)} failures are listed")
        if sum(count for _, count in self.instead) != others:
            raise ValueError(f"instead: the sum is not {others}")


@dataclasses.dataclass(frozen=True, kw_only=True)
class PromptReport:
    """The results of a group of tests."""

    group: str
    """What was asked for."""
    motion: str
    """`cleaned` or `decoded`."""
    contents: tuple[PromptResult, ...]
    """One result for each test."""

    def __post_init__(self) -> None:
        if self.num_samples < 1:
            raise ValueError("contents: there are no motions")

    @property
    def num_samples(self) -> int:
        """Motions of all tests."""
        return sum(result.samples for result in self.contents)

    @property
    def prompt_following(self) -> float:
        """Share of these motions that did what was asked."""
        return sum(result.right for result in self.contents) / self.num_samples


def following_table(results: Sequence[PromptResult]) -> str:
    """Returns the results as a Markdown table; the last line is the sum."""
    lines = []
    for result in results:
        others = ", ".join(f"{name} {count}" for name, count in result.instead)
        lines.append((result.name, result.rule, f"{result.right} of {result.samples}", others))
    right = sum(result.right for result in results)
    total = sum(result.samples for result in results)
    lines.append(("**all**", "", f"**{right} of {total} ({right / total:.0%})**", ""))
    return markdown_table(("content", "rule", "did what was asked", "did instead"), lines, sides="<<><")


def _sums(report: PromptReport) -> dict[str, float]:
    """Returns the entries of a file that follow from its contents."""
    return {"num_samples": report.num_samples, "prompt_following": report.prompt_following}


def save_prompt_report(path: Path, report: PromptReport) -> None:
    """Writes a report as JSON, with the results by name."""
    data = dataclasses.asdict(report) | _sums(report)
    data["contents"] = {
        result.name: {
            "right": result.right,
            "samples": result.samples,
            "failures": result.failures,
            "instead": dict(result.instead),
        }
        for result in report.contents
    }
    save_sealed_json(path, data)


def load_prompt_report(path: Path) -> PromptReport:
    """Returns a report of `t2m evaluate prompts`.

    Raises:
        UserError: The file is missing, or is something else.
    """
    known = (*names_of(PromptReport), "num_samples", "prompt_following")
    data = load_sealed_json(path, max_bytes=MAX_REPORT, entries=known)
    with reading_report(path, "with the counts of prompts", command="t2m evaluate prompts --json"):
        contents = [
            {"name": name, **entry, "instead": list(entry["instead"].items())}
            for name, entry in data["contents"].items()
        ]
        report = fields_of(PromptReport, data | {"contents": contents})
        # Both are in the file for other readers; a file in which they disagree was changed by hand.
        for name, value in _sums(report).items():
            if data[name] != value:
                raise UserError(f"{name}: does not fit the contents")
    return report
