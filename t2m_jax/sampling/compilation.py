"""A cache of compiled programs on disk, so that only the first run of a model waits for the compiler."""

import logging
import os
import stat
from pathlib import Path

import jax
import platformdirs

logger = logging.getLogger(__name__)

DISABLE_VARIABLE = "T2M_JAX_NO_COMPILATION_CACHE"
SYSTEM = 0
"""Number of the user root, who can write everywhere."""


def use_compilation_cache() -> Path | None:
    """Turns on JAX's persistent compilation cache in the user's cache folder and returns its folder.

    A cache that the user has configured (`JAX_COMPILATION_CACHE_DIR`) is not changed. Returns None if
    `T2M_JAX_NO_COMPILATION_CACHE=1` turns the cache off, or if the folder cannot be written.

    Programs in the cache are native code that this process would run. So a folder in which others can write turns the
    cache off, with a warning.
    """
    if os.environ.get(DISABLE_VARIABLE):
        return None
    configured = jax.config.values["jax_compilation_cache_dir"]
    folder = Path(configured) if configured else Path(platformdirs.user_cache_dir("t2m_jax")) / "xla"
    try:
        if not configured:
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        problem = _writer(folder)
    except OSError:
        return None
    if problem:
        logger.warning("%s: compiled programs are not kept or read here: %s", folder, problem)
        jax.config.update("jax_compilation_cache_dir", None)
        return None
    if configured:
        return folder
    if not os.access(folder, os.W_OK):
        return None
    jax.config.update("jax_compilation_cache_dir", str(folder))
    # Generation consists of many small programs. By default, JAX keeps only those that took a second to compile.
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    return folder


def _writer(folder: Path) -> str:
    """Returns who else could put files into a folder, or put another in its place; "" if nobody can."""
    # Buckets of clouds have no modes, and Windows has other rights.
    if "://" in str(folder) or not hasattr(os, "getuid") or not folder.exists():
        return ""
    status = folder.stat()
    if status.st_uid not in (SYSTEM, os.getuid()):
        return "the folder belongs to somebody else"
    if status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        return "others can write in it; delete the folder, or give another JAX_COMPILATION_CACHE_DIR"
    for place in folder.resolve().parents:
        mode = place.stat().st_mode
        # In a folder with the sticky bit, such as /tmp, nobody can replace what others have put there.
        if mode & stat.S_IWOTH and not mode & stat.S_ISVTX:
            return f"everybody can write in {place}; `chmod o-w` it"
    return ""
