"""Keys by purpose: a run has one seed, and every use of randomness its own named stream."""

import zlib

import jax
from jaxtyping import Array, Key


def stream_key(seed: int, name: str) -> Key[Array, ""]:
    """Returns the key of stream `name` of a run; fold the step in before use."""
    return jax.random.fold_in(jax.random.key(seed), zlib.crc32(name.encode()))
