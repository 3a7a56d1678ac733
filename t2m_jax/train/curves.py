"""The curves of a run: what its logs say of a metric, and the picture of its losses for notebooks."""

import dataclasses
import io
from pathlib import Path

from t2m_jax.errors import UserError
from t2m_jax.evaluation.report.charts import DPI, MetricCurve, curves_chart
from t2m_jax.train.log import whole_lines

SPLITS = ("train", "val", "evaluation")
"""Names of the logs of a run."""


@dataclasses.dataclass(frozen=True)
class Run:
    """A run folder; a notebook shows it as a plot of its losses."""

    path: str | Path

    def curves(self, metric: str = "loss") -> dict[str, MetricCurve]:
        """Returns the curves of a metric in the logs of the run, by the name of the log.

        Raises:
            UserError: The folder has no logs, no log has this metric, or one is damaged.
        """
        found: dict[str, MetricCurve] = {}
        known: set[str] = set()
        for split in SPLITS:
            path = Path(self.path) / f"{split}.csv"
            if path.is_file():
                header, *rows = (line.rstrip("\n").split(",") for line in whole_lines(path))
                # A run that has just begun has a header and no rows.
                known |= set(header) if rows else set()
                if rows and metric in header:
                    found[split] = _curve(path, rows, header.index(metric), metric)
        if not known:
            reason = "has no logs of a training (train.csv); give the folder of a run that has begun"
            raise UserError(f"{self.path}: {reason}")
        if not found:
            names = ", ".join(sorted(known - {"step"}))
            raise UserError(f"{self.path}: its logs have no {metric!r}; they have {names}")
        return found

    def _repr_png_(self) -> bytes | None:
        """Returns the plot of `t2m plot`; None without the extra `plot`, so that a notebook shows the name."""
        curves = {str(self.path): self.curves()}
        picture = io.BytesIO()
        try:
            curves_chart(curves, metric="loss").savefig(picture, format="png", dpi=DPI)
        except ImportError:
            return None
        return picture.getvalue()


def _curve(path: Path, rows: list[list[str]], column: int, metric: str) -> MetricCurve:
    try:
        return MetricCurve([int(row[0]) for row in rows], [float(row[column]) for row in rows])
    except ValueError:
        raise UserError(f"{path}: is damaged: a step or a value of {metric} is not a number") from None
