"""Sentences in turn, given lengths, and motion that goes on from another."""

import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax import Motion
from t2m_jax.data.importers.synthetic import make_motion
from t2m_jax.errors import UserError
from t2m_jax.motion.features import positions_from_features
from t2m_jax.motion.gltf import load_gltf
from t2m_jax.motion.joining import FADE_SECONDS
from t2m_jax.sampling.loop import Given
from t2m_jax.sampling.programs import generate_codes
from t2m_jax.sampling.prompts import sample_key
from t2m_jax.sampling.request import MotionRequest, SamplingOptions
from t2m_jax.sampling.segments import context_rows
from t2m_jax.text.coverage import PromptWarning
from tests import tiny

pytestmark = pytest.mark.slow

FIRST, SECOND, THIRD = tiny.CAPTIONS[:3]


def sample(model, *, known=None, num_codes=0, num_rows=0, min_codes=None, **options):
    """Codes of four motions, with `num_codes` rows of `known` [4, N, R], and their lengths."""
    keys = jnp.stack([sample_key(7, FIRST, number) for number in range(4)])
    sampling = model.parts.sampling(SamplingOptions(**options), min_codes=min_codes)
    given = None
    if known is not None:
        is_known = jnp.arange(known.shape[1])[None] < jnp.full((4, 1), num_codes)
        given = Given(jnp.asarray(known), is_known, jnp.full(4, num_rows))
    sampled = model.parts.sample_codes(model.text_encoder([FIRST] * 4), keys, sampling, given=given)
    return np.asarray(sampled.codes), np.asarray(sampled.code_lengths)


@pytest.mark.parametrize("number", [0, 1, 3])
def test_what_follows_own_codes_is_what_followed_them(model, number):
    expected, lengths = sample(model)
    found, found_lengths = sample(model, known=expected, num_codes=number)
    kept = lengths > number  # the others ended before
    assert kept.any()
    np.testing.assert_array_equal(found[kept], expected[kept])
    np.testing.assert_array_equal(found_lengths[kept], lengths[kept])
    assert (found_lengths > number).all()


def test_known_rows_are_kept_whatever_is_drawn(model):
    known = np.random.default_rng(0).integers(0, model.config.tokenizer.num_codes, sample(model)[0].shape, np.int32)
    found, _ = sample(model, known=known, num_codes=2)
    np.testing.assert_array_equal(found[:, :2], known[:, :2])
    assert (found[:, 2:] != known[:, 2:]).any()


def test_what_goes_on_is_as_long_as_a_new_motion_and_has_its_program(model):
    known = sample(model)[0]
    assert sample(model, known=known, min_codes=14)[1].min() >= 14
    compiled = generate_codes._cache_size()
    for number in (1, 3):
        assert sample(model, known=known, num_codes=number, min_codes=14)[1].min() >= number + 14
    assert generate_codes._cache_size() == compiled
    assert sample(model, known=known, num_codes=3, min_codes=0)[1].min() < 17, "the model ends some earlier by itself"


@pytest.mark.parametrize("rows", [1, 3, 5])
def test_motions_have_the_length_that_is_asked_for(model, rows):
    rules = ["end"] if model.config.generator.stop_rule == "end" else ["threshold", "argmax", "sampled"]
    for rule in rules:
        found, lengths = sample(model, known=np.zeros_like(sample(model)[0]), num_rows=rows, stop_rule=rule)
        assert lengths.tolist() == [rows] * 4
        assert not found[:, rows:].any() and found.max() < model.config.tokenizer.num_codes


def test_one_sentence_is_the_motion_of_generate(model):
    for one, other in zip(
        model.generate(FIRST, num_samples=3), model.generate_chain([FIRST], num_samples=3), strict=True
    ):
        np.testing.assert_array_equal(one.codes, other.codes)
        for name in ("features", "positions_raw", "positions"):
            whole = getattr(one, name)
            np.testing.assert_allclose(getattr(other, name), whole, atol=max(1e-4, 2e-6 * np.abs(whole).max()))
        assert (other.part_starts, other.part_captions) == ((0,), (FIRST,))
        assert (other.caption, other.seed) == (one.caption, one.seed)


def test_sentences_follow_one_another(model):
    motions = model.generate_chain([FIRST, SECOND, THIRD], seed=3, num_samples=3, raw=True)
    firsts = model.generate(FIRST, seed=3, num_samples=3, raw=True)
    downsample = model.config.tokenizer.downsample
    for alone, motion in zip(firsts, motions, strict=True):
        assert (
            motion.part_captions == (FIRST, SECOND, THIRD) and motion.caption == f"{FIRST}, then {SECOND}, then {THIRD}"
        )
        assert motion.part_starts[0] == 0 and len(motion.part_starts) == 3
        assert motion.num_frames == downsample * len(motion.codes)
        np.testing.assert_array_equal(motion.codes[: len(alone.codes)], alone.codes)
        assert motion.part_starts[1] == alone.num_frames
        np.testing.assert_array_equal(model.decode(motion.codes, raw=True).codes, motion.codes)
    (again,) = model.generate_chain([FIRST, SECOND, THIRD], seed=3, raw=True)
    np.testing.assert_array_equal(again.codes, motions[0].codes)
    assert any(len(one.codes) != len(motions[0].codes) or (one.codes != motions[0].codes).any() for one in motions[1:])
    other = model.generate_chain([FIRST, SECOND, SECOND], seed=3, raw=True)[0]
    shared = motions[0].part_starts[2] // downsample
    np.testing.assert_array_equal(other.codes[:shared], motions[0].codes[:shared])


def test_a_sentence_is_sampled_and_decoded_as_if_it_were_alone(model):
    downsample = model.config.tokenizer.downsample
    seconds = 8 * downsample / model.skeleton.fps
    first, second = (
        model.generate_chain([FIRST, other, THIRD], seconds=seconds, raw=True)[0] for other in (SECOND, THIRD)
    )
    assert (first.codes[8:16] != second.codes[8:16]).any()
    np.testing.assert_array_equal(first.codes[16:], second.codes[16:])
    alone = model.decode(first.codes[8:16], raw=True)
    half = round(FADE_SECONDS * model.skeleton.fps) // 2
    inner = slice(half, 8 * downsample - half)
    # Random weights give features of a thousand. Float32 rounds them to steps of 1e-4, and sums of them more.
    atol = 2e-6 * np.abs(alone.features).max()
    np.testing.assert_allclose(first.features[8 * downsample :][inner], alone.features[inner], rtol=1e-4, atol=atol)
    positions = positions_from_features(first.features, model.skeleton) * model.skeleton.metres_per_unit
    np.testing.assert_allclose(first.positions, positions, rtol=1e-5, atol=1e-4)


def test_a_motion_may_be_longer_than_the_generator_can_read(model):
    longest = model.config.generator.max_codes
    seconds = 3 * longest * model.config.tokenizer.downsample / model.skeleton.fps
    (motion,) = model.generate_chain([FIRST, SECOND], seconds=seconds)
    assert len(motion.codes) == 6 * longest and motion.part_starts == (0, motion.num_frames // 2)
    assert context_rows(model.parts) < longest


def test_a_motion_goes_on_from_another(model):
    start = Motion(make_motion("walk", seed=1, num_frames=60), 20.0)
    (motion,) = model.generate_chain([FIRST, SECOND], start=start, raw=True)
    known = model.encode(start)
    np.testing.assert_array_equal(motion.codes[: len(known)], known)
    assert motion.part_starts[0] == len(known) * model.config.tokenizer.downsample and len(motion.part_starts) == 2
    assert motion.positions_raw is None


def test_progress_is_told_after_each_sentence(model):
    told = []
    request = MotionRequest(captions=(FIRST, SECOND), seconds=2.0, num_samples=2)
    list(model.make(request, on_progress=lambda *counts: told.append(counts)))
    assert told == sorted(told) and told[-1] == (2, 2) and len(told) >= 4
    assert 0.5 < told[0][0] < 1  # one of two sentences of both motions


def test_what_goes_on_keeps_its_sentences(model):
    (two,) = model.generate_chain([FIRST, SECOND], seconds=2.0, seed=1)
    (three,) = model.generate_chain([THIRD], start=two, seconds=2.0)
    assert three.part_captions == (FIRST, SECOND, THIRD) and three.part_starts == (*two.part_starts, two.num_frames)
    assert three.caption == f"{FIRST}, then {SECOND}, then {THIRD}"
    pieces = list(model.stream_chain([THIRD], start=two.resampled(40), seconds=2.0))
    assert [text for piece in pieces for text in piece.part_captions] == [FIRST, SECOND, THIRD]
    walk = Motion(make_motion("walk", seed=1, num_frames=60), 20.0, caption="a person walks")
    (after,) = model.generate_chain([FIRST], start=walk, seconds=2.0)
    assert after.part_captions == ("a person walks", FIRST) and after.part_starts[0] == 0


@pytest.mark.parametrize("seconds", [0.0, -1.0, float("nan"), 1e9])
def test_lengths_that_no_motion_has_are_refused(model, seconds):
    with pytest.raises(UserError, match=r"seconds: .* is not a number above 0, up to 3600"):
        model.generate_chain([FIRST], seconds=seconds)


def test_what_cannot_be_continued_is_refused(model):
    with pytest.raises(UserError, match="a code needs"):
        model.generate_chain([FIRST], start=Motion(make_motion("walk", seed=1, num_frames=40)[:2], 20.0))
    with pytest.raises(UserError, match="captions: give at least one"):
        model.generate_chain([])
    with pytest.raises(UserError, match="num-samples: 0"):
        model.generate_chain([FIRST], num_samples=0)


def test_a_stream_is_the_motion_as_decoded(model):
    options = {"start": Motion(make_motion("walk", seed=1, num_frames=60), 20.0), "seconds": 4.0, "seed": 5}
    pieces = list(model.stream_chain([FIRST, SECOND, THIRD], **options))
    (whole,) = model.generate_chain([FIRST, SECOND, THIRD], raw=True, **options)
    assert len(pieces) > 2
    for name in ("positions", "features", "codes"):
        np.testing.assert_array_equal(np.concatenate([getattr(piece, name) for piece in pieces]), getattr(whole, name))
    firsts = np.cumsum([0] + [piece.num_frames for piece in pieces])
    starts = [first + own for first, piece in zip(firsts, pieces, strict=False) for own in piece.part_starts]
    captions = [text for piece in pieces for text in piece.part_captions]
    assert (tuple(starts), tuple(captions)) == (whole.part_starts, whole.part_captions)
    assert {(piece.caption, piece.seed, piece.fps) for piece in pieces} == {(whole.caption, 5, 20.0)}


def test_a_stream_warns_as_the_whole_does(model):
    captions, options = ["a person walks for five seconds", SECOND], {"seconds": 2.0, "seed": 5}
    with pytest.warns(PromptWarning, match="takes 2 s, as asked for"):
        (whole,) = model.generate_chain(captions, **options)
    with pytest.warns(PromptWarning, match="takes 2 s, as asked for"):
        pieces = list(model.stream_chain(captions, **options))
    assert whole.warning
    assert {(piece.warning, piece.unknown_words) for piece in pieces} == {(whole.warning, whole.unknown_words)}


def test_a_stream_begins_before_all_is_sampled(model, monkeypatch):
    sampled = []
    sample_codes = model.parts.sample_codes
    monkeypatch.setattr(model.parts, "sample_codes", lambda *args, **kw: sampled.append(1) or sample_codes(*args, **kw))
    pieces = model.stream_chain([FIRST], seconds=60.0)
    assert not sampled
    next(pieces)
    first = len(sampled)
    assert sum(1 for _ in pieces) > 2 and 0 < first <= len(sampled) / 2


def test_what_cannot_be_streamed_is_refused_at_once(model):
    with pytest.raises(UserError, match="seconds: 0"):
        model.stream_chain([FIRST], seconds=0.0)


def test_parts_are_saved(tmp_path):
    motion = Motion(
        make_motion("walk", seed=1, num_frames=60),
        20.0,
        caption="a, then b",
        part_starts=(0, 20),
        part_captions=("a", "b"),
    )
    motion.save(tmp_path / "a.npz")
    again = Motion.load(tmp_path / "a.npz")
    assert (again.part_starts, again.part_captions) == ((0, 20), ("a", "b"))
    assert motion[10:].part_starts == (0, 10) and motion[20:].part_starts == ()
    for name in ("a.glb", "a.bvh"):
        motion.save(tmp_path / name)
        again = Motion.load(tmp_path / name)
        assert (again.part_starts, again.part_captions) == ((0, 20), ("a", "b"))
    assert b'"part_starts":[0,20],"part_captions":["a","b"]' in (tmp_path / "a.glb").read_bytes()
    (clip,) = load_gltf(tmp_path / "a.glb", fps=30.0).values()
    assert clip.parts == ()


@pytest.mark.parametrize(
    ("starts", "captions", "said"),
    [
        ((0,), (), "1 part_starts and 0"),
        ((-1,), ("a",), "do not rise"),
        ((3, 3), ("a", "b"), "do not rise"),
        ((60,), ("a",), r"\[60\] do not rise from 0 to below 60"),
    ],
)
def test_parts_that_are_not_in_the_motion_are_refused(starts, captions, said):
    with pytest.raises(UserError, match=said):
        Motion(make_motion("walk", seed=1, num_frames=60), 20.0, part_starts=starts, part_captions=captions)
