"""Random keys by purpose. A run has one seed, and every use of randomness has its own named stream."""

import zlib

import jax
from jaxtyping import Array, Key


def stream_key(seed: int, name: str) -> Key[Array, ""]:
    """Returns the key of stream `name` of a run. Fold the step into it before use."""
    # The checksum is the same on every platform and in every process, unlike `hash`.
    return jax.random.fold_in(jax.random.key(seed), zlib.crc32(name.encode()))
