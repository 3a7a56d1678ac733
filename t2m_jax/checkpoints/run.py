"""A run directory: the resolved config, the statistics and the checkpoints of one training run."""

import concurrent.futures
import contextlib
import dataclasses
import errno
import logging
import os
import secrets
import shutil
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import jax

from t2m_jax.config import config_text, load_versioned, save_config
from t2m_jax.distributed import is_writer, wait_for_all
from t2m_jax.errors import UserError
from t2m_jax.files.manifest import MANIFEST, check_folder, load_sealed, save_sealed, write_manifest
from t2m_jax.files.reading import first_line
from t2m_jax.files.writing import PARTIAL, commit_folder

logger = logging.getLogger(__name__)

CONFIG_FILE = "config.yaml"
INFO_FILE = "run.yaml"
DATA_FILE = "training_data.json"
CHECKPOINTS = "checkpoints"
STARTED = ".started"
"""In a folder that is not yet a run: what is there is of a start that was interrupted, and may be written again."""

FORMAT_VERSION = 4
"""Version of runs: checkpoints have manifests, and `config.yaml` has a checksum."""

DELETE_TRIES = 50
"""After Orbax has failed, its threads write for a moment. So their files are deleted again and again."""
QUIET_TRIES = 5
"""Tries without new files after which the threads have ended."""
DELETE_SECONDS = 0.1

CONSTANT_FILES = ("*.npy", "*.yaml", "*.json", "words.txt", f"*/{MANIFEST}")
"""What a run keeps as it was at its start: statistics, sizes, words, and the manifest of the copy of its tokenizer, by
which it knows that copy."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class RunInfo:
    """The file that makes a folder a run directory."""

    kind: str
    """What was trained, such as `vqvae`, `gpt` or `evaluator`."""
    format_version: int = FORMAT_VERSION
    """Layout of the directory, and the random streams of its updates."""
    data: str | None = None
    """Fingerprints of the parts of the data set; null if they are not known."""


def run_info(path: Path) -> RunInfo:
    """Returns what a run directory contains.

    Raises:
        UserError: The folder is not a run directory, or of an unknown version.
    """
    if not is_run(path):
        raise UserError(f"{path}: not a run directory (it has no {INFO_FILE})")
    return load_versioned(path / INFO_FILE, RunInfo, version=FORMAT_VERSION)


def is_run(path: Path) -> bool:
    """Returns whether a folder was written by training."""
    return (path / INFO_FILE).is_file()


def begin_run(path: Path) -> None:
    """Makes the folder of a run that is started, with a file that says so until `create_run`."""
    path.mkdir(parents=True, exist_ok=True)
    (path / STARTED).touch()


def foreign_file(path: Path) -> str:
    """Returns the name of a file in a folder that no interrupted start of a run has left; empty if there is none."""
    if not path.is_dir() or (path / STARTED).exists():
        return ""
    return min((entry.name for entry in path.iterdir() if not entry.name.startswith(".")), default="")


def create_run(path: Path, kind: str, config: Any, *, data: str | None = None) -> None:
    """Makes a folder a run directory; call this when everything else that a run needs is in the folder.

    `data` are the fingerprints of the data set.
    """
    (path / CONFIG_FILE).unlink(missing_ok=True)  # of an interrupted start; it changes when a run is extended
    write_manifest(path, CONSTANT_FILES)
    save_run_config(path, config)
    # Last, because a folder without this file is not a run: an interrupted start can simply be repeated.
    save_config(path / INFO_FILE, RunInfo(kind=kind, data=data))
    (path / STARTED).unlink(missing_ok=True)


def save_run_config(path: Path, config: Any) -> None:
    """Writes the config of a run. It ends with its own checksum, because a resumed run writes it again."""
    save_sealed(path / CONFIG_FILE, config_text(config, source=f"{path / CONFIG_FILE}"))


def run_config_text(path: Path) -> str:
    """Returns the config of a run as it was written, without its checksum.

    Raises:
        UserError: It has changed since the run wrote it.
    """
    return load_sealed(path / CONFIG_FILE)


class Checkpoints:
    """The checkpoints of a run: folders named by the step.

    Each is written under a temporary name, gets its manifest and is renamed, so none is ever incomplete. Damaged ones
    are found by their manifests, and the newest intact one counts.
    """

    def __init__(self, run: Path, *, keep: int | None = None):
        """Opens the folder, which is created if it is missing; the newest `keep` checkpoints are kept."""
        import orbax.checkpoint as ocp  # here, because generation from a bundle does not need it

        self._ocp = ocp
        self._run = run
        self._keep = keep
        self._folder = (run / CHECKPOINTS).resolve()
        self._folder.mkdir(parents=True, exist_ok=True)
        # Orbax's CheckpointManager is not used, because a manifest could not cover its folders. After its only hook, it
        # changes `_CHECKPOINT_METADATA`, adds `commit_success.txt` and renames the folder. A manifest that the hook
        # writes does not fit these two files, and one that is written after the name can be lost when the process is
        # killed.
        self._checkpointer = ocp.AsyncCheckpointer(ocp.CompositeCheckpointHandler())
        # Saving continues while training does; the next save and closing wait for it.
        self._thread = concurrent.futures.ThreadPoolExecutor(1)
        self._unfinished: concurrent.futures.Future[None] | None = None
        self._saves = False

    def __enter__(self) -> "Checkpoints":
        return self

    def __exit__(self, *error: object) -> None:
        try:
            self._finish()
        finally:
            self._thread.shutdown()
            self._checkpointer.close()
            if self._saves:  # what is unfinished may be another process's
                self._delete_unfinished()

    def steps(self) -> list[int]:
        """Returns the steps of all checkpoints, the newest first."""
        self._finish()
        return self._finished_steps()

    def _finished_steps(self) -> list[int]:
        names = [path.name for path in self._folder.iterdir() if path.is_dir()]
        # `isdecimal` also accepts other scripts' digits and `007`, which would be deleted and restored as `7`.
        return sorted((int(name) for name in names if name.isdecimal() and str(int(name)) == name), reverse=True)

    def damage(self, step: int, *, thorough: bool = False) -> str:
        """Returns what is wrong with a checkpoint, "" if it is as it was written; see `check_folder`."""
        try:
            check_folder(self._folder / str(step), thorough=thorough)
        except UserError as error:
            return str(error)
        return ""

    def newest_intact(self) -> tuple[int | None, dict[int, str]]:
        """Returns the step of the newest intact checkpoint, and what is wrong with those that are newer."""
        problems: dict[int, str] = {}
        for step in self.steps():
            if not (problem := self.damage(step)):
                return step, problems
            problems[step] = problem
        return None, problems

    def set_aside_damaged(self) -> None:
        """Renames damaged checkpoints that are newer than the newest intact one, and says so.

        Raises:
            UserError: There are checkpoints, but all of them are damaged.
        """
        newest, problems = self.newest_intact()
        if newest is None and problems:
            raise UserError(f"{next(iter(problems.values()))} (no older checkpoint is intact)")
        # Renamed, because a step that has a folder would not be saved again. Not deleted, because somebody may still
        # read parts of them.
        for step, problem in problems.items():
            aside = self._folder / f"damaged-{step}-{secrets.token_hex(3)}"
            (self._folder / str(step)).rename(aside)
            logger.warning("%s; checkpoint %d is set aside as %s", problem, step, aside.name)

    def save(self, step: int, state: Any) -> None:
        """Writes a checkpoint unless this step has one; every field of the state that contains arrays is one item.

        Raises:
            UserError: This checkpoint or the one before it cannot be written.
        """
        if step in self.steps():
            return
        args = self._ocp.args
        # Orbax refuses items without arrays, and items that are one bare array: so each is in a dictionary below.
        fields = {name: value for name, value in state._asdict().items() if jax.tree.leaves(value)}
        items = {name: args.StandardSave({name: value}) for name, value in fields.items()}
        # Two phases: Orbax writes all files and commits them under this name. Only then can checksums be taken, and
        # only after these are on the disk does the folder get its number.
        partial = self._folder / f".{step}{PARTIAL}"
        self._saves = True
        self._delete_unfinished()
        # Process 0 deletes. The others may not write before it has finished.
        wait_for_all("save")
        with self._writing(step):
            self._checkpointer.save(partial, args=args.Composite(**items))
        self._unfinished = self._thread.submit(self._commit, step, partial)
        if jax.process_count() > 1:  # the others may only continue when it has its name
            self._finish()
            wait_for_all("saved")

    def _commit(self, step: int, partial: Path) -> None:
        """Gives a checkpoint its manifest and its name, and deletes those that are too old."""
        with self._writing(step):
            self._checkpointer.wait_until_finished()
            if not is_writer():
                return
            write_manifest(partial)
            commit_folder(partial, self._folder / str(step))
        # After the new one has its name, so that a kill at any moment leaves at least `keep` checkpoints.
        for old in self._finished_steps()[self._keep :] if self._keep else ():
            self._delete(old)

    def _delete(self, step: int) -> None:
        # Renamed, so that a kill in the middle does not leave half of a checkpoint. It goes with the next save.
        leftover = self._folder / f".{step}{PARTIAL}"
        with contextlib.suppress(OSError):  # what cannot be deleted does no harm
            shutil.rmtree((self._folder / str(step)).rename(leftover))

    @contextlib.contextmanager
    def _writing(self, step: int) -> Iterator[None]:
        try:
            yield
        except (OSError, ValueError, RuntimeError) as error:  # what Orbax raises for a full disk
            no_space = os.strerror(errno.ENOSPC)
            reason = no_space if no_space in str(error) else first_line(error)
            path = self._folder / str(step)
            raise UserError(f"{path}: the checkpoint cannot be written ({reason}); make room, then resume") from error

    def _delete_unfinished(self) -> None:
        """Deletes what could not be written, or what a killed process left."""
        quiet = QUIET_TRIES  # nothing has failed: one look is enough
        for _ in range(DELETE_TRIES if is_writer() else 0):
            leftovers = list(self._folder.glob(f".*{PARTIAL}*"))
            for leftover in leftovers:
                shutil.rmtree(leftover, ignore_errors=True)
            quiet = 0 if leftovers else quiet + 1
            if quiet > QUIET_TRIES:
                break
            time.sleep(DELETE_SECONDS)

    def _finish(self) -> None:
        """Waits for the save in progress."""
        if self._unfinished is not None:
            # Forgotten first: an error is raised once, and not again when the folder is closed.
            unfinished = self._unfinished
            self._unfinished = None
            unfinished.result()

    def restore_fields(self, like: Mapping[str, Any]) -> dict[str, Any]:
        """Returns some fields of the newest intact checkpoint, each in the structure of `like`.

        Raises:
            UserError: There is no checkpoint, or it does not fit.
        """
        step, problems = self.newest_intact()
        if step is None:
            raise UserError(next(iter(problems.values()), f"{self._run}: has no checkpoint yet; train it first"))
        for problem in problems.values():
            logger.warning("%s; checkpoint %d is used instead", problem, step)
        return self.restore_step(step, like)

    def restore_step(self, step: int, like: Mapping[str, Any]) -> dict[str, Any]:
        """Returns some fields of one checkpoint, each in the structure of `like`.

        Raises:
            UserError: It does not fit.
        """
        args = self._ocp.args
        saved = {name: value for name, value in like.items() if jax.tree.leaves(value)}
        # Without a sharding, Orbax takes that of the file, whose devices this machine may not have.
        shapes = jax.tree.map(_destination, saved)
        items = {name: args.StandardRestore({name: value}) for name, value in shapes.items()}
        try:
            restored = self._checkpointer.restore(self._folder / str(step), args=args.Composite(**items))
        except Exception as error:  # Orbax and TensorStore raise all kinds, also `Exception` itself
            problem = f"is damaged or does not fit its config ({first_line(error)})"
            raise UserError(f"{self._run}: checkpoint {step} {problem}") from error
        return dict(like) | {name: restored[name][name] for name in saved}


def newest_step(run: Path) -> int:
    """Returns the updates of the newest checkpoint of a run; 0 if there is none."""
    with Checkpoints(run) as checkpoints:
        return max(checkpoints.steps(), default=0)


def restore_latest(run: Path, state: Any) -> Any:
    """Returns the newest checkpoint of a run on the devices of `state`, or `state` if there is none yet.

    Newer checkpoints that are damaged are set aside.
    """
    with Checkpoints(run) as checkpoints:
        if is_writer():
            # One process renames, and the others wait: all must resume from the same step.
            checkpoints.set_aside_damaged()
        wait_for_all("checked")
        steps = checkpoints.steps()
        return type(state)(**checkpoints.restore_step(steps[0], state._asdict())) if steps else state


def _destination(leaf: Any) -> jax.ShapeDtypeStruct:
    """Returns shape, dtype and place of an array to restore: its own devices, or the first device of this process."""
    sharding = getattr(leaf, "sharding", None) or jax.sharding.SingleDeviceSharding(jax.local_devices()[0])
    return jax.ShapeDtypeStruct(leaf.shape, leaf.dtype, sharding=sharding)
