"""Keys of random numbers that depend on the seed alone."""

from typing import Any

import jax
from jaxtyping import Array, Int, Key

from t2m_jax.errors import UserError

# JAX's types do not name its options.
_config: Any = jax.config


def new_key(seed: int | Int[Array, ""]) -> Key[Array, ""]:
    """Returns the key of a seed. Its numbers do not depend on settings of JAX.

    The generator is always Threefry, whatever `jax_default_prng_impl` says, and divides its numbers as
    `jax_threefry_partitionable` says, JAX's default, which this function turns on for the process.

    Raises:
        UserError: JAX computes with 64 bits, with which a seed gives other numbers, and models have 32; or the call is
            inside `jax.threefry_partitionable(False)`.
    """
    if _config.jax_enable_x64:
        raise UserError("jax_enable_x64: models compute with 32 bits; turn it off")
    if not _config.jax_threefry_partitionable:
        _config.update("jax_threefry_partitionable", True)
    if not _config.jax_threefry_partitionable:
        raise UserError("jax.threefry_partitionable(False): a seed would give another motion; leave it out")
    return jax.random.key(seed, impl="threefry2x32")
