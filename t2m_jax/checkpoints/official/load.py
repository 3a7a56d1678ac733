"""Reads checkpoints of the original PyTorch code: sizes come from the tensors, and every key must fit."""

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import jax.numpy as jnp
import numpy as np
from flax import traverse_util

from t2m_jax.checkpoints.official import names
from t2m_jax.checkpoints.torch_file import load_torch_file
from t2m_jax.errors import UserError
from t2m_jax.files.arrays import fit_arrays, read_arrays
from t2m_jax.models.evaluator import NUM_CONTACTS, EvaluatorConfig
from t2m_jax.models.motion_gpt import MotionGptConfig
from t2m_jax.models.vqvae import VqVaeConfig
from t2m_jax.text.word_vectors import load_vector_table

StateDict = Mapping[str, np.ndarray]
Config = TypeVar("Config")

WRAPPERS = {"net": "a VQ-VAE", "trans": "a GPT"}
"""The key under which the original saves each model."""
OTHER_WRAPPERS = ("state_dict", "model")
"""Keys under which trainers such as Lightning save a model. These and `DataParallel` put a prefix before its names."""
POSITION_TOLERANCE = 1e-4
"""Largest difference between a file's fixed position table and ours; rounding alone makes 3e-7."""


def vqvae_variables(state_dict: StateDict, config: VqVaeConfig) -> dict[str, Any]:
    """Returns the collections of a `VqVae`.

    The original does not save the averages of the codebook. They start from the loaded codebook with counts of one. The
    codebook is marked as initialized; the original would replace it in the first training step.
    """
    variables = _variables(state_dict, names.vqvae_weights(config))
    if "codebook" in variables:
        codebook = variables["codebook"]["quantizer"]["codebook"]
        variables["codebook"]["quantizer"] |= {
            "ema_sum": codebook,
            "ema_count": jnp.ones(codebook.shape[0]),
            "initialised": jnp.array(True),
        }
    return variables


def gpt_variables(state_dict: StateDict, config: MotionGptConfig, *, num_base: int | None = None) -> dict[str, Any]:
    """Returns the collections of a `MotionGpt`; without `num_base`, half of its blocks are the original's base."""
    # All published GPTs have as many blocks in the base as in the head.
    num_base = config.num_layers // 2 if num_base is None else num_base
    return _variables(state_dict, names.gpt_weights(config, num_base=num_base))


def evaluator_variables(
    state_dict: StateDict, config: EvaluatorConfig, word_vectors: np.ndarray | None = None
) -> dict[str, Any]:
    """Returns the collections of an `Evaluator`; without word vectors it can embed motions only."""
    variables = _variables(state_dict, names.evaluator_weights(config))
    if word_vectors is not None:
        variables["params"]["word_embedding"] = {"embedding": jnp.asarray(word_vectors, jnp.float32)}
    return variables


def _variables(state_dict: StateDict, weights: Iterable[names.Weight]) -> dict[str, Any]:
    """Returns the arrays of a state dict by our names."""
    flat = {
        weight.path: state_dict[weight.key].T if weight.is_reversed else state_dict[weight.key] for weight in weights
    }
    return traverse_util.unflatten_dict({path: jnp.asarray(array) for path, array in flat.items()})


def load_vqvae(path: str | Path, **options: Any) -> tuple[VqVaeConfig, dict[str, Any]]:
    """Returns the config and the variables of an original VQ-VAE (`.pth`, `.tar` or `.safetensors`).

    Args:
        path: The file.
        **options: Fields of `VqVaeConfig` that the file does not contain: `dilation_growth`, `activation`, `ema_decay`,
            `reset_threshold`, and `norm` and `quantizer`, of which it contains a part. The defaults are the published
            models' values; by default, `norm` is what the file has, or `LN` for the tensors of `LN` and `GN`, and
            `quantizer` is `orig` or `ema_reset`, by the name of the codebook's tensor.

    Raises:
        UserError: The file is damaged or is not a VQ-VAE, or a key is missing, unknown, of another shape or not finite.
    """
    path = Path(path)
    state = _load_state_dict(path, wrapper="net")
    codebook = "vqvae.quantizer.embedding.weight"
    is_orig = codebook in state
    width, feature_dim, _ = _shape(path, state, "vqvae.encoder.model.0.weight", axes=3)
    num_codes, code_dim = _shape(path, state, codebook if is_orig else "vqvae.quantizer.codebook", axes=2)
    # Only batch norms have running means. Layer and group norms cannot be told apart by names and shapes.
    first_norm = "vqvae.encoder.model.2.1.model.0.norm1"
    norm = "BN" if f"{first_norm}.running_mean" in state else "LN" if f"{first_norm}.weight" in state else "none"
    found = {"norm": norm, "quantizer": "orig" if is_orig else "ema_reset"}
    config = _config(
        path,
        VqVaeConfig,
        feature_dim=feature_dim,
        num_codes=num_codes,
        code_dim=code_dim,
        width=width,
        # Numbers 0 and 1 are the first convolution and its activation.
        num_stages=_count(state, "vqvae.encoder.model.{}.0.weight", first=2),
        depth=_count(state, "vqvae.encoder.model.2.1.model.{}.conv1.weight"),
        **found | {name: value for name, value in options.items() if value is not None},
    )
    constants = names.vqvae_constant_shapes(config)
    return config, vqvae_variables(_fit(path, state, names.vqvae_weights(config), constants), config)


def load_gpt(path: str | Path, *, num_heads: int = 16) -> tuple[MotionGptConfig, dict[str, Any]]:
    """Returns the config and the variables of an original GPT (`.pth`, `.tar` or `.safetensors`).

    Args:
        path: The file.
        num_heads: Attention heads, which the file does not contain.

    Raises:
        UserError: The file is damaged or is not a GPT, or a key is missing, unknown, of another shape or not finite.
    """
    path = Path(path)
    state = _load_state_dict(path, wrapper="trans")
    num_tokens, embed_dim = _shape(path, state, "trans_base.tok_emb.weight", axes=2)
    num_base = _count(state, "trans_base.blocks.{}.ln1.weight")
    config = _config(
        path,
        MotionGptConfig,
        # The table also has the end and the padding.
        num_codes=num_tokens - 2,
        embed_dim=embed_dim,
        text_dim=_shape(path, state, "trans_base.cond_emb.weight", axes=2)[1],
        num_layers=num_base + _count(state, "trans_head.blocks.{}.ln1.weight"),
        num_heads=num_heads,
        mlp_ratio=_shape(path, state, "trans_base.blocks.0.mlp.0.weight", axes=2)[0] // max(embed_dim, 1),
        block_size=_shape(path, state, "trans_base.pos_embed.embed", axes=3)[0],
    )
    constants = names.gpt_constant_shapes(config, num_base=num_base)
    state = _fit(path, state, names.gpt_weights(config, num_base=num_base), constants)
    return config, gpt_variables(state, config, num_base=num_base)


def load_evaluator(
    path: str | Path, *, word_vectors: str | Path | None = None
) -> tuple[EvaluatorConfig, dict[str, Any]]:
    """Returns the config and the variables of an original evaluator (`finest.tar` or `.safetensors`).

    Args:
        path: The file.
        word_vectors: The original's table of word vectors, `our_vab_data.npy`, which is not part of the checkpoint.
            Without it the evaluator can embed motions, but not texts.

    Raises:
        UserError: A file is damaged or is of something else, or a key is missing, unknown, of another shape or not
            finite.
    """
    path = Path(path)
    state = read_arrays(path) if path.suffix == ".safetensors" else _load_evaluator_parts(path)
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
    return config, evaluator_variables(_fit(path, state, names.evaluator_weights(config), {}), config, table)


def _load_evaluator_parts(path: Path) -> StateDict:
    """Returns the tensors of an evaluator's file by part and key, without the states of its optimizers."""
    content = load_torch_file(path)
    state: dict[str, np.ndarray] = {}
    for part in names.EVALUATOR_PARTS:
        if part not in content:
            raise UserError(f"{path}: {part!r} is missing; give a checkpoint of the original evaluator (finest.tar)")
        state |= {f"{part}.{key}": array for key, array in _tensors(path, content[part], part).items()}
    return state


def _load_state_dict(path: Path, *, wrapper: str) -> StateDict:
    """Returns the tensors of a model's file by key; `wrapper` is the key that may contain them."""
    content: Mapping[Any, Any] = read_arrays(path) if path.suffix == ".safetensors" else load_torch_file(path)
    # Both files of a model are named alike, so that they are easily given in the wrong order.
    for key, kind in WRAPPERS.items():
        if key != wrapper and isinstance(content.get(key), dict) and wrapper not in content:
            raise UserError(f"{path}: contains {kind} ({key!r}), but {WRAPPERS[wrapper]} is needed")
    found = next((name for name in (wrapper, *OTHER_WRAPPERS) if name in content), None)
    state = _tensors(path, content if found is None else content[found], found or wrapper)
    for prefix in ("model.", f"{wrapper}.", "module."):
        if all(key.startswith(prefix) for key in state):
            state = {key.removeprefix(prefix): value for key, value in state.items()}
    return state


def _tensors(path: Path, state: Any, name: str) -> StateDict:
    """Returns a dictionary of tensors, after checking that it is one."""
    if not isinstance(state, Mapping) or not state:
        raise UserError(f"{path}: {name!r} is not a dictionary of tensors")
    for key, value in state.items():
        if not isinstance(key, str) or not isinstance(value, np.ndarray):
            raise UserError(f"{path}: {str(key)[:80]!r} in {name!r} is not a tensor; give a file of the original code")
    return state


def _shape(path: Path, state: StateDict, key: str, *, axes: int) -> tuple[int, ...]:
    """Returns the shape of a tensor from which sizes are read."""
    if key not in state:
        raise UserError(f"{path}: {key!r} is missing; give a checkpoint of the original code")
    if state[key].ndim != axes:
        raise UserError(f"{path}: {key!r} has shape {state[key].shape}; {axes} axes are needed")
    return state[key].shape


def _count(state: StateDict, pattern: str, *, first: int = 0) -> int:
    """Returns how many consecutive numbers, from `first`, make a key of the file when put into the pattern."""
    number = first
    while pattern.format(number) in state:
        number += 1
    return number - first


def _config(path: Path, schema: Callable[..., Config], **sizes: Any) -> Config:
    """Returns a config; its own errors get the file's name."""
    try:
        return schema(**sizes)
    except ValueError as error:
        raise UserError(f"{path}: {error}") from None


def _fit(
    path: Path, state: StateDict, weights: Iterable[names.Weight], constants: Mapping[str, tuple[int, ...]]
) -> dict[str, np.ndarray]:
    """Returns the weights in single precision, after checking every key of the file."""
    for key, shape in constants.items():
        if key not in state or state[key].shape != shape:
            problem = f"has shape {state[key].shape}; its config needs {shape}" if key in state else "is missing"
            raise UserError(f"{path}: {key!r} {problem}")
        # A GPT with learned positions has the same names and shapes, but would make nonsense with our table.
        if names.is_used(key) and not _is_table(state[key], names.constant(key, shape)):
            raise UserError(f"{path}: {key!r} is not the table that the original computes; only T2M-GPT can be read")
    found = {key: array for key, array in state.items() if key not in constants}
    return fit_arrays(path, found, {weight.key: (weight.shape, np.float32) for weight in weights})


def _is_table(found: np.ndarray, table: np.ndarray) -> bool:
    """Returns whether an array of numbers from -1 to 1 is a table, but for the rounding of its own precision."""
    rounding = float(jnp.finfo(found.dtype).eps) if jnp.issubdtype(found.dtype, jnp.floating) else 0.0
    return bool(np.allclose(found.astype(np.float64), table, rtol=0, atol=max(POSITION_TOLERANCE, rounding)))
