"""A new middle for a motion, and variations of it."""

import dataclasses
import itertools
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax import Motion, load
from t2m_jax.data.importers.synthetic import make_motion
from t2m_jax.errors import UserError
from t2m_jax.models.system import make_module
from t2m_jax.motion.features import bone_vectors
from t2m_jax.motion.skeleton import HUMANML3D
from t2m_jax.motion.targets import read_target
from t2m_jax.sampling.directing import cost_of
from t2m_jax.sampling.inbetween import Middle, rank_middles
from tests import tiny

pytestmark = pytest.mark.slow

CAPTION = tiny.CAPTIONS[1]


@pytest.fixture(scope="module")
def walk():
    return Motion(make_motion("walk", seed=1, num_frames=83), 20.0, caption="a person walks")


def likelihoods(model, codes):
    codes = jnp.asarray(codes, jnp.int32)
    return np.asarray(model.parts.log_likelihood(codes, model.text_encoder([CAPTION] * len(codes))))


def test_probabilities_of_all_rows_add_up_to_one(model):
    config = model.config.tokenizer
    rows = np.array(list(itertools.product(range(config.num_codes), repeat=config.num_quantizers)), np.int32)
    codes = np.stack([np.broadcast_to(rows[5], rows.shape), rows], axis=1)
    total = np.exp(likelihoods(model, codes)[:, 1].astype(np.float64)).sum()
    if model.config.generator.stop_rule == "end":
        module = make_module(model.config.generator)
        logits = module.apply(
            model.variables["generator"], jnp.full((1, 1), 5), model.text_encoder([CAPTION]), train=False
        )
        total += float(jax.nn.softmax(logits[0, 1])[module.config.end_token])
    np.testing.assert_allclose(total, 1, rtol=1e-5)


def test_rows_are_as_likely_as_they_are_often_sampled(model):
    (first,) = model.generate(CAPTION, temperature=0.0)
    likely = likelihoods(model, first.codes[None])[0]
    changed = first.codes.copy()
    changed[2] = (changed[2] + 1) % model.config.tokenizer.num_codes
    other = likelihoods(model, changed[None])[0]
    np.testing.assert_allclose(other[:2], likely[:2], rtol=1e-5)
    assert other[2] < likely[2] < 0


def shape_of(positions):
    """Distances of all pairs of joints in each frame and the next one, which turns and moves do not change."""
    both = np.concatenate([positions[:-1], positions[1:]], axis=1).astype(np.float64)
    return np.linalg.norm(both[:, :, None] - both[:, None], axis=-1)


@pytest.mark.parametrize("raw", [False, True])
@pytest.mark.parametrize("span", [(1.2, 2.4), (0.0, 1.2), (2.4, 4.15), (0.0, 4.15), (1.21, 1.22)])
def test_head_and_tail_stay_as_they_are(model, walk, span, raw):
    (redone,) = model.redo(walk, span, CAPTION, raw=raw, num_candidates=2)
    downsample = model.config.tokenizer.downsample
    expected = walk.num_frames if span[1] < 4 else round(walk.num_frames / downsample) * downsample
    assert redone.num_frames == expected and redone.fps == 20
    number = redone.part_captions.index(CAPTION)
    first, last = (*redone.part_starts, expected)[number : number + 2]
    assert abs(first / 20 - span[0]) <= downsample / 40 and abs(last / 20 - span[1]) <= downsample / 20 + 0.2
    np.testing.assert_array_equal(redone.positions[:first], walk.positions[:first])
    np.testing.assert_allclose(redone.positions[last:, :, 1], walk.positions[last:expected, :, 1], atol=1e-5)
    if last < expected:
        np.testing.assert_allclose(shape_of(redone.positions[last:]), shape_of(walk.positions[last:]), atol=1e-4)
    lengths = np.linalg.norm(bone_vectors(redone.positions, HUMANML3D), axis=-1)
    np.testing.assert_allclose(lengths, np.broadcast_to(lengths[:1], lengths.shape), atol=1e-3)


def test_the_sentence_of_a_middle_has_its_place(model, walk):
    (redone,) = model.redo(walk, (1.2, 2.4), CAPTION, seed=4, num_candidates=2)
    assert redone.part_captions == ("a person walks", CAPTION, "a person walks")
    assert redone.caption == f"a person walks, then {CAPTION}, then a person walks" and redone.seed == 4
    (again,) = model.redo(redone, (1.6, 2.0), "a man turns", num_candidates=2)
    assert again.part_captions == ("a person walks", CAPTION, "a man turns", CAPTION, "a person walks")
    assert list(again.part_starts) == sorted(again.part_starts)


@pytest.mark.parametrize("span", [(1.2, 2.4), (0.0, 1.2), (2.4, 4.15), (1.2, 1.2), (0.0, 0.0), (4.15, 4.15)])
def test_a_middle_has_its_own_length(model, walk, span):
    (redone,) = model.redo(walk, span, CAPTION, seconds=1.6, num_candidates=2)
    downsample = model.config.tokenizer.downsample
    first, end = (min(downsample * round(time * 20 / downsample), walk.num_frames) for time in span)
    last = first + 32
    tail = walk.positions[end:] if span[1] < 4 else walk.positions[:0]
    assert redone.num_frames == last + len(tail)
    parts = dict(zip(redone.part_starts, redone.part_captions, strict=True))
    walks = [0] * bool(first) + [last] * bool(len(tail))
    assert parts == dict.fromkeys(walks, "a person walks") | {first: CAPTION}
    np.testing.assert_array_equal(redone.positions[:first], walk.positions[:first])
    np.testing.assert_allclose(redone.positions[last:, :, 1], tail[..., 1], atol=1e-5)


@pytest.mark.both
@pytest.mark.parametrize(
    "span", [(1.2, 2.4), *(pytest.param(span, marks=pytest.mark.release) for span in [(0.0, 1.2), (2.4, 4.15)])]
)
def test_targets_bring_a_middle_nearer_or_leave_it(model, walk, span):
    """The motion begins somewhere else and faces another way than one that is generated."""
    turn = np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]], np.float32)
    turned = dataclasses.replace(walk, positions=walk.positions @ turn + np.array([3, 0, 1], np.float32))
    (plain,) = model.redo(turned, span, CAPTION, num_candidates=2)
    frame = round(10 * sum(span))
    x, z = plain.positions[frame, 0, [0, 2]] + 0.2
    targets = [f"{frame / 20} right_wrist+=-0.3,1.2,0.2", f"{frame / 20} root={x},{z}"]
    (redone,) = model.direct(CAPTION, targets, start=turned, span=span, num_candidates=2)
    read = [read_target(text) for text in targets]
    # Not all random weights can bring it nearer; `test_the_packaged_model_meets_targets_in_a_middle` asks for more.
    share = 0.6 if model.config.tokenizer.num_quantizers == 1 else 1.0
    assert cost_of(read, redone) <= share * cost_of(read, plain) + 1e-3
    first = round(20 * span[0])
    last = round(20 * span[1]) if span[1] < 4 else redone.num_frames
    np.testing.assert_array_equal(redone.positions[:first], turned.positions[:first])
    tail = turned.positions[last : redone.num_frames]
    if len(tail):
        np.testing.assert_allclose(shape_of(redone.positions[last:]), shape_of(tail), atol=1e-4)
    lengths = np.linalg.norm(bone_vectors(redone.positions, HUMANML3D), axis=-1)
    np.testing.assert_allclose(lengths, np.broadcast_to(lengths[:1], lengths.shape), atol=1e-3)


@pytest.mark.parametrize(
    ("target", "says"),
    [
        ("0.5 root=0,0", "is not in the part that is made again, 1.2 to 2.4 s"),
        ("1.5:3 root=0,0", "is not in the part that is made again"),
        ("2.4 root=0,0", "is not in the part that is made again"),
        ("1.3 root=9,9", "m in 0.1 s is faster than 5 m/s"),
        ("1.3 root=0,1 exact", "cannot be exact in a part that is made again"),
        ("1.3 nose=0,1,0", "no such joint"),
    ],
)
def test_targets_that_no_middle_can_meet_are_refused(model, walk, target, says):
    with pytest.raises(UserError, match=re.escape(says)):
        model.direct(CAPTION, [target], start=walk, span=(1.2, 2.4), num_candidates=1)


@pytest.mark.release
def test_the_packaged_model_meets_targets_in_a_middle():
    model = load("demo")
    (walk,) = model.generate("a person walks forward", seed=1)
    x, y, z = walk.positions[36, 21] + np.array([0, 0.4, 0.1])
    targets = [f"1.8 right_wrist={x},{y},{z}", f"2 root={walk.positions[40, 0, 0] + 0.2},{walk.positions[40, 0, 2]}"]
    (redone,) = model.direct("a person walks forward", targets, start=walk, span=(1.2, 2.8))
    assert redone.warning == "" and redone.num_frames == walk.num_frames
    np.testing.assert_array_equal(redone.positions[:24], walk.positions[:24])


@pytest.mark.parametrize("targets", [[], pytest.param(["1.8 right_wrist+=-0.3,1.2,0.2"], marks=pytest.mark.release)])
def test_a_motion_with_a_new_middle_comes_back_from_each_file(model, walk, tmp_path, targets):
    """Cleaned motions of one model differ in the shapes of pelvis and chest, and files have rigid bones."""
    start = walk.cleaned()
    # Without targets, this is `redo`.
    (redone,) = model.direct(CAPTION, targets, start=start, span=(1.2, 2.4), num_candidates=2)
    np.testing.assert_array_equal(redone.positions[:24], start.positions[:24])
    for suffix in ("bvh", "glb", "vrma"):
        redone.save(tmp_path / f"redone.{suffix}")
        apart = Motion.load(tmp_path / f"redone.{suffix}").positions - redone.positions
        # Random weights may walk below the floor, to which readers bring what they read.
        assert np.linalg.norm(apart - apart[0, 0], axis=-1).max() < 1e-3


def test_later_sentences_move_with_the_end_of_a_middle(model, walk):
    chain = dataclasses.replace(walk, part_starts=(0, 24, 48), part_captions=("a", "b", "c"))
    (redone,) = model.redo(chain, (1.2, 2.4), "b", seconds=0.8, num_candidates=2)
    assert redone.part_starts == (0, 24, 40) and redone.part_captions == ("a", "b", "c")
    (redone,) = model.redo(chain, (1.2, 1.2), "d", seconds=0.8, num_candidates=2)
    assert redone.part_starts == (0, 24, 40, 64) and redone.part_captions == ("a", "d", "b", "c")


def test_a_motion_may_have_no_sentence_at_its_beginning(model, walk):
    """Such as one that was continued."""
    chain = dataclasses.replace(walk, part_starts=(48,), part_captions=("c",))
    (redone,) = model.redo(chain, (0.4, 1.2), "b", num_candidates=2)
    assert redone.part_starts == (0, 8, 24, 48) and redone.part_captions == ("", "b", "", "c")
    (varied,) = model.vary(redone, 0.5)
    assert varied.part_captions == ("b", "b", "b", "c")


def test_the_best_middles_come_first(model, walk):
    best, second = model.redo(walk, (1.2, 2.4), CAPTION, num_samples=2, num_candidates=2)
    (alone,) = model.redo(walk, (1.2, 2.4), CAPTION, num_candidates=2)
    np.testing.assert_array_equal(best.positions, alone.positions)
    assert (best.positions != second.positions).any()
    (other,) = model.redo(walk, (1.2, 2.4), CAPTION, num_candidates=2, seed=1)
    assert (best.positions != other.positions).any()


def test_a_middle_may_be_longer_than_the_generator_can_read(model):
    rows = model.config.generator.max_codes + 5
    frames = model.config.tokenizer.downsample * (rows + 4)
    motion = Motion(make_motion("walk", seed=1, num_frames=frames), 20.0)
    row_seconds = model.config.tokenizer.downsample / 20
    (redone,) = model.redo(motion, (2 * row_seconds, (rows + 2) * row_seconds), CAPTION, num_candidates=2)
    assert redone.num_frames == frames and redone.part_starts[1] == 2 * model.config.tokenizer.downsample


def test_the_last_seconds_of_a_file_can_be_made_again(model):
    motion = Motion(make_motion("walk", seed=1, num_frames=88), 20.0)
    (redone,) = model.redo(motion, (3.2, motion.seconds), CAPTION, num_candidates=2)
    assert redone.num_frames == 88 and redone.part_starts[1] == 64


def test_motion_of_another_frame_rate_gets_the_model_s(model, walk):
    (redone,) = model.redo(walk.resampled(60), (1.2, 2.4), CAPTION, num_candidates=2)
    assert redone.fps == 20 and abs(redone.num_frames - walk.num_frames) <= 1


def test_spans_that_are_not_in_the_motion_are_refused(model, walk):
    end = len(model.encode(walk)) * model.config.tokenizer.downsample / 20
    with pytest.raises(UserError, match=f"span: 1 to 9 s is not a part of the time from 0 to {end:.1f} s"):
        model.redo(walk, (1.0, 9.0), CAPTION)


def test_more_motions_than_candidates_are_refused(model, walk):
    with pytest.raises(UserError, match="17 motions cannot be chosen from 16 candidates"):
        model.redo(walk, (1.2, 2.4), CAPTION, num_samples=17)


def middle_with(tail, *, shift):
    """Returns a candidate whose frames after a middle of 4 frames are the tail, with raised arms."""
    positions = np.concatenate([tail[:4], tail]).copy()
    positions[4:, 16:] += [0, shift, 0]
    return Middle(positions, 0, 4, np.zeros((1, 1), np.int32))


def test_candidates_are_ranked_by_likelihood_and_jump(walk):
    tail = walk.positions[40:]
    candidates = [middle_with(tail, shift=shift) for shift in (0.3, 0.1, 0.0, 0.2)]
    # By the jump alone, they would be in the order 2, 1, 3, 0, and by the likelihood alone, 0, 1, 3, 2.
    likelihoods = np.array([-4.0, -5.0, -9.0, -6.0])
    assert rank_middles(tail, candidates, likelihoods, skeleton=HUMANML3D) == [1, 0, 2, 3]
    assert rank_middles(tail[:0], candidates, likelihoods, skeleton=HUMANML3D) == [0, 1, 2, 3]


def test_variations_keep_a_share_of_the_codes(model, walk):
    codes = model.encode(walk)
    shares = []
    for strength in (0.0, 0.3, 1.0):
        variations = model.vary(walk, strength, CAPTION, num_samples=4)
        assert all(one.codes.shape == codes.shape and one.caption == CAPTION for one in variations)
        shares.append(np.mean([(one.codes != codes).any(axis=1).mean() for one in variations]))
    assert shares[0] == 0 and 0.1 < shares[1] < 0.5 and shares[2] > 0.8


def test_a_variation_depends_on_its_number_only(model, walk):
    (alone,) = model.vary(walk, 0.5, seed=2)
    first, second, third = model.vary(walk, 0.5, seed=2, num_samples=3)
    np.testing.assert_array_equal(alone.codes, first.codes)
    assert alone.caption == "a person walks"
    assert (first.codes != second.codes).any() and (second.codes != third.codes).any()


def test_a_variation_of_a_chain_keeps_its_sentences(model):
    (chain,) = model.generate_chain(tiny.CAPTIONS[:2], seconds=2.0, seed=1)
    kept = chain.part_starts, chain.part_captions
    for strength in (0.0, 0.5):
        (varied,) = model.vary(chain, strength, seed=2)
        assert (varied.part_starts, varied.part_captions, varied.caption) == (*kept, chain.caption)
        assert (varied.codes == model.encode(chain)).all() == (strength == 0)
    (whole,) = model.vary(chain, 0.5, CAPTION)
    assert whole.part_captions == (CAPTION,)
    (slow,) = model.vary(dataclasses.replace(chain, part_starts=(0, 1)), 0.5)  # both begin in the first row of codes
    assert slow.part_captions == (tiny.CAPTIONS[1],)


@pytest.mark.parametrize("strength", [-0.1, 1.01, float("nan")])
def test_strengths_that_are_not_shares_are_refused(model, walk, strength):
    with pytest.raises(UserError, match=r"strength: .* is not a number from 0 to 1"):
        model.vary(walk, strength)
