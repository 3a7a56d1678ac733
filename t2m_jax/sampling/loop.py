"""The sampling loop: one jitted program from text embeddings to codes, for any generator given as three functions."""

from collections.abc import Callable
from typing import Any, NamedTuple

import chex
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key

from t2m_jax.sampling.stopping import StopRule
from t2m_jax.sampling.strategies import Strategy

CHUNK = 8
"""Rows that are sampled before the loop checks whether every motion has ended."""
STOP_STREAM = 2**31
"""In place of a step's number, in keys for the stop rule."""


class GeneratorFunctions(NamedTuple):
    """The methods of a `t2m_jax.models.system.Generator` with its weights."""

    begin: Callable[[Float[Array, "B E"], Any], tuple[Any, Any]]
    draw: Callable[..., Int[Array, "B R"]]
    step: Callable[[Any, Int[Array, "B R"]], tuple[Any, Float[Array, " B"], Any]]


class Sampling(NamedTuple):
    """How codes are sampled; hashable."""

    strategy: Strategy
    stop_rule: StopRule
    max_codes: int
    """Rows of the longest motion."""
    min_codes: int = 0
    """Rows of the shortest motion, without those that are given."""


class Given(NamedTuple):
    """What is fixed before sampling, for each motion."""

    codes: Int[Array, "B N R"]
    """Rows of each motion; N is the longest length."""
    known: Bool[Array, "B N"]
    """Which of them are known. The others are sampled, at least one after the last known row if `num_rows` is 0."""
    num_rows: Int[Array, " B"]
    """Rows of each motion with the known ones; 0 leaves the end to the stop rule, after known rows at the beginning."""


class SampledCodes(NamedTuple):
    """Codes of a batch of motions."""

    codes: Int[Array, "B N R"]
    """0 after the end of a motion."""
    code_lengths: Int[Array, " B"]
    """Rows of each motion."""
    steps: Int[Array, ""]
    """Rows that were sampled for the batch: a multiple of `CHUNK`, or the maximum."""


class LoopState(NamedTuple):
    """What one step of the loop gives to the next."""

    context: Any
    cache: Any
    done: Bool[Array, " B"]
    step: Int[Array, ""]


def first_state(
    generator: GeneratorFunctions, text_embedding: Float[Array, "B E"], guidance_scale: Float[Array, ""] | None
) -> LoopState:
    """Returns the state before the first row."""
    context, cache = generator.begin(text_embedding, guidance_scale)
    return LoopState(context, cache, jnp.zeros(text_embedding.shape[0], bool), jnp.array(0, jnp.int32))


def sample_row(
    generator: GeneratorFunctions,
    state: LoopState,
    keys: Key[Array, " B"],
    *,
    sampling: Sampling,
    given: Given | None = None,
) -> tuple[LoopState, tuple[Int[Array, "B R"], Float[Array, " B"]]]:
    """Returns the state after one more row, the row, and its stop score: -inf if a motion may not end there."""
    rule = sampling.stop_rule
    done = state.done
    # A row that ends a motion but is not kept may come one step later than one that is kept.
    step = state.step + rule.keeps_last
    if given is None:
        may_stop = step >= sampling.min_codes
    else:
        # As data, so that motions with and without known rows have one program.
        may_stop = (step >= given.known.sum(axis=1) + max(1, sampling.min_codes)) & (given.num_rows == 0)
        done |= (given.num_rows > 0) & (state.step + 1 >= given.num_rows)
    # A key per motion and step, so that a motion does not depend on the batch or on where the loop began.
    step_keys = jax.vmap(jax.random.fold_in, (0, None))(keys, state.step)
    rows = generator.draw(state.context, step_keys, sampling.strategy, may_stop=may_stop)
    if given is not None:
        # Known rows replace drawn ones, which are still drawn: all motions of a batch take the same steps.
        rows = jnp.where(given.known[:, state.step, None], given.codes[:, state.step], rows)
    # The cache has the keys and values of all rows before (KV cache), so a step reads one row.
    context, scores, cache = generator.step(state.cache, rows)
    scores = jnp.where(may_stop, rule.draw(scores, _stop_keys(keys, state.step)), -jnp.inf)
    # `done` only ends the loop. How many rows a motion keeps is counted from all scores afterwards.
    return LoopState(context, cache, done | rule.ends(scores), state.step + 1), (rows, scores)


def _stop_keys(keys: Key[Array, " B"], step: Int[Array, ""]) -> Key[Array, " B"]:
    """Returns keys for the stop rule at a step; no row is drawn with them."""
    return jax.vmap(lambda key: jax.random.fold_in(jax.random.fold_in(key, STOP_STREAM), step))(keys)


def sample_codes(
    generator: GeneratorFunctions,
    text_embedding: Float[Array, "B E"],
    keys: Key[Array, " B"],
    *,
    sampling: Sampling,
    guidance_scale: Float[Array, ""] | None = None,
    given: Given | None = None,
) -> SampledCodes:
    """Returns codes until the stop rule ends each motion, or until there are `sampling.max_codes` rows.

    The loop is a `lax.scan` over `CHUNK` rows inside a `lax.while_loop`, so a batch ends soon after its longest motion.
    A motion depends on its text and its key only, not on the batch.

    Args:
        generator: The model.
        text_embedding: One text per motion.
        keys: One key per motion [B]; consumed.
        sampling: How to choose codes, and when to stop.
        guidance_scale: Strength of the guidance, None for none.
        given: Rows that motions begin with, and their lengths; None for neither.
    """
    chex.assert_rank([text_embedding, keys], [2, 1])
    chex.assert_equal_shape_prefix([text_embedding, keys], 1)
    max_codes = sampling.max_codes

    @jax.jit
    def one_row(state: LoopState, _: None) -> tuple[LoopState, tuple[Int[Array, "B R"], Float[Array, " B"]]]:
        return sample_row(generator, state, keys, sampling=sampling, given=given)

    def go_on(carry: tuple[LoopState, Any]) -> Bool[Array, ""]:
        return (carry[0].step < max_codes) & ~jnp.all(carry[0].done)

    def one_chunk(carry: tuple[LoopState, Any]) -> tuple[LoopState, Any]:
        state, buffers = carry
        chunk = state.step // CHUNK
        state, sampled = jax.lax.scan(one_row, state, None, length=CHUNK)
        return state, jax.tree.map(lambda buffer, values: buffer.at[chunk].set(values), buffers, sampled)

    state = first_state(generator, text_embedding, guidance_scale)
    # Only the shape is needed, and nothing is computed. Under jit, a row is traced once, for this and for the loop.
    _, (row, _) = jax.eval_shape(one_row, state, None)
    # Whole chunks, so that each is written at once; what is beyond `max_codes` is cut. At -inf, no rule ends a motion.
    chunks = (-(-max_codes // CHUNK), CHUNK)
    buffers = (jnp.zeros((*chunks, *row.shape), jnp.int32), jnp.full((*chunks, len(keys)), -jnp.inf))
    state, (codes, scores) = jax.lax.while_loop(go_on, one_chunk, (state, buffers))
    codes = jnp.swapaxes(codes.reshape(-1, *row.shape)[:max_codes], 0, 1)
    code_lengths = sampling.stop_rule.count(scores.reshape(-1, len(keys))[:max_codes].T)
    if given is not None:
        code_lengths = jnp.where(given.num_rows > 0, jnp.minimum(given.num_rows, max_codes), code_lengths)
    # What was sampled after the end of a motion, because others went on, is not part of it.
    kept = jnp.arange(max_codes)[None] < code_lengths[:, None]
    return SampledCodes(jnp.where(kept[:, :, None], codes, 0), code_lengths, jnp.minimum(state.step, max_codes))
