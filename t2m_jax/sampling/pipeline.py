"""From sentences to motions: text encoder, generator, tokenizer and skeleton in one object."""

import dataclasses
import functools
import itertools
import zlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Key

from t2m_jax.checkpoints.model import load_model
from t2m_jax.config import check_seed
from t2m_jax.devices import put_everywhere
from t2m_jax.errors import UserError
from t2m_jax.motion.record import Motion
from t2m_jax.sampling.batches import padded_batch_size
from t2m_jax.sampling.codec import begin_motions, generate_row, motions_from_codes
from t2m_jax.sampling.compilation import use_compilation_cache
from t2m_jax.sampling.decoding import Sampling
from t2m_jax.sampling.edit import context_rows, join_parts, part_keys, rows_of_seconds, sample_parts, split_parts
from t2m_jax.sampling.model import MotionModel
from t2m_jax.sampling.prompts import Prompt, read_prompts
from t2m_jax.sampling.stopping import find_stop_rule
from t2m_jax.sampling.strategies import Strategy, make_strategy
from t2m_jax.sampling.streaming import stream_pieces

MAX_SAMPLES = 1_000_000
"""Most motions of a caption in one call. A larger number is probably a mistake: they would take weeks and 100 GB."""
MAX_BATCH = 32
"""Motions that are generated together."""


def sample_key(seed: int, caption: str, sample: int) -> Key[Array, ""]:
    """Returns the key of one sample: a function of seed, caption and number, independent of the batch."""
    key = jax.random.fold_in(jax.random.key(seed), zlib.crc32(caption.encode()))
    return jax.random.fold_in(key, sample)


class TextToMotion(MotionModel):
    """A loaded model: `TextToMotion.load("demo").generate(["a person walks forward"])`."""

    @classmethod
    def load(cls, name_or_path: str | Path) -> "TextToMotion":
        """Returns a model by bundled name ("demo"), bundle folder or run directory; turns on the compilation cache.

        Raises:
            UserError: There is no such model, or it is damaged.
        """
        use_compilation_cache()
        return cls(load_model(name_or_path))

    def generate(
        self,
        captions: Sequence[str] | str,
        *,
        seed: int = 0,
        num_samples: int = 1,
        temperature: float | int = 1.0,
        top_k: int | None = None,
        top_p: float | None = None,
        strategy: Strategy | None = None,
        max_codes: int | None = None,
        guidance_scale: float | None = None,
        stop_rule: str | None = None,
        raw: bool = False,
        on_progress: Callable[[int, int], None] | None = None,
    ) -> list[Motion]:
        """Returns `num_samples` motions for each caption, caption by caption.

        A motion depends on the seed, its caption and its number among the samples. It does not depend on the other
        motions of the call.

        Args:
            captions: Sentences, or a single one.
            seed: From 0 to 2**32 - 1.
            num_samples: Motions per caption.
            temperature: Below 1, likely codes are chosen more often; with 0, always the likeliest.
            top_k: Number of the likeliest codes to choose among.
            top_p: Codes are chosen among the likeliest ones, up to this sum of their probabilities.
            strategy: Another way to choose codes, instead of the three numbers.
            max_codes: Longest motion in codes; by default the model's maximum.
            guidance_scale: Strength of the guidance by the text, for models that were trained for it; 1 is none. By
                default the model's own.
            stop_rule: `argmax`, `threshold` or `sampled`, for models with a stop head; by default the model's own.
            raw: Whether positions stay as decoded. By default they are cleaned: they tremble less, bones have constant
                lengths, and feet slide less (`t2m_jax.motion.cleanup`).
            on_progress: Called with the number of motions that are ready and the number of all, after each batch.

        Warns:
            PromptWarning: The model cannot know what a caption asks for. The motions say so, too.

        Raises:
            UserError: A caption or a number cannot be used.
        """
        motions = self.generate_each(
            captions,
            seed=seed,
            num_samples=num_samples,
            temperature=temperature,
            top_k=top_k,
            top_p=top_p,
            strategy=strategy,
            max_codes=max_codes,
            guidance_scale=guidance_scale,
            stop_rule=stop_rule,
            raw=raw,
            on_progress=on_progress,
        )
        return list(motions)

    def generate_each(
        self,
        captions: Sequence[str] | str,
        *,
        seed: int = 0,
        num_samples: int = 1,
        temperature: float | int = 1.0,
        top_k: int | None = None,
        top_p: float | None = None,
        strategy: Strategy | None = None,
        max_codes: int | None = None,
        guidance_scale: float | None = None,
        stop_rule: str | None = None,
        raw: bool = False,
        on_progress: Callable[[int, int], None] | None = None,
    ) -> Iterator[Motion]:
        """Returns an iterator over the motions of `generate`, for more of them than fit into the memory.

        Arguments and errors are those of `generate`.
        """
        check_seed(seed)
        if not 1 <= num_samples <= MAX_SAMPLES:
            raise UserError(f"num-samples: {num_samples} is not a whole number from 1 to {MAX_SAMPLES:,}")
        if strategy is None:
            strategy = make_strategy(float(temperature), top_k, top_p=top_p)
        elif (temperature, top_k, top_p) != (1.0, None, None):
            raise UserError("strategy: excludes temperature, top-k and top-p; give them to the strategy")
        sampling = self.sampling(strategy, max_codes=max_codes, stop_rule=stop_rule)
        prompts = read_prompts(captions, self.knowledge, self.text_encoder)
        total = len(prompts) * num_samples
        requests = itertools.product(prompts, range(num_samples))
        batches = iter(lambda: list(itertools.islice(requests, MAX_BATCH)), [])

        def generate_batches() -> Iterator[Motion]:
            for number, batch in enumerate(batches):
                motions = self._generate_batch(
                    batch, seed=seed, sampling=sampling, guidance_scale=guidance_scale, clean=not raw
                )
                if on_progress is not None:
                    on_progress(number * MAX_BATCH + len(batch), total)
                yield from motions

        return generate_batches()

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
        """Returns motions that show sentences in turn, without a seam and of any length.

        Each sentence goes on from the last codes of what was before it. The motions say where each begins
        (`part_starts`, `part_captions`).

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
        if not 1 <= num_samples <= MAX_SAMPLES:
            raise UserError(f"num-samples: {num_samples} is not a whole number from 1 to {MAX_SAMPLES:,}")
        sampling = self.sampling(strategy, stop_rule=stop_rule)
        rows = 0 if seconds is None else rows_of_seconds(self, seconds)
        if not captions:
            raise UserError("captions: give at least one sentence")
        prompts = read_prompts(captions, self.knowledge, self.text_encoder)
        parts = split_parts(prompts, rows, limit=sampling.max_codes - context_rows(self))
        known = None if start is None else self.encode(start)
        motions: list[Motion] = []
        for first in range(0, num_samples, MAX_BATCH):
            samples = range(first, min(first + MAX_BATCH, num_samples))
            keys = [sample_key(seed, prompts[0].text, sample) for sample in samples]
            filled = jnp.stack([*keys, *[keys[0]] * (padded_batch_size(len(keys)) - len(keys))])
            found = sample_parts(
                self,
                parts,
                part_keys(filled, len(parts)),
                start=known,
                sampling=sampling,
                guidance_scale=guidance_scale,
            )
            motions += [
                join_parts(self, parts, found[row], start=known, seed=seed, raw=raw) for row in range(len(samples))
            ]
        return motions

    def stream(
        self,
        caption: str,
        *,
        seed: int = 0,
        sample: int = 0,
        strategy: Strategy | None = None,
        max_codes: int | None = None,
        guidance_scale: float | None = None,
    ) -> Iterator[Motion]:
        """Returns an iterator over the motion of a caption while it is generated: a piece for each row of codes.

        A piece comes as soon as its frames are final. They also depend on some rows after them (see
        `TokenizerConfig.decoder_context`), so the last pieces come together. Pieces are as decoded, because a clean-up
        needs the whole motion: together they are the motion that `generate` returns with the same arguments and
        `raw=True`, and with `stop_rule="threshold"` if the model's own rule needs all rows first.

        Args:
            caption: A sentence.
            seed: From 0 to 2**32 - 1.
            sample: Number of the motion among the samples of `generate`.
            strategy: How codes are chosen; by default from the model's own probabilities.
            max_codes: Longest motion in codes; by default the model's maximum.
            guidance_scale: Strength of the guidance by the text; by default the model's own.

        Raises:
            UserError: The caption or a number cannot be used.
        """
        check_seed(seed)
        ((text, *_),) = read_prompts(caption, self.knowledge, self.text_encoder)
        ends_early = find_stop_rule(self.config.generator).ends_early
        sampling = self.sampling(strategy, max_codes=max_codes, stop_rule=None if ends_early else "threshold")
        keys = put_everywhere(sample_key(seed, text, sample)[None])
        variables, scale = self._variables_for_sampling(), self._guidance(guidance_scale)
        state = begin_motions(variables, self.text_encoder([text]), scale, generator=self._generator)
        return stream_pieces(
            lambda state: generate_row(variables, state, keys, generator=self._generator, sampling=sampling),
            state,
            sampling,
            functools.partial(self._decode_padded, size=sampling.max_codes, caption=text, seed=seed, clean=False),
            decoder_context=self.config.tokenizer.decoder_context,
        )

    def _generate_batch(
        self,
        requests: Sequence[tuple[Prompt, int]],
        *,
        seed: int,
        sampling: Sampling,
        guidance_scale: float | None,
        clean: bool,
    ) -> list[Motion]:
        filled = [*requests, *[requests[0]] * (padded_batch_size(len(requests)) - len(requests))]
        sampled = self.sample_codes(
            self.text_encoder([prompt.text for prompt, _ in filled]),
            jnp.stack([sample_key(seed, prompt.text, sample) for prompt, sample in filled]),
            sampling,
            guidance_scale=guidance_scale,
        )
        motions = motions_from_codes(
            self.tokenizer,
            np.asarray(sampled.codes),
            np.asarray(sampled.code_lengths),
            skeleton=self.skeleton,
            captions=[prompt.text for prompt, _ in requests],
            seed=seed,
            clean=clean,
        )
        return [
            dataclasses.replace(motion, warning=prompt.warning, unknown_words=prompt.unknown_words)
            for motion, (prompt, _) in zip(motions, requests, strict=True)
        ]
