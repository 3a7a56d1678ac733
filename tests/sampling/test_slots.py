"""Motions that begin and end in the slots of a batch at different times."""

import dataclasses

import numpy as np
import pytest

from t2m_jax.sampling import TextToMotion
from t2m_jax.sampling.programs import SLOT_ROWS
from t2m_jax.sampling.prompts import read_prompts, sample_key
from tests.tiny import BUNDLE, CAPTIONS, HIFIGPT, HIFIGPT_BUNDLE, random_bundle

pytestmark = pytest.mark.slow

CONFIGS = {
    "gpt": BUNDLE,
    "argmax": HIFIGPT_BUNDLE,
    "sampled": dataclasses.replace(HIFIGPT_BUNDLE, generator=dataclasses.replace(HIFIGPT, stop_rule="sampled")),
}
NUM_SLOTS = 4


@pytest.fixture(
    scope="module", params=["gpt", *(pytest.param(name, marks=pytest.mark.slow) for name in ("argmax", "sampled"))]
)
def model(request):
    return TextToMotion(random_bundle(CONFIGS[request.param]))


def begin(model, slots, chosen, requests):
    """Begins motions of requests, which are pairs of a caption and a seed."""
    prompts = read_prompts([caption for caption, _ in requests], model.knowledge, model.text_encoder)
    keys = [sample_key(seed, prompt.text, 0) for prompt, (_, seed) in zip(prompts, requests, strict=True)]
    slots.begin(chosen, list(model.text_encoder([prompt.text for prompt in prompts])), keys)


def run(model, requests, sampling=None):
    """Returns the codes of all requests, each in the first slot that gets free, and all that was reported."""
    slots = model.parts.slots(NUM_SLOTS, sampling or model.parts.sampling())
    waiting, owners, codes, reports = list(enumerate(requests)), {}, {}, []
    while waiting or owners:
        for slot in slots.free:
            if waiting:
                number, request = waiting.pop(0)
                begin(model, slots, [slot], [request])
                owners[slot] = number
        for progress in slots.step():
            reports.append((owners[progress.slot], progress))
            if progress.ended:
                codes[owners.pop(progress.slot)] = progress.codes
    return [codes[number] for number in range(len(requests))], reports


REQUESTS = [(caption, seed) for seed, caption in enumerate([*CAPTIONS, *CAPTIONS][:7])]


@pytest.fixture(scope="module")
def made(model):
    return run(model, REQUESTS)


def test_codes_are_those_of_generate(model, made):
    for (caption, seed), codes in zip(REQUESTS, made[0], strict=True):
        np.testing.assert_array_equal(codes, model.generate(caption, seed=seed, whole=True)[0].codes)


def test_codes_do_not_depend_on_what_is_in_the_other_slots(model, made):
    alone, _ = run(model, [REQUESTS[5]])
    np.testing.assert_array_equal(alone[0], made[0][5])


def test_reports_are_the_codes_in_turn(made):
    found, reports = made
    for number, codes in enumerate(found):
        own = [progress for owner, progress in reports if owner == number]
        assert [progress.ended for progress in own] == [False] * (len(own) - 1) + [True]
        assert all(progress.num_new <= SLOT_ROWS for progress in own)
        told = np.concatenate([one.codes[len(one.codes) - one.num_new :] for one in own])
        np.testing.assert_array_equal(told[: len(codes)], codes)


def test_a_slot_can_be_released(model):
    slots = model.parts.slots(2, model.parts.sampling())
    assert slots.free == [0, 1]
    begin(model, slots, [0, 1], REQUESTS[:2])
    assert slots.free == []
    slots.release([0])
    assert slots.free == [0] and {progress.slot for progress in slots.step()} == {1}


def test_a_motion_that_goes_on_is_not_disturbed_by_one_that_begins(model):
    """The second motion begins when the first one is in its middle."""
    sampling = model.parts.sampling(min_codes=SLOT_ROWS + 1)
    expected, _ = run(model, REQUESTS[:1], sampling)
    slots = model.parts.slots(NUM_SLOTS, sampling)
    begin(model, slots, [2], REQUESTS[:1])
    (progress,) = slots.step()
    assert not progress.ended
    begin(model, slots, [0], REQUESTS[1:2])
    while not progress.ended:
        progress = next(progress for progress in slots.step() if progress.slot == 2)
    np.testing.assert_array_equal(progress.codes, expected[0])
