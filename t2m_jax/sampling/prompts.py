"""Prompts, with what the model knows of them, and the keys of their samples."""

import inspect
import warnings
import zlib
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Key

from t2m_jax.keys import new_key
from t2m_jax.motion.repetitions import COUNTED_ACTIONS
from t2m_jax.sampling.batches import fill_up
from t2m_jax.text.coverage import Knowledge, PromptWarning, check_coverage
from t2m_jax.text.directions import with_directions
from t2m_jax.text.encoder import CuttingTextEncoder, TextEncoder
from t2m_jax.text.prompts import check_prompt
from t2m_jax.text.spelling import correct_spelling

MAX_BATCH = 32
"""Motions that are generated together, and most samples to choose one from."""


class Prompt(NamedTuple):
    """A sentence for the text encoder."""

    text: str
    """As it was typed, but for spaces and quotes."""
    read: str
    """What the encoder gets: without typing mistakes, with the directions that it leaves out (`with_directions`)."""
    warning: str
    """Why the motion cannot be what the sentence says, in a line; empty if it may be."""
    unknown_words: tuple[str, ...]
    """Words that the model did not learn."""


class Sample(NamedTuple):
    """One motion to generate."""

    prompt: Prompt
    seed: int
    number: int
    """Among the samples of the same prompt and seed."""

    @property
    def key(self) -> Key[Array, ""]:
        """Its key, which depends on nothing else."""
        return sample_key(self.seed, self.prompt.text, self.number)


def read_prompts(
    captions: Sequence[str], knowledge: Knowledge, encoder: TextEncoder, *, notes: Sequence[str] | None = None
) -> list[Prompt]:
    """Returns the prompts of sentences, cleaned and checked; `notes` are warnings about each that are known before.

    Warns:
        PromptWarning: The model cannot know what a sentence asks for.

    Raises:
        UserError: A sentence cannot be used.
    """
    prompts = []
    known = knowledge.words.union(knowledge.actions)
    for caption, note in zip(captions, notes or [""] * len(captions), strict=True):
        text = check_prompt(caption)
        read, corrected = correct_spelling(text, knowledge.words, rare=knowledge.taught)
        if knowledge.is_labeled:
            read, gaits = with_directions(read, known, knowledge.actions)
            corrected |= gaits
        # Some encoders cut long sentences, and the warning names what is not read.
        read_part = encoder.read_part(read) if isinstance(encoder, CuttingTextEncoder) else read
        given: dict[str, Any] = {"typed": text, "corrected": corrected, "countable": COUNTED_ACTIONS}
        coverage = check_coverage(read, knowledge, read_part=read_part, **given)
        warning = " ".join(filter(None, (coverage.warning, note)))
        prompts.append(Prompt(text, read, warning, coverage.unknown_words))
    # Each once, however many sentences have it.
    for warning in dict.fromkeys(prompt.warning for prompt in prompts):
        if warning:
            warnings.warn(warning, PromptWarning, stacklevel=_level_outside())
    return prompts


def _level_outside() -> int:
    """Returns the stack level of the code that uses the package, as its caller would count it for a warning."""
    level = 0
    frame = inspect.currentframe()
    while frame is not None and frame.f_globals.get("__name__", "").startswith("t2m_jax."):
        level += 1
        frame = frame.f_back
    return level


def sample_key(seed: int, caption: str, sample: int) -> Key[Array, ""]:
    """Returns the key of one sample: a function of seed, caption and number, independent of the batch."""
    # Not `hash`, which differs from process to process.
    key = jax.random.fold_in(new_key(seed), zlib.crc32(caption.encode()))
    return jax.random.fold_in(key, sample)


class KeyBatch(NamedTuple):
    """The keys of samples that are generated together."""

    keys: Key[Array, " B"]
    """Filled up with the first one."""
    num_samples: int
    """Without those that fill it up."""


def batches_of_keys(seed: int, prompt: Prompt, num_samples: int) -> Iterator[KeyBatch]:
    """Yields the keys of each batch of samples."""
    for first in range(0, num_samples, MAX_BATCH):
        samples = range(first, min(first + MAX_BATCH, num_samples))
        keys = jnp.stack(fill_up([sample_key(seed, prompt.text, number) for number in samples]))
        yield KeyBatch(keys, len(samples))
