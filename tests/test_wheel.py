"""The package as users get it: a wheel in a new environment, in which the commands of the README run as written."""

import os
import re
import subprocess
import sys
import venv
import zipfile

import numpy as np
import pytest

from t2m_jax.data.importers.synthetic import KINDS, make_motion
from t2m_jax.motion.record import Motion
from tests.conftest import REPOSITORY

# Options that make the long commands short.
SHORTENED = {
    "t2m train": "--loop.num_steps 2 --loop.batch_size 4 --loop.validate_every 0",
    "t2m train evaluator": "--movement_steps 2",
    "t2m evaluate generation": "--num-repeats 1",
}
# CLIP has 600 MB. The conversion of the published weights that is written before this command is tested.
NEEDS_CLIP = ("t2m generate", "--model t2m-gpt ")


def readme_commands():
    """Returns the `t2m` commands of the README in their order, without comments."""
    text = (REPOSITORY / "README.md").read_text(encoding="utf-8")
    blocks = "".join(re.findall(r"```sh\n(.*?)```", text, re.DOTALL)).replace("\\\n", " ")
    return [line.partition("  #")[0].strip() for line in blocks.splitlines() if line.startswith("t2m ")]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wheel")
    command = [
        sys.executable,
        "-m",
        "pip",
        "wheel",
        "--quiet",
        "--no-deps",
        "--wheel-dir",
        f"{folder}",
        f"{REPOSITORY}",
    ]
    subprocess.run(command, check=True, cwd=folder)
    (path,) = folder.glob("*.whl")
    return path


@pytest.fixture(scope="module")
def programs(wheel, tmp_path_factory):
    """The folder of the programs of a new environment that has the wheel and what it needs, and nothing else."""
    folder = tmp_path_factory.mktemp("environment")
    venv.create(folder, with_pip=True)
    programs = folder / ("Scripts" if os.name == "nt" else "bin")
    subprocess.run([programs / "python", "-m", "pip", "install", "--quiet", wheel], check=True, cwd=folder)
    return programs


@pytest.fixture(scope="module")
def folder(tmp_path_factory, golden_dir):
    """A folder with the files that the README's commands read."""
    folder = tmp_path_factory.mktemp("work")
    (folder / "my-bvh").mkdir()
    rows = ["file,caption"]
    for number in range(220):  # so that the test split has 32 clips, as R-precision needs
        kind = list(KINDS)[number % len(KINDS)]
        name = f"{number}.bvh"
        Motion(make_motion(kind, seed=number, num_frames=60), 20.0).save(folder / "my-bvh" / name)
        rows.append(f"{name},a person does {kind}")
    (folder / "my-bvh" / "captions.csv").write_text("\n".join(rows) + "\n")
    for name, published in {"net_last": "ckpt_vqvae_small", "net_best_fid": "ckpt_gpt_small"}.items():
        (folder / f"{name}.pth").write_bytes((golden_dir / "t2m_gpt" / f"{published}.pth").read_bytes())
    (folder / "card.md").write_text("---\nlicense: cc0-1.0\n---\n# Mine\n")
    for name in ("mean", "std"):
        np.save(folder / f"{name}.npy", np.ones(263))
    return folder


@pytest.mark.slow
def test_the_wheel_has_what_is_not_python(wheel):
    names = set(zipfile.ZipFile(wheel).namelist())
    configs = REPOSITORY / "configs"
    expected = {f"t2m_jax/configs/{path.relative_to(configs).as_posix()}" for path in configs.rglob("*.yaml")}
    assert expected | {"t2m_jax/py.typed", "t2m_jax/bundles/demo/weights.safetensors"} <= names
    assert not [name for name in names if name.startswith(("tests/", "configs/"))]


@pytest.mark.slow
def test_the_commands_of_the_readme_run(programs, folder, hub):
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    environment |= {"PATH": f"{programs}{os.pathsep}{environment['PATH']}", "JAX_DISABLE_MOST_OPTIMIZATIONS": "1"}
    environment |= hub.settings(folder / "home")
    commands = [command for command in readme_commands() if not all(part in command for part in NEEDS_CLIP)]
    assert len(commands) > 15
    for command in commands:
        options = " ".join(short for start, short in SHORTENED.items() if command.startswith(start))
        done = subprocess.run(
            f"{command} {options}", shell=True, cwd=folder, env=environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, f"{command} {options}: {done.stderr[-2000:]}"
    assert set(hub.repositories) == {"user/my-model"}
    assert {"turn.html", "turn.gif", "many-7.gif", "my-model", "it.html", "mine.json"} <= {
        path.name for path in folder.iterdir()
    }
