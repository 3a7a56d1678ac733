"""Memory that commands which train keep after they have freed it."""

import ctypes
import os
import subprocess
import sys

import pytest

SIZE = 2**28
PROGRAM = f"""
from pathlib import Path
from t2m_jax.cli.allocation import keep_freed_memory
keep_freed_memory()
values = bytes({SIZE}) + b"x"
del values
print(Path("/proc/self/statm").read_text().split()[1])
"""


@pytest.mark.skipif(sys.platform != "linux" or not hasattr(ctypes.CDLL(None), "mallopt"), reason="needs glibc")
@pytest.mark.parametrize(("first", "is_kept"), [("", True), ("import jax", False)])
def test_freed_memory_is_kept_unless_jax_has_begun(first, is_kept):
    command = [sys.executable, "-c", first + PROGRAM]
    pages = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert (int(pages) * os.sysconf("SC_PAGE_SIZE") > SIZE) == is_kept
