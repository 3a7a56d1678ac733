"""The package needs nothing that Windows does not have, and reads and writes UTF-8 on every system."""

import os
import subprocess
import sys

import pytest

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="imitates Windows with /proc")

START = """
import sys
from pathlib import Path
import tests.windows
folder = Path(sys.argv[1])
"""


def run_as_on_windows(program, folder):
    """Returns what a program prints in a process that has only what Windows has, in a system without UTF-8."""
    environ = os.environ | {"LC_ALL": "C", "PYTHONUTF8": "0", "T2M_JAX_NO_COMPILATION_CACHE": "1"}
    command = [sys.executable, "-X", "warn_default_encoding", "-c", START + program, str(folder)]
    result = subprocess.run(command, capture_output=True, encoding="utf-8", env=environ, check=False)
    assert result.returncode == 0, result.stderr[-3000:]
    return result.stdout


@pytest.mark.slow
def test_every_module_imports(tmp_path, repository):
    names = sorted(
        ".".join(path.relative_to(repository).with_suffix("").parts) for path in repository.glob("t2m_jax/**/*.py")
    )
    program = f"import importlib\nfor name in {names}:\n    name.endswith('__main__') or importlib.import_module(name)"
    run_as_on_windows(program, tmp_path)


FILES = """
import pytest
from t2m_jax.errors import UserError
from t2m_jax.files.locks import lock
from t2m_jax.files.writing import atomic_file, atomic_folder, save_text
(folder / "data").mkdir()  # may be replaced, because it is empty
with atomic_folder(folder / "data") as partial:
    save_text(partial / "caption.txt", "geht 5\\u00b0 h\\u00f6her")
save_text(folder / "data/caption.txt", "\\u6b69\\u304f")
with lock(folder / "data"), pytest.raises(UserError, match="exists already"), atomic_folder(folder / "data"):
    pass
assert [path.name for path in folder.rglob("*")] == ["data", "caption.txt"]
assert (folder / "data/caption.txt").read_text(encoding="utf-8") == "\\u6b69\\u304f"
"""


def test_files_folders_and_locks(tmp_path):
    run_as_on_windows(FILES, tmp_path)


GENERATE = """
from t2m_jax.cli.main import main
names = ["a.html", "a.gif", "a.bvh", "a.npz"]
outputs = [option for name in names for option in ("-o", str(folder / name))]
assert main(["generate", "a person walks to a caf\\u00e9", "--seed", "1", *outputs, "--debug"]) == 0
assert sorted(path.name for path in folder.iterdir()) == sorted(names)
for name in names[2:]:
    assert main(["view", str(folder / name), "-o", str(folder / "b.npz")]) == 0
assert main(["models", "demo"]) == 0
"""


@pytest.mark.release
def test_generation_saves_each_format_and_its_output_fits_the_terminal(tmp_path):
    assert r"\xa9" in run_as_on_windows(GENERATE, tmp_path)  # a sign of the card that ASCII lacks


TRAIN = """
import dataclasses
from t2m_jax.cli.main import main
from t2m_jax.config import save_config
from t2m_jax.data.importers.synthetic import write_synthetic_dataset
from tests.tiny import LOOP, vqvae_training
write_synthetic_dataset(folder / "data", num_clips=20, seed=3)
loop = dataclasses.replace(LOOP, num_steps=4)
save_config(folder / "run.yaml", vqvae_training(folder / "data", folder / "run", loop=loop))
assert main(["train", "vqvae", str(folder / "run.yaml"), "--debug"]) == 0
assert main(["train", "vqvae", "--run", str(folder / "run"), "--resume", "--loop.num-steps", "8", "--debug"]) == 0
assert main(["check", str(folder / "run")]) == 0
assert sorted(path.name for path in (folder / "run/checkpoints").iterdir()) == ["4", "8"]
"""


@pytest.mark.release
def test_training_writes_checkpoints_and_resumes(tmp_path):
    run_as_on_windows(TRAIN, tmp_path)


MEASURE = """
from t2m_jax import memory
from t2m_jax.bench import probes, timing
assert timing.peak_memory() is None
assert memory.host_memory() > 0
assert probes.describe_machine(()).num_cores > 0
"""


@pytest.mark.slow
def test_what_the_system_does_not_tell_is_left_out(tmp_path):
    run_as_on_windows(MEASURE, tmp_path)
