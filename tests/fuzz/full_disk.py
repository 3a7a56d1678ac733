"""Commands whose disk becomes full: one line names what could not be written, and older files stay."""

import contextlib
import errno
import os
import random
import shutil
import subprocess
from collections.abc import Iterator, Sequence
from pathlib import Path

from t2m_jax.cli.main import main
from tests.fuzz.attack import Broken
from tests.fuzz.processes import COMMANDS, Command, has_checkpoints, start, unfinished

PAGE = 4096
"""Space is given in units of this many bytes."""
LARGE = 100_000_000
"""More bytes than any of the commands writes."""
REASONS = tuple(os.strerror(number) for number in (errno.ENOSPC, errno.EFBIG))


class Mounted:
    """A small file system in memory. For Linux, with the right to mount."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._call("mount", "-t", "tmpfs", "-o", f"size={LARGE}", "none")

    def used(self) -> int:
        """Returns the bytes of all files."""
        return shutil.disk_usage(self.folder).used

    def limit(self, size: int) -> None:
        """Leaves as much space as `size` bytes need."""
        self._call("mount", "-o", f"remount,size={max(size, PAGE)}")

    def close(self) -> None:
        self._call("umount")

    def _call(self, *command: str) -> None:
        subprocess.run([*command, self.folder], check=True, capture_output=True)


class Limited:
    """A folder in which all files must be small, where nothing can be mounted. For POSIX."""

    def __init__(self, folder: Path) -> None:
        import resource

        self.folder, self._resource = folder, resource

    def used(self) -> int:
        """Returns the bytes of the largest file."""
        return max(path.stat().st_size for path in self.folder.rglob("*"))

    def limit(self, size: int) -> None:
        """Limits the size of all files that this process and new ones write."""
        _, most = self._resource.getrlimit(self._resource.RLIMIT_FSIZE)
        self._resource.setrlimit(self._resource.RLIMIT_FSIZE, (size, most))

    def close(self) -> None:
        _, most = self._resource.getrlimit(self._resource.RLIMIT_FSIZE)
        self._resource.setrlimit(self._resource.RLIMIT_FSIZE, (most, most))


Disk = Mounted | Limited


@contextlib.contextmanager
def small_disk(folder: Path) -> Iterator[Disk]:
    """Yields a folder whose space can be limited: a file system of its own if possible."""
    folder.mkdir(exist_ok=True)
    disk: Disk
    try:
        disk = Mounted(folder)
    except (OSError, subprocess.CalledProcessError):
        disk = Limited(folder)
    try:
        yield disk
    finally:
        disk.close()


def all_commands() -> list[Command]:
    """Returns the commands that are interrupted, too."""
    return [command for group in COMMANDS.values() for command in group]


def fill(folder: Path, disk: Disk, command: Command, share: float) -> str:
    """Runs a command on a disk with a share of the space that it needs, then with enough space.

    Returns:
        What it printed when the disk was full.

    Raises:
        Broken: It did not fail in one line that names a file, left something unfinished or cannot be run again.
    """
    path = disk.folder / command.result
    place = f"{disk.folder.name}/{command.result}"

    def placed(arguments: Sequence[str]) -> list[str]:
        return [place if argument == command.result else argument for argument in arguments]

    def run_here(arguments: Sequence[str], when: str) -> None:
        # A process would import and compile everything again.
        with contextlib.chdir(folder):
            code = main(placed(arguments))
        if code:
            raise Broken(f"{command.arguments}: returns {code} {when}")

    disk.limit(LARGE)
    old = disk.folder / "old.txt"
    old.write_text("older contents\n")
    run_here(command.arguments, "when there is space")
    needed = disk.used()
    _clear(path)
    disk.limit(int(needed * share))
    process = start(placed(command.arguments), folder)
    output, _ = process.communicate()
    code, line = process.returncode, output.splitlines()[-1]
    if code != 2 or place not in line or not any(reason in line for reason in REASONS) or "Traceback" in output:
        raise Broken(f"{command.arguments}: returns {code} when the disk is full: {output[-1000:]}")
    if old.read_text() != "older contents\n" or (left := unfinished(disk.folder)):
        raise Broken(f"{command.arguments}: leaves {sorted(left)[:5]} when the disk is full")
    if path.exists():
        command.check(path)
    disk.limit(LARGE)
    if command.resume is not None and not has_checkpoints(path):
        _clear(path)
    goes_on = command.resume if has_checkpoints(path) else None
    run_here(goes_on or command.arguments, "after the disk was full")
    command.check(path)
    _clear(path)
    return output


def fill_often(folder: Path, *, seed: int, count: int) -> Iterator[str]:
    """Runs the commands in turn, `count` times, on a disk with a random share of the space that they need."""
    draws, commands = random.Random(f"full{seed}"), all_commands()
    with small_disk(folder / "disk") as disk:
        for number in range(count):
            command = commands[number % len(commands)]
            fill(folder, disk, command, draws.uniform(0.02, 0.9))
            yield f"{command.arguments[0]} {type(disk).__name__.lower()}"


def _clear(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
