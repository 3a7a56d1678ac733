"""Motions of different sentences and seeds that are generated in one batch."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Key

from t2m_jax.motion.record import Motion
from t2m_jax.sampling.codec import motions_from_codes
from t2m_jax.sampling.decoding import SampledCodes, Sampling
from t2m_jax.sampling.prompts import Prompt, sample_key
from t2m_jax.sampling.streaming import part_of_rows

if TYPE_CHECKING:
    from t2m_jax.sampling.model import MotionModel


class Sample(NamedTuple):
    """One motion to generate."""

    prompt: Prompt
    seed: int
    number: int
    """Among the samples of the same prompt and seed."""


class NewRows(NamedTuple):
    """What is known of a motion after some more of it was sampled."""

    sample: int
    """Its place in the batch."""
    codes: Int[np.ndarray, "_ R"]
    """Rows that follow the ones that were reported before."""
    motion: Motion | None
    """Frames, as decoded, that follow the ones that were reported before; None if none are final."""


def batch_inputs(
    model: "MotionModel", samples: Sequence[Sample], batch_size: int
) -> tuple[Float[Array, "B E"], Key[Array, " B"]]:
    """Returns the text embeddings and keys of samples, filled up with the first one."""
    filled = [*samples, *[samples[0]] * (batch_size - len(samples))]
    keys = [sample_key(sample.seed, sample.prompt.text, sample.number) for sample in filled]
    return model.text_encoder([sample.prompt.text for sample in filled]), jnp.stack(keys)


def batch_motions(
    model: "MotionModel", sampled: SampledCodes, samples: Sequence[Sample], *, clean: bool
) -> list[Motion]:
    """Returns the motions of the samples of a batch."""
    codes, lengths = np.asarray(sampled.codes), np.asarray(sampled.code_lengths)
    captions = [sample.prompt.text for sample in samples]
    options: Any = {"skeleton": model.skeleton, "captions": captions, "clean": clean}
    motions = motions_from_codes(model.tokenizer, codes, lengths, **options)
    return [
        dataclasses.replace(
            motion, seed=sample.seed, warning=sample.prompt.warning, unknown_words=sample.prompt.unknown_words
        )
        for motion, sample in zip(motions, samples, strict=True)
    ]


def generate_together(
    model: "MotionModel",
    samples: Sequence[Sample],
    *,
    batch_size: int,
    sampling: Sampling,
    guidance_scale: float | None = None,
    on_rows: Callable[[NewRows], None] | None = None,
    decode_early: bool = False,
) -> list[Motion]:
    """Returns the motions of samples, and reports their codes while they are sampled.

    Args:
        model: The model.
        samples: At most `batch_size`.
        batch_size: Motions of the batch. With the same size, a motion does not depend on the others to the last bit.
        sampling: How to choose codes, and when to stop.
        guidance_scale: Strength of the guidance by the text.
        on_rows: Called for each motion when there are new rows. With a stop rule that does not end early, these may be
            more than the motion keeps.
        decode_early: Whether frames are reported, too, if the stop rule ends early. It takes time.
    """
    context, sent = model.config.tokenizer.decoder_context, np.zeros((2, len(samples)), int)
    early = decode_early and sampling.stop_rule.ends_early
    embedding, keys = batch_inputs(model, samples, batch_size)
    for sampled in model.sample_chunks(embedding, keys, sampling, guidance_scale=guidance_scale):
        if on_rows is None:
            continue
        rows, steps = np.asarray(sampled.code_lengths)[: len(samples)], int(sampled.steps)
        ended = (rows < steps) | (steps >= sampling.max_codes)  # then no rows follow on which frames depend
        final = np.where(ended, rows, np.maximum(rows - context, 0)) if early else sent[1]
        motions = batch_motions(model, sampled, samples, clean=False) if (final > sent[1]).any() else None
        for number in np.flatnonzero(rows > sent[0]):
            first, last = int(sent[1, number]), int(final[number])
            piece = None if motions is None or last <= first else part_of_rows(motions[number], first, last)
            on_rows(NewRows(int(number), np.asarray(sampled.codes[number, sent[0, number] : rows[number]]), piece))
        sent = np.stack([rows, final])
    return batch_motions(model, sampled, samples, clean=True)
