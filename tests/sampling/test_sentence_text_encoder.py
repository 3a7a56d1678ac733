"""Sentence encoders as text encoders: the reference's embeddings in any batch, and what is read of long captions."""

import numpy as np
import pytest

from t2m_jax.checkpoints.sentence import load_sentence_encoder
from t2m_jax.sampling.text_encoders import PretrainedTextEncoder
from t2m_jax.text.embedding_cache import EmbeddingCache
from t2m_jax.text.encoder import CuttingTextEncoder
from tests.sentence_golden import BERT, CAPTIONS, FOLDERS, MPNET, ROBERTA, golden


@pytest.mark.slow
@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.name)
def test_the_embeddings_are_those_of_the_reference(folder):
    found = PretrainedTextEncoder(load_sentence_encoder(folder))(CAPTIONS)
    np.testing.assert_allclose(found, golden(folder), rtol=0, atol=1e-5)


@pytest.mark.slow
def test_an_embedding_does_not_depend_on_its_neighbors():
    encoder, short = PretrainedTextEncoder(load_sentence_encoder(BERT)), CAPTIONS[5]
    alone, together = encoder([short]), encoder([short, CAPTIONS[-1], "a walk"])
    np.testing.assert_allclose(together[:1], alone, rtol=0, atol=1e-5)
    assert np.abs(together[1] - together[0]).max() > 0.1


@pytest.mark.slow
def test_another_encoder_takes_nothing_from_the_cache(tmp_path):
    for folder in (BERT, ROBERTA, BERT):
        encoder = PretrainedTextEncoder(load_sentence_encoder(folder), cache=EmbeddingCache(tmp_path / "cache.sqlite3"))
        np.testing.assert_allclose(encoder(CAPTIONS[:4]), golden(folder)[:4], rtol=0, atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("folder", [BERT, MPNET, ROBERTA], ids=lambda folder: folder.name)
def test_the_part_that_is_read_gives_the_same_embedding(folder):
    encoder = PretrainedTextEncoder(load_sentence_encoder(folder))
    assert isinstance(encoder, CuttingTextEncoder)
    caption = " and then a person walks slowly to the left".join(["someone waves"] * 25)
    read = encoder.read_part(caption)
    assert caption.startswith(read) and 10 < len(read) < len(caption)
    np.testing.assert_allclose(encoder([read]), encoder([caption]), rtol=0, atol=1e-5)
    assert encoder.read_part("someone waves") == "someone waves"
