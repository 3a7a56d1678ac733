"""A run directory: the resolved config, the statistics and the checkpoints of one training run."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol, TypeVar, runtime_checkable

import jax

from t2m_jax.config import load_versioned, save_config
from t2m_jax.errors import UserError
from t2m_jax.files import first_line

CONFIG_FILE, INFO_FILE, DATA_FILE = "config.yaml", "run.yaml", "training_data.json"
CHECKPOINTS = "checkpoints"

FORMAT_VERSION = 2
"""Version of new runs. Since version 2, every row of a batch has its own random keys, and the order of the data is
another one. Runs of version 1 can be used, but not continued."""

_DAMAGED = (OSError, LookupError, ValueError, TypeError, AttributeError, RuntimeError)
"""What Orbax raises for damaged files. It uses their metadata without checking it."""


@runtime_checkable
class NamedFields(Protocol):
    """Any `NamedTuple`."""

    def _asdict(self) -> dict[str, Any]: ...


State = TypeVar("State", bound=NamedFields)


@dataclasses.dataclass(frozen=True, kw_only=True)
class RunInfo:
    """The file that makes a folder a run directory."""

    kind: str
    """What was trained, such as `vqvae`, `gpt` or `evaluator`."""
    format_version: int = FORMAT_VERSION
    """Layout of the directory, and the random streams of its updates."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class _RunInfoV1(RunInfo):
    """The file in runs of version 1, which did not name it at first."""

    format_version: int = 1


def run_info(path: Path) -> RunInfo:
    """Returns what a run directory contains.

    Raises:
        UserError: The folder is not a run directory, or of an unknown version.
    """
    if not is_run(path):
        raise UserError(f"{path}: not a run directory (it has no {INFO_FILE})")
    return load_versioned(path / INFO_FILE, {1: _RunInfoV1, FORMAT_VERSION: RunInfo})


def check_resumable(path: Path) -> None:
    """Raises `UserError` if a folder is not a run, or was written by a version whose updates were different."""
    if run_info(path).format_version != FORMAT_VERSION:
        raise UserError(
            f"{path}: was started with an older t2m_jax, whose updates were different; use it as it is, or start "
            f"a new run from its weights with `--init {path}`"
        )


def is_run(path: Path) -> bool:
    """Returns whether a folder was written by training."""
    return (path / INFO_FILE).is_file()


def create_run(path: Path, kind: str, config: Any) -> None:
    """Makes a folder a run directory; call this when everything else that a run needs is in the folder."""
    save_config(path / CONFIG_FILE, config)
    # Last, because a folder without this file is not a run: an interrupted start can simply be repeated.
    save_config(path / INFO_FILE, RunInfo(kind=kind))


class Checkpoints:
    """The checkpoints of a run. Each is written under a temporary name and renamed, so none is ever incomplete."""

    def __init__(self, run: Path, *, keep: int | None = None):
        """Opens the folder, which is created if it is missing; the newest `keep` checkpoints are kept."""
        import orbax.checkpoint as ocp  # here, because generation from a bundle does not need it

        folder = (run / CHECKPOINTS).resolve()
        folder.mkdir(parents=True, exist_ok=True)
        # Saving goes on while training does; closing waits for it.
        self._ocp = ocp
        self._manager = ocp.CheckpointManager(folder, options=ocp.CheckpointManagerOptions(max_to_keep=keep))
        self._run = run

    def __enter__(self) -> "Checkpoints":
        return self

    def __exit__(self, *error: object) -> None:
        self._manager.close()

    @property
    def latest_step(self) -> int | None:
        """The step of the newest checkpoint, None if there is none."""
        return self._manager.latest_step()

    def save(self, step: int, state: NamedFields) -> None:
        """Writes a checkpoint unless this step has one; every field of the state that contains arrays is one item."""
        if step != self.latest_step:
            args = self._ocp.args
            fields = {name: value for name, value in state._asdict().items() if jax.tree.leaves(value)}
            items = {name: args.StandardSave({name: value}) for name, value in fields.items()}
            self._manager.save(step, args=args.Composite(**items))

    def restore(self, like: State) -> State:
        """Returns the newest checkpoint in the structure of `like`, a state of arrays or of shapes.

        Raises:
            UserError: There is no checkpoint, or it does not fit.
        """
        return type(like)(**self.restore_fields(like._asdict()))

    def restore_fields(self, like: Mapping[str, Any]) -> dict[str, Any]:
        """Returns some fields of the newest checkpoint, each in the structure of `like`.

        Raises:
            UserError: There is no checkpoint, or it does not fit.
        """
        step, args = self.latest_step, self._ocp.args
        if step is None:
            raise UserError(f"{self._run}: has no checkpoint yet; train it first")
        saved = {name: value for name, value in like.items() if jax.tree.leaves(value)}
        shapes = jax.tree.map(_destination, saved)
        items = {name: args.StandardRestore({name: value}) for name, value in shapes.items()}
        try:
            restored = self._manager.restore(step, args=args.Composite(**items))
        except _DAMAGED as error:
            raise UserError(
                f"{self._run}: checkpoint {step} is damaged or does not fit its config ({first_line(error)})"
            ) from error
        return dict(like) | {name: restored[name][name] for name in saved}


def has_checkpoint(run: Path) -> bool:
    """Returns whether a run has a checkpoint."""
    with Checkpoints(run) as checkpoints:
        return checkpoints.latest_step is not None


def restore_latest(run: Path, state: State) -> State:
    """Returns the newest checkpoint of a run on the devices of `state`, or `state` if there is none yet."""
    with Checkpoints(run) as checkpoints:
        return state if checkpoints.latest_step is None else checkpoints.restore(state)


def _destination(leaf: Any) -> jax.ShapeDtypeStruct:
    """Returns shape, dtype and place of an array to restore: its own devices, or the first device of this process."""
    sharding = getattr(leaf, "sharding", None) or jax.sharding.SingleDeviceSharding(jax.local_devices()[0])
    return jax.ShapeDtypeStruct(leaf.shape, leaf.dtype, sharding=sharding)
