"""How much memory there is: of an accelerator, and of the machine within the limits of this process."""

import os
import sys
from collections.abc import Iterator
from pathlib import Path

import jax

CGROUPS = (("", "", "memory.max"), ("memory", "memory", "memory.limit_in_bytes"))
"""Controller in /proc/self/cgroup, its folder and its file with the limit: of version 2 and of version 1."""


def device_memory(device: jax.Device) -> int:
    """Returns the bytes of memory that are free on a device; for a CPU, those that this process may use."""
    stats = device.memory_stats()
    return host_memory() if stats is None else stats["bytes_limit"] - stats["bytes_in_use"]


def host_memory() -> int:
    """Returns the bytes of memory that this process may use.

    This is what is available on the machine or, if that is less, the limit of a control group (containers, systemd,
    Slurm) or of `ulimit -v` and `ulimit -d`. Without a known limit it is `sys.maxsize`.
    """
    return min([_available(), *_group_limits(Path("/proc/self/cgroup"), Path("/sys/fs/cgroup")), *_process_limits()])


def _available() -> int:
    """Returns the memory that is free or can be freed; where the system does not tell, all that the machine has."""
    table = Path("/proc/meminfo")
    if table.exists():
        fields = dict(line.split(":", 1) for line in table.read_text(encoding="ascii").splitlines())
        return 1024 * int(fields["MemAvailable"].removesuffix("kB"))
    names = getattr(os, "sysconf_names", {})
    if {"SC_PHYS_PAGES", "SC_PAGE_SIZE"} <= names.keys():
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    return sys.maxsize


def _group_limits(table: Path, root: Path) -> Iterator[int]:
    """Yields the limits of this process's control group and of the groups that contain it."""
    for line in table.read_text(encoding="utf-8").splitlines() if table.exists() else ():
        _, controllers, group = line.split(":", 2)
        for controller, folder, name in CGROUPS:
            if controller not in controllers.split(",") or (controllers and not controller):
                continue
            place = root / folder / group.lstrip("/")
            for path in (place, *place.parents):
                # In a container, groups are named as on the machine, but only the container's own can be seen.
                if path.is_relative_to(root / folder) and (path / name).exists():
                    limit = (path / name).read_text(encoding="ascii").strip()
                    yield sys.maxsize if limit == "max" else int(limit)


def _process_limits() -> Iterator[int]:
    """Yields the limits of the address space and of the data of this process."""
    try:
        import resource
    except ImportError:  # Windows
        return
    for kind in (resource.RLIMIT_AS, resource.RLIMIT_DATA):
        limit = resource.getrlimit(kind)[0]
        yield sys.maxsize if limit == resource.RLIM_INFINITY else limit
