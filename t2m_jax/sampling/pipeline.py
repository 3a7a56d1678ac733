"""From sentences to motions: text encoder, GPT, decoder and skeleton in one object."""

import functools
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Key

from t2m_jax.checkpoints.bundle import Bundle, BundleConfig
from t2m_jax.checkpoints.gpt_run import load_model
from t2m_jax.errors import UserError
from t2m_jax.masks import mask_from_lengths
from t2m_jax.models.motion_gpt import MotionGpt
from t2m_jax.models.vqvae import VqVae
from t2m_jax.motion.features import positions_from_features
from t2m_jax.motion.record import Motion
from t2m_jax.motion.skeleton import skeleton_from_name
from t2m_jax.sampling.compilation import use_compilation_cache
from t2m_jax.sampling.decoding import DecodedCodes, decode_codes
from t2m_jax.sampling.strategies import Strategy, Temperature
from t2m_jax.sampling.text_encoders import make_text_encoder
from t2m_jax.text.encoder import TextEncoder
from t2m_jax.text.prompts import check_prompt

MAX_BATCH = 32
"""Motions made at a time; more are made in turns."""


class GeneratedMotion(NamedTuple):
    """One batch of decoded motion, raw."""

    features: Float[Array, "B T D"]
    positions: Float[Array, "B T J 3"]


def sample_key(seed: int, caption: str, sample: int) -> Key[Array, ""]:
    """Returns the key of one sample: a function of seed, caption and number, never of the batch around it."""
    key = jax.random.fold_in(jax.random.key(seed), zlib.crc32(caption.encode()))
    return jax.random.fold_in(key, sample)


@functools.partial(jax.jit, static_argnames=("config", "strategy", "min_codes", "max_codes"))
def generate_codes(
    variables: dict[str, Any],
    text_embedding: Float[Array, "B E"],
    keys: Key[Array, " B"],
    *,
    config: BundleConfig,
    strategy: Strategy,
    min_codes: int,
    max_codes: int,
) -> DecodedCodes:
    """Returns codes for text embeddings, by cached decoding in one program."""
    gpt = MotionGpt(config.gpt)
    return decode_codes(
        lambda text: gpt.apply(variables["gpt"], text, method="prefill"),
        lambda tokens, caches, step: gpt.apply(variables["gpt"], tokens, caches, step, method="decode_step"),
        text_embedding,
        keys,
        strategy=strategy,
        max_codes=max_codes,
        min_codes=min_codes,
    )


@functools.partial(jax.jit, static_argnames="config")
def decode_motion(
    variables: dict[str, Any],
    statistics: tuple[Float[Array, " D"], Float[Array, " D"]],
    codes: Int[Array, "B N"],
    code_lengths: Int[Array, " B"],
    *,
    config: BundleConfig,
) -> GeneratedMotion:
    """Returns raw features and joint positions of codes; what lies past a motion's end means nothing."""
    mask = mask_from_lengths(code_lengths, codes.shape[1])
    motion = VqVae(config.vqvae).apply(variables["vqvae"], codes, mask, method="decode")
    mean, std = statistics
    features = motion * std[None, None] + mean[None, None]
    return GeneratedMotion(features, positions_from_features(features, skeleton_from_name(config.skeleton)))


class TextToMotion:
    """A loaded model: `TextToMotion.load("demo").generate(["a person walks forward"])`."""

    def __init__(self, bundle: Bundle):
        """Puts the weights on the default device.

        Raises:
            UserError: if the model reads text with CLIP and that is not to be had.
        """
        self.config = bundle.config
        self.skeleton = skeleton_from_name(bundle.config.skeleton)
        self.normalizer = bundle.normalizer
        self._variables = jax.device_put(bundle.variables)
        self.text_encoder: TextEncoder = make_text_encoder(bundle)
        self._statistics = (jnp.asarray(bundle.normalizer.mean), jnp.asarray(bundle.normalizer.std))

    @classmethod
    def load(cls, name_or_path: str | Path) -> "TextToMotion":
        """Returns a model by bundled name ("demo"), bundle folder or run directory; turns the compilation cache on.

        Raises:
            UserError: if there is no such model, or it is damaged.
        """
        use_compilation_cache()
        return cls(load_model(name_or_path))

    @property
    def variables(self) -> dict[str, Any]:
        """The weights: `vqvae`, `gpt` and `caption_encoder`, each ready for its module's `apply`."""
        return self._variables

    def generate(
        self,
        captions: Sequence[str] | str,
        *,
        seed: int = 0,
        num_samples: int = 1,
        strategy: Strategy | None = None,
        max_codes: int | None = None,
    ) -> list[Motion]:
        """Returns `num_samples` motions for each caption, caption by caption.

        A motion depends on seed, caption and its number among the samples, not on what else is made beside it.

        Args:
            captions: Sentences (one may be given bare).
            seed: From 0 to 2**32 - 1.
            num_samples: Motions a caption.
            strategy: How codes are chosen; by default from the model's own probabilities.
            max_codes: Longest motion in codes; by default what the model was built for.

        Raises:
            UserError: if a caption or a number is not usable.
        """
        texts = [check_prompt(caption) for caption in ([captions] if isinstance(captions, str) else captions)]
        self._check_numbers(seed, num_samples, max_codes)
        requests = [(text, sample) for text in texts for sample in range(num_samples)]
        motions: list[Motion] = []
        for first in range(0, len(requests), MAX_BATCH):
            motions += self._generate_batch(
                requests[first : first + MAX_BATCH],
                seed=seed,
                strategy=strategy or Temperature(),
                max_codes=max_codes or self.config.gpt.max_codes,
            )
        return motions

    def _check_numbers(self, seed: int, num_samples: int, max_codes: int | None) -> None:
        if not 0 <= seed < 2**32:
            raise UserError(f"seed: {seed} is not between 0 and {2**32 - 1}")
        if num_samples < 1:
            raise UserError(f"num-samples: {num_samples} is not a whole number above 0")
        if max_codes is not None and not 1 <= max_codes <= self.config.gpt.max_codes:
            raise UserError(f"max-codes: {max_codes} is not between 1 and {self.config.gpt.max_codes}")

    def _generate_batch(
        self, requests: Sequence[tuple[str, int]], *, seed: int, strategy: Strategy, max_codes: int
    ) -> list[Motion]:
        # Sizes are powers of two, so that few programs are compiled; the filling repeats the first request.
        size = 1 << (len(requests) - 1).bit_length()
        filled = [*requests, *[requests[0]] * (size - len(requests))]
        decoded = generate_codes(
            self._variables,
            self.text_encoder([text for text, _ in filled]),
            jnp.stack([sample_key(seed, text, sample) for text, sample in filled]),
            config=self.config,
            strategy=strategy,
            min_codes=1,
            max_codes=max_codes,
        )
        batch = decode_motion(
            self._variables, self._statistics, decoded.codes, decoded.code_lengths, config=self.config
        )
        codes, lengths, features, positions = map(np.asarray, (*decoded[:2], *batch))
        return [
            self._motion(text, seed, codes[row, : lengths[row]], features[row], positions[row])
            for row, (text, _) in enumerate(requests)
        ]

    def _motion(
        self,
        caption: str,
        seed: int,
        codes: Int[np.ndarray, " N"],
        features: Float[np.ndarray, "T D"],
        positions: Float[np.ndarray, "T J 3"],
    ) -> Motion:
        num_frames = len(codes) * self.config.vqvae.downsample
        return Motion(
            positions=positions[:num_frames] * np.float32(self.skeleton.metres_per_unit),
            fps=self.skeleton.fps,
            skeleton=self.skeleton,
            features=features[:num_frames],
            codes=codes,
            caption=caption,
            seed=seed,
        )

    def decode(self, codes: Int[np.ndarray, " N"], *, caption: str = "") -> Motion:
        """Returns the motion of given codes.

        Raises:
            UserError: if there are none, or one is not in the codebook.
        """
        codes = np.asarray(codes, np.int32)
        if codes.ndim != 1 or not len(codes):
            raise UserError("codes: give at least one, in one row")
        if codes.min() < 0 or codes.max() >= self.config.vqvae.num_codes:
            raise UserError(f"codes: must lie between 0 and {self.config.vqvae.num_codes - 1}")
        batch = decode_motion(
            self._variables, self._statistics, codes[None], jnp.array([len(codes)]), config=self.config
        )
        return self._motion(caption, 0, codes, np.asarray(batch.features[0]), np.asarray(batch.positions[0]))
