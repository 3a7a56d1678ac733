"""Prompts, with what the model knows of them, and the keys of their samples."""

import warnings
import zlib
from collections.abc import Sequence
from typing import NamedTuple

import jax
from jaxtyping import Array, Key

from t2m_jax.errors import UserError
from t2m_jax.text.coverage import Knowledge, PromptWarning, check_coverage
from t2m_jax.text.encoder import CuttingTextEncoder, TextEncoder
from t2m_jax.text.prompts import check_prompt

MAX_SAMPLES = 1_000_000
"""Most motions of a caption in one call. A larger number is probably a mistake: they would take weeks and 100 GB."""
MAX_BATCH = 32
"""Motions that are generated together."""


class Prompt(NamedTuple):
    """A sentence for the text encoder."""

    text: str
    """What the encoder gets."""
    warning: str
    """Why the motion cannot be what the sentence says, in a line; empty if it may be."""
    unknown_words: tuple[str, ...]
    """Words that the model did not learn."""


def read_prompts(captions: Sequence[str] | str, knowledge: Knowledge, encoder: TextEncoder) -> list[Prompt]:
    """Returns the prompts of a single sentence or of several, cleaned and checked.

    Warns:
        PromptWarning: The model cannot know what a sentence asks for.

    Raises:
        UserError: A sentence cannot be used.
    """
    prompts = []
    for caption in [captions] if isinstance(captions, str) else captions:
        text = check_prompt(caption)
        read_part = encoder.read_part(text) if isinstance(encoder, CuttingTextEncoder) else text
        prompts.append(Prompt(text, *check_coverage(text, knowledge, read_part=read_part)))
    for warning in dict.fromkeys(prompt.warning for prompt in prompts):
        if warning:
            warnings.warn(warning, PromptWarning, stacklevel=4)
    return prompts


def sample_key(seed: int, caption: str, sample: int) -> Key[Array, ""]:
    """Returns the key of one sample: a function of seed, caption and number, independent of the batch."""
    key = jax.random.fold_in(jax.random.key(seed), zlib.crc32(caption.encode()))
    return jax.random.fold_in(key, sample)


def check_num_samples(num_samples: int) -> None:
    """Raises `UserError` if a number of motions for a caption is not from 1 to `MAX_SAMPLES`."""
    if not 1 <= num_samples <= MAX_SAMPLES:
        raise UserError(f"num-samples: {num_samples} is not a whole number from 1 to {MAX_SAMPLES:,}")
