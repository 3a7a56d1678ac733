"""A system from another package goes from training to evaluation; nothing in t2m_jax knows it."""

import json
import os
import shlex
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

from t2m_jax.checkpoints import save_evaluator
from t2m_jax.config import config_to_dict
from t2m_jax.data import open_dataset, write_synthetic_dataset
from tests.conftest import PROGRAMS
from tests.one_process import shared_process
from tests.tiny import CAPTION_ENCODER, random_evaluator

DISTRIBUTION = Path(__file__).parent / "distribution"
LOOP = {"loop.num_steps": 6, "loop.batch_size": 4, "loop.log_every": 2, "loop.validate_every": 3}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A data set and an evaluator of it."""
    folder = tmp_path_factory.mktemp("third")
    write_synthetic_dataset(folder / "data", num_clips=40, seed=3)
    (folder / "data" / "val.txt").write_text((folder / "data" / "train.txt").read_text())
    trained = random_evaluator()._replace(normalizer=open_dataset(folder / "data").normalizer)
    save_evaluator(folder / "evaluator", trained)
    return folder


@pytest.fixture
def t2m(folder):
    """Returns a function that runs a command where the distribution is on the path, and gives what it printed.

    All commands run in one process. The fields of a config are options.
    """
    path = os.pathsep.join([f"{DISTRIBUTION}", f"{DISTRIBUTION.parents[2]}", os.environ.get("PYTHONPATH", "")])
    environment = os.environ | {"PYTHONPATH": path, "JAX_COMPILATION_CACHE_DIR": os.environ[PROGRAMS]}
    printed = folder / "printed.txt"
    with printed.open("wb") as log, shared_process(sys.executable, folder, environment, log) as run:

        def run_command(*arguments, **fields):
            options = [text for name, value in fields.items() for text in (f"--{name}", f"{value}")]
            before = printed.stat().st_size
            status = run("sh", shlex.join(["t2m", *map(str, arguments), *options]))
            said = printed.read_bytes()[before:].decode()
            assert status == "0", said
            return said

        yield run_command


@pytest.mark.slow
def test_train_bundle_load_generate_evaluate(folder, t2m):
    (folder / "lookup.yaml").write_text("{}\n")
    sizes = {"caption_encoder": config_to_dict(CAPTION_ENCODER), "model": {"text_dim": 12, "max_codes": 12}}
    (folder / "bigram.yaml").write_text(yaml.safe_dump(sizes))
    evaluation = {"evaluation.evaluator": "evaluator", "evaluation.every": 3, "evaluation.metric": "r_precision_1"}
    t2m("train", "lookup", "lookup.yaml", data="data", run="lookup", **LOOP, **evaluation)
    t2m("train", "bigram", "bigram.yaml", data="data", vqvae="lookup", run="bigram", **LOOP, **evaluation)
    assert (folder / "bigram" / "pictures" / "6.png").is_file()
    t2m("bundle", "bigram", "lookup", "model")
    assert "kind: bigram" in (folder / "model" / "bundle.yaml").read_text()
    for model in ("bigram", "model"):
        t2m("generate", "a person walks", "--model", model, "--seed", 2, "-o", f"{model}.npz")
    with np.load(folder / "model.npz") as motion:
        rows = len(motion["codes"])
        assert motion["codes"].shape == (rows, 2) and 1 <= rows <= 12
        assert motion["positions"].shape == (8 * rows, 22, 3)
    t2m("export", "onnx", "model", "onnx")
    assert json.loads((folder / "onnx" / "manifest.json").read_text())["sampling"]["num_codes"]
    for kind in ("reconstruction", "generation"):
        options = ["--data", "data", "--split", "val", "--evaluator", "evaluator", "--num-repeats", 2]
        t2m("evaluate", kind, "--model", "model", *options, "--json", f"{kind}.json")
        report = json.loads((folder / f"{kind}.json").read_text())
        assert "fid" in json.dumps(report)
    stronger = ["--guidance-scale", 9.0, "-o", "guided.npz"]
    t2m("generate", "a person walks", "--model", "model", "--seed", 2, *stronger)
    assert (folder / "guided.npz").is_file()
    again = t2m("train", "bigram", "--run", "bigram", "--resume", **{"loop.num_steps": 8})
    assert "bigram" in again and "num_steps: 8" in (folder / "bigram" / "config.yaml").read_text()
