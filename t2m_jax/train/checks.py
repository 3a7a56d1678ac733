"""What is checked before a run starts or is resumed."""

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from t2m_jax.checkpoints.bundle import BUNDLED, WEIGHTS_FILE
from t2m_jax.checkpoints.run import CONFIG_FILE, is_run, run_info
from t2m_jax.checkpoints.tokenizer import load_tokenizer
from t2m_jax.config import flat_fields, load_config
from t2m_jax.data.folder import Dataset
from t2m_jax.distributed import is_writer
from t2m_jax.errors import UserError
from t2m_jax.files import lock
from t2m_jax.train.config import ExperimentConfig

MAY_CHANGE = (
    "run",
    "loop.num_steps",
    "loop.log_every",
    "loop.checkpoint_every",
    "loop.keep_checkpoints",
    "loop.steps_per_call",
    "sharding",
    "placement",
)
"""Fields and sections that a resumed run may change, because they do not affect what its updates compute."""


@contextlib.contextmanager
def claim_run(run: Path) -> Iterator[None]:
    """Holds the lock of a run, so that no other training writes into it. Of several processes, one holds it for all.

    Raises:
        UserError: Another training writes into it, or its folder cannot be written.
    """
    with contextlib.ExitStack() as held:
        if is_writer():
            try:
                run.absolute().parent.mkdir(parents=True, exist_ok=True)
                held.enter_context(lock(run))
            except OSError as error:
                raise UserError(f"{run}: cannot be written ({error.strerror or error})") from error
        yield


def check_new_run(run: Path) -> None:
    """Raises `UserError` if a folder cannot become a run."""
    if is_run(run):
        raise UserError(f"{run}: contains a run already; add --resume to continue it, or choose another --run")
    if (run / WEIGHTS_FILE).exists():  # they would be loaded instead of the run's
        raise UserError(f"{run}: contains a model already; choose another --run")
    if str(run) in BUNDLED:
        raise UserError(f"run: {run} is the name of a packaged model; choose another --run")


def check_same_config(config: ExperimentConfig) -> None:
    """Raises `UserError` if a run was started with other values of fields that must not change."""
    saved = flat_fields(load_config(config.run / CONFIG_FILE, type(config)))
    for name, value in flat_fields(config).items():
        if not {name, name.partition(".")[0]} & set(MAY_CHANGE) and not _is_same(config, name, saved[name], value):
            raise UserError(
                f"{config.run}: was started with {name} {saved[name]}, not {value}; resume it with the same config "
                "(`--run RUN --resume` alone takes the config of the run)"
            )


def _is_same(config: ExperimentConfig, name: str, saved: Any, value: Any) -> bool:
    """Returns whether a field has its old value. What only moved is the same."""
    if saved == value:
        return True
    if name == "data":
        return run_info(config.run).data is not None  # its contents are compared by `check_same_data`
    if name == "vqvae":
        with contextlib.suppress(UserError):  # there is nothing
            return load_tokenizer(value).fingerprint == load_tokenizer(config.run).fingerprint
    return False


def check_same_data(config: ExperimentConfig, dataset: Dataset) -> None:
    """Raises `UserError` if a run was started with other clips, captions, splits or statistics."""
    known = run_info(config.run).data
    if known not in (None, dataset.fingerprint):
        raise UserError(
            f"data: {dataset.folder} is not what {config.run} was started with (fingerprint {dataset.fingerprint}, "
            f"not {known}); resume with the old data, or start a new run with `--init {config.run}`"
        )
