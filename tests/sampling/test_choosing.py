"""Sentences that say how often something is done, how fast, and how long it lasts."""

import numpy as np
import pytest

from t2m_jax.data.importers.synthetic import make_motion
from t2m_jax.motion.skeleton import JOINT, KIT_ML
from t2m_jax.sampling.choosing import (
    AT_ONCE_CANDIDATES,
    FEW_CANDIDATES,
    SLOWEST_SHARE,
    candidate_keys,
    candidate_texts,
    choose,
    choose_by_count,
    choose_by_pace,
    count_shown,
    mean_speed,
    missed_count,
)
from t2m_jax.sampling.pipeline import TextToMotion
from t2m_jax.sampling.prompts import Prompt, sample_key
from t2m_jax.sampling.request import MotionRequest, SamplingOptions
from t2m_jax.sampling.segments import split_segments
from t2m_jax.text.at_once import SaidAtOnce, in_plain_words
from t2m_jax.text.counts import SaidSide, Times
from t2m_jax.text.coverage import PromptWarning
from t2m_jax.text.paces import SaidPace
from tests import tiny

pytestmark = pytest.mark.slow

JUMPS = "a person jumps 3 times"
TIMES = Times("jump", frozenset({"left", "right"}), 3)
MOST_ROWS = tiny.GPT.max_codes


@pytest.fixture(scope="module")
def model():
    return TextToMotion(tiny.random_bundle())


def candidates_of(model, caption, wanted):
    """Returns the codes that a sentence may give with seed 3."""
    parts = model.parts
    keys = candidate_keys(sample_key(3, caption, 0), wanted)
    texts = parts.text_encoder(candidate_texts(caption, wanted, len(keys)))
    sampled = parts.sample_codes(texts, keys, model.parts.sampling())
    lengths = np.asarray(sampled.code_lengths)
    return [codes[:length] for codes, length in zip(np.asarray(sampled.codes), lengths, strict=True)]


@pytest.fixture(scope="module")
def candidates(model):
    return candidates_of(model, JUMPS, TIMES)


def misses(model, codes):
    motion = model.decode(codes, raw=True)
    return abs(count_shown(TIMES, motion.positions) - TIMES.number)


def test_the_motion_with_the_asked_count_is_taken(model, candidates):
    least = min(misses(model, codes) for codes in candidates)
    first = next(codes for codes in candidates if misses(model, codes) == least)
    np.testing.assert_array_equal(choose_by_count(model.parts, candidates, TIMES, most_rows=MOST_ROWS), first)
    (motion,) = model.generate(JUMPS, seed=3)
    np.testing.assert_array_equal(motion.codes, first)


def test_a_counted_motion_is_not_longer_than_asked_for(model):
    for seed in range(3):
        (motion,) = model.generate(JUMPS, seed=seed, max_codes=8, raw=True)
        assert len(motion.codes) <= 8


def test_a_sentence_that_is_read_whole_gives_the_first_candidate(model, candidates):
    (whole,) = model.generate(JUMPS, seed=3, whole=True)
    np.testing.assert_array_equal(whole.codes, candidates[0])


def test_samples_of_a_counted_sentence_do_not_depend_on_each_other(model):
    first, second, _ = model.generate(JUMPS, seed=3, num_samples=3)
    (alone,) = model.generate(JUMPS, seed=3)
    np.testing.assert_array_equal(first.codes, alone.codes)
    assert len(first.codes) != len(second.codes) or (first.codes != second.codes).any()
    pieces = list(model.stream(JUMPS, seed=3, sample=1))
    np.testing.assert_array_equal(np.concatenate([piece.codes for piece in pieces]), second.codes)


def test_a_missed_count_is_said(model):
    (motion,) = model.generate("a person jumps 19 times", seed=3)
    assert motion.warning.endswith("times; try another seed") and "jump is counted" in motion.warning
    still = np.zeros((20, 22, 3), np.float32)
    assert missed_count(TIMES, still, sentence=JUMPS) == (f"'{JUMPS}': jump is counted 0 times; try another seed")
    assert missed_count(TIMES._replace(number=0), still, sentence=JUMPS) == ""


def test_a_count_in_a_motion_that_is_too_long_for_it_is_said(model):
    segments = split_segments(Prompt(JUMPS, JUMPS, "told before", ()), 30, limit=12, wanted=TIMES)
    assert [segment.num_rows for segment in segments] == [12, 12, 6]
    expected = f"told before {JUMPS!r}: too long to choose a sample by its count (jump 3 times)"
    assert {segment.prompt.warning for segment in segments} == {expected}
    (motion,) = model.generate_chain([JUMPS], seed=3, seconds=12)
    assert "too long to choose a sample by its count" in motion.warning


def test_motion_of_other_skeletons_is_not_counted(model, monkeypatch):
    monkeypatch.setattr("t2m_jax.sampling.timeline.HUMANML3D", KIT_ML)  # as if the model's were the other one
    (motion,) = model.generate("a person jumps 19 times", seed=3)
    assert not motion.warning
    (plain,) = model.generate("a person jumps 19 times", seed=3, whole=True)
    np.testing.assert_array_equal(motion.codes, plain.codes)


@pytest.mark.parametrize(("words", "best"), [("slowly", min), ("fast", max)])
def test_the_slowest_or_fastest_motion_is_taken(model, words, best):
    caption = f"a person waves {words}"
    candidates = candidates_of(model, caption, SaidPace(words == "slowly", ""))
    speeds = [mean_speed(model.decode(codes, raw=True).positions) for codes in candidates]
    assert len(speeds) == FEW_CANDIDATES and len(set(speeds)) > 1
    moving = [number for number, speed in enumerate(speeds) if speed >= SLOWEST_SHARE * np.median(speeds)]
    chosen = candidates[best(moving, key=speeds.__getitem__)]
    (motion,) = model.generate(caption, seed=3)
    np.testing.assert_array_equal(motion.codes, chosen)
    pieces = list(model.stream(caption, seed=3))
    np.testing.assert_array_equal(np.concatenate([piece.codes for piece in pieces]), chosen)
    (whole,) = model.generate(caption, seed=3, whole=True)
    np.testing.assert_array_equal(whole.codes, candidates[0])


def test_only_sentences_with_a_pace_are_chosen_by_it():
    request = MotionRequest(captions=("a person walks slowly", "a person waves", "runs fast"))
    assert request.paces == (SaidPace(True, "walk"), None, SaidPace(False, "run"))
    assert not MotionRequest(captions=request.captions[:1]).is_plain
    whole = MotionRequest(captions=request.captions[:1], options=SamplingOptions(whole=True))
    assert whole.paces == (None,) and whole.is_plain


@pytest.fixture
def chosen(model, monkeypatch):
    """Returns a function of speeds in m/s, and of a pace, that gives the number of the candidate that is chosen."""
    going = np.arange(20.0)[:, None, None] * np.array([1.0, 0.0, 0.0]) / model.skeleton.fps

    def choose_number(speeds, *, is_slow, gait=""):
        shown = [np.repeat(speed * going, 22, axis=1) for speed in speeds]
        monkeypatch.setattr("t2m_jax.sampling.choosing._decoded", lambda model, candidates: shown)
        candidates = [np.full((1, 1), number) for number in range(len(speeds))]
        return int(choose_by_pace(model.parts, candidates, SaidPace(is_slow, gait))[0, 0])

    return choose_number


def test_a_fast_walk_is_not_a_run(chosen):
    speeds = (1.0, 4.0, 1.9, 3.0)
    assert [chosen(speeds, is_slow=False, gait=gait) for gait in ("walk", "run", "")] == [2, 1, 1]
    assert [chosen(speeds, is_slow=True, gait=gait) for gait in ("walk", "run", "")] == [0, 2, 0]
    assert chosen((4.0, 3.0), is_slow=False, gait="walk") == 0, "all run"


def test_the_side_that_is_asked_for_does_it(model, monkeypatch):
    def kick(left, right):
        positions = np.zeros((20, 22, 3))
        positions[10, JOINT["left_ankle"], 1] = left
        positions[10, JOINT["right_ankle"], 1] = right
        return positions

    def chosen(*shown, side):
        monkeypatch.setattr("t2m_jax.sampling.choosing._decoded", lambda model, candidates: shown)
        candidates = [np.full((1, 1), number) for number in range(len(shown))]
        return int(choose(model.parts, candidates, SaidSide("kick", side), most_rows=0)[0, 0])

    shown = [kick(0.1, 0.1), kick(1.0, 0.1), kick(0.1, 0.5), kick(0.1, 1.0)]
    assert chosen(*shown, side="left") == 1 and chosen(*shown, side="right") == 2
    assert chosen(*shown[:2], side="right") == 0, "none does; the nearest"


def test_a_kick_with_a_side_is_one_of_few_samples(model):
    caption, side = "a person kicks with the left leg", SaidSide("kick", "left")
    candidates = candidates_of(model, caption, side)
    assert len(candidates) == FEW_CANDIDATES
    (motion,) = model.generate(caption, seed=3)
    np.testing.assert_array_equal(motion.codes, choose(model.parts, candidates, side, most_rows=0))
    (whole,) = model.generate(caption, seed=3, whole=True)
    np.testing.assert_array_equal(whole.codes, candidates[0])


LEFT = frozenset({"left"})


def test_legs_and_arms_are_both_chosen(model, monkeypatch):
    walk, wave, wrong = (
        make_motion(kind, seed=1, num_frames=60) for kind in ("walk", "wave-left-hand", "wave-right-hand")
    )
    both = wave + (walk - walk[:1])[:, :1]  # the waving body, moved along the walk

    def chosen(*shown, legs="walk"):
        monkeypatch.setattr("t2m_jax.sampling.choosing._decoded", lambda model, candidates: shown)
        candidates = [np.full((1, 1), number) for number in range(len(shown))]
        return int(choose(model.parts, candidates, SaidAtOnce(legs, "wave", LEFT), most_rows=0)[0, 0])

    assert chosen(wrong, walk, wave, both, both) == 3
    assert chosen(wrong, wave, walk) == 1, "none does both; the first that does one"
    assert chosen(walk, wave, both, legs="") == 1, "the path is not checked"
    assert chosen(walk[:1], wrong) == 0, "one frame shows nothing"


def test_what_is_done_at_once_is_one_of_some_samples(model):
    caption, said = "she waves the left hand as she walks", SaidAtOnce("walk", "wave", LEFT)
    texts = candidate_texts(caption, said, AT_ONCE_CANDIDATES)
    assert texts == [caption] * 4 + [in_plain_words(said)] * 4
    assert candidate_texts(caption, said._replace(legs=""), 3) == [caption] * 3
    assert candidate_texts(JUMPS, TIMES, 2) == [JUMPS] * 2
    candidates = candidates_of(model, caption, said)
    (motion,) = model.generate(caption, seed=3)
    np.testing.assert_array_equal(motion.codes, choose(model.parts, candidates, said, most_rows=0))
    (whole,) = model.generate(caption, seed=3, whole=True)
    np.testing.assert_array_equal(whole.codes, candidates[0])


def test_only_sentences_of_legs_and_arms_are_chosen_by_them():
    request = MotionRequest(captions=("runs while clapping", "a person runs"))
    assert request.at_once == (SaidAtOnce("run", "clap", frozenset()), None)
    assert not MotionRequest(captions=request.captions[:1]).is_plain
    assert MotionRequest(captions=request.captions[:1], options=SamplingOptions(whole=True)).is_plain
    assert MotionRequest(captions=request.captions[1:]).is_plain


def test_who_hardly_moves_is_not_slow(chosen):
    assert chosen((0.1, 0.5, 0.6, 0.7), is_slow=True, gait="walk") == 1
    assert chosen((0.1, 1.0, 0.9, 1.1), is_slow=True) == 2, "a tenth of what others do"
    assert chosen((0.1, 0.1, 0.15, 0.12), is_slow=True) == 0, "nobody moves much"


def test_a_count_is_more_than_a_pace(model):
    caption = "a person slowly jumps 3 times"
    candidates = candidates_of(model, caption, TIMES)
    (motion,) = model.generate(caption, seed=3)
    np.testing.assert_array_equal(motion.codes, choose_by_count(model.parts, candidates, TIMES, most_rows=MOST_ROWS))


def test_speed_is_the_mean_of_all_joints():
    steps = np.arange(5.0)[:, None, None] * np.array([0.3, 0.0, 0.4])
    assert mean_speed(steps.repeat(2, axis=1)) == pytest.approx(0.5)
    assert mean_speed(np.zeros((1, 22, 3))) == 0


@pytest.mark.parametrize(("words", "seconds"), [("for 2 seconds", 2.0), ("for 2.5 seconds", 2.5)])
def test_a_sentence_sets_the_length_of_its_motion(model, words, seconds):
    caption = f"walks {words}"
    (motion,) = model.generate(caption, seed=3)
    (asked,) = model.generate_chain([caption], seconds=seconds, seed=3)
    np.testing.assert_array_equal(motion.positions, asked.positions)
    assert abs(motion.num_frames - seconds * motion.fps) <= model.config.tokenizer.downsample / 2


def test_seconds_count_more_than_words(model):
    request = MotionRequest(captions=("a person walks for 2 seconds",), seconds=3.0)
    assert request.lengths == (3.0,) and not request.is_plain
    with pytest.warns(PromptWarning, match="takes 3 s, as asked for, and not 2 s"):
        (motion,) = model.make(request)
    assert motion.num_frames == 60 and "not 2 s" in motion.warning


def test_each_sentence_sets_its_own_length(model):
    (motion,) = model.generate_chain(["walks for 2 seconds", "a person waves for 3 seconds", "a person walks"])
    assert motion.part_starts == (0, 40, 100)
    whole = MotionRequest(captions=("walks for 2 seconds",), options=SamplingOptions(whole=True))
    assert whole.lengths == (None,) and whole.is_plain
