"""A run directory: the resolved config, statistics and checkpoints of one training run."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, Protocol, TypeVar, runtime_checkable

import jax
import jax.numpy as jnp
import orbax.checkpoint as ocp

from t2m_jax.config import load_config, save_config
from t2m_jax.errors import UserError

RunKind = Literal["vqvae", "gpt", "evaluator"]


@runtime_checkable
class NamedFields(Protocol):
    """What any `NamedTuple` is."""

    def _asdict(self) -> dict[str, Any]: ...


State = TypeVar("State", bound=NamedFields)

CONFIG_FILE = "config.yaml"
INFO_FILE = "run.yaml"
CHECKPOINTS = "checkpoints"

_DAMAGED = (OSError, LookupError, ValueError, TypeError, AttributeError, RuntimeError)
"""What Orbax raises on damaged files: it uses their metadata without looking whether they are what it expects."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class RunInfo:
    """What a run directory says of itself."""

    kind: RunKind
    """What was trained."""
    format_version: int = 1
    """Layout of the directory."""


def run_info(path: Path) -> RunInfo:
    """Returns what a run directory holds.

    Raises:
        UserError: if it is no run directory.
    """
    if not (path / INFO_FILE).is_file():
        raise UserError(f"{path}: not a run directory (it has no {INFO_FILE})")
    return load_config(path / INFO_FILE, RunInfo)


def is_run_directory(path: Path) -> bool:
    """Returns whether training wrote this folder."""
    return (path / INFO_FILE).is_file()


def refuse_existing_run(path: Path) -> None:
    """Raises `UserError` where a new run would write over another."""
    if is_run_directory(path):
        raise UserError(f"{path}: holds a run already; add --resume to go on with it, or choose another run")


def create_run(path: Path, kind: RunKind, config: Any) -> None:
    """Makes a folder a run directory, with its config; to be called when everything else that a run needs is in it.

    Raises:
        UserError: if there is one already.
    """
    refuse_existing_run(path)
    path.mkdir(parents=True, exist_ok=True)
    save_config(path / CONFIG_FILE, config)
    # Last: a folder without it is not a run, so a start that was interrupted can simply be repeated.
    save_config(path / INFO_FILE, RunInfo(kind=kind))


class Checkpoints:
    """The checkpoints of a run; each is written beside the others and renamed, so none is ever half there."""

    def __init__(self, run: Path, *, keep: int | None = None):
        """Opens (and makes, if needed) the folder; `keep` is how many of the newest stay."""
        folder = (run / CHECKPOINTS).resolve()
        folder.mkdir(parents=True, exist_ok=True)
        options = ocp.CheckpointManagerOptions(max_to_keep=keep, enable_async_checkpointing=False)
        self._manager = ocp.CheckpointManager(folder, options=options)
        self._run = run

    @property
    def latest_step(self) -> int | None:
        """The step of the newest checkpoint, None where there is none."""
        return self._manager.latest_step()

    def save(self, step: int, state: NamedFields) -> None:
        """Writes a checkpoint, once a step: every field of the state that holds arrays is an item of its own."""
        if step != self.latest_step:
            items = {
                name: ocp.args.StandardSave({name: value})
                for name, value in state._asdict().items()
                if jax.tree.leaves(value)
            }
            self._manager.save(step, args=ocp.args.Composite(**items))

    def restore(self, like: State) -> State:
        """Returns the newest checkpoint in the structure of `like`, a state of arrays or shape structs.

        Raises:
            UserError: if there is none, or it does not fit.
        """
        return type(like)(**self.restore_fields(like._asdict()))

    def restore_fields(self, like: Mapping[str, Any]) -> dict[str, Any]:
        """Returns some fields of the newest checkpoint, each in the structure of `like`.

        Raises:
            UserError: if there is none, or it does not fit.
        """
        step = self.latest_step
        if step is None:
            raise UserError(f"{self._run}: no checkpoint yet; train it first")
        held = {name: value for name, value in like.items() if jax.tree.leaves(value)}
        shapes = jax.tree.map(ocp.utils.to_shape_dtype_struct, held)
        items = {name: ocp.args.StandardRestore({name: value}) for name, value in shapes.items()}
        try:
            restored = self._manager.restore(step, args=ocp.args.Composite(**items))
        except _DAMAGED as error:
            reason = next(iter(str(error).splitlines()), type(error).__name__)
            raise UserError(
                f"{self._run}: checkpoint {step} does not fit its config or is damaged ({reason})"
            ) from error
        return dict(like) | {name: restored[name][name] for name in held}

    def close(self) -> None:
        """Ends background work."""
        self._manager.close()


def restore_latest(run: Path, state: State) -> State:
    """Returns the newest checkpoint of a run in the structure of `state`, or `state` where there is none yet."""
    checkpoints = Checkpoints(run)
    try:
        if checkpoints.latest_step is None:
            return state
        # Orbax ties arrays to a device, for which steps would be compiled anew.
        return jax.tree.map(jnp.array, jax.device_get(checkpoints.restore(state)))
    finally:
        checkpoints.close()
