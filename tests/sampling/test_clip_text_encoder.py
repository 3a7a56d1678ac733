"""CLIP as a text encoder: the reference's embeddings, whatever stands beside a caption, from the cache or not."""

import jax
import numpy as np
import pytest

from t2m_jax.checkpoints.clip import load_clip
from t2m_jax.models.rows import apply_compiled
from t2m_jax.sampling import text_encoders
from t2m_jax.sampling.text_encoders import MAX_BATCH, PretrainedTextEncoder
from t2m_jax.text.embedding_cache import EmbeddingCache
from t2m_jax.text.encoder import TextEncoder
from tests.clip_golden import CAPTIONS, FULL, TEXT_ONLY, golden


@pytest.fixture(scope="module")
def clip():
    return load_clip(FULL)


@pytest.fixture
def batches(monkeypatch):
    """Returns the sizes of the batches that were embedded."""
    sizes = []

    def watched(variables, tokens, *, module):
        sizes.append(len(tokens))
        return apply_compiled(variables, tokens, module=module)

    monkeypatch.setattr(text_encoders, "apply_compiled", watched)
    return sizes


def test_it_is_a_text_encoder(clip):
    assert isinstance(PretrainedTextEncoder(clip), TextEncoder)


@pytest.mark.parametrize("folder", [FULL, TEXT_ONLY])
def test_the_embeddings_are_those_of_the_reference(folder):
    found = PretrainedTextEncoder(load_clip(folder))(CAPTIONS)
    assert isinstance(found, jax.Array)
    np.testing.assert_allclose(found, golden(folder, "embeddings"), rtol=0, atol=1e-5)


@pytest.mark.slow
def test_an_embedding_does_not_depend_on_its_neighbours(clip):
    encoder = PretrainedTextEncoder(clip)
    together = np.asarray(encoder(CAPTIONS))
    np.testing.assert_array_equal(encoder(CAPTIONS[::-1]), together[::-1])
    for size in (1, 3):
        np.testing.assert_allclose(encoder(CAPTIONS[5 : 5 + size]), together[5 : 5 + size], rtol=0, atol=1e-5)


@pytest.mark.slow
def test_batches_are_powers_of_two(clip, batches):
    encoder = PretrainedTextEncoder(clip)
    for size in (1, 2, 3, 5):
        encoder(CAPTIONS[:size])
    assert batches == [1, 2, 4, 8]
    many = [f"a person takes {number} steps" for number in range(MAX_BATCH + 3)]
    assert encoder(many).shape == (len(many), clip.config.text_dim)
    assert batches[4:] == [MAX_BATCH, 4]


def test_a_caption_given_twice_is_embedded_once(clip, batches):
    found = PretrainedTextEncoder(clip)(["a walk", "a jump", "a walk", "a walk"])
    assert batches == [2]
    np.testing.assert_array_equal(found[0], found[2])
    np.testing.assert_array_equal(found[0], found[3])
    assert np.abs(found[0] - found[1]).max() > 1e-3


def test_no_captions_are_no_embeddings(clip, batches):
    assert PretrainedTextEncoder(clip)([]).shape == (0, clip.config.text_dim)
    assert batches == []


def test_what_is_cached_is_not_embedded_again(clip, batches, tmp_path):
    cache = EmbeddingCache(tmp_path / "cache.sqlite3")
    first = PretrainedTextEncoder(clip, cache=cache)(CAPTIONS[:6])
    assert batches == [8]
    again = PretrainedTextEncoder(clip, cache=EmbeddingCache(cache.path))([*CAPTIONS[:6][::-1], "a new one"])
    assert batches == [8, 1]
    np.testing.assert_array_equal(again[:6], first[::-1])
    np.testing.assert_allclose(first, PretrainedTextEncoder(clip)(CAPTIONS[:6]), rtol=0, atol=1e-5)


def test_another_model_takes_nothing_from_the_cache(clip, tmp_path):
    cache = EmbeddingCache(tmp_path / "cache.sqlite3")
    for folder in (FULL, TEXT_ONLY):
        found = PretrainedTextEncoder(load_clip(folder), cache=cache)(CAPTIONS)
        np.testing.assert_allclose(found, golden(folder, "embeddings"), rtol=0, atol=1e-5)


def test_a_damaged_cache_changes_nothing(clip, tmp_path):
    cache = EmbeddingCache(tmp_path / "cache.sqlite3")
    cache.path.write_bytes(b"no database" * 400)
    np.testing.assert_allclose(
        PretrainedTextEncoder(clip, cache=cache)(CAPTIONS), golden(FULL, "embeddings"), rtol=0, atol=1e-5
    )
