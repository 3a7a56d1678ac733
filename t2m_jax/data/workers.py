"""Work in several processes."""

import contextlib
import functools
import multiprocessing
from collections.abc import Callable, Iterable, Iterator
from typing import Any, TypeAlias

Mapper: TypeAlias = Callable[..., Iterable[Any]]


@contextlib.contextmanager
def map_in_processes(workers: int) -> Iterator[Mapper]:
    """Yields what applies a function to many arguments, in as many processes."""
    if workers == 1:
        yield map
        return
    # Fresh interpreters, because forking a process in which JAX has threads may hang.
    with multiprocessing.get_context("spawn").Pool(workers) as pool:
        yield functools.partial(pool.imap, chunksize=8)
