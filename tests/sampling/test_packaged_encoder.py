"""The sentence encoder of the package: the embeddings of the original, and the hash by which models know it."""

import numpy as np
import pytest

from t2m_jax.checkpoints.text_encoder import SentenceReference, SentenceStatesConfig, encoder_identity, load_pretrained
from t2m_jax.sampling.text_encoders import PretrainedTextEncoder, SentenceStates
from tests.sentence_golden import GOLDEN

REFERENCE = SentenceReference(name="minilm")


@pytest.fixture(scope="module")
def encoder():
    return load_pretrained(REFERENCE)


def test_models_know_it_by_this_hash(encoder):
    """If it changes, the models that were trained with it do not load."""
    assert encoder_identity(encoder) == "18437cec1fa5d9a8"
    assert SentenceStatesConfig().encoder == REFERENCE and encoder.config.text_dim == 384


@pytest.mark.slow
def test_embeddings_are_those_of_the_original(encoder):
    """The golden embeddings are those of all-MiniLM-L6-v2 with its float32 weights and its whole vocabulary."""
    with np.load(GOLDEN / "minilm.npz") as golden:
        found = np.asarray(PretrainedTextEncoder(encoder)(golden["captions"].tolist()))
        cosines = np.sum(found * golden["embeddings"], axis=1)
    assert len(cosines) == 6 and 0.9995 < cosines.min() < 1


def test_it_is_loaded_when_it_is_needed(monkeypatch):
    def refuse(*args, **options):
        raise AssertionError("loaded")

    monkeypatch.setattr("t2m_jax.sampling.text_encoders.load_pretrained", refuse)
    states = SentenceStates(REFERENCE)
    with pytest.raises(AssertionError, match="loaded"):
        states.read_batch(["a person walks"])
