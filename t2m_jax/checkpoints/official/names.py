"""Names of every weight in the original PyTorch code (T2M-GPT b1446f1, text-to-motion) and in our modules."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from t2m_jax.models.evaluator import NUM_CONTACTS, EvaluatorConfig
from t2m_jax.models.motion_gpt import MotionGptConfig, sinusoidal_table
from t2m_jax.models.vqvae import VqVaeConfig


class Weight(NamedTuple):
    """One array in the original and in our variables."""

    key: str
    """Name in the original's state dict."""
    shape: tuple[int, ...]
    """Shape in the original."""
    path: tuple[str, ...]
    """Collection, modules and name in our variables."""
    is_reversed: bool = False
    """Whether the order of the axes differs: (out, in, kernel) or (out, in) in the original, reversed in ours."""


def vqvae_weights(config: VqVaeConfig) -> Iterator[Weight]:
    """Yields every array of a `VqVae` that the original saves."""
    encoder = "vqvae.encoder.model"
    decoder = "vqvae.decoder.model"
    # Convolution and activation come before the stages.
    last = 2 + config.num_stages
    features = config.feature_dim
    width = config.width
    codes = config.code_dim
    yield from _layer(f"{encoder}.0", (width, features, 3), "encoder", "input", "conv")
    yield from _layer(f"{decoder}.0", (width, codes, 3), "decoder", "input", "conv")
    for stage in range(config.num_stages):
        yield from _layer(f"{encoder}.{2 + stage}.0", (width, width, 4), "encoder", f"down_{stage}", "conv")
        yield from _stack(f"{encoder}.{2 + stage}.1", config, "encoder", f"stack_{stage}")
        yield from _stack(f"{decoder}.{2 + stage}.0", config, "decoder", f"stack_{stage}")
        yield from _layer(f"{decoder}.{2 + stage}.2", (width, width, 3), "decoder", f"up_{stage}", "conv")
    yield from _layer(f"{encoder}.{last}", (codes, width, 3), "encoder", "output", "conv")
    yield from _layer(f"{decoder}.{last}", (width, width, 3), "decoder", "penultimate", "conv")
    yield from _layer(f"{decoder}.{last + 2}", (features, width, 3), "decoder", "output", "conv")
    codebook = (config.num_codes, codes)
    # This one is learned by gradients, so it is a parameter. The others are running means.
    if config.quantizer == "orig":
        yield Weight("vqvae.quantizer.embedding.weight", codebook, ("params", "quantizer", "codebook"))
    else:
        yield Weight("vqvae.quantizer.codebook", codebook, ("codebook", "quantizer", "codebook"))


def _layer(key: str, shape: tuple[int, ...], *path: str) -> Iterator[Weight]:
    """Yields kernel and bias of a dense layer or a convolution."""
    yield Weight(f"{key}.weight", shape, ("params", *path, "kernel"), is_reversed=True)
    yield Weight(f"{key}.bias", shape[:1], ("params", *path, "bias"))


def _norm(key: str, width: int, *path: str) -> Iterator[Weight]:
    yield Weight(f"{key}.weight", (width,), ("params", *path, "scale"))
    yield Weight(f"{key}.bias", (width,), ("params", *path, "bias"))


def _stack(key: str, config: VqVaeConfig, *path: str) -> Iterator[Weight]:
    """Yields the weights of the residual units of one stage."""
    width = config.width
    for unit in range(config.depth):
        name = f"{key}.model.{unit}"
        place = (*path, f"unit_{unit}")
        yield from _layer(f"{name}.conv1", (width, width, 3), *place, "dilated", "conv")
        yield from _layer(f"{name}.conv2", (width, width, 1), *place, "pointwise", "conv")
        for norm in ("norm1", "norm2") if config.norm != "none" else ():
            yield from _norm(f"{name}.{norm}", width, *place, norm)
            if config.norm == "BN":
                yield Weight(f"{name}.{norm}.running_mean", (width,), ("batch_stats", *place, norm, "mean"))
                yield Weight(f"{name}.{norm}.running_var", (width,), ("batch_stats", *place, norm, "var"))


def vqvae_constant_shapes(config: VqVaeConfig) -> dict[str, tuple[int, ...]]:
    """Returns the shapes of what the original saves besides the weights: how many batches each norm has seen."""
    keys = [weight.key.rpartition(".") for weight in vqvae_weights(config)]
    return {f"{norm}.num_batches_tracked": () for norm, _, name in keys if name == "running_mean"}


def gpt_weights(config: MotionGptConfig, *, num_base: int) -> Iterator[Weight]:
    """Yields every array of a `MotionGpt`; the first `num_base` blocks are the original's base, the others its head."""
    width = config.embed_dim
    inner = config.mlp_ratio * width
    # End and padding are read, but only the end is predicted: the head has one token less.
    tokens = (config.num_codes + 2, width)
    yield Weight("trans_base.tok_emb.weight", tokens, ("params", "token_embedding", "embedding"))
    yield from _layer("trans_base.cond_emb", (width, config.text_dim), "text_projection")
    for layer, key in enumerate(_blocks(config, num_base=num_base)):
        block = f"block_{layer}"
        yield from _norm(f"{key}.ln1", width, block, "ln1")
        yield from _norm(f"{key}.ln2", width, block, "ln2")
        for name in ("query", "key", "value", "proj"):
            yield from _layer(f"{key}.attn.{name}", (width, width), block, "attn", name)
        yield from _layer(f"{key}.mlp.0", (inner, width), block, "mlp", "up")
        yield from _layer(f"{key}.mlp.2", (width, inner), block, "mlp", "down")
    yield from _norm("trans_head.ln_f", width, "final_norm")
    head = (config.num_codes + 1, width)
    yield Weight("trans_head.head.weight", head, ("params", "head", "kernel"), is_reversed=True)


def _blocks(config: MotionGptConfig, *, num_base: int) -> list[str]:
    parts = (("trans_base", num_base), ("trans_head", config.num_layers - num_base))
    return [f"{part}.blocks.{block}" for part, count in parts for block in range(count)]


_FIXED_POSITIONS = "trans_base.pos_embed.embed"
_UNUSED_POSITIONS = "trans_base.pos_embedding.weight"


def gpt_constant_shapes(config: MotionGptConfig, *, num_base: int) -> dict[str, tuple[int, ...]]:
    """Returns the shapes of what the original saves besides the weights: causal masks and two position tables.

    One table is the fixed sinusoid. The other is learned, but the original never reads it.
    """
    length = config.block_size
    masks = {f"{block}.attn.mask": (1, 1, length, length) for block in _blocks(config, num_base=num_base)}
    return masks | {_FIXED_POSITIONS: (length, 1, config.embed_dim), _UNUSED_POSITIONS: (length, config.embed_dim)}


def constant(key: str, shape: tuple[int, ...]) -> np.ndarray:
    """Returns an array that the original saves and that is not learned; zeros if its values are not used."""
    if key == _FIXED_POSITIONS:
        return sinusoidal_table(shape[0], shape[2])[:, None]
    if key.endswith(".attn.mask"):
        return np.tril(np.ones(shape, np.float32))
    return np.zeros(shape, np.float32 if shape else np.int64)


def is_used(key: str) -> bool:
    """Returns whether the original's results depend on a constant."""
    return key != _UNUSED_POSITIONS and not key.endswith(".num_batches_tracked")


EVALUATOR_PARTS = ("text_encoder", "motion_encoder", "movement_encoder")
"""The dictionaries in a checkpoint of the evaluator. Our keys begin with their names and a dot."""


def evaluator_weights(config: EvaluatorConfig) -> Iterator[Weight]:
    """Yields every array of an `Evaluator` that the original saves: everything except the word vectors."""
    hidden = config.movement_hidden
    width = config.movement_dim
    # The original cuts the foot contacts off before its first layer.
    features = config.feature_dim - NUM_CONTACTS
    yield from _layer("movement_encoder.main.0", (hidden, features, 4), "movement_encoder", "conv_0")
    yield from _layer("movement_encoder.main.3", (width, hidden, 4), "movement_encoder", "conv_1")
    yield from _layer("movement_encoder.out_net", (width, width), "movement_encoder", "output")
    yield from _sequence_encoder("motion_encoder", (width, config.motion_hidden, config.embedding_dim))
    classes = (config.word_dim, config.num_parts_of_speech)
    yield from _layer("text_encoder.pos_emb", classes, "part_of_speech_projection")
    yield from _sequence_encoder("text_encoder", (config.word_dim, config.text_hidden, config.embedding_dim))


def _sequence_encoder(part: str, sizes: tuple[int, int, int]) -> Iterator[Weight]:
    """Yields the weights of one `SequenceEncoder`, which has the same name in the original."""
    inputs, hidden, outputs = sizes
    yield Weight(f"{part}.hidden", (2, 1, hidden), ("params", part, "gru", "initial_state"))
    yield from _layer(f"{part}.input_emb", (hidden, inputs), part, "input")
    for name, suffix in (("forward", ""), ("backward", "_reverse")):
        gru = f"{part}.gru.{{}}_l0{suffix}"
        place = ("params", part, "gru", name)
        for kind, ours, shape in (("weight", "kernel", (3 * hidden, hidden)), ("bias", "bias", (3 * hidden,))):
            is_matrix = kind == "weight"
            yield Weight(gru.format(f"{kind}_ih"), shape, (*place, "input", ours), is_reversed=is_matrix)
            yield Weight(gru.format(f"{kind}_hh"), shape, (*place, f"recurrent_{ours}"), is_reversed=is_matrix)
    yield from _layer(f"{part}.output_net.0", (hidden, 2 * hidden), part, "head")
    yield from _norm(f"{part}.output_net.1", hidden, part, "head_norm")
    yield from _layer(f"{part}.output_net.3", (outputs, hidden), part, "output")
