"""Codes become motion, whole or in windows: the same either way."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax.data.importers.synthetic import make_motion
from t2m_jax.motion.features import features_from_positions, positions_from_features
from t2m_jax.motion.joining import FADE_SECONDS, fade_features
from t2m_jax.motion.skeleton import HUMANML3D
from t2m_jax.sampling import TextToMotion
from t2m_jax.sampling.decode import (
    MAX_CONTEXT,
    ORIGIN,
    WINDOW_ROWS,
    GrowingMotion,
    decode_motions,
    decode_sentences,
    place_features,
)
from t2m_jax.sampling.programs import decode_batch
from tests import tiny

BUNDLES = {
    "gpt": tiny.BUNDLE,
    "hifigpt": tiny.HIFIGPT_BUNDLE,
    "GN": dataclasses.replace(tiny.BUNDLE, tokenizer=dataclasses.replace(tiny.BUNDLE.tokenizer, norm="GN", width=32)),
}


@pytest.fixture(scope="module", params=["gpt", pytest.param("hifigpt", marks=pytest.mark.slow), "GN"])
def tokenizer(request):
    return TextToMotion(tiny.random_bundle(BUNDLES[request.param])).tokenizer


def random_codes(tokenizer, count):
    config = tokenizer.config
    return np.random.default_rng(count).integers(0, config.num_codes, (count, config.num_quantizers), np.int32)


def in_windows(tokenizer, pieces):
    found = list(decode_sentences(tokenizer, ((0, rows) for rows in pieces), skeleton=HUMANML3D))
    return found, [np.concatenate(parts) for parts in zip(*found, strict=True)]


@pytest.mark.slow
@pytest.mark.parametrize("count", [1, WINDOW_ROWS, 5 * WINDOW_ROWS + 3])
def test_windows_are_the_whole_motion(tokenizer, count):
    codes = random_codes(tokenizer, count)
    pieces, (rows, features, positions) = in_windows(tokenizer, [codes])
    np.testing.assert_array_equal(rows, codes)
    bounded = tokenizer.config.decoder_context <= MAX_CONTEXT
    sizes = [len(piece.codes) for piece in pieces]
    assert max(sizes) == (min(count, WINDOW_ROWS) if bounded else count) and min(sizes) >= min(count, WINDOW_ROWS // 2)
    lengths = jnp.array([count], np.int32)
    whole = decode_batch(tokenizer.variables, tokenizer.normalizer, codes[None], lengths, tokenizer=tokenizer.module)
    expected = np.asarray(whole)[0]
    np.testing.assert_allclose(features, expected, atol=1e-4 * np.abs(expected).max())
    whole = np.asarray(positions_from_features(expected, HUMANML3D))
    np.testing.assert_allclose(positions, whole, atol=1e-4 * np.abs(whole).max())


def test_windows_do_not_depend_on_how_rows_arrive(tokenizer):
    codes = random_codes(tokenizer, 3 * WINDOW_ROWS + 5)
    _, expected = in_windows(tokenizer, [codes])
    for sizes in ([1] * len(codes), [30, 2, 21]):
        parts = np.split(codes, np.cumsum(sizes)[:-1])
        _, found = in_windows(tokenizer, iter(parts))
        for one, other in zip(found, expected, strict=True):
            np.testing.assert_array_equal(one, other)


def test_sentences_are_decoded_alone_and_fade(tokenizer):
    first, second = random_codes(tokenizer, 2 * WINDOW_ROWS + 1), random_codes(tokenizer, 3)
    _, (_, alone, _) = in_windows(tokenizer, [first])
    _, (_, other, _) = in_windows(tokenizer, [second])
    pieces = [(1, first[:5]), (1, first[5:]), (2, second)]
    joined = [piece.features for piece in decode_sentences(tokenizer, pieces, skeleton=HUMANML3D)]
    expected = fade_features(alone, other, overlap=round(FADE_SECONDS * HUMANML3D.fps))
    np.testing.assert_array_equal(np.concatenate(joined), np.concatenate(expected))


@pytest.mark.parametrize("cuts", [[], [1], [30, 31, 90]])
def test_pieces_go_on_where_the_one_before_ends(cuts):
    features = np.asarray(features_from_positions(make_motion("walk-turn-left", seed=3, num_frames=120), HUMANML3D))
    place = ORIGIN
    found = []
    for part in np.split(features, cuts):
        positions, place = place_features(part, place, skeleton=HUMANML3D)
        found.append(positions)
    np.testing.assert_allclose(np.concatenate(found), positions_from_features(features, HUMANML3D), atol=1e-5)


@pytest.mark.slow
def test_a_growing_motion_gives_each_frame_once_when_it_is_final(tokenizer):
    codes = random_codes(tokenizer, 40)
    growing = GrowingMotion(tokenizer, skeleton=HUMANML3D, step=4, max_codes=40)
    pieces = [growing.add(codes[first : first + 4], ended=first == 36) for first in range(0, 40, 4)]
    context = tokenizer.config.decoder_context
    finals = [max(0, 4 * number - context) for number in range(1, 10)] + [40]
    assert [0 if piece is None else len(piece.codes) for piece in pieces] == np.diff([0, *finals]).tolist()
    (whole,) = decode_motions(tokenizer, [codes], skeleton=HUMANML3D)
    for name in ("codes", "features", "positions"):
        found = np.concatenate([getattr(piece, name) for piece in pieces if piece is not None])
        expected = getattr(whole, name)
        np.testing.assert_allclose(found, expected, atol=1e-4 * np.abs(expected).max())


@pytest.mark.slow
def test_motions_of_a_batch_do_not_depend_on_the_others(tokenizer):
    short, long = random_codes(tokenizer, 5), random_codes(tokenizer, 9)
    options = {"skeleton": HUMANML3D, "size": 12, "batch": 4, "clean": True}
    together = decode_motions(tokenizer, [long, short], **options)
    for codes, motion in zip((long, short), together, strict=True):
        (alone,) = decode_motions(tokenizer, [codes], **options)
        assert motion.num_frames == len(codes) * tokenizer.config.downsample
        np.testing.assert_array_equal(motion.positions, alone.positions)
        np.testing.assert_array_equal(motion.codes, codes)
