"""A cache of compiled programs on disk, so that only the first run of a model waits for the compiler."""

import os
from pathlib import Path

import jax
import platformdirs

DISABLE_VARIABLE = "T2M_JAX_NO_COMPILATION_CACHE"


def use_compilation_cache() -> Path | None:
    """Turns on JAX's persistent compilation cache in the user's cache folder and returns its folder.

    A cache that the user has configured (`JAX_COMPILATION_CACHE_DIR`) is not changed. Returns None if
    `T2M_JAX_NO_COMPILATION_CACHE=1` turns the cache off, or if the folder cannot be written.
    """
    if os.environ.get(DISABLE_VARIABLE):
        return None
    configured = jax.config.values["jax_compilation_cache_dir"]
    if configured:
        return Path(configured)
    folder = Path(platformdirs.user_cache_dir("t2m_jax")) / "xla"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return None
    if not os.access(folder, os.W_OK):
        return None
    jax.config.update("jax_compilation_cache_dir", str(folder))
    # Generation consists of many small programs. By default, JAX keeps only those that took a second to compile.
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    return folder
