"""Reads mutated files: each is read or refused in one line, in little time and memory."""

import contextlib
import random
import shutil
import signal
import sys
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jax
import numpy as np

from t2m_jax.errors import UserError
from t2m_jax.files.manifest import MANIFEST, write_manifest
from tests.fuzz.mutations import mutate

MAX_SECONDS = 5
"""The longest that one input may take, in processor time."""
MAX_MEMORY = 10**9
"""The most memory in bytes that one input may need."""
MAX_RESERVED = 8 * 10**9
"""The most memory in bytes that may be reserved, used or not."""
MAX_MESSAGE = 400
"""Characters of a refusal, without the folder of the file."""


class Broken(Exception):  # noqa: N818 - it is no error of the project, but a finding
    """An input that is neither read nor refused as it should be."""


def check(read: Callable[[], object], folder: Path) -> bool:
    """Returns whether something was refused.

    Raises:
        Broken: It was refused in another way than with one line, or crashed.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            read()
    except UserError as error:
        message = str(error).replace(str(folder), "")
        if "\n" in message or len(message) > MAX_MESSAGE:
            raise Broken(f"a message of {len(message)} characters: {message[:300]!r}") from error
        return True
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # libraries written in Rust raise a `PanicException`, which is no `Exception`
        raise Broken(f"{type(error).__name__}: {str(error)[:300]}") from error
    return False


@contextlib.contextmanager
def limited() -> Iterator[None]:
    """Lets the body use `MAX_SECONDS` and `MAX_MEMORY`. The time is stopped where the system has alarms.

    Raises:
        Broken: It used more, also if it refused the input in the end.
    """
    late, memory = [], peak_memory()

    def stop(*_: Any) -> None:
        late.append(True)
        raise TimeoutError

    before = signal.signal(signal.SIGPROF, stop) if hasattr(signal, "SIGPROF") else None
    try:
        if before is not None:
            signal.setitimer(signal.ITIMER_PROF, MAX_SECONDS)
        with contextlib.suppress(TimeoutError):
            yield
    finally:
        if before is not None:
            signal.setitimer(signal.ITIMER_PROF, 0)
            signal.signal(signal.SIGPROF, before)
        # Raised here, because code may take a `TimeoutError` for a file that cannot be read.
        if late:
            raise Broken(f"takes more than {MAX_SECONDS} s")
        if peak_memory() - memory > MAX_MEMORY:
            raise Broken(f"takes {(peak_memory() - memory) / 1e9:.1f} GB")


def peak_memory() -> int:
    """Returns the most memory in bytes that this process ever had; 0 where the system does not say."""
    if sys.platform != "linux":
        return 0
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def limit_memory() -> None:
    """Protects the machine: the rest of this process can reserve `MAX_RESERVED` more than now. For Linux."""
    if sys.platform == "linux":
        import resource

        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
        limit = pages * resource.getpagesize() + MAX_RESERVED
        resource.setrlimit(resource.RLIMIT_AS, (limit, resource.RLIM_INFINITY))


def attack_file(root: Path, name: str, read: Callable[[Path], object], *, seed: int, count: int) -> int:
    """Reads `count` mutated versions of a file, and returns how many were refused. The file is intact afterwards.

    Raises:
        Broken: One of them was neither read nor refused. It stays next to the file, with `.broken` after its name.
    """
    path, draws, refused = root / name, random.Random(f"{name}{seed}"), 0
    whole = path.read_bytes()
    try:
        for _ in range(count):
            data = mutate(whole, draws)
            path.write_bytes(data)
            with limited():
                refused += check(lambda: read(root), root)
    except Broken as error:
        path.with_name(f"{path.name}.broken").write_bytes(data)
        raise Broken(f"{name}: {error}") from error
    finally:
        path.write_bytes(whole)
    return refused


def files_of(folder: Path) -> list[Path]:
    """Returns the files of a folder, without those that nothing reads."""
    unread = {"README.md"}
    return sorted(path for path in folder.rglob("*") if path.is_file() and path.name not in unread)


def attack_folder(root: Path, name: str, read: Callable[[Path], object], *, seed: int, count: int) -> int:
    """Reads versions of a folder with one mutated file and a manifest that fits it; like `attack_file`."""
    folder, draws, refused = root / name, random.Random(f"{name}{seed}"), 0
    paths, described = [path for path in files_of(folder) if path.name != MANIFEST], (folder / MANIFEST).exists()
    for _ in range(count):
        path = draws.choice(paths)
        whole = path.read_bytes()
        try:
            path.write_bytes(mutate(whole, draws))
            if described:
                write_manifest(folder)
            with limited():
                refused += check(lambda: read(root), root)
        except Broken as error:
            shutil.copytree(folder, f"{folder}.broken", dirs_exist_ok=True)
            raise Broken(f"{path.relative_to(root)}: {error}") from error
        finally:
            path.write_bytes(whole)
            if described:
                write_manifest(folder)
    return refused


def flip_bits(root: Path, name: str, read: Callable[[Path], dict[str, Any]], *, seed: int, count: int) -> int:
    """Flips single bits of a folder's files, and returns how many of them were refused.

    Raises:
        Broken: With one of them, other arrays than the right ones were returned, or the refusal was not right.
    """
    draws, refused, right = random.Random(f"{name}{seed}"), 0, jax.tree.map(np.array, jax.tree.leaves(read(root)))
    paths = [path for path in files_of(root / name) if path.stat().st_size]
    for _ in range(count):
        path = draws.choice(paths)
        whole = path.read_bytes()
        place, bit = draws.randrange(len(whole)), draws.randrange(8)
        try:
            path.write_bytes(whole[:place] + bytes([whole[place] ^ 1 << bit]) + whole[place + 1 :])
            found: list[Any] = []
            with limited():
                was_refused = check(lambda found=found: found.extend(jax.tree.leaves(read(root))), root)
            if not was_refused and not all(np.array_equal(*pair) for pair in zip(found, right, strict=True)):
                raise Broken("other arrays were returned")
            refused += was_refused
        except Broken as error:
            raise Broken(f"{path.relative_to(root)}, bit {bit} of byte {place}: {error}") from error
        finally:
            path.write_bytes(whole)
    return refused
