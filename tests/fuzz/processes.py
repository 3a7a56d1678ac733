"""Kills and races of real commands: what is on the disk is whole, and what goes on is the same to the last bit."""

import dataclasses
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from t2m_jax.checkpoints import load_model
from t2m_jax.checkpoints.run import Checkpoints
from t2m_jax.checkpoints.tokenizer import load_tokenizer
from t2m_jax.config import save_config
from t2m_jax.data.audit import audit_dataset
from t2m_jax.data.importers.synthetic import write_synthetic_dataset
from t2m_jax.files.arrays import read_arrays
from t2m_jax.files.reading import load_json
from t2m_jax.files.writing import PARTIAL
from t2m_jax.motion.formats import load_motion
from t2m_jax.train import train
from tests.data.bvh_files import write_bvh
from tests.fuzz.attack import Broken
from tests.tiny import LOOP as LOOP_OF_TESTS
from tests.tiny import gpt_training, vqvae_training

SIGNALS = (signal.SIGKILL, signal.SIGTERM) if os.name == "posix" else (signal.SIGTERM,)
EXIT_CODES = {signal.SIGTERM: (143, 0, -signal.SIGTERM), 9: (-9, 0)}
"""What a command may return after a signal; it may also have been finished before."""
MODEL = ["--model.num-codes", "16", "--model.code-dim", "8", "--model.width", "16", "--model.depth", "1"]
LOOP = [
    "--loop.num-steps",
    "30",
    "--loop.batch-size",
    "4",
    "--loop.checkpoint-every",
    "5",
    "--loop.validate-every",
    "0",
]


def start(arguments: Sequence[str], folder: Path) -> subprocess.Popen[str]:
    """Returns a running `t2m`."""
    return subprocess.Popen(
        [sys.executable, "-m", "t2m_jax", *arguments],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env=os.environ | {"JAX_PLATFORMS": "cpu", "TQDM_DISABLE": "1"},
    )


def finish(arguments: Sequence[str], folder: Path) -> float:
    """Runs a command to its end, and returns how many seconds it took."""
    before = time.monotonic()
    process = start(arguments, folder)
    output, _ = process.communicate()
    if process.returncode:
        raise Broken(f"{' '.join(arguments)}: returns {process.returncode}: {output[-300:]}")
    return time.monotonic() - before


class Command(NamedTuple):
    """A command that is interrupted again and again."""

    arguments: Sequence[str]
    result: str
    """The file or folder that it makes."""
    check: Callable[[Path], object]
    """Raises if the result is not whole."""
    resume: Sequence[str] | None = None
    """The command that goes on; None for a command that starts again."""


def _check_data(path: Path) -> None:
    problems = audit_dataset(path).problems
    if problems:
        raise Broken(problems[0])


def has_weights(path: Path) -> None:
    """Raises if a file with weights of the original's names is missing or damaged."""
    for name in ("vqvae", "gpt"):
        read_arrays(path / f"{name}.safetensors")


def _check_run(path: Path) -> None:
    with Checkpoints(path) as checkpoints:
        for step in checkpoints.steps():
            if damage := checkpoints.damage(step, thorough=True):
                raise Broken(damage)


TRAIN = ["train", "vqvae", "official", "--statistics", "data", "--data", "data", "--run", "run", *MODEL, *LOOP]
COMMANDS: Mapping[str, tuple[Command, ...]] = {
    "train": (
        Command(TRAIN, "run", _check_run, ["train", "vqvae", "--run", "run", "--resume"]),
        Command(
            ["train", "gpt", "gpt.yaml", "--run", "gpt-run"],
            "gpt-run",
            _check_run,
            ["train", "gpt", "--run", "gpt-run", "--resume"],
        ),
    ),
    "data": (
        Command(["data", "synthetic", "made", "--num-clips", "20"], "made", _check_data),
        Command(["data", "import", "bvh", "motions", "imported"], "imported", _check_data),
        Command(["data", "merge", "data", "data2", "merged"], "merged", _check_data),
    ),
    "models": (
        Command(["bundle", "model", "packed"], "packed", load_model),
        Command(["generate", "a man walks", "--model", "model", "-o", "a.npz"], "a.npz", load_motion),
        Command(["generate", "a man walks", "--model", "model", "-o", "a.bvh"], "a.bvh", load_motion),
        Command(["convert", "official", "--export-official", "model", "theirs"], "theirs", has_weights),
        Command(
            ["evaluate", "reconstruction", "--model", "model", "--data", "data", "--json", "report.json"],
            "report.json",
            load_json,
        ),
    ),
}
"""The groups of commands."""


def prepare(folder: Path) -> None:
    """Writes what the commands read."""
    write_synthetic_dataset(folder / "data", num_clips=20, seed=3)
    train(vqvae_training(folder / "data", folder / "tokenizer"))
    train(gpt_training(folder / "data", folder / "tokenizer", folder / "model"))
    loop = dataclasses.replace(LOOP_OF_TESTS, num_steps=16, checkpoint_every=2, validate_every=0)
    save_config(folder / "gpt.yaml", gpt_training(Path("data"), Path("tokenizer"), Path("gpt-run"), loop=loop))
    (folder / "motions").mkdir()
    for number in range(4):
        write_bvh(folder / "motions" / f"walk {number}.bvh", num_frames=40, seed=number)
        (folder / "motions" / f"walk {number}.txt").write_text("a person walks\n")
    finish(["data", "import", "bvh", "motions", "data2"], folder)


def kill_often(folder: Path, group: str, *, seed: int, count: int) -> Iterator[str]:
    """Interrupts commands of a group at random moments, `count` times, and yields what was seen each time.

    Raises:
        Broken: A result is not whole, something unfinished is left, or the command cannot be finished afterwards.
    """
    draws = random.Random(f"{group}{seed}")
    commands = COMMANDS[group][:count]
    seconds: dict[str, float] = {}
    right: dict[str, bytes] = {}
    for command in commands:
        finish(command.arguments, folder)  # compiles, and the next one finds that in the cache of JAX
        _remove(folder / command.result)
        seconds[command.result] = finish(command.arguments, folder)
        command.check(folder / command.result)
        right[command.result] = _contents(folder / command.result)
        _remove(folder / command.result)
    for number in range(count):
        command = commands[number % len(commands)]
        path = folder / command.result
        resume = command.resume if has_checkpoints(path) else None
        if command.resume is not None and resume is None:
            _remove(path)  # killed before its first checkpoint
        before = unfinished(folder)
        process = start(resume or command.arguments, folder)
        time.sleep(seconds[command.result] * draws.uniform(0.3, 1.05))
        sent = draws.choice(SIGNALS)
        process.send_signal(sent)
        output, _ = process.communicate()
        if process.returncode not in EXIT_CODES[sent]:
            raise Broken(f"{command.arguments}: returns {process.returncode} after {sent.name}: {output[-500:]}")
        if path.exists():
            command.check(path)
        if sent == signal.SIGTERM and (left := unfinished(folder) - before):
            raise Broken(f"{command.arguments}: leaves {sorted(left)[:5]} after {sent.name}")
        if process.returncode == 0 or (path.exists() and command.resume is None):
            _check_same(command, path, right[command.result])
            _remove(path)
        yield f"{command.arguments[0]} {sent.name} {process.returncode}"
    for command in commands:
        if command.resume is not None and (folder / command.result).exists():
            finish(command.resume, folder)
            _check_same(command, folder / command.result, right[command.result])
        _remove(folder / command.result)


def race_often(folder: Path, *, count: int) -> Iterator[str]:
    """Starts pairs of processes with one destination, and yields what they returned.

    Raises:
        Broken: Not exactly one of them makes a folder, what is made is not whole, or something unfinished is left.
    """
    commands = (*COMMANDS["data"], *COMMANDS["models"], *COMMANDS["train"])
    for number in range(count):
        command = commands[number % len(commands)]
        before = unfinished(folder)
        pair = [start(command.arguments, folder) for _ in range(2)]
        outputs = [process.communicate()[0] for process in pair]
        codes = sorted(process.returncode for process in pair)
        # A file may be replaced by whoever comes later; a folder may not.
        if codes != [0, 2] and (codes != [0, 0] or (folder / command.result).is_dir()):
            raise Broken(f"{command.arguments}: two at once return {codes}: {[text[-300:] for text in outputs]}")
        command.check(folder / command.result)
        if left := unfinished(folder) - before:
            raise Broken(f"{command.arguments}: two at once leave {sorted(left)[:5]}")
        _remove(folder / command.result)
        yield f"{' '.join(command.arguments[:2])} {codes}"


KEPT = (".npy", ".txt", ".safetensors")
"""Suffixes of files that are the same each time; others have the time in them."""


def _contents(path: Path) -> bytes:
    """Returns what must be the same in every result: the weights of a run, and the bytes of anything else."""
    if (path / "checkpoints").is_dir():
        load = load_model if (path / "bundle.yaml").exists() else load_tokenizer
        return load(path).fingerprint.encode()
    files = [path] if path.is_file() else sorted(file for file in path.rglob("*") if file.suffix in KEPT)
    if path.suffix == ".npz":
        return np.asarray(load_motion(path).positions).tobytes()
    return b"".join(file.read_bytes() for file in files if file.is_file() and ".t2m-cache" not in file.parts)


def _check_same(command: Command, path: Path, right: bytes) -> None:
    if _contents(path) != right:
        raise Broken(f"{command.arguments}: makes something else after it was interrupted")


def has_checkpoints(run: Path) -> bool:
    return (run / "checkpoints").is_dir() and any(path.name.isdecimal() for path in (run / "checkpoints").iterdir())


def unfinished(folder: Path) -> set[str]:
    """Returns the unfinished files and the locks in a folder. What a killed process leaves, a later one deletes."""
    names = (f"{path.relative_to(folder)}" for path in folder.rglob("*"))
    return {name for name in names if PARTIAL in name or name.endswith(".lock")}


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
