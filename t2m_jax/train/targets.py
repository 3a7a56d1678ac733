"""The inputs and targets of the GPT, made from codes (T2M-GPT, section 3.2, and its code)."""

from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key


class Targets(NamedTuple):
    """What the GPT predicts: the codes of each motion, then End, then Pad."""

    tokens: Int[Array, "B L"]
    code_lengths: Int[Array, " B"]


def make_targets(
    codes: Int[Array, "B N"], code_lengths: Int[Array, " B"], *, num_codes: int, block_size: int
) -> Targets:
    """Returns `block_size` targets per motion: its codes, End (= num_codes), then Pad (= num_codes + 1).

    Motions are cut after `block_size - 1` codes.
    """
    code_lengths = jnp.minimum(code_lengths, block_size - 1)
    room = block_size - codes.shape[1]
    padded = jnp.pad(codes, ((0, 0), (0, max(room, 0))))[:, :block_size]
    # Every motion gets an End, also one that was cut.
    position = jnp.arange(block_size)[None]
    tokens = jnp.where(position < code_lengths[:, None], padded, num_codes + 1)
    return Targets(jnp.where(position == code_lengths[:, None], num_codes, tokens), code_lengths)


def drop_one_code(
    codes: Int[Array, "B N"], code_lengths: Int[Array, " B"], drop: Bool[Array, " B"], *, at_head: Bool[Array, " B"]
) -> tuple[Int[Array, "B N"], Int[Array, " B"]]:
    """Returns codes and lengths. Where `drop` is True, the first or the last code is removed.

    As in the original, a motion of one code then has none, so that its only target is End.
    """
    # Without its last code a motion is only shorter; without its first, all codes move to the left.
    shifted = jnp.where((drop & at_head)[:, None], jnp.roll(codes, -1, axis=1), codes)
    return shifted, code_lengths - drop


class Corruption(NamedTuple):
    """Inputs that are replaced in training, and their replacements."""

    keep: Bool[Array, "B L"]
    replacements: Int[Array, "B L"]

    def apply(self, tokens: Int[Array, "B L"]) -> Int[Array, "B L"]:
        """Returns the tokens, replaced where `keep` is False."""
        return jnp.where(self.keep, tokens, self.replacements)


def draw_corruption(
    tokens: Int[Array, "B L"],
    keys: Key[Array, " B"],
    *,
    tau: float | Float[Array, ""] | Literal["per_motion"],
    num_codes: int,
    past_end: bool,
) -> Corruption:
    """Returns a corruption that replaces each token, with probability `tau`, by a code from a uniform distribution.

    Args:
        tokens: Codes, End (= `num_codes`) and Pad.
        keys: One per motion; consumed.
        tau: The probability. `per_motion` draws one from 0 to 1 for each motion.
        num_codes: Number of codes to draw from. The right code may be drawn, too.
        past_end: Whether End and Pad may be replaced, as in the original code.
    """

    def draw(key: Key[Array, ""]) -> tuple[Bool[Array, " L"], Int[Array, " L"]]:
        share_key, replace_key, code_key = jax.random.split(key, 3)
        share = jax.random.uniform(share_key) if isinstance(tau, str) else tau
        # The inputs alone are replaced. Targets stay what they are, so that the model learns to recover from errors.
        keep = ~(jax.random.uniform(replace_key, tokens.shape[1:]) < share)
        return keep, jax.random.randint(code_key, tokens.shape[1:], 0, num_codes)

    keep, replacements = jax.vmap(draw)(keys)
    return Corruption(keep if past_end else keep | (tokens >= num_codes), replacements)
