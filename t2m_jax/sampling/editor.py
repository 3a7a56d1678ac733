"""What a model does with motions that exist: it goes on from them, and replaces or varies a part."""

import dataclasses
import itertools
from collections.abc import Iterator, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Key

from t2m_jax.config import check_seed
from t2m_jax.errors import UserError
from t2m_jax.motion.motion import Motion
from t2m_jax.sampling.batches import padded_batch_size
from t2m_jax.sampling.inbetween import check_strength, replace_span, variation_parts
from t2m_jax.sampling.loop import Sampling
from t2m_jax.sampling.model import MotionModel
from t2m_jax.sampling.prompts import MAX_BATCH, Prompt, check_num_samples, read_prompts, sample_key
from t2m_jax.sampling.strategies import Strategy
from t2m_jax.sampling.timeline import (
    Part,
    context_rows,
    join_parts,
    part_keys,
    rows_of_seconds,
    sample_parts,
    split_parts,
    stream_parts,
)

NUM_CANDIDATES = 16
"""Middles that are sampled to choose from."""


class MotionEditor(MotionModel):
    """Motions from several sentences, and changes of given motions."""

    def generate_chain(
        self,
        captions: Sequence[str],
        *,
        start: Motion | None = None,
        seconds: float | None = None,
        seed: int = 0,
        num_samples: int = 1,
        strategy: Strategy | None = None,
        guidance_scale: float | None = None,
        stop_rule: str | None = None,
        raw: bool = False,
    ) -> list[Motion]:
        """Returns motions that show sentences in turn, of any length.

        Each sentence is sampled as if it were alone, and fades into the next. Only the first one goes on from the last
        codes of `start`. The motions say where each begins (`part_starts`, `part_captions`).

        Args:
            captions: Sentences in turn.
            start: A motion that the first sentence goes on from. It is part of the result, as the tokenizer gives it
                back.
            seconds: Length for each sentence, rounded to whole rows of codes; by default the model decides.
            seed: From 0 to 2**32 - 1.
            num_samples: Motions to return.
            strategy: How codes are chosen; by default from the model's own probabilities.
            guidance_scale: As in `generate`.
            stop_rule: As in `generate`.
            raw: As in `generate`.

        Warns:
            PromptWarning: The model cannot know what a sentence asks for.

        Raises:
            UserError: A sentence or a number cannot be used, or `start` is too short or has another skeleton.
        """
        check_seed(seed)
        check_num_samples(num_samples)
        sampling = self.sampling(strategy, stop_rule=stop_rule)
        parts = self._parts(captions, seconds, sampling)
        known = None if start is None else self.encode(start)

        motions: list[Motion] = []
        for keys, count in _batches_of_keys(seed, parts[0].prompt, num_samples):
            options: Any = {"start": known, "sampling": sampling, "guidance_scale": guidance_scale}
            found = zip(*sample_parts(self, parts, part_keys(keys, len(parts)), **options), strict=True)
            samples = itertools.islice(found, count)
            motions += [join_parts(self, parts, own, start=known, seed=seed, raw=raw) for own in samples]
        return motions

    def stream_chain(
        self,
        captions: Sequence[str],
        *,
        start: Motion | None = None,
        seconds: float | None = None,
        seed: int = 0,
        strategy: Strategy | None = None,
        guidance_scale: float | None = None,
        stop_rule: str | None = None,
    ) -> Iterator[Motion]:
        """Returns an iterator over the motion of `generate_chain` while it is generated, in pieces of some seconds.

        It needs hardly more memory for a longer motion. Each piece goes on where the one before it ends, and says
        which sentences begin in it. Pieces are as decoded: together they are the motion that `generate_chain` returns
        with `raw=True`. Arguments, warnings and errors are those of `generate_chain`.
        """
        check_seed(seed)
        sampling = self.sampling(strategy, stop_rule=stop_rule)
        parts = self._parts(captions, seconds, sampling)
        known = None if start is None else self.encode(start)
        ((keys, _),) = _batches_of_keys(seed, parts[0].prompt, 1)
        options: Any = {"start": known, "sampling": sampling, "guidance_scale": guidance_scale}
        found = sample_parts(self, parts, part_keys(keys, len(parts)), **options)
        return stream_parts(self, parts, (own for own, *_ in found), start=known, seed=seed)

    def _parts(self, captions: Sequence[str], seconds: float | None, sampling: Sampling) -> list[Part]:
        """Returns the parts of sentences in turn, each of the given length.

        Raises:
            UserError: There are no sentences, or a sentence or the length cannot be used.
        """
        rows = 0 if seconds is None else rows_of_seconds(self, seconds)
        if not captions:
            raise UserError("captions: give at least one sentence")
        prompts = read_prompts(captions, self.knowledge, self.text_encoder)
        return split_parts(prompts, rows, limit=sampling.max_codes - context_rows(self))

    def redo(
        self,
        motion: Motion,
        span: tuple[float, float],
        caption: str,
        *,
        seed: int = 0,
        num_samples: int = 1,
        num_candidates: int = NUM_CANDIDATES,
        strategy: Strategy | None = None,
        guidance_scale: float | None = None,
        raw: bool = False,
    ) -> list[Motion]:
        """Returns a motion with another middle, which a sentence describes. Head and tail stay as they are.

        Several middles are sampled after the head. Those come first after which the tail is likely, and that jump
        least to it. The tail is turned and moved to where the middle ends. The motion has the model's frame rate.

        Args:
            motion: Any motion of the model's skeleton.
            span: Begin and end of the middle in seconds, rounded to whole rows of codes.
            caption: What happens in the middle.
            seed: From 0 to 2**32 - 1.
            num_samples: Motions to return, the best ones first.
            num_candidates: Middles to choose them from.
            strategy: How codes are chosen; by default from the model's own probabilities.
            guidance_scale: As in `generate`.
            raw: Whether the middle is not cleaned.

        Warns:
            PromptWarning: The model cannot know what the sentence asks for.

        Raises:
            UserError: The sentence, the span or a number cannot be used, or the motion is too short or has another
                skeleton.
        """
        check_seed(seed)
        check_num_samples(num_samples)
        if not 1 <= num_candidates <= MAX_BATCH:
            raise UserError(f"num-candidates: {num_candidates} is not a whole number from 1 to {MAX_BATCH}")
        if num_samples > num_candidates:
            raise UserError(f"num-samples: {num_samples} motions cannot be chosen from {num_candidates} candidates")
        (prompt,) = read_prompts(caption, self.knowledge, self.text_encoder)
        keys = jnp.stack([sample_key(seed, prompt.text, number) for number in range(num_candidates)])
        sampling = self.sampling(strategy)
        found = replace_span(
            self, motion, span, prompt, keys, sampling=sampling, guidance_scale=guidance_scale, raw=raw
        )
        return [dataclasses.replace(one, seed=seed) for one in found[:num_samples]]

    def vary(
        self,
        motion: Motion,
        strength: float,
        caption: str | None = None,
        *,
        seed: int = 0,
        num_samples: int = 1,
        strategy: Strategy | None = None,
        guidance_scale: float | None = None,
        raw: bool = False,
    ) -> list[Motion]:
        """Returns variations of a motion, of the same length.

        Args:
            motion: Any motion of the model's skeleton.
            strength: Probability of each row of codes to be sampled again; 0 changes nothing but what the tokenizer
                loses, and 1 keeps nothing.
            caption: What happens; by default the motion's own caption.
            seed: From 0 to 2**32 - 1.
            num_samples: Variations to return.
            strategy: How codes are chosen; by default from the model's own probabilities.
            guidance_scale: As in `generate`.
            raw: As in `generate`.

        Warns:
            PromptWarning: The model cannot know what the sentence asks for.

        Raises:
            UserError: The sentence or a number cannot be used, or the motion is too short or has another skeleton.
        """
        check_seed(seed)
        check_num_samples(num_samples)
        check_strength(strength)
        (prompt,) = read_prompts(motion.caption if caption is None else caption, self.knowledge, self.text_encoder)
        codes, sampling = self.encode(motion), self.sampling(strategy)
        limit = sampling.max_codes - context_rows(self)

        motions: list[Motion] = []
        for keys, count in _batches_of_keys(seed, prompt, num_samples):
            parts = variation_parts(codes, prompt, keys, strength=strength, limit=limit)
            options: Any = {"start": None, "sampling": sampling, "guidance_scale": guidance_scale}
            found = zip(*sample_parts(self, parts, part_keys(keys, len(parts)), **options), strict=True)
            samples = itertools.islice(found, count)
            motions += [join_parts(self, parts, own, start=None, seed=seed, raw=raw) for own in samples]
        return motions


def _batches_of_keys(seed: int, prompt: Prompt, num_samples: int) -> Iterator[tuple[Key[jax.Array, " B"], int]]:
    """Yields the keys of each batch of samples, filled up with the first one, and how many samples it has."""
    for first in range(0, num_samples, MAX_BATCH):
        samples = range(first, min(first + MAX_BATCH, num_samples))
        keys = [sample_key(seed, prompt.text, number) for number in samples]
        yield jnp.stack([*keys, *[keys[0]] * (padded_batch_size(len(keys)) - len(keys))]), len(samples)
