"""A tiny model on disk, and a way to run the program and see what it says."""

import pytest

from t2m_jax.checkpoints.bundle import save_bundle
from t2m_jax.cli.main import main
from t2m_jax.data.importers.synthetic import write_synthetic_dataset
from tests.tiny import random_bundle


@pytest.fixture(scope="session")
def bundle_folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("models") / "tiny"
    save_bundle(folder, random_bundle(), card="# tiny\n")
    return folder


@pytest.fixture(scope="session")
def data_folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("data") / "synthetic"
    write_synthetic_dataset(folder, num_clips=20, seed=4)
    return folder


@pytest.fixture
def refusal(capsys):
    """Returns a function that runs a command which must fail, and gives the one line it says."""

    def run(*arguments) -> str:
        assert main([f"{argument}" for argument in arguments]) == 2
        said = capsys.readouterr()
        assert said.out == ""
        lines = [line for line in said.err.splitlines() if line.startswith("t2m: error: ")]
        assert len(lines) == 1
        assert "Traceback" not in said.err
        return lines[0]

    return run


@pytest.fixture(autouse=True)
def no_cache(monkeypatch):
    monkeypatch.setenv("T2M_JAX_NO_COMPILATION_CACHE", "1")
