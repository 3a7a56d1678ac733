"""The jitted programs of a system: motion to codes, codes to motion, and text to codes."""

import functools
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key
from tqdm import tqdm

from t2m_jax.checkpoints.tokenizer import TrainedTokenizer
from t2m_jax.devices import put_everywhere, put_rows
from t2m_jax.errors import UserError
from t2m_jax.masks import mask_from_lengths
from t2m_jax.models.projection import transpose_kernels
from t2m_jax.models.rows import apply_compiled
from t2m_jax.models.system import GeneratorConfig
from t2m_jax.motion.features import features_from_positions, positions_from_features
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.normalizer import Normalizer
from t2m_jax.motion.skeleton import Skeleton
from t2m_jax.sampling.batches import pad_motions, round_up
from t2m_jax.sampling.loop import (
    GeneratorFunctions,
    Given,
    LoopState,
    SampledCodes,
    Sampling,
    first_state,
    sample_codes,
    sample_row,
)

BATCH = 64
"""Motions that are encoded together."""
FRAME_BUCKET = 64
"""Batches of motion are padded to a multiple of this many frames."""
SLOT_ROWS = 4
"""Rows that are sampled in slots before others can begin, which costs the time of about half a row."""


@functools.partial(jax.jit, static_argnames="tokenizer")
def decode_batch(
    variables: Any,
    normalizer: Normalizer,
    codes: Int[Array, "B N R"],
    code_lengths: Int[Array, " B"],
    *,
    tokenizer: Any,
) -> Float[Array, "B T D"]:
    """Returns the raw features of codes; frames after the end of a motion have no meaning."""
    mask = mask_from_lengths(code_lengths, codes.shape[1])
    return normalizer.denormalize(tokenizer.apply(variables, codes, mask, method="decode"))


@functools.partial(jax.jit, static_argnames=("tokenizer", "skeleton"))
def decode_positions(
    variables: Any,
    normalizer: Normalizer,
    codes: Int[Array, "B N R"],
    code_lengths: Int[Array, " B"],
    *,
    tokenizer: Any,
    skeleton: Skeleton,
) -> tuple[Float[Array, "B T D"], Float[Array, "B T J 3"]]:
    """Returns the raw features of codes and the joint positions in the skeleton's unit."""
    features = decode_batch(variables, normalizer, codes, code_lengths, tokenizer=tokenizer)
    return features, positions_from_features(features, skeleton)


@functools.partial(jax.jit, static_argnames=("generator", "sampling"))
def generate_codes(
    variables: Any,
    text_embedding: Float[Array, "B E"],
    keys: Key[Array, " B"],
    guidance_scale: Float[Array, ""] | None = None,
    given: Given | None = None,
    *,
    generator: Any,
    sampling: Sampling,
) -> SampledCodes:
    """Returns codes for text embeddings; `generator` is the module.

    The variables may be those that training made, or `sampling_variables` of them, with which it is faster.
    """
    functions = _functions(generator, variables)
    return sample_codes(functions, text_embedding, keys, sampling=sampling, guidance_scale=guidance_scale, given=given)


def _functions(generator: Any, variables: Any) -> GeneratorFunctions:
    """Returns the methods of a generator with its weights."""
    names = ("begin", "draw", "step")
    return GeneratorFunctions(*[functools.partial(generator.apply, variables, method=name) for name in names])


@functools.partial(jax.jit, static_argnames="generator")
def begin_motions(
    variables: Any, text_embedding: Float[Array, "B E"], guidance_scale: Float[Array, ""] | None, *, generator: Any
) -> LoopState:
    """Returns the state before the first row, to generate row by row; `generator` is the module."""
    return first_state(_functions(generator, variables), text_embedding, guidance_scale)


@functools.partial(jax.jit, static_argnames=("generator", "sampling"))
def generate_row(
    variables: Any, state: LoopState, keys: Key[Array, " B"], *, generator: Any, sampling: Sampling
) -> tuple[LoopState, Int[Array, "B R"]]:
    """Returns the state after one more row, and the row; `generator` is the module."""
    # Without the scores: `state.done` says what a rule that ends early makes of them.
    state, (rows, _) = sample_row(_functions(generator, variables), state, keys, sampling=sampling)
    return state, rows


@functools.partial(jax.jit, static_argnames="generator")
def begin_slots(
    variables: Any,
    state: LoopState | None,
    text_embedding: Float[Array, "B E"],
    guidance_scale: Float[Array, ""] | None,
    is_new: Bool[Array, " B"],
    *,
    generator: Any,
) -> LoopState:
    """Returns the state of slots in which new motions begin and others continue; `generator` is the module.

    It is the state of a batch of one, with an axis for the slots: each slot has its own step. None means no state.
    """
    functions = _functions(generator, variables)
    # For all slots, also for those that continue: a program for each number of new motions would be compiled.
    fresh = jax.vmap(lambda text: first_state(functions, text[None], guidance_scale))(text_embedding)
    if state is None:
        return fresh
    return jax.tree.map(lambda new, old: jax.vmap(jnp.where)(is_new, new, old), fresh, state)


@functools.partial(jax.jit, static_argnames=("generator", "sampling"))
def generate_in_slots(
    variables: Any, state: LoopState, keys: Key[Array, " B"], *, generator: Any, sampling: Sampling
) -> tuple[LoopState, tuple[Int[Array, "_ B R"], Float[Array, "_ B"]]]:
    """Returns the state of slots after `SLOT_ROWS` more rows, the rows, and their scores; `generator` is the module."""
    functions = _functions(generator, variables)

    # A slot is a batch of one, because its step, unlike that of a batch, is its own.
    def one_slot(state: LoopState, key: Key[Array, ""]) -> tuple[LoopState, tuple[Int[Array, " R"], Float[Array, ""]]]:
        state, (rows, scores) = sample_row(functions, state, key[None], sampling=sampling)
        return state, (rows[0], scores[0])

    return jax.lax.scan(lambda state, _: jax.vmap(one_slot)(state, keys), state, None, length=SLOT_ROWS)


def sampling_variables(variables: dict[str, Any], config: GeneratorConfig) -> dict[str, Any]:
    """Returns a generator's variables in the layout with which `generate_codes` is fastest on the default device."""
    # On a CPU, products with few rows are faster with transposed kernels (see `Projection`).
    return transpose_kernels(variables, config) if jax.default_backend() == "cpu" else variables


def encode_motions(
    tokenizer: TrainedTokenizer, motions: Sequence[Float[np.ndarray, "_ D"]], *, progress: bool = True
) -> list[Int[np.ndarray, "_ R"]]:
    """Returns the codes of each motion (raw features); `progress` shows a bar on a terminal."""
    codes: list[Int[np.ndarray, "_ R"]] = [np.zeros((0, tokenizer.config.num_quantizers), np.int32)] * len(motions)
    # Motions of similar lengths together need little padding.
    order = sorted(range(len(motions)), key=lambda index: len(motions[index]))
    variables = put_everywhere(tokenizer.variables)
    downsample = tokenizer.config.downsample
    # On the host, because each motion has another length, and on devices every length would be a program.
    normalize = jax.tree.map(np.asarray, tokenizer.normalizer).normalize
    for first in tqdm(range(0, len(order), BATCH), desc="encoding", unit="batch", disable=None if progress else True):
        chosen = order[first : first + BATCH]
        size = round_up(len(motions[chosen[-1]]), FRAME_BUCKET)
        normalized = [normalize(motions[index]) for index in chosen]
        batch = pad_motions(normalized, batch=BATCH, size=size)
        mask = mask_from_lengths(jnp.asarray(batch.lengths), size)
        inputs = put_rows((batch.motion, mask))
        found = np.asarray(apply_compiled(variables, *inputs, module=tokenizer.module, method="encode"))
        for row, index in enumerate(chosen):
            codes[index] = found[row, : batch.lengths[row] // downsample]
    return codes


def encode_motion(tokenizer: TrainedTokenizer, motion: Motion, skeleton: Skeleton) -> Int[np.ndarray, "N R"]:
    """Returns the codes of a motion: of its features, or of those that follow from its positions.

    Raises:
        UserError: The motion has another skeleton than the tokenizer's, or is too short for a code.
    """
    if motion.skeleton != skeleton:
        raise UserError(f"motion: has skeleton {motion.skeleton.name}; the model reads {skeleton.name}")
    features = motion.features
    if features is None:
        # Only motion as decoded or of a data set has features. They are lost with a change, such as of the rate.
        positions = motion.resampled(skeleton.fps).positions / skeleton.metres_per_unit
        features = features_from_positions(positions, skeleton)
    size = tokenizer.config.downsample
    if len(features) < size:
        raise UserError(f"motion: {len(features)} frames at {skeleton.fps:g} a second; a code needs {size}")
    missing = -len(features) % size
    if motion.features is None and missing <= size // 2:
        # Positions give one row of features less than frames, so a file of whole codes would lose its last one.
        features = np.pad(features, ((0, missing), (0, 0)), mode="edge")
    return encode_motions(tokenizer, [features], progress=False)[0]
