import os
import subprocess
import sys

import pytest

from t2m_jax.memory import _group_limits, host_memory

LIMITED = "import t2m_jax.memory as memory; print(memory.host_memory())"


def test_the_limit_of_every_group_counts(tmp_path):
    root = tmp_path / "cgroup"
    (root / "slice" / "scope").mkdir(parents=True)
    (root / "memory" / "jobs").mkdir(parents=True)
    (root / "slice" / "memory.max").write_text("4000\n")
    (root / "slice" / "scope" / "memory.max").write_text("max\n")
    (root / "memory" / "jobs" / "memory.limit_in_bytes").write_text("3000\n")
    (root / "memory" / "memory.limit_in_bytes").write_text("5000\n")
    table = tmp_path / "table"
    table.write_text("5:cpu,memory:/jobs/hidden\n1:cpuset:/jobs\n0::/slice/scope\n")
    assert sorted(_group_limits(table, root)) == [3000, 4000, 5000, sys.maxsize]
    assert list(_group_limits(tmp_path / "missing", root)) == []


def test_the_machine_has_some_memory():
    assert 1e6 < host_memory() <= sys.maxsize


@pytest.mark.skipif(sys.platform != "linux", reason="sets a limit as Linux does")
def test_a_limit_of_the_process_counts():
    command = f"ulimit -d 3000000; exec {sys.executable} -c '{LIMITED}'"
    found = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=True, env=os.environ)
    assert int(found.stdout) <= 3000000 * 1024
