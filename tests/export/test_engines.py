"""The sampling loops of the docs in C++ and C# do what the one in Python does, with the same random numbers."""

import importlib
import shutil
import subprocess

import numpy as np
import pytest

from t2m_jax.checkpoints.bundle import save_bundle
from tests.conftest import REPOSITORY
from tests.documents import code_blocks
from tests.tiny import BUNDLE, random_bundle

ENGINES = REPOSITORY / "docs" / "engines"
SCORES = [-3.0, 4.0, 0.2, -0.5, 0.7, 0.1]
WARNINGS = ("-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror")


@pytest.fixture(scope="module")
def sampler():
    """The module of the docs that makes motions with graphs."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(ENGINES)
        yield importlib.import_module("sampler")


@pytest.fixture(scope="module", params=["g++", "mcs"])
def program(request, tmp_path_factory):
    """The command of the loop in C++ or C# with graphs that are not a model."""
    if not (compiler := shutil.which(request.param)):
        pytest.skip(f"needs the compiler {request.param}")
    path = tmp_path_factory.mktemp("engines") / "fake_graphs.exe"
    sources = REPOSITORY / "tests" / "export"
    options = {
        "g++": ["-std=c++17", *WARNINGS, f"-I{ENGINES}", sources / "fake_graphs.cpp", "-o", path],
        "mcs": ["-warnaserror", f"-out:{path}", ENGINES / "Sampler.cs", sources / "FakeGraphs.cs"],
    }
    subprocess.run([compiler, *options[request.param]], check=True)
    return [path] if request.param == "g++" else ["mono", path]


def fake_model(sampler, rule, keeps_last, min_rows):
    """Returns a model as that of `fake_graphs.cpp`."""
    model = sampler.OnnxModel.__new__(sampler.OnnxModel)
    stop = {"rule": rule, "threshold": 0.5, "keeps_last": keeps_last}
    rules = {"max_rows": len(SCORES), "min_rows": min_rows, "state": [], "next": "next_", "guidance_scale": None}
    noise = {"shape": [1, 2, 5]}
    model.manifest = {"sampling": rules | {"stop": stop}, "graphs": {"row": {"inputs": {"noise": noise}}}}
    scores = iter(SCORES)

    def run(name, inputs):
        return {"codes": inputs["noise"].argmax(axis=2), "stop_score": [next(scores)]} if name == "row" else {}

    model.run = run
    return model


@pytest.mark.parametrize("min_rows", [0, 3])
@pytest.mark.parametrize("keeps_last", [True, False])
@pytest.mark.parametrize("rule", ["end", "threshold", "sampled", "argmax"])
def test_the_loop_gives_the_codes_of_the_loop_in_python(rule, keeps_last, min_rows, sampler, program):
    model = fake_model(sampler, rule, keeps_last, min_rows)
    wanted = model.sample(np.zeros((1, 4)), model.random_noise(7))
    arguments = [rule, f"{int(keeps_last)}", f"{min_rows}", *map(str, SCORES)]
    found = subprocess.run([*program, *arguments], check=True, capture_output=True, text=True).stdout
    final, codes, numbers = found.splitlines()
    assert [int(code) for code in codes.split()] == wanted.ravel().tolist()
    # All frames are final at the end; before it, those of the last two rows are not.
    *before, last = map(int, final.split())
    assert last == 4 * len(wanted)
    assert before == [0 if rule == "argmax" else 4 * max(0, row - 2) for row in range(1, len(before) + 1)]
    # The clean-up gets zeros after the motion, and adds the number of frames here.
    size, longest = 3 * last, 3 * 4 * len(SCORES)
    assert list(map(int, numbers.split())) == [size, size, longest, size, size, size * (1 + last)]


def test_random_numbers_are_those_of_splitmix64(sampler):
    """Of the reference implementation with the seed 1234567, of which the 52 highest bits are used."""
    bits = [6457827717110365317, 3203168211198807973, 9817491932198370423]
    found = sampler.uniform(1234567, 0, 3)
    np.testing.assert_array_equal(found, [((number >> 12) + 0.5) / 2**52 for number in bits])


@pytest.mark.slow
def test_the_lines_for_stablehlo_give_files_that_compute_what_the_model_does(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    save_bundle(tmp_path / "tiny", random_bundle(BUNDLE), card="---\nlicense: mit\n---\n# Tiny\n")
    ((_, code),) = code_blocks(REPOSITORY / "docs" / "engines.md", "python")
    names = {}
    exec(code.replace('"demo"', '"tiny"'), names)  # noqa: S102 - the page's code is run as it is
    assert sorted(path.stem for path in tmp_path.glob("*.stablehlo")) == [
        "begin",
        "calm",
        "decode",
        "lock",
        "row",
        "text",
    ]
    graph = names["graphs"]["decode"]
    wanted = graph.function(*(np.ones(array.shape, array.dtype) for array in graph.inputs.values()))
    np.testing.assert_allclose(names["positions"], wanted[0], atol=1e-5)
