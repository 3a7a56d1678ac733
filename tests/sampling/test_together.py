"""Batches of different sentences and seeds, with reports while they are sampled."""

import dataclasses

import numpy as np
import pytest

from t2m_jax.sampling import TextToMotion
from t2m_jax.sampling.prompts import read_prompts
from t2m_jax.sampling.together import Sample, generate_together
from tests.tiny import BUNDLE, CAPTIONS, HIFIGPT, HIFIGPT_BUNDLE, random_bundle

CONFIGS = {
    "gpt": BUNDLE,
    "argmax": HIFIGPT_BUNDLE,
    "sampled": dataclasses.replace(HIFIGPT_BUNDLE, generator=dataclasses.replace(HIFIGPT, stop_rule="sampled")),
}


@pytest.fixture(scope="module", params=CONFIGS)
def made(request):
    """Returns a model, samples of different seeds, their motions, and what was reported."""
    model, reports = TextToMotion(random_bundle(CONFIGS[request.param])), []
    prompts = read_prompts(CAPTIONS[:3], model.knowledge, model.text_encoder)
    samples = [Sample(prompt, seed, seed % 2) for seed, prompt in enumerate(prompts)]
    options = {"batch_size": 4, "sampling": model.sampling(), "guidance_scale": None}
    motions = generate_together(model, samples, on_rows=reports.append, decode_early=True, **options)
    return model, samples, motions, reports, options


def test_motions_are_those_of_generate(made):
    model, samples, motions, *_ = made
    for sample, motion in zip(samples, motions, strict=True):
        expected = model.generate(sample.prompt.text, seed=sample.seed, num_samples=2)[sample.number]
        np.testing.assert_array_equal(motion.codes, expected.codes)
        np.testing.assert_allclose(motion.positions, expected.positions, atol=1e-4)
        assert (motion.caption, motion.seed) == (expected.caption, expected.seed)


def test_reports_are_the_codes_and_frames_in_turn(made):
    _, _, motions, reports, options = made
    for number, motion in enumerate(motions):
        own = [report for report in reports if report.sample == number]
        codes = np.concatenate([report.codes for report in own])
        np.testing.assert_array_equal(codes[: len(motion.codes)], motion.codes)
        frames = [report.motion.positions for report in own if report.motion is not None]
        if options["sampling"].stop_rule.ends_early:
            np.testing.assert_allclose(np.concatenate(frames), motion.positions_raw, atol=1e-4)
        else:  # frames depend on the rows after them, and which of these are kept is only known at the end
            assert frames == []


def test_a_motion_does_not_depend_on_its_batch(made):
    model, samples, motions, _, options = made
    (alone,) = generate_together(model, samples[1:2], **options)
    np.testing.assert_array_equal(alone.positions, motions[1].positions)
