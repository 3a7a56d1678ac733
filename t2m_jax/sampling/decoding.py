"""The cached decoding loop: one jitted program from text embedding to codes, for any model given as two functions."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key

from t2m_jax.sampling.strategies import Strategy

CHUNK = 8
"""Steps between two looks at whether every sequence has ended."""

Prefill = Callable[[Float[Array, "B E"]], tuple[Float[Array, "B V"], Any]]
DecodeStep = Callable[[Int[Array, " B"], Any, Int[Array, ""]], tuple[Float[Array, "B V"], Any]]


class DecodedCodes(NamedTuple):
    """What the loop returns."""

    codes: Int[Array, "B N"]
    """0 past the end."""
    code_lengths: Int[Array, " B"]
    steps: Int[Array, ""]
    """Steps made, a multiple of `CHUNK` (or the maximum): what the batch cost."""


class DecodeState(NamedTuple):
    """What one step hands to the next."""

    logits: Float[Array, "B V"]
    caches: Any
    code_lengths: Int[Array, " B"]
    done: Bool[Array, " B"]
    step: Int[Array, ""]


def sample_tokens(
    strategy: Strategy, logits: Float[Array, "B V"], keys: Key[Array, " B"], step: Int[Array, ""]
) -> Int[Array, " B"]:
    """Returns one token a sequence, each from its own key folded with the step."""

    def sample(logits: Float[Array, " V"], key: Key[Array, ""]) -> Int[Array, ""]:
        return strategy(logits[None], jax.random.fold_in(key, step))[0]

    return jax.vmap(sample)(logits, keys)


def decode_codes(
    prefill: Prefill,
    decode_step: DecodeStep,
    text_embedding: Float[Array, "B E"],
    keys: Key[Array, " B"],
    *,
    strategy: Strategy,
    max_codes: int,
    min_codes: int = 0,
) -> DecodedCodes:
    """Returns codes until End (the last class of the logits) or until there are `max_codes`.

    A `lax.scan` over `CHUNK` steps inside a `lax.while_loop`, so that a batch stops soon after its longest motion. A
    sequence depends on its text and its key alone.

    Args:
        prefill: Text embedding to the first logits and the caches.
        decode_step: Tokens, caches and position to the next logits and caches.
        text_embedding: One text a sequence.
        keys: One key a sequence [B]; consumed.
        strategy: Chooses tokens.
        max_codes: Longest motion, in codes.
        min_codes: End is not allowed before this many codes.
    """
    logits, caches = prefill(text_embedding)
    batch, end_token = logits.shape[0], logits.shape[1] - 1
    num_chunks = -(-max_codes // CHUNK)
    codes = jnp.zeros((num_chunks, CHUNK, batch), jnp.int32)
    state = DecodeState(logits, caches, jnp.zeros(batch, jnp.int32), jnp.zeros(batch, bool), jnp.array(0))

    def one_step(state: DecodeState, _: None) -> tuple[DecodeState, Int[Array, " B"]]:
        too_early = (jnp.arange(end_token + 1) == end_token) & (state.step < min_codes)
        allowed = jnp.where(too_early[None], -jnp.inf, state.logits)
        tokens = sample_tokens(strategy, allowed, keys, state.step).astype(jnp.int32)
        done = state.done | (tokens == end_token) | (state.step >= max_codes)
        tokens = jnp.where(done, 0, tokens)
        # Past the maximum the position is clamped; nothing reads what is computed there.
        position = jnp.minimum(state.step + 1, max_codes)
        logits, caches = decode_step(tokens, state.caches, position)
        code_lengths = state.code_lengths + ~done
        return DecodeState(logits, caches, code_lengths, done, state.step + 1), tokens

    def go_on(carry: tuple[DecodeState, Int[Array, "M S B"]]) -> Bool[Array, ""]:
        state, _ = carry
        return (state.step < max_codes) & ~jnp.all(state.done)

    def one_chunk(carry: tuple[DecodeState, Int[Array, "M S B"]]) -> tuple[DecodeState, Int[Array, "M S B"]]:
        state, codes = carry
        chunk = state.step // CHUNK
        state, tokens = jax.lax.scan(one_step, state, None, length=CHUNK)
        return state, codes.at[chunk].set(tokens)

    state, codes = jax.lax.while_loop(go_on, one_chunk, (state, codes))
    codes = codes.reshape(-1, batch)[:max_codes].T
    return DecodedCodes(codes, state.code_lengths, jnp.minimum(state.step, max_codes))
