"""`MotionRequest`: each value is checked once, and every way to ask for a motion makes the same."""

import dataclasses
import itertools

import numpy as np
import pytest

from t2m_jax.data.importers.synthetic import make_motion
from t2m_jax.errors import UserError
from t2m_jax.motion.motion import Motion
from t2m_jax.sampling import Greedy, TextToMotion
from t2m_jax.sampling.model import ModelParts
from t2m_jax.sampling.request import MotionRequest, SamplingOptions, sentences
from t2m_jax.text.coverage import Knowledge
from t2m_jax.text.verbs import word_set
from tests import tiny

NAN = float("nan")
WALK = Motion(make_motion("walk", seed=1, num_frames=60), 20.0, caption="a person walks")
CHAIN = dataclasses.replace(WALK, part_starts=(0, 30), part_captions=("a", "b"))
FIRST, SECOND, THIRD = tiny.CAPTIONS[:3]


@pytest.fixture(scope="module")
def model():
    return TextToMotion(tiny.random_bundle())


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"temperature": -1.0}, "temperature: -1.0 is not a number above 0"),
        ({"temperature": NAN}, "temperature: nan"),
        ({"top_k": 0}, "top-k: 0 is not a whole number above 0"),
        ({"top_p": 1.5}, "top-p: 1.5 is not a probability"),
        ({"top_k": 3, "top_p": 0.5}, "top-k and top-p exclude each other"),
        ({"strategy": Greedy(), "top_k": 3}, "strategy: excludes temperature, top-k and top-p"),
        ({"guidance_scale": -1.0}, "guidance-scale: -1.0 is not a number from 0"),
        ({"guidance_scale": NAN}, "guidance-scale: nan"),
    ],
)
def test_options_that_no_model_has_are_one_line(options, said):
    with pytest.raises(UserError, match=said) as refused:
        SamplingOptions(**options)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"captions": ()}, "captions: give at least one sentence"),
        ({"captions": (" ",)}, "captions: '' has no words"),
        ({"captions": ("walk", " ")}, "captions: sentence 2: '' has no words"),
        ({"seed": -1}, "seed: -1 is not between 0 and"),
        ({"num_samples": 0}, "num-samples: 0 is not a whole number from 1 to 1,000,000"),
        ({"seconds": 0.0}, "seconds: 0 is not a number above 0, up to 3600"),
        ({"seconds": NAN}, "seconds: nan"),
        ({"span": (0.0, 1.0)}, "span: changes a motion; give it as start"),
        ({"strength": 0.5}, "strength: changes a motion; give it as start"),
        ({"start": WALK, "span": (0.0, 1.0), "strength": 0.5}, "span: excludes strength"),
        ({"start": WALK, "span": (0.0, 1.0), "captions": ("a", "b")}, "span: takes one sentence"),
        ({"start": WALK, "strength": 0.5, "captions": ("walk", "run")}, "strength: takes one sentence"),
        (
            {"start": CHAIN, "strength": 0.5, "captions": ("a", "b", "c")},
            r"one sentence \(or 2, one for each of the motion",
        ),
        ({"start": CHAIN, "span": (0.0, 1.0), "captions": ("a", "b")}, "span: takes one sentence"),
        ({"start": WALK, "strength": 0.5, "seconds": 2.0}, "strength: excludes seconds"),
        ({"start": WALK, "strength": 1.5}, "strength: 1.5 is not a number from 0 to 1"),
        ({"start": WALK, "strength": NAN}, "strength: nan"),
        ({"start": WALK, "span": (2.0, 1.0)}, "span: 2 to 1 s ends before it begins"),
        ({"start": WALK, "span": (-1.0, 1.0)}, "span: -1 to 1 is not"),
        ({"start": WALK, "span": (1.0, 1.0)}, "span: 1 to 1 is no time; give seconds"),
        ({"start": WALK, "span": (NAN, 1.0)}, "span: nan to 1 is not"),
        ({"start": WALK, "span": (0.0, float("inf"))}, "span: 0 to inf is not"),
        ({"start": WALK, "span": (0.0, 1.0), "candidates": 0}, "candidates: 0 is not a whole number from 1 to 32"),
        ({"start": WALK, "span": (0.0, 1.0), "candidates": 33}, "candidates: 33 is not"),
        ({"candidates": 8}, "candidates: is only for targets or a span to redo"),
        ({"start": WALK, "strength": 0.5, "candidates": 8}, "candidates: is only for"),
        ({"start": WALK, "span": (0.0, 1.0), "num_samples": 17}, "17 motions cannot be chosen from 16 candidates"),
    ],
)
def test_requests_that_no_model_can_answer_are_one_line(fields, said):
    with pytest.raises(UserError, match=said) as refused:
        MotionRequest(**{"captions": ("walk",)} | fields)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("option", [{"stop_rule": "sampled"}, {"max_codes": 3}])
@pytest.mark.parametrize("length", [{"seconds": 4.0}, {"span": (0.0, 1.0)}, {"strength": 0.5}])
def test_a_given_length_excludes_what_says_when_a_motion_ends(option, length):
    start = {} if "seconds" in length else {"start": WALK}
    said = f"{next(iter(length))}: excludes {next(iter(option)).replace('_', '-')}; the length of the motion is given"
    for captions in (("walk",), ("walk", "run"))[: 2 if not start else 1]:
        with pytest.raises(UserError, match=said):
            MotionRequest(captions=captions, options=SamplingOptions(**option), **length, **start)
    # A length that the sentence says is one wish beside others.
    MotionRequest(captions=("a person walks for five seconds",), options=SamplingOptions(**option))
    MotionRequest(captions=("walk",), start=WALK, options=SamplingOptions(**option))


@pytest.mark.slow  # the fast tests check types by themselves
@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"seconds": "3"}, "seconds: '3' is not a number above 0"),
        ({"num_samples": 2.5}, "num-samples: 2.5 is not a whole number"),
        ({"seconds": True}, "seconds: True is not a number above 0"),
        ({"num_samples": True}, "num-samples: True is not a whole number"),
        ({"seed": True}, "seed: True is not a whole number"),
        ({"start": WALK, "span": (False, True)}, "span: False to True are not two numbers of seconds"),
        ({"start": WALK, "span": (0.0, 1.0), "candidates": True}, "candidates: True is not a whole number"),
        ({"start": WALK, "strength": "1"}, "strength: '1' is not a number"),
        ({"start": WALK, "span": ("0", "1")}, "span: '0' to '1' are not two numbers of seconds"),
        ({"seed": 1.5}, "seed: 1.5 is not a whole number"),
        ({"start": WALK, "span": (0.0, 1.0), "candidates": 2.5}, "candidates: 2.5 is not a whole number"),
    ],
)
def test_numbers_of_another_type_are_refused(fields, said):
    with pytest.raises(UserError, match=said):
        MotionRequest(captions=("walk",), **fields)


@pytest.mark.slow  # the fast tests check types by themselves
@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"top_k": 10.5}, "top-k: 10.5 is not a whole number"),
        ({"max_codes": "5"}, "max-codes: '5' is not a whole number"),
        ({"temperature": "1"}, "temperature: '1' is not a number"),
    ],
)
def test_options_of_another_type_are_refused(options, said):
    with pytest.raises(UserError, match=said):
        SamplingOptions(**options)


@pytest.mark.parametrize("bound", [{"span": (0.0, 1.0)}, {"strength": 0.5}])
def test_a_change_of_a_motion_says_what_it_does_not_follow(bound):
    caption = "a person slowly kicks twice for 3 seconds"
    request = MotionRequest(captions=(caption,), start=WALK, **bound)
    assert request.lengths == request.times == request.paces == (None,)
    assert request.notes == (
        f"'{caption}': not followed in a change of a motion or with targets: length, number of times, pace",
    )
    assert MotionRequest(captions=("walk",), start=WALK, **bound).notes == ("",)
    assert MotionRequest(captions=(caption,), start=WALK).notes == ("",)


@pytest.mark.parametrize(
    ("caption", "seconds", "said"),
    [
        ("a person walks for 3 seconds", 5.0, "'a person walks for 3 seconds': takes 5 s, as asked for, and not 3 s"),
        ("a person walks for 3 seconds", 3.0, ""),
        ("a person walks for 3 seconds", None, ""),
        ("a person walks", 5.0, ""),
    ],
)
def test_another_length_than_the_sentence_says_is_told(caption, seconds, said):
    assert MotionRequest(captions=(caption,), seconds=seconds).notes == (said,)


def test_sentences_are_cleaned():
    assert MotionRequest(captions=(" a  person\nwalks ",)).captions == ("a person walks",)
    assert sentences("walk") == ("walk",) and sentences(["walk", "run"]) == ("walk", "run")


def test_unknown_options_are_named(model):
    for method in (model.generate, model.generate_each, model.generate_chain, model.stream, model.stream_chain):
        with pytest.raises(TypeError, match="temprature"):
            method(FIRST, temprature=0.5)
    for method, change in ((model.redo, (0.5, 1.0)), (model.vary, 0.5)):
        with pytest.raises(TypeError, match="temprature"):
            method(WALK, change, FIRST, temprature=0.5)


def assert_equal(found, expected):
    """To the last bit."""
    assert len(found) == len(expected)
    for one, other in zip(found, expected, strict=True):
        for name in ("positions", "positions_raw", "features", "codes"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
        for name in ("caption", "seed", "fps"):
            assert getattr(one, name) == getattr(other, name)


@pytest.mark.slow
def test_make_is_what_the_methods_return(model):
    options = {"temperature": 0.7, "raw": True}
    shared = {"seed": 3, "num_samples": 2, "options": SamplingOptions(**options)}
    options |= {"seed": 3, "num_samples": 2}
    asked = {
        "plain": (MotionRequest(captions=(FIRST,), **shared), model.generate(FIRST, **options)),
        "chain": (
            MotionRequest(captions=(FIRST, SECOND), start=WALK, seconds=1.0, **shared),
            model.generate_chain([FIRST, SECOND], start=WALK, seconds=1.0, **options),
        ),
        "redo": (
            MotionRequest(captions=(FIRST,), start=WALK, span=(0.5, 1.5), candidates=4, **shared),
            model.redo(WALK, (0.5, 1.5), FIRST, num_candidates=4, **options),
        ),
        "vary": (
            MotionRequest(captions=(WALK.caption,), start=WALK, strength=0.5, **shared),
            model.vary(WALK, 0.5, **options),
        ),
    }
    for request, expected in asked.values():
        assert_equal(list(model.make(request)), expected)
    together = list(model.make(*(request for request, _ in asked.values())))
    assert_equal(together, [motion for _, expected in asked.values() for motion in expected])


@pytest.mark.slow
def test_requests_with_the_same_options_share_a_batch(model, monkeypatch):
    sizes = []
    sample_codes = ModelParts.sample_codes

    def record(self, text_embedding, *args, **kwargs):
        sizes.append(len(text_embedding))
        return sample_codes(self, text_embedding, *args, **kwargs)

    monkeypatch.setattr(ModelParts, "sample_codes", record)
    plain = [MotionRequest(captions=(caption,), seed=seed) for seed, caption in enumerate((FIRST, SECOND))]
    other = dataclasses.replace(plain[0], options=SamplingOptions(temperature=0.5))
    told = []
    made = list(model.make(*plain, other, on_progress=lambda *counts: told.append(counts)))
    assert sizes == [2, 1] and told == [(2, 3), (3, 3)]
    assert [motion.caption for motion in made] == [FIRST, SECOND, FIRST]
    assert [motion.seed for motion in made] == [0, 1, 0]


def test_what_does_not_fit_the_model_is_said_at_once(model):
    for fields, said in (({"max_codes": 99}, "max-codes: 99"), ({"stop_rule": "argmax"}, "stop-rule: 'argmax'")):
        for verb in (model.make, model.make_pieces):
            with pytest.raises(UserError, match=said):
                verb(MotionRequest(captions=(FIRST,), options=SamplingOptions(**fields)))


@pytest.mark.slow
def test_pieces_of_all_requests_are_the_motion(model):
    options = SamplingOptions(temperature=0.5, raw=True)
    for fields in ({"captions": (FIRST,)}, {"captions": (FIRST, SECOND), "seconds": 2.0, "start": WALK}):
        request = MotionRequest(seed=4, options=options, **fields)
        (whole,) = model.make(request)
        pieces = list(model.make_pieces(request))
        assert len(pieces) > 1
        np.testing.assert_array_equal(np.concatenate([piece.codes for piece in pieces]), whole.codes)
    for change in ({"span": (0.5, 1.0)}, {"strength": 0.5}):
        with pytest.raises(UserError, match="stream: a change of a motion"):
            model.make_pieces(MotionRequest(captions=(FIRST,), start=WALK, **change))


def test_a_stop_rule_that_needs_all_rows_cannot_stream():
    model = TextToMotion(tiny.random_bundle(tiny.HIFIGPT_BUNDLE))
    with pytest.raises(UserError, match="stop-rule: 'argmax' needs all rows first"):
        model.stream(FIRST, stop_rule="argmax")


@pytest.mark.slow
def test_sentences_in_turn_are_limited_each(model):
    (motion,) = model.generate_chain([FIRST, SECOND, THIRD], max_codes=3)
    starts = [*motion.part_starts, motion.num_frames]
    assert all(after - first <= 3 * model.config.tokenizer.downsample for first, after in itertools.pairwise(starts))


IN_TURN = f"{FIRST}, then {SECOND}"


@pytest.fixture(scope="module")
def knowing():
    words = {word: 100 for caption in tiny.CAPTIONS for word in caption.split()}
    data = {"num_clips": 100, "words": words, "actions": {"walk": 60, "wave": 40}}
    return TextToMotion(tiny.random_bundle()._replace(training_data=data))


def same(one, other):
    return np.array_equal(one.positions, other.positions) and one.part_captions == other.part_captions


@pytest.mark.slow
def test_actions_in_turn_are_a_chain(knowing):
    (motion,) = knowing.generate([IN_TURN], seed=3)
    (chain,) = knowing.generate_chain([FIRST, SECOND], seed=3)
    assert same(motion, chain) and motion.part_captions == (FIRST, SECOND)
    assert same(knowing.generate_chain([IN_TURN], seed=3)[0], chain)
    assert knowing.generate([motion.caption], seed=3)[0].part_captions == (FIRST, SECOND)


@pytest.mark.slow
def test_a_whole_sentence_is_read_as_it_is(knowing, model):
    (whole,) = knowing.generate([IN_TURN], seed=3, whole=True)
    (unknowing,) = model.generate([IN_TURN], seed=3)
    assert same(whole, unknowing) and whole.part_captions == ()


@pytest.mark.slow
def test_a_stream_of_actions_in_turn_is_their_motion(knowing):
    motions = knowing.generate([IN_TURN], num_samples=2, raw=True)
    for sample, motion in enumerate(motions):
        pieces = list(knowing.stream(IN_TURN, sample=sample))
        np.testing.assert_array_equal(np.concatenate([piece.codes for piece in pieces]), motion.codes)
        np.testing.assert_allclose(np.concatenate([piece.positions for piece in pieces]), motion.positions, atol=1e-5)


@pytest.mark.parametrize(
    ("typed", "read"),
    [
        ("a person walks forward, tehn a person waves", ("a person walks forward", "a person waves")),
        ("wlaks tehn waves", ("walks", "waves")),
        ("waves three tmies", ("waves three times",)),
        ("walks for fiev seconds", ("walks for five seconds",)),
        ("walks slowyl", ("walks slowly",)),
        ("wvaes while a person walks", ("waves while a person walks",)),
        ("a person wlaks", ("a person wlaks",)),  # corrected when it is read, and the warning says so
    ],
)
def test_mistakes_that_hide_an_order_or_a_number_are_corrected_first(typed, read):
    words = word_set("a person walks forward waves while then three times for five seconds slowly")
    assert MotionRequest(captions=(typed,)).in_turn(Knowledge(words, ("walk", "wave"))).captions == read


@pytest.mark.slow
def test_actions_in_turn_share_the_seconds(knowing):
    request = MotionRequest(captions=(IN_TURN,), seconds=4.0)
    assert request.in_turn(knowing.knowledge).seconds == 2.0
    assert abs(next(knowing.make(request)).num_frames - 80) <= 8
    for fields in ({"span": (0.0, 1.0)}, {"strength": 0.5}):
        change = MotionRequest(captions=(IN_TURN,), start=WALK, **fields)
        assert change.in_turn(knowing.knowledge) is change
