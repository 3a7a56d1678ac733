"""Reports: the typed results of an evaluation, and their JSON files."""

import contextlib
import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from t2m_jax.config import config_from_dict
from t2m_jax.errors import UserError
from t2m_jax.files.manifest import load_sealed_json, save_sealed_json
from t2m_jax.files.markdown import markdown_table

T = TypeVar("T")

REAL = "real"
"""Name of the metrics of real motion."""
FOLLOWING = "following"
"""Entry of a file with text following by group."""
KINDS = ("generated", "reconstruction")
"""Where measured motion comes from."""
CLEANED = "cleaned_"
"""Prefix of the names of metrics of cleaned motion."""
MAX_REPORT = 2_000_000
"""The largest report in bytes. One of 1,000 repeats of 28 metrics has 0.9 MB."""
MOTIONS_PER_DIMENSION = 2
"""FID needs so many motions for each number of an embedding: fewer do not determine a covariance well."""
COMPARABLE = ("protocol", "data", "split", "num_samples", "evaluator", "seed", "batch")
"""Fields of the header that reports must share to be in one table."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Header:
    """What the figures of a report depend on."""

    protocol: str
    """Name of the protocol."""
    model: str = ""
    """What the user called the model: a name or a folder."""
    data: str
    """Name of the data set."""
    split: str
    """Split of the data set."""
    num_samples: int
    """Motions with captions in the split."""
    left_out_for_shared_source: int | None = None
    """Clips left out because their recording is also in training; None if this is not known or does not matter."""
    evaluator: str
    """Fingerprint of the evaluator."""
    weights: str
    """Fingerprint of the model, or of the tokenizer if only that is measured."""
    contents: str
    """Fingerprint of the data set."""
    seed: int
    """Start of every random choice."""
    unit: int
    """Lengths of real motion are multiples of this many frames."""
    batch: int
    """Pairs among which texts and motions are ranked."""
    sampling: str = "none"
    """`sampled`, `greedy` (always the likeliest code) or `none` (reconstruction)."""
    temperature: float | None = None
    """Temperature of the sampling; None if codes were not sampled."""
    top_k: int | None = None
    """Number of likeliest codes that were sampled from; None for all."""
    top_p: float | None = None
    """Probability of the likeliest codes that were sampled from; None for all."""
    guidance_scale: float | None = None
    """Strength of the guidance by the text; None for none."""
    motion: str = "decoded"
    """What all metrics measure, except for those that are called `cleaned`: motion as decoded."""
    stop_rule: str | None = None
    """Rule that ended motions; None for reconstructions."""
    fid_motions: int | None = None
    """Different motions from which FID is computed; None in reports of earlier versions."""
    embedding_dim: int | None = None
    """Numbers in an embedding of the evaluator; None in reports of earlier versions."""

    @property
    def fid_warning(self) -> str:
        """What a reader of FID must know if it is of too few motions; empty if there are enough."""
        wanted = MOTIONS_PER_DIMENSION * (self.embedding_dim or 0)
        if self.fid_motions is None or self.fid_motions >= wanted:
            return ""
        return (
            f"FID is not reliable: {self.fid_motions} motions are too few to estimate the covariance of embeddings of "
            f"{self.embedding_dim} dimensions, so FID is noisy and too high. Use {wanted} motions or more."
        )


def first_difference(one: Header, other: Header, names: Sequence[str]) -> tuple[str, Any, Any] | None:
    """Returns the first of some fields, and then `contents`, in which two headers differ, with both values."""
    fields = dataclasses.asdict(one)
    others = dataclasses.asdict(other)
    for name in (*names, "contents"):
        if fields[name] != others[name]:
            return name, fields[name], others[name]
    return None


@dataclasses.dataclass(frozen=True)
class Metric:
    """One metric of one set of motions."""

    mean: float
    """Mean over the repeats."""
    interval: float
    """Half-width of the 95 % interval: 1.96 standard deviations over the root of the number of repeats."""
    repeats: tuple[float, ...]
    """The value of each repeat."""

    def __str__(self) -> str:
        return f"{self.mean:.3f} ± {self.interval:.3f}"

    @classmethod
    def from_repeats(cls, repeats: Sequence[float]) -> "Metric":
        """Returns mean and interval of some values."""
        # The deviation is divided by the number of repeats, not by one less, as in the published codes.
        values = np.asarray(repeats, np.float64)
        return cls(float(values.mean()), float(1.96 * values.std() / np.sqrt(len(values))), tuple(values.tolist()))


@dataclasses.dataclass(frozen=True, kw_only=True)
class QualityFigures:
    """What a viewer sees first, as means over clips; see `t2m_jax.metrics.MotionQuality`."""

    bone_variation: float
    """Share of a bone's length."""
    jerk: float
    """m/s^3."""
    skating_ratio: float
    """Share of contacts."""
    skating_speed: float
    """m/s."""
    floating: float
    """Share of frames."""
    penetration: float
    """Share of frames."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class ReconstructionFigures:
    """How well a tokenizer reconstructs the motion of a split, without an evaluator."""

    mpjpe_mm: float
    """Root-aligned mean per-joint position error over all frames, in millimeters."""
    mpjpe_median_clip_mm: float
    """Median over the clips of the same error."""
    codebook_usage: float
    """Share of the codes that the split uses."""
    perplexity: float
    """exp of the entropy of code use."""
    num_clips: int
    """Clips of the split."""
    num_frames: int
    """Frames of all clips, whole codes only."""
    split: str
    """Name of the split."""
    global_mpjpe_mm: float
    """Mean over clips, with only the first frame aligned."""
    acceleration_error_mm: float
    """Mean over clips, in millimeters per squared frame."""
    path_drift_mm: float
    """Mean distance of the roots in the last frame."""
    heading_drift_degrees: float
    """Mean difference of the turns from the first frame to the last."""
    real_quality: QualityFigures
    """Quality of the split's motion."""
    quality: QualityFigures
    """Quality of the reconstructed motion, as decoded."""
    cleaned_quality: QualityFigures
    """Quality of the reconstructed motion after the clean-up."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Following:
    """How often motion did what the sentences of a group of prompts asked."""

    right: int
    """Motions that did it."""
    samples: int
    """Motions that were generated."""

    def __post_init__(self) -> None:
        if not 0 <= self.right <= self.samples or not self.samples:
            raise ValueError(f"{self.right} of {self.samples} motions are right")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Report:
    """Metrics of real motion, and of motion that was generated or reconstructed."""

    header: Header
    """What the figures depend on."""
    kind: str
    """Where the measured motion comes from: `generated` or `reconstruction`."""
    real: dict[str, Metric]
    """Metrics of real motion, by name."""
    measured: dict[str, Metric]
    """Metrics of the measured motion, by name."""
    reconstruction: ReconstructionFigures | None = None
    """Figures of the tokenizer alone, if they were measured too."""
    following: dict[str, Following] | None = None
    """Text following by group of prompts; the benchmark alone measures it."""

    def _repr_markdown_(self) -> str:
        """Returns the report for notebooks: a table with a line for each metric."""
        names = dict.fromkeys([*self.measured, *self.real])
        columns = (self.real, self.measured)
        lines = [[name, *(f"{found[name]}" if name in found else "" for found in columns)] for name in names]
        table = markdown_table(("metric", REAL, self.kind), lines)
        return "\n\n".join(filter(None, (table, self.header.fid_warning)))

    @property
    def metrics(self) -> dict[str, dict[str, Metric]]:
        """Both sets of metrics: `real`, and the report's kind."""
        return {REAL: self.real, self.kind: self.measured}


def report_as_json(report: Report) -> dict[str, Any]:
    """Returns a report as plain data: the fields of the header, `rows`, and the figures of a reconstruction."""
    figures = {} if report.reconstruction is None else dataclasses.asdict(report.reconstruction)
    sets = {
        kind: {name: dataclasses.asdict(metric) for name, metric in metrics.items()}
        for kind, metrics in report.metrics.items()
    }
    groups = {name: dataclasses.asdict(group) for name, group in (report.following or {}).items()}
    return {**figures, **dataclasses.asdict(report.header), "rows": sets} | ({FOLLOWING: groups} if groups else {})


def save_report(path: str | Path, report: Report) -> None:
    """Writes a report as JSON."""
    save_sealed_json(path, report_as_json(report))


def save_reconstruction(path: Path, figures: ReconstructionFigures) -> None:
    """Writes the figures of a tokenizer as JSON."""
    save_sealed_json(path, dataclasses.asdict(figures))


@contextlib.contextmanager
def reading_report(path: str | Path, contents: str, *, command: str) -> Iterator[None]:
    """Turns what damaged data raise in the block into a `UserError`, which says what was expected in the file."""
    try:
        yield
    except (LookupError, TypeError, AttributeError, ValueError) as error:
        reason = f" ({error})" if isinstance(error, UserError) else ""
        raise UserError(f"{path}: is not a report {contents}{reason}; write one with `{command}`") from None


def load_report(path: str | Path) -> Report:
    """Returns a report of `t2m evaluate generation`, or of `reconstruction` with an evaluator.

    Raises:
        UserError: The file is missing, or is something else.
    """
    known = (*names_of(Header, ReconstructionFigures), "rows", FOLLOWING)
    data = load_sealed_json(path, max_bytes=MAX_REPORT, entries=known)
    with reading_report(path, "with the metrics of an evaluator", command="t2m evaluate generation --json"):
        sets = data["rows"]
        # A comparison needs exactly one kind beside real motion.
        (kind,) = sets.keys() & set(KINDS)
        if sets.keys() != {REAL, kind}:
            raise ValueError("rows of an unknown kind")
        header = fields_of(Header, data)
        figures = fields_of(ReconstructionFigures, data) if "mpjpe_mm" in data else None
        real, measured = (_metrics(sets[one]) for one in (REAL, kind))
        if not measured:
            raise ValueError("no metrics")
        groups = _following(data[FOLLOWING]) if FOLLOWING in data else None
        report = Report(
            header=header, kind=kind, real=real, measured=measured, reconstruction=figures, following=groups
        )
    return report  # noqa: RET504 - for mypy, a `return` inside `with` may not be reached


def _following(entries: Mapping[str, Mapping[str, Any]]) -> dict[str, Following]:
    """Returns the groups of prompts of a report file.

    Raises:
        UserError: There is none, a name is not a word, or counts do not fit each other.
    """
    if not entries or not all(name.replace("-", "_").isidentifier() for name in entries):
        raise UserError(f"{FOLLOWING}: needs groups with names of letters")
    return {name: config_from_dict(Following, found, source=repr(name)) for name, found in entries.items()}


def load_reconstruction(path: Path) -> ReconstructionFigures:
    """Returns the figures that `t2m evaluate reconstruction` wrote without an evaluator.

    Raises:
        UserError: The file is missing, or is something else.
    """
    data = load_sealed_json(path, max_bytes=MAX_REPORT, entries=names_of(ReconstructionFigures))
    with reading_report(path, "with the figures of a tokenizer", command="t2m evaluate reconstruction --json"):
        figures = fields_of(ReconstructionFigures, data)
    return figures  # noqa: RET504 - for mypy, a `return` inside `with` may not be reached


def names_of(*schemas: type) -> list[str]:
    """Returns the names of the fields of some dataclasses."""
    return [field.name for schema in schemas for field in dataclasses.fields(schema)]


def fields_of(schema: type[T], data: Mapping[str, Any]) -> T:
    """Returns the fields of one dataclass among the entries of a report.

    Raises:
        UserError: A field is missing or has another type, or text has control characters.
    """
    found = {field.name: data[field.name] for field in dataclasses.fields(schema) if field.name in data}  # type: ignore[arg-type]
    for name, value in found.items():
        # Reports come from others, too, and a terminal obeys control characters.
        if isinstance(value, str) and not value.isprintable():
            raise UserError(f"{name}: {value!r} has characters that cannot be printed")
    return config_from_dict(schema, found, source="fields")


def _metrics(entries: Mapping[str, Mapping[str, Any]]) -> dict[str, Metric]:
    """Returns one set of metrics of a report file.

    Raises:
        UserError: A name is not a word, or a metric has no repeats or figures that are not finite.
    """
    metrics = {name: config_from_dict(Metric, found, source=repr(name)) for name, found in entries.items()}
    for name, metric in metrics.items():
        figures = (metric.mean, metric.interval, *metric.repeats)
        if not name.isidentifier() or not metric.repeats or not np.isfinite(figures).all():
            raise UserError(f"metric {name!r}: needs a name of letters, and repeats that are finite")
    return metrics
