"""From sentences to motions: text encoder, generator, tokenizer and skeleton in one object."""

import dataclasses
import functools
import itertools
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Key

from t2m_jax.checkpoints.bundle import Bundle, ClipReference
from t2m_jax.checkpoints.model import load_model
from t2m_jax.checkpoints.tokenizer import TrainedTokenizer
from t2m_jax.config import check_seed
from t2m_jax.devices import put_everywhere, put_rows
from t2m_jax.errors import UserError
from t2m_jax.models.projection import restore_kernels
from t2m_jax.models.system import make_module
from t2m_jax.motion.normalizer import Normalizer
from t2m_jax.motion.record import Motion
from t2m_jax.motion.skeleton import skeleton_from_name
from t2m_jax.sampling.batches import padded_batch_size
from t2m_jax.sampling.codec import (
    begin_motions,
    encode_motion,
    generate_codes,
    generate_row,
    motions_from_codes,
    sampling_variables,
)
from t2m_jax.sampling.compilation import use_compilation_cache
from t2m_jax.sampling.decoding import SampledCodes, Sampling
from t2m_jax.sampling.stopping import find_stop_rule
from t2m_jax.sampling.strategies import Strategy, Temperature
from t2m_jax.sampling.streaming import stream_pieces
from t2m_jax.sampling.text_encoders import make_text_encoder
from t2m_jax.text.encoder import TextEncoder
from t2m_jax.text.prompts import check_prompt

MAX_SAMPLES = 1_000_000
"""Most motions of a caption in one call. A larger number is probably a mistake: they would take weeks and 100 GB."""
MAX_BATCH = 32
"""Motions that are generated together."""


def sample_key(seed: int, caption: str, sample: int) -> Key[Array, ""]:
    """Returns the key of one sample: a function of seed, caption and number, independent of the batch."""
    key = jax.random.fold_in(jax.random.key(seed), zlib.crc32(caption.encode()))
    return jax.random.fold_in(key, sample)


class TextToMotion:
    """A loaded model: `TextToMotion.load("demo").generate(["a person walks forward"])`."""

    def __init__(self, bundle: Bundle, *, text_encoder: TextEncoder | None = None):
        """Puts the weights on all devices of this process.

        Args:
            bundle: The model.
            text_encoder: Used instead of the model's own; it must give the same embeddings.

        Raises:
            UserError: The model reads text with CLIP, and CLIP cannot be found.
        """
        self.config = bundle.config
        self.skeleton = skeleton_from_name(bundle.config.skeleton)
        self.training_data = bundle.training_data
        self.text_encoder = text_encoder or make_text_encoder(bundle)
        self._bpe = bundle.bpe
        self._variables = put_everywhere(bundle.variables)
        self._ready_to_sample = False
        self._normalizer = Normalizer(*map(jnp.asarray, bundle.normalizer))
        self._generator = make_module(self.config.generator)

    @classmethod
    def load(cls, name_or_path: str | Path) -> "TextToMotion":
        """Returns a model by bundled name ("demo"), bundle folder or run directory; turns on the compilation cache.

        Raises:
            UserError: There is no such model, or it is damaged.
        """
        use_compilation_cache()
        return cls(load_model(name_or_path))

    @property
    def variables(self) -> dict[str, Any]:
        """The weights of `tokenizer`, `generator` and (if trained with the model) `text_encoder` for `apply`."""
        return self._variables | {"generator": restore_kernels(self._variables["generator"])}

    @property
    def fingerprint(self) -> str:
        """Identifies the model: a digest of sizes, weights, statistics and subwords."""
        config, clip = self.config, getattr(self.text_encoder, "fingerprint", None)
        if clip is not None:  # where CLIP is does not matter
            config = dataclasses.replace(config, text_encoder=ClipReference(name=clip))
        return Bundle(config, self.variables, self._normalizer, self._bpe).fingerprint

    @property
    def tokenizer(self) -> TrainedTokenizer:
        """The tokenizer with its statistics."""
        return TrainedTokenizer(self.config.tokenizer, self._variables["tokenizer"], self._normalizer)

    def generate(
        self,
        captions: Sequence[str] | str,
        *,
        seed: int = 0,
        num_samples: int = 1,
        strategy: Strategy | None = None,
        max_codes: int | None = None,
        guidance_scale: float | None = None,
        stop_rule: str | None = None,
        raw: bool = False,
    ) -> list[Motion]:
        """Returns `num_samples` motions for each caption, caption by caption.

        A motion depends on the seed, its caption and its number among the samples. It does not depend on the other
        motions of the call.

        Args:
            captions: Sentences, or a single one.
            seed: From 0 to 2**32 - 1.
            num_samples: Motions per caption.
            strategy: How codes are chosen; by default from the model's own probabilities.
            max_codes: Longest motion in codes; by default the model's maximum.
            guidance_scale: Strength of the guidance by the text, for models that were trained for it; 1 is none. By
                default the model's own.
            stop_rule: `argmax`, `threshold` or `sampled`, for models with a stop head; by default the model's own.
            raw: Whether positions stay as decoded. By default they are cleaned: they tremble less, bones have constant
                lengths, and feet slide less (`t2m_jax.motion.cleanup`).

        Raises:
            UserError: A caption or a number cannot be used.
        """
        motions = self.generate_each(
            captions,
            seed=seed,
            num_samples=num_samples,
            strategy=strategy,
            max_codes=max_codes,
            guidance_scale=guidance_scale,
            stop_rule=stop_rule,
            raw=raw,
        )
        return list(motions)

    def generate_each(
        self,
        captions: Sequence[str] | str,
        *,
        seed: int = 0,
        num_samples: int = 1,
        strategy: Strategy | None = None,
        max_codes: int | None = None,
        guidance_scale: float | None = None,
        stop_rule: str | None = None,
        raw: bool = False,
    ) -> Iterator[Motion]:
        """Returns an iterator over the motions of `generate`, for more of them than fit into the memory.

        Arguments and errors are those of `generate`.
        """
        texts = [check_prompt(caption) for caption in ([captions] if isinstance(captions, str) else captions)]
        check_seed(seed)
        if not 1 <= num_samples <= MAX_SAMPLES:
            raise UserError(f"num-samples: {num_samples} is not a whole number from 1 to {MAX_SAMPLES:,}")
        sampling = self.sampling(strategy, max_codes=max_codes, stop_rule=stop_rule)
        requests = itertools.product(texts, range(num_samples))
        batches = iter(lambda: list(itertools.islice(requests, MAX_BATCH)), [])
        return itertools.chain.from_iterable(
            self._generate_batch(batch, seed=seed, sampling=sampling, guidance_scale=guidance_scale, clean=not raw)
            for batch in batches
        )

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
        text = check_prompt(caption)
        check_seed(seed)
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

    def sampling(
        self,
        strategy: Strategy | None = None,
        *,
        max_codes: int | None = None,
        min_codes: int = 1,
        stop_rule: str | None = None,
    ) -> Sampling:
        """Returns how codes are sampled; what is not given is the model's own.

        Raises:
            UserError: The length or the stop rule does not fit the model.
        """
        longest = self.config.generator.max_codes
        if max_codes is not None and not 1 <= max_codes <= longest:
            raise UserError(f"max-codes: {max_codes} is not between 1 and {longest}")
        rule = find_stop_rule(self.config.generator, stop_rule)
        return Sampling(strategy or Temperature(), rule, max_codes or longest, min_codes)

    def guidance_scale(self, given: float | None = None) -> float | None:
        """Returns the strength of the guidance: as given, or the model's own; None for none.

        Raises:
            UserError: It is not a number from 0.
        """
        scale = self.config.generator.guidance_scale if given is None else given
        if scale is not None and not 0 <= scale < float("inf"):
            raise UserError(f"guidance-scale: {scale} is not a number from 0")
        return scale

    def _guidance(self, given: float | None) -> Float[Array, ""] | None:
        """Returns the scale for the generator. A scale of 1 changes nothing, so only half of the work is needed."""
        scale = self.guidance_scale(given)
        return None if scale is None or scale == 1 else jnp.asarray(scale, jnp.float32)

    def sample_codes(
        self,
        text_embedding: Float[Array, "B E"],
        keys: Key[Array, " B"],
        sampling: Sampling,
        *,
        guidance_scale: float | None = None,
    ) -> SampledCodes:
        """Returns codes for text embeddings of `text_encoder`, one key per motion (consumed)."""
        scale = self._guidance(guidance_scale)
        text_embedding, keys = put_rows((text_embedding, keys))
        variables = self._variables_for_sampling()
        return generate_codes(variables, text_embedding, keys, scale, generator=self._generator, sampling=sampling)

    def _variables_for_sampling(self) -> dict[str, Any]:
        """Returns the generator's variables, rearranged at the first call; the old arrangement is not kept."""
        if not self._ready_to_sample:
            generator = sampling_variables(self._variables["generator"], self.config.generator)
            # A new dictionary, because another thread may be in this function, too. Both make the same variables.
            self._variables = self._variables | {"generator": generator}
            self._ready_to_sample = True
        return self._variables["generator"]

    def _generate_batch(
        self,
        requests: Sequence[tuple[str, int]],
        *,
        seed: int,
        sampling: Sampling,
        guidance_scale: float | None,
        clean: bool,
    ) -> list[Motion]:
        filled = [*requests, *[requests[0]] * (padded_batch_size(len(requests)) - len(requests))]
        sampled = self.sample_codes(
            self.text_encoder([text for text, _ in filled]),
            jnp.stack([sample_key(seed, text, sample) for text, sample in filled]),
            sampling,
            guidance_scale=guidance_scale,
        )
        return motions_from_codes(
            self.tokenizer,
            np.asarray(sampled.codes),
            np.asarray(sampled.code_lengths),
            skeleton=self.skeleton,
            captions=[text for text, _ in requests],
            seed=seed,
            clean=clean,
        )

    def encode(self, motion: Motion) -> Int[np.ndarray, "N R"]:
        """Returns the codes of a motion. Frames at its end that do not fill a code are left out.

        Raises:
            UserError: It has another skeleton than the model's, or is too short for a code.
        """
        return encode_motion(self.tokenizer, motion, self.skeleton)

    def decode(self, codes: Int[np.ndarray, "N ..."], *, caption: str = "", raw: bool = False) -> Motion:
        """Returns the motion of codes [N, R]; the last axis may be left out if there is one code per row.

        With fewer than R codes per row, those of the first depths, the motion is coarser. It is cleaned as by
        `generate`, unless `raw`.

        Raises:
            UserError: There are no codes, too many per row, or one that is not in the codebook.
        """
        config, codes = self.config.tokenizer, np.asarray(codes, np.int32)
        if codes.ndim == 1:
            codes = codes[:, None]
        if codes.ndim != 2 or not len(codes) or not 1 <= codes.shape[1] <= config.num_quantizers:
            raise UserError(f"codes: expected rows of {config.num_quantizers} codes (or fewer), at least one row")
        if codes.min() < 0 or codes.max() >= config.num_codes:
            raise UserError(f"codes: must be between 0 and {config.num_codes - 1}")
        return self._decode_padded(codes, size=len(codes), caption=caption, seed=0, clean=not raw)

    def _decode_padded(
        self, codes: Int[np.ndarray, "N R"], *, size: int, caption: str, seed: int, clean: bool
    ) -> Motion:
        """Returns the motion of codes, decoded by a program for `size` rows."""
        lengths = np.array([len(codes)], np.int32)
        padded = np.pad(codes, ((0, size - len(codes)), (0, 0)))[None]
        options: Any = {"skeleton": self.skeleton, "captions": [caption], "seed": seed, "clean": clean}
        return motions_from_codes(self.tokenizer, padded, lengths, **options)[0]
