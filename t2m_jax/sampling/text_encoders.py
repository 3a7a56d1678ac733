"""The text encoder of a model: the caption encoder that was trained with its GPT, or CLIP."""

import functools
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int
from tokenizers import Tokenizer

from t2m_jax.checkpoints.bundle import Bundle
from t2m_jax.checkpoints.clip import load_clip
from t2m_jax.models.caption_encoder import CaptionEncoder, CaptionEncoderConfig
from t2m_jax.sampling.clip_text_encoder import ClipTextEncoder
from t2m_jax.text.bpe import tokenize_captions
from t2m_jax.text.encoder import TextEncoder


@functools.partial(jax.jit, static_argnames="config")
def encode_captions(
    variables: Any,
    caption_tokens: Int[Array, "B S"],
    caption_mask: Bool[Array, "B S"],
    *,
    config: CaptionEncoderConfig,
) -> Float[Array, "B E"]:
    """Returns the text embeddings of tokenized captions."""
    return CaptionEncoder(config).apply(variables, caption_tokens, caption_mask, train=False)


class CaptionTextEncoder:
    """A `TextEncoder` made of a tokenizer and a trained caption encoder."""

    def __init__(self, config: CaptionEncoderConfig, variables: Any, tokenizer: Tokenizer):
        """Keeps the three parts; `variables` are those of `CaptionEncoder`."""
        self._config = config
        self._variables = variables
        self._tokenizer = tokenizer

    def __call__(self, captions: Sequence[str]) -> Float[Array, "B E"]:
        """Returns one embedding a caption; what is longer than the encoder reads is cut."""
        tokens, mask = tokenize_captions(self._tokenizer, captions, max_length=self._config.max_length)
        return encode_captions(self._variables, jnp.asarray(tokens), jnp.asarray(mask), config=self._config)


def make_text_encoder(bundle: Bundle) -> TextEncoder:
    """Returns what reads the captions of a model.

    Raises:
        UserError: if it is CLIP and not to be had, or of another width than the GPT reads.
    """
    config = bundle.config
    if bundle.tokenizer is not None:
        variables = jax.device_put(bundle.variables["caption_encoder"])
        return CaptionTextEncoder(config.caption_encoder, variables, bundle.tokenizer)
    return ClipTextEncoder(load_clip(config.clip, text_dim=config.gpt.text_dim))
