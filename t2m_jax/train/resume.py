"""Going on with a run: only with the config it was started with."""

from pathlib import Path
from typing import Any

from t2m_jax.checkpoints.run import CONFIG_FILE, refuse_existing_run, run_info
from t2m_jax.config import flat_fields, load_config
from t2m_jax.errors import UserError

MAY_CHANGE = ("run", "loop.num_steps", "loop.log_every", "loop.checkpoint_every", "loop.keep_checkpoints")
"""Fields that do not touch what the run computes."""


def check_start(run: Path, config: Any, *, resume: bool) -> None:
    """Raises `UserError` where a new run would write over another, or one to resume does not fit the config."""
    if not resume:
        refuse_existing_run(run)
        return
    run_info(run)
    saved = flat_fields(load_config(run / CONFIG_FILE, type(config)))
    for name, value in flat_fields(config).items():
        if name not in MAY_CHANGE and saved[name] != value:
            raise UserError(
                f"{run}: was started with {name} {saved[name]}, not {value}; resume it with the same config"
            )
