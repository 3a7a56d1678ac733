"""Motion while it is generated: the pieces are the motion of the batch."""

import dataclasses
import itertools

import numpy as np
import pytest

from t2m_jax.errors import UserError
from t2m_jax.sampling import TextToMotion
from t2m_jax.sampling import model as sampling_model
from t2m_jax.sampling.request import SamplingOptions
from t2m_jax.sampling.strategies import Greedy
from tests import tiny


def stop_rule(model):
    return None if model.config.generator.stop_rule == "end" else "threshold"


@pytest.mark.slow
@pytest.mark.parametrize("strategy", [None, Greedy()], ids=["drawn", "greedy"])
def test_pieces_are_the_motion_of_generate(model, strategy):
    lengths = set()
    for seed, sample in itertools.product(range(3), range(2)):
        options = {"seed": seed, "strategy": strategy}
        motions = model.generate(tiny.CAPTIONS[:3], num_samples=2, stop_rule=stop_rule(model), raw=True, **options)
        expected = motions[2 + sample]
        pieces = list(model.stream(tiny.CAPTIONS[1], sample=sample, **options))
        assert {len(piece.codes) for piece in pieces} == {1}
        assert {piece.num_frames for piece in pieces} == {model.config.tokenizer.downsample}
        np.testing.assert_array_equal(np.concatenate([piece.codes for piece in pieces]), expected.codes)
        for name in ("features", "positions"):
            found, whole = np.concatenate([getattr(piece, name) for piece in pieces]), getattr(expected, name)
            # Random weights give features in the hundreds, which are sums of numbers of this size.
            np.testing.assert_allclose(found, whole, atol=max(1e-4, 2e-6 * np.abs(whole).max()))
        assert pieces[0].caption == expected.caption and pieces[0].seed == seed
        lengths.add(len(pieces))
    assert len(lengths) > 1 or strategy is not None


@pytest.mark.slow
def test_pieces_come_before_the_end(model, monkeypatch):
    """As soon as the decoder's context is known, and not earlier."""
    rows = []
    generate_row = sampling_model.generate_row
    monkeypatch.setattr(sampling_model, "generate_row", lambda *a, **k: rows.append(1) or generate_row(*a, **k))
    context = model.config.tokenizer.decoder_context
    longest = model.config.generator.max_codes
    # A stop probability of 1 is never reached.
    endless = {"stop_threshold": 1.0} if stop_rule(model) else {}
    generator = dataclasses.replace(model.config.generator, **endless)
    name = "gpt" if stop_rule(model) is None else "hifigpt"
    long = TextToMotion(tiny.random_bundle(dataclasses.replace(tiny.BUNDLES[name], generator=generator)))
    for seed in range(40):
        rows.clear()
        seen = [len(rows) for _ in long.stream(tiny.CAPTIONS[0], seed=seed)]
        drawn = len(rows)
        early = [row + 1 + context for row in range(len(seen)) if row + 1 + context < drawn]
        assert seen[: len(early)] == early
        if early:
            return
    pytest.fail(f"no motion is longer than {context} of {longest} rows")


def test_what_cannot_be_streamed_is_refused(model):
    for arguments, message in (
        ({"caption": " "}, "caption|text|prompt"),
        ({"caption": "walk", "max_codes": 99}, "max-codes: 99"),
        ({"caption": "walk", "seed": -1}, "seed"),
        ({"caption": "walk", "sample": -1}, "sample: -1"),
        ({"caption": "walk", "guidance_scale": float("nan")}, "guidance-scale: nan"),
    ):
        with pytest.raises(UserError, match=message):
            next(model.stream(**arguments))


def test_a_stop_rule_of_other_scores_is_refused(model):
    wrong = "end" if stop_rule(model) else "argmax"
    with pytest.raises(UserError, match=f"stop-rule: '{wrong}' does not fit this model; use"):
        model.parts.sampling(SamplingOptions(stop_rule=wrong))


@pytest.mark.slow
def test_a_random_end_is_the_same_in_a_stream():
    config = tiny.BUNDLES["hifigpt"]
    sampled = dataclasses.replace(config, generator=dataclasses.replace(config.generator, stop_rule="sampled"))
    model, lengths = TextToMotion(tiny.random_bundle(sampled)), set()
    for seed in range(6):
        expected = model.generate(tiny.CAPTIONS[:2], seed=seed)[1]
        pieces = list(model.stream(tiny.CAPTIONS[1], seed=seed))
        np.testing.assert_array_equal(np.concatenate([piece.codes for piece in pieces]), expected.codes)
        lengths.add(len(pieces))
    assert len(lengths) > 1
