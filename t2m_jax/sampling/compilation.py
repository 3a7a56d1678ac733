"""Compiled programs kept on disk, so that only the first run of a model waits for the compiler."""

import os
from pathlib import Path

import jax
import platformdirs

DISABLE_VARIABLE = "T2M_JAX_NO_COMPILATION_CACHE"


def use_compilation_cache() -> Path | None:
    """Returns the folder of JAX's persistent compilation cache, having turned it on in the user's cache folder.

    A cache the user configured (`JAX_COMPILATION_CACHE_DIR`) is left alone; `T2M_JAX_NO_COMPILATION_CACHE=1` turns
    ours off, and so does a cache folder that cannot be written (None is returned).
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
    # Generation is many small programs: keep them all, not only those that took a second to compile.
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    return folder
