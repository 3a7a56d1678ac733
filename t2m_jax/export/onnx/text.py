"""The text encoder of a model as one function of tokens, and what makes tokens of a sentence."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from tokenizers import Tokenizer

from t2m_jax.checkpoints.bundle import Bundle
from t2m_jax.checkpoints.clip import TrainedClip
from t2m_jax.checkpoints.pretrained import quantized_rows
from t2m_jax.checkpoints.sentence import WEIGHTS_FILE, TrainedSentenceEncoder
from t2m_jax.checkpoints.text_encoder import load_pretrained, pretrained_reference, trained_network
from t2m_jax.files.arrays import read_arrays
from t2m_jax.models.caption_encoder import StateEncoderConfig, network_module
from t2m_jax.models.clip_text import ClipText
from t2m_jax.models.sentence_encoder import SentenceEncoder
from t2m_jax.text.bpe import CLIP_END, CLIP_START

MAX_TOKENS = 64
"""Tokens that a sentence encoder reads, of which captions of motion have fewer. All of them are always computed."""

Network = Callable[[Array, Bool[Array, "1 S"]], Float[Array, "1 E"]]


class TextPart(NamedTuple):
    """The text encoder of a model."""

    embed: Callable[[Int[Array, "1 S"], Bool[Array, "1 S"]], tuple[Array, ...]]
    """From tokens, and where they are, to `outputs`."""
    tokenizer: Tokenizer
    num_tokens: int
    """Tokens of the graph (S); a longer sentence is cut."""
    marks: Mapping[str, int | None] = {}
    """Tokens before and after those of the sentence that the tokenizer does not add itself."""
    quantized: tuple[tuple[np.ndarray, np.ndarray], ...] = ()
    """Matrices in 8 bits with their scales, from which the encoder's weights were restored."""
    outputs: tuple[str, ...] = ("text_embedding",)
    """Also `meaning`, the mean of the token states, if the record of the model says which actions its data lack."""


def text_part(bundle: Bundle) -> TextPart:
    """Returns the text encoder of a model.

    Raises:
        UserError: Its pretrained encoder cannot be found.
    """
    network = trained_network(bundle.config.text_encoder)
    reference = pretrained_reference(bundle.config.text_encoder)
    embed = None if network is None else _trained(bundle, network)
    if reference is None:
        assert network is not None and embed is not None and bundle.bpe is not None, "there is an encoder"
        return TextPart(lambda *inputs: (embed(*inputs),), bundle.bpe, network.max_length)
    width = network.state_dim if isinstance(network, StateEncoderConfig) else bundle.config.generator.text_dim
    encoder = load_pretrained(reference, text_dim=width)
    if isinstance(encoder, TrainedClip):
        marks = {name: encoder.tokenizer.token_to_id(mark) for name, mark in (("start", CLIP_START), ("end", CLIP_END))}
        # CLIP finds the end by its token, and needs no mask.
        return TextPart(
            lambda tokens, _: (ClipText(encoder.config).apply(encoder.variables, tokens),),
            encoder.tokenizer,
            encoder.config.max_length,
            marks,
        )
    num_tokens = max(MAX_TOKENS, 0 if network is None else network.max_length)
    has_meaning = bool((bundle.training_data or {}).get("missing"))
    return _sentence_part(encoder, embed, num_tokens, has_meaning=has_meaning)


def _trained(bundle: Bundle, network: Any) -> Network:
    variables = bundle.variables["text_encoder"]
    return lambda inputs, mask: network_module(network).apply(
        variables, inputs[:, : network.max_length], mask[:, : network.max_length], train=False
    )


def _sentence_part(
    encoder: TrainedSentenceEncoder, read_states: Network | None, num_tokens: int, *, has_meaning: bool
) -> TextPart:
    """Returns a sentence encoder, and the network that reads its token states if there is one."""

    def embed(tokens: Int[Array, "1 S"], mask: Bool[Array, "1 S"]) -> tuple[Array, ...]:
        module = SentenceEncoder(encoder.config)
        if read_states is None:
            return (module.apply(encoder.variables, tokens, mask),)
        # In 16 bits, as they are stored for training.
        states = module.apply(encoder.variables, tokens, mask, method="states").astype(jnp.float16)
        states = states.astype(jnp.float32)
        if not has_meaning:
            return (read_states(states, mask),)
        used = mask[..., None].astype(jnp.float32)
        return read_states(states, mask), (states * used).sum(axis=1) / used.sum(axis=1)

    quantized = tuple(quantized_rows(read_arrays(encoder.folder / WEIGHTS_FILE)))
    part = TextPart(embed, encoder.tokenizer, min(num_tokens, encoder.config.max_length), quantized=quantized)
    has_both = has_meaning and read_states is not None
    return part._replace(outputs=("text_embedding", "meaning")) if has_both else part
