"""Checkpoints of the original PyTorch code as models of ours: sizes are read off the tensors, every key must fit."""

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, Literal, TypeVar

import jax.numpy as jnp
import numpy as np
from flax import traverse_util

from t2m_jax.checkpoints.official.names import (
    EVALUATOR_PARTS,
    Weight,
    constant,
    evaluator_weights,
    gpt_constant_shapes,
    gpt_weights,
    is_used,
    vqvae_constant_shapes,
    vqvae_weights,
)
from t2m_jax.checkpoints.torch_file import load_torch_file
from t2m_jax.errors import UserError
from t2m_jax.files import read_arrays
from t2m_jax.models.convolution import NormKind
from t2m_jax.models.evaluator import NUM_CONTACTS, EvaluatorConfig
from t2m_jax.models.motion_gpt import MotionGptConfig
from t2m_jax.models.quantizer import QuantizerKind
from t2m_jax.models.vqvae import VqVaeConfig
from t2m_jax.text.word_vectors import load_vector_table

StateDict = Mapping[str, np.ndarray]
Config = TypeVar("Config")

WRAPPERS = {"net": "a VQ-VAE", "trans": "a GPT"}
"""The key under which the original saves each model."""
POSITION_TOLERANCE = 1e-4
"""How far a file's fixed position table may be from ours; rounding alone makes 3e-7."""


def vqvae_variables(state_dict: StateDict, config: VqVaeConfig) -> dict[str, Any]:
    """Returns the collections of a `VqVae`.

    The original does not save the codebook's averages: they start from the loaded codebook with counts of one, and
    the codebook counts as initialised (the original would throw it away on the first training step).
    """
    variables = _variables(state_dict, vqvae_weights(config))
    if "codebook" in variables:
        codebook = variables["codebook"]["quantizer"]["codebook"]
        variables["codebook"]["quantizer"] |= {
            "ema_sum": codebook,
            "ema_count": jnp.ones(codebook.shape[0]),
            "initialised": jnp.array(True),
        }
    return variables


def gpt_variables(state_dict: StateDict, config: MotionGptConfig, *, num_base: int | None = None) -> dict[str, Any]:
    """Returns the collections of a `MotionGpt`; without `num_base`, half of its blocks are the original's base.

    The masks, the unused learned position table and the fixed sinusoid are left out.
    """
    return _variables(
        state_dict, gpt_weights(config, num_base=config.num_layers // 2 if num_base is None else num_base)
    )


def evaluator_variables(
    state_dict: StateDict, config: EvaluatorConfig, word_vectors: np.ndarray | None = None
) -> dict[str, Any]:
    """Returns the collections of an `Evaluator`; without word vectors it embeds motions alone."""
    variables = _variables(state_dict, evaluator_weights(config))
    if word_vectors is not None:
        variables["params"]["word_embedding"] = {"embedding": jnp.asarray(word_vectors, jnp.float32)}
    return variables


def _variables(state_dict: StateDict, weights: Iterable[Weight]) -> dict[str, Any]:
    """Returns the arrays of a state dict in their places."""
    placed = {}
    for weight in weights:
        array = state_dict[weight.key]
        placed[weight.path] = jnp.asarray(array.T if weight.is_reversed else array)
    return traverse_util.unflatten_dict(placed)


def load_vqvae(
    path: str | Path,
    *,
    dilation_growth: int = 3,
    activation: Literal["relu", "silu", "gelu"] = "relu",
    norm: NormKind | None = None,
    quantizer: QuantizerKind | None = None,
) -> tuple[VqVaeConfig, dict[str, Any]]:
    """Returns the config and the variables of an original VQ-VAE (`.pth`, `.tar` or `.safetensors`).

    Args:
        path: The file.
        dilation_growth: Ratio of the dilations of neighbouring units; the file does not tell.
        activation: Inside the residual units; the file does not tell.
        norm: By default what the file has; `LN` and `GN` cannot be told apart, then it is `LN`.
        quantizer: How the codebook learnt; by default `orig` or `ema_reset`, by the name of its key.

    Raises:
        UserError: if it is no such file, or a key is missing, unknown, of another shape, or not finite.
    """
    path = Path(path)
    state = _load_state_dict(path, wrapper="net")
    codebook = "vqvae.quantizer.embedding.weight"
    is_orig = codebook in state
    width, feature_dim, _ = _shape(path, state, "vqvae.encoder.model.0.weight", axes=3)
    num_codes, code_dim = _shape(path, state, codebook if is_orig else "vqvae.quantizer.codebook", axes=2)
    config = _config(
        path,
        VqVaeConfig,
        feature_dim=feature_dim,
        num_codes=num_codes,
        code_dim=code_dim,
        width=width,
        num_stages=_count(state, "vqvae.encoder.model.{}.0.weight", first=2),
        depth=_count(state, "vqvae.encoder.model.2.1.model.{}.conv1.weight"),
        dilation_growth=dilation_growth,
        activation=activation,
        norm=norm or _norm_kind(state),
        quantizer=quantizer or ("orig" if is_orig else "ema_reset"),
    )
    state = _checked(path, state, list(vqvae_weights(config)), vqvae_constant_shapes(config))
    return config, vqvae_variables(state, config)


def load_gpt(path: str | Path, *, num_heads: int = 16) -> tuple[MotionGptConfig, dict[str, Any]]:
    """Returns the config and the variables of an original GPT (`.pth`, `.tar` or `.safetensors`).

    Args:
        path: The file.
        num_heads: Attention heads; the file does not tell.

    Raises:
        UserError: if it is no such file, or a key is missing, unknown, of another shape, or not what it must be.
    """
    path = Path(path)
    state = _load_state_dict(path, wrapper="trans")
    num_tokens, embed_dim = _shape(path, state, "trans_base.tok_emb.weight", axes=2)
    num_base = _count(state, "trans_base.blocks.{}.ln1.weight")
    config = _config(
        path,
        MotionGptConfig,
        num_codes=num_tokens - 2,
        embed_dim=embed_dim,
        text_dim=_shape(path, state, "trans_base.cond_emb.weight", axes=2)[1],
        num_layers=num_base + _count(state, "trans_head.blocks.{}.ln1.weight"),
        num_heads=num_heads,
        mlp_ratio=_shape(path, state, "trans_base.blocks.0.mlp.0.weight", axes=2)[0] // max(embed_dim, 1),
        block_size=_shape(path, state, "trans_base.pos_embed.embed", axes=3)[0],
    )
    weights = list(gpt_weights(config, num_base=num_base))
    state = _checked(path, state, weights, gpt_constant_shapes(config, num_base=num_base))
    return config, gpt_variables(state, config, num_base=num_base)


def load_evaluator(
    path: str | Path, *, word_vectors: str | Path | None = None
) -> tuple[EvaluatorConfig, dict[str, Any]]:
    """Returns the config and the variables of an original evaluator (`finest.tar` or `.safetensors`).

    Args:
        path: The file.
        word_vectors: The original's table of word vectors, `our_vab_data.npy`. It is no part of the checkpoint; without
            it motions can be embedded, and texts cannot.

    Raises:
        UserError: if it is no such file, or a key is missing, unknown, of another shape, or not finite.
    """
    path = Path(path)
    state = _load_evaluator_parts(path)
    table = None if word_vectors is None else load_vector_table(Path(word_vectors))
    hidden, features, _ = _shape(path, state, "movement_encoder.main.0.weight", axes=3)
    word_dim, num_classes = _shape(path, state, "text_encoder.pos_emb.weight", axes=2)
    if table is not None and table.shape[1] != word_dim:
        raise UserError(f"{word_vectors}: vectors of {table.shape[1]} numbers, but {path} reads {word_dim}")
    config = _config(
        path,
        EvaluatorConfig,
        feature_dim=features + NUM_CONTACTS,
        movement_hidden=hidden,
        movement_dim=_shape(path, state, "movement_encoder.main.3.weight", axes=3)[0],
        motion_hidden=_shape(path, state, "motion_encoder.input_emb.weight", axes=2)[0],
        text_hidden=_shape(path, state, "text_encoder.input_emb.weight", axes=2)[0],
        embedding_dim=_shape(path, state, "motion_encoder.output_net.3.weight", axes=2)[0],
        word_dim=word_dim,
        num_parts_of_speech=num_classes,
        **({} if table is None else {"num_words": len(table)}),
    )
    return config, evaluator_variables(_checked(path, state, list(evaluator_weights(config)), {}), config, table)


def _load_evaluator_parts(path: Path) -> dict[str, np.ndarray]:
    """Returns the arrays of an evaluator's file by part and key; the states of its optimisers are left out."""
    if path.suffix == ".safetensors":
        return read_arrays(path)
    content = load_torch_file(path)
    state = {}
    for part in EVALUATOR_PARTS:
        arrays = content.get(part)
        if not isinstance(arrays, Mapping):
            raise UserError(f"{path}: {part!r} is missing; not a checkpoint of the original evaluator (finest.tar)")
        for key, value in arrays.items():
            if not isinstance(key, str) or not isinstance(value, np.ndarray):
                raise UserError(f"{path}: {str(key)[:80]!r} of {part!r} is not a tensor")
            state[f"{part}.{key}"] = value
    return state


def _load_state_dict(path: Path, *, wrapper: str) -> dict[str, np.ndarray]:
    """Returns the arrays of a file by key, taken out of what they are wrapped in."""
    content: Mapping[Any, Any] = read_arrays(path) if path.suffix == ".safetensors" else load_torch_file(path)
    for key, kind in WRAPPERS.items():
        if key != wrapper and isinstance(content.get(key), dict) and wrapper not in content:
            raise UserError(f"{path}: holds {kind} ({key!r}), but {WRAPPERS[wrapper]} is wanted")
    state = content.get(wrapper, content)
    if not isinstance(state, Mapping) or not state:
        raise UserError(f"{path}: {wrapper!r} is not a dictionary of tensors")
    for key, value in state.items():
        if not isinstance(key, str) or not isinstance(value, np.ndarray):
            raise UserError(f"{path}: {str(key)[:80]!r} is not a tensor of {WRAPPERS[wrapper]}")
    prefix = "module." if all(key.startswith("module.") for key in state) else ""
    return {key.removeprefix(prefix): value for key, value in state.items()}


def _shape(path: Path, state: StateDict, key: str, *, axes: int) -> tuple[int, ...]:
    """Returns the shape of an array, from which sizes are to be read."""
    if key not in state:
        raise UserError(f"{path}: {key!r} is missing; not a checkpoint of the original code")
    if state[key].ndim != axes:
        raise UserError(f"{path}: {key!r} has shape {state[key].shape}, {axes} axes are wanted")
    return state[key].shape


def _count(state: StateDict, pattern: str, *, first: int = 0) -> int:
    """Returns how many keys there are of a pattern with a number in it, counted from `first` without a gap."""
    number = first
    while pattern.format(number) in state:
        number += 1
    return number - first


def _norm_kind(state: StateDict) -> NormKind:
    unit = "vqvae.encoder.model.2.1.model.0.norm1"
    if f"{unit}.running_mean" in state:
        return "BN"
    return "LN" if f"{unit}.weight" in state else "none"


def _config(path: Path, schema: Callable[..., Config], **sizes: Any) -> Config:
    """Returns a config of the sizes that a file and the options give."""
    try:
        return schema(**sizes)
    except ValueError as error:
        raise UserError(f"{path}: {error}") from None


def _checked(
    path: Path, state: StateDict, weights: list[Weight], constants: Mapping[str, tuple[int, ...]]
) -> dict[str, np.ndarray]:
    """Returns the weights in single precision, having looked at every key of the file."""
    shapes = {weight.key: weight.shape for weight in weights} | dict(constants)
    for key in sorted(shapes.keys() ^ state.keys()):
        problem = "is missing" if key in shapes else "is not part of the model that the other keys describe"
        raise UserError(f"{path}: {key[:80]!r} {problem}")
    for key, shape in shapes.items():
        if state[key].shape != shape:
            raise UserError(f"{path}: {key!r} has shape {state[key].shape}, the other keys want {shape}")
    for key, shape in constants.items():
        if is_used(key) and not np.allclose(state[key], constant(key, shape), rtol=0, atol=POSITION_TOLERANCE):
            raise UserError(f"{path}: {key!r} is not the table that the original computes; another model than T2M-GPT")
    return {weight.key: _float32(path, weight.key, state[weight.key]) for weight in weights}


def _float32(path: Path, key: str, array: np.ndarray) -> np.ndarray:
    if not jnp.issubdtype(array.dtype, jnp.floating):
        raise UserError(f"{path}: {key!r} holds {array.dtype} where floating-point numbers are expected")
    with np.errstate(over="ignore"):  # doubles that are too large become infinite, and are refused
        single = array.astype(np.float32, copy=False)
    if not np.all(np.isfinite(single)):
        raise UserError(f"{path}: {key!r} has values that are not finite")
    return single
