"""`t2m bundle`: what it refuses, and that it writes all or nothing (the way to a bundle is walked in tests/train)."""

import dataclasses
import errno

import chex
import numpy as np
import pytest

from t2m_jax.checkpoints import load_bundle, model, save_bundle
from t2m_jax.checkpoints.averaging import mean_of_models
from t2m_jax.checkpoints.bundle import expected_variables
from t2m_jax.checkpoints.official import export
from t2m_jax.cli.main import main
from tests.tiny import BUNDLE, HIFIGPT_BUNDLE, random_bundle, random_variables


def bundle_of(config):
    return random_bundle()._replace(config=config, variables=random_variables(expected_variables(config)))


@pytest.fixture
def exporting(tmp_path, monkeypatch):
    """Returns a function that begins the export of a model, whose run is not read, and gives the command's words."""
    (tmp_path / "card.md").write_text("# mine\n")

    def begin(bundle):
        monkeypatch.setattr(model, "load_runs", lambda paths: (tmp_path / "run", bundle))
        return ("bundle", "run", f"{tmp_path / 'out'}", "--export-official", "--card", f"{tmp_path / 'card.md'}")

    return begin


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_what_is_no_run_is_refused(refusal, bundle_folder, tmp_path):
    assert "not a run directory" in refusal("bundle", bundle_folder, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_bundle_that_exists_is_refused_before_the_run_is_read(refusal, bundle_folder, tmp_path):
    assert f"{bundle_folder}: exists already" in refusal("bundle", tmp_path / "no-run", bundle_folder)


@pytest.mark.parametrize(
    ("config", "said"),
    [
        (HIFIGPT_BUNDLE, "the original code has no model of 'rvqvae' and 'hifigpt'; only a T2M-GPT can be exported"),
        (dataclasses.replace(BUNDLE, generator=dataclasses.replace(BUNDLE.generator, num_layers=3)), "3 is odd"),
    ],
)
def test_a_model_without_the_original_form_is_refused(refusal, exporting, tmp_path, config, said):
    assert said in refusal(*exporting(bundle_of(config)))
    assert names(tmp_path) == ["card.md"]


def test_a_bundle_without_its_official_files_is_not_left(refusal, exporting, tmp_path, monkeypatch):
    command = exporting(random_bundle())
    with monkeypatch.context() as full_disk:
        full_disk.setattr(export, "save_weights", lambda *_, **__: raise_full())
        said = f"{tmp_path / 'out'}: cannot be written (No space left on device); make room"
        assert said in refusal(*command)
    assert names(tmp_path) == ["card.md"]
    assert main([*command]) == 0  # the same command again, now with room
    assert names(tmp_path) == ["card.md", "out"]
    assert names(tmp_path / "out" / "official") == ["gpt.safetensors", "mean.npy", "std.npy", "vqvae.safetensors"]
    assert (tmp_path / "out" / "README.md").read_text() == "# mine\n"
    assert not any(name.startswith(".") or name == "bundle" for name in names(tmp_path / "out"))
    np.testing.assert_array_equal(load_bundle(tmp_path / "out").normalizer, random_bundle().normalizer)


def test_the_mean_of_two_models_is_written(refusal, bundle_folder, tmp_path, capsys):
    new = random_bundle(seed=11)
    new = new._replace(variables=new.variables | {"tokenizer": random_bundle().variables["tokenizer"]})
    save_bundle(tmp_path / "new", new, card="# new\n")
    command = ["bundle", str(bundle_folder), str(tmp_path / "new"), str(tmp_path / "mean"), "--mean", "0.25"]
    assert "--mean: give two models" in refusal(*command[:1], *command[2:])
    assert names(tmp_path) == ["new"]
    assert main(command) == 0
    assert capsys.readouterr().out == f"{tmp_path / 'mean'}\n"
    found, parts = load_bundle(tmp_path / "mean"), [load_bundle(folder) for folder in command[1:3]]
    assert found.card == "# new\n"
    chex.assert_trees_all_close(found.variables, mean_of_models(*parts, 0.25).variables, rtol=1e-3, atol=1e-3)


def raise_full():
    raise OSError(errno.ENOSPC, "No space left on device")
