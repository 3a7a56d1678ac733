"""Motions of different sentences and seeds that are generated in one batch."""

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key

from t2m_jax.motion.motion import Motion
from t2m_jax.sampling.loop import SampledCodes
from t2m_jax.sampling.programs import motions_from_codes
from t2m_jax.sampling.prompts import Prompt, sample_key

if TYPE_CHECKING:
    from t2m_jax.sampling.model import ModelParts


class Sample(NamedTuple):
    """One motion to generate."""

    prompt: Prompt
    seed: int
    number: int
    """Among the samples of the same prompt and seed."""


def batch_inputs(
    model: "ModelParts", samples: Sequence[Sample], batch_size: int
) -> tuple[Float[Array, "B E"], Key[Array, " B"]]:
    """Returns the text embeddings and keys of samples, filled up with the first one."""
    filled = [*samples, *[samples[0]] * (batch_size - len(samples))]
    keys = [sample_key(sample.seed, sample.prompt.text, sample.number) for sample in filled]
    return model.text_encoder([sample.prompt.text for sample in filled]), jnp.stack(keys)


def batch_motions(
    model: "ModelParts", sampled: SampledCodes, samples: Sequence[Sample], *, clean: bool
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
