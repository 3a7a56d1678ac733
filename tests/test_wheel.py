"""The package as users get it: a wheel in a new environment, in which the commands of the pages run as written."""

import os
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

from t2m_jax.cli.main import FIRST_COMMANDS
from t2m_jax.data.importers.synthetic import KINDS, make_motion
from t2m_jax.motion.motion import Motion
from tests.conftest import REPOSITORY
from tests.documents import PAGES, code_blocks, commands, name_of
from tests.motion.character_files import write_character
from tests.motion.rig.test_retarget import BANDAI
from tests.one_process import shared_process
from tests.sentence_golden import wide_encoder

TRAINING = "--loop.num_steps 2 --loop.batch_size 4 --loop.validate_every 0"
# Parts of commands with options that make them short. Options of all parts are added.
SHORTENED = {
    r"t2m train .* --run (?!.*--resume)": TRAINING,
    r"--resume .*--loop.num_steps": "--loop.num_steps 3",
    r"t2m train evaluator": "--movement_steps 2",
    r"t2m evaluate generation": "--num-repeats 2",
    r"t2m data replay": "--num-clips 8",
    r"-o many.gif": "--num-samples 1",
}
MEASUREMENT = "hours on a data set that must be downloaded; test_documents.py and test_configs.py check the options"
# Text encoders that the stand-in for the hub has, with the weights of a small one.
ENCODERS = {f"sentence-transformers/{name}" for name in ("all-MiniLM-L6-v2", "paraphrase-multilingual-MiniLM-L12-v2")}
# Pages and parts of commands, and why they are not run.
NOT_RUN = {
    "docs/ablations.md": MEASUREMENT,
    "docs/benchmark.md": MEASUREMENT,
    "docs/demo_model.md": MEASUREMENT,
    "docs/evaluation.md": MEASUREMENT,
    "docs/hifigpt.md": MEASUREMENT,
    "docs/paper_and_code.md": MEASUREMENT,
    "docs/results.md": MEASUREMENT,
    "data/bandai-namco": MEASUREMENT,
    "demo.json": "the report of such a measurement",
    "train vqvae official": MEASUREMENT,
    "train gpt official": MEASUREMENT,
    "t2m data compose": "thousands of motions of labeled clips; tests/data/test_composing.py makes some",
    "data/humanml3d": "HumanML3D is made from data that need a registration",
    "finest.tar": "the published evaluator is not part of the repository; tests/checkpoints converts small ones",
    "--model t2m-gpt ": "CLIP has 600 MB; the conversion before this command is run",
    "--evaluation.evaluator": "its 22 clips for validation do not fill a batch; tests/train has such trainings",
    "docs/performance.md": "minutes of measurements of the machine; tests/bench runs small ones",
    "docs/systems.md": "the package that the page describes is not installed; tests/third_system runs the commands",
    "CUDA_VISIBLE_DEVICES": "needs two GPUs; tests/devices and test_distributed.py have virtual ones",
    "my-demo": "reading thousands of sentences takes minutes; tests/train teaches small models",
    "t2m export": "needs the extra `onnx`; tests/export exports small models",
    "t2m serve": "it serves until it is stopped; tests/serving starts servers",
    "--distributed": "needs a cluster; test_distributed.py starts processes",
}
# Characters with which a command needs a shell.
SHELL = set("|&;<>*?~`$")


def is_run(page, command):
    return not any(part in command or part == name_of(page) for part in NOT_RUN)


def steps(pages):
    """Returns language and code of what is run, in order: each command once, and the Python blocks of how-tos."""
    found = [("sh", command) for command in commands(FIRST_COMMANDS)]
    for page in pages:
        for language, text in code_blocks(page, "sh|python" if page.parent.name == "howto" else "sh"):
            parts = [text] if language == "python" else [part for part in commands(text) if is_run(page, part)]
            found += [(language, part) for part in parts]
    return list(dict.fromkeys(found))


def options_of(command):
    return " ".join(options for part, options in SHORTENED.items() if re.search(part, command))


def need_process(found):
    """Returns the commands that run in a process of their own.

    These are the first commands that users see, the first of each kind, which must not depend on what others have
    imported, those that need a shell, and evaluations, which are compiled in another way.
    """
    kinds = {}
    shell = [code for language, code in found if language == "sh"]
    for code in shell:
        kinds.setdefault(re.search(r"t2m (train|[a-z]+( [a-z]+(?= |$))?)", code)[1], code)
    rest = {code for code in shell if "evaluate generation" in code or code[:4] != "t2m " or SHELL & set(code)}
    return {*commands(FIRST_COMMANDS), *kinds.values()} | rest


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
    uv = [sys.executable, "-m", "uv"]
    subprocess.run([*uv, "venv", "--quiet", "--python", sys.executable, "environment"], check=True, cwd=folder)
    programs = folder / "environment" / ("Scripts" if os.name == "nt" else "bin")
    install = ["pip", "install", "--quiet", "--python", f"{programs / 'python'}", f"{wheel}[plot,video]"]
    subprocess.run([*uv, *install], check=True, cwd=folder)
    return programs


@pytest.fixture
def folder(tmp_path, golden_dir):
    """A folder with the files that the commands of the pages read."""
    folder = tmp_path / "work"
    folder.mkdir()
    (folder / "my-bvh").mkdir()
    rows = ["file,caption"]
    for number in range(220):  # so that the test split has 32 clips, as R-precision needs
        kind = list(KINDS)[number % len(KINDS)]
        name = f"{number}.bvh"
        # Of other lengths, because those of one kind would be equal: copies in two splits are a fault of a data set.
        frames = 60 + number // len(KINDS)
        Motion(make_motion(kind, seed=number, num_frames=frames), 20.0).save(folder / "my-bvh" / name)
        rows.append(f"{name},a person does {kind}")
    (folder / "my-bvh" / "captions.csv").write_text("\n".join(rows) + "\n")
    shutil.copy(folder / "my-bvh" / "0.bvh", folder / "take_07.bvh")
    for name in ("hero.glb", "avatar.vrm"):
        write_character(folder / name, BANDAI)
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
    expected |= {"t2m_jax/serving/page/index.html", "t2m_jax/export/viewer/vendor/three.min.js"}
    expected |= {"t2m_jax/export/viewer/vendor/three-character.min.js"}
    vendored = ("vendor/ort.wasm.packed", "vendor/LICENSE")
    expected |= {f"t2m_jax/export/page/web/{name}" for name in ("index.html", *vendored)}
    expected |= {"t2m_jax/py.typed", "t2m_jax/encoders/minilm/model.safetensors"}
    assert expected | {"t2m_jax/bundles/demo/weights.safetensors"} <= names
    assert not [name for name in names if "node_modules" in name]
    assert not [name for name in names if name.startswith(("tests/", "configs/"))]


def test_commands_are_left_out_for_a_reason():
    found = [(name_of(page), part) for page in PAGES for _, text in code_blocks(page, "sh") for part in commands(text)]
    assert [part for part in NOT_RUN if not any(part == page or part in command for page, command in found)] == []


@pytest.mark.release
def test_the_commands_of_the_readme_run(programs, folder, hub):
    found = steps(PAGES[:1])
    assert len(found) > 25
    run_commands(found, programs, folder, hub)
    assert {"turn.html", "turn.gif", "many-1.gif", "my-model", "it.html", "mine.json"} <= names_in(folder)


@pytest.mark.release
def test_the_commands_of_all_pages_run(programs, folder, hub):
    found = steps(PAGES)
    assert len(found) > 80
    run_commands(found, programs, folder, hub)
    assert {"turn.gif", "take-2.mp4", "scene.bvh", "synthetic.json"} <= names_in(folder)


def names_in(folder):
    return {path.name for path in folder.iterdir()}


def run_commands(found, programs, folder, hub):
    """Runs the steps as users do, with a stand-in for the hub."""
    plain = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    plain |= {"PATH": f"{programs}{os.pathsep}{plain['PATH']}"}
    plain |= hub.settings(folder / "home")
    for name in ENCODERS:
        hub.add(name, wide_encoder(folder / name))
        shutil.rmtree(folder / name)  # a folder would be used instead of the hub
    quick = plain | {"JAX_DISABLE_MOST_OPTIMIZATIONS": "1"}
    plain.pop("JAX_DISABLE_MOST_OPTIMIZATIONS", None)  # sampling takes longer with it
    alone = need_process(found)
    with (
        (folder / "printed.txt").open("w+", encoding="utf-8") as log,
        shared_process(programs / "python", folder, quick, log) as run_with_others,
    ):
        for language, code in found:
            command = f"{code} {options_of(code)}" if language == "sh" else code
            if code in alone:
                environment = plain if "evaluate generation" in code else quick
                options = {"cwd": folder, "env": environment, "stdout": log, "stderr": log, "check": False}
                status = f"{subprocess.run(command, shell=True, **options).returncode}"
            else:
                status = run_with_others(language, command)
            assert status == "0", f"{command}: {(folder / 'printed.txt').read_text(encoding='utf-8')[-2000:]}"
    assert set(hub.repositories) == {"user/my-model"} | ENCODERS


def first_commands():
    """Returns the first commands of the README, up to the first motion of one's own, without those of containers."""
    text = "".join(text for _, text in code_blocks(REPOSITORY / "README.md", "sh"))
    lines = [line.partition("  #")[0].strip() for line in text.splitlines() if line.strip()]
    end = next(number for number, line in enumerate(lines) if line.startswith("t2m generate"))
    return [line for line in lines[: end + 1] if not line.startswith(("docker", "make test"))]


def what_git_ignores(folder, names):
    """Returns which names of a folder a clone does not have. Without git, which may not know the repository."""
    top = {".git", "demo", "runs", "data", "page", "site", "dist", "build"} if Path(folder) == REPOSITORY else set()
    return {name for name in names if name in top or name == "__pycache__" or re.match(r"\.(venv|\w+_cache)", name)}


@pytest.mark.release
@pytest.mark.skipif(os.name == "nt", reason="the Makefile needs a shell of Unix")
def test_the_first_commands_run_in_a_fresh_clone(tmp_path):
    clone = tmp_path / "clone"
    shutil.copytree(REPOSITORY, clone, ignore=what_git_ignores)
    # A shell that was not prepared: no environment is active, and only settings of the network are kept.
    kept = {
        name: value
        for name, value in os.environ.items()
        if name.upper().startswith(("PIP_", "HTTP", "SSL_", "NO_PROXY"))
    }
    python = Path(sys.base_prefix) / "bin"
    plain = kept | {"HOME": f"{tmp_path}", "PATH": f"{python}{os.pathsep}{os.defpath.removeprefix(':')}"}
    lines = first_commands()
    assert lines[:2] == ["make demo", "source .venv/bin/activate"] and len(lines) == 3
    subprocess.run(["bash", "--norc", "-ec", "\n".join(lines)], cwd=clone, env=plain, check=True)
    assert {"wave.html", "wave.gif", "wave.bvh"} == {path.name for path in (clone / "demo").iterdir()}
    assert (clone / "turn.html").is_file()
