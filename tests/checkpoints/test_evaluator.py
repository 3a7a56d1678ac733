"""An evaluator's folder: there and back, its fingerprint, and what is refused."""

import dataclasses
import shutil

import jax
import numpy as np
import pytest

from t2m_jax.checkpoints.evaluator import (
    TrainedEvaluator,
    load_trained_evaluator,
    make_trained_evaluator,
    save_evaluator,
)
from t2m_jax.errors import UserError
from t2m_jax.text.word_vectors import Vocabulary, save_vocabulary
from tests.tiny import random_evaluator, trust_manifests


@pytest.fixture(scope="module")
def trained() -> TrainedEvaluator:
    return random_evaluator()


@pytest.fixture
def folder(trained, tmp_path):
    save_evaluator(tmp_path / "evaluator", trained)
    return tmp_path / "evaluator"


@pytest.fixture
def trusted(folder, monkeypatch):
    """A folder whose files can be changed."""
    trust_manifests(monkeypatch)
    return folder


def test_there_and_back(trained, folder):
    found = load_trained_evaluator(folder)
    assert found.config == trained.config
    assert found.vocabulary.words == trained.vocabulary.words
    assert found.fingerprint == trained.fingerprint
    jax.tree.map(np.testing.assert_array_equal, found.variables, trained.variables)
    np.testing.assert_array_equal(found.normalizer.std, trained.normalizer.std)
    assert {path.name for path in folder.iterdir()} == {
        "evaluator.yaml",
        "weights.safetensors",
        "Mean.npy",
        "Std.npy",
        "words.txt",
        "manifest.txt",
    }
    assert load_trained_evaluator(str(folder)).fingerprint == found.fingerprint


def test_anything_that_changes_numbers_changes_the_fingerprint(trained):
    config, variables, normalizer, vocabulary, fingerprint = trained
    bias = variables["params"]["motion_encoder"]["output"]["bias"]
    changed = jax.tree.map(lambda leaf: leaf + 1e-6 if leaf is bias else leaf, variables)
    others = [
        (dataclasses.replace(config, dropout=0.1), variables, normalizer, vocabulary),
        (config, changed, normalizer, vocabulary),
        (config, variables, normalizer._replace(std=normalizer.std * np.float32(1.01)), vocabulary),
        (config, variables, normalizer, Vocabulary(tuple(reversed(vocabulary.words)))),
    ]
    found = {make_trained_evaluator(*other).fingerprint for other in others}
    assert len(found | {fingerprint}) == 5
    assert make_trained_evaluator(*trained[:4]).fingerprint == fingerprint


def test_no_folder_is_written_over(trained, folder):
    with pytest.raises(UserError, match="exists already"):
        save_evaluator(folder, trained)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("evaluator.yaml", "not an evaluator"),
        ("weights.safetensors", "missing"),
        ("words.txt", "there is no such file"),
        ("Mean.npy", "missing"),
    ],
)
def test_what_is_missing_is_named(trusted, name, said):
    (trusted / name).unlink()
    with pytest.raises(UserError, match=said):
        load_trained_evaluator(trusted)


def test_every_change_of_a_file_is_refused(folder):
    for path in sorted(folder.iterdir()):
        whole = path.read_bytes()
        flipped = bytearray(whole)
        flipped[len(whole) // 2] ^= 1
        path.write_bytes(bytes(flipped))
        with pytest.raises(UserError, match=f"{path}: "):
            load_trained_evaluator(folder)
        path.write_bytes(whole)
    load_trained_evaluator(folder)


def test_parts_that_do_not_fit_are_refused(trained, trusted, tmp_path):
    shutil.copytree(trusted, tmp_path / "words")
    save_vocabulary(tmp_path / "words" / "words.txt", Vocabulary((*trained.vocabulary.words, "more")))
    with pytest.raises(UserError, match=r"words\.txt: has \d+ words, but evaluator\.yaml says"):
        load_trained_evaluator(tmp_path / "words")
    shutil.copytree(trusted, tmp_path / "statistics")
    for name in ("Mean.npy", "Std.npy"):
        np.save(tmp_path / "statistics" / name, np.ones(251, np.float32))
    with pytest.raises(UserError, match="statistics are for 251 features; the model has 263"):
        load_trained_evaluator(tmp_path / "statistics")
    path = trusted / "evaluator.yaml"
    path.write_text(path.read_text().replace("format_version: 2", "format_version: 1"))
    with pytest.raises(UserError, match="format_version 1 is of an older t2m_jax"):
        load_trained_evaluator(trusted)
    path.write_text(
        path.read_text()
        .replace("format_version: 1", "format_version: 2")
        .replace("motion_hidden: 8", "motion_hidden: 6")
    )
    with pytest.raises(UserError, match="has shape"):
        load_trained_evaluator(trusted)
