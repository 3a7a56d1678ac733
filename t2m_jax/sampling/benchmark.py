"""How fast codes are made."""

import functools
import time
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Key

from t2m_jax.models.motion_gpt import MotionGpt, MotionGptConfig
from t2m_jax.sampling.decoding import decode_codes
from t2m_jax.sampling.strategies import Temperature


class Timing(NamedTuple):
    """Median over the repeats; the compiler's time is apart."""

    milliseconds_per_code: float
    """Wall time over all codes of the batch: what one more code costs."""
    milliseconds_per_step: float
    """Wall time over the steps: how long the batch waits for its next codes."""
    compile_seconds: float


def random_gpt_variables(config: MotionGptConfig) -> dict[str, Any]:
    """Returns a GPT's variables before training."""
    tokens, text = jnp.zeros((1, 1), jnp.int32), jnp.zeros((1, config.text_dim))
    return jax.jit(MotionGpt(config).init, static_argnames="train")(jax.random.key(0), tokens, text, train=False)


@functools.partial(jax.jit, static_argnames=("config", "num_codes"))
def _decode(
    variables: dict[str, Any],
    text: Float[Array, "B E"],
    keys: Key[Array, " B"],
    *,
    config: MotionGptConfig,
    num_codes: int,
) -> Int[Array, "B N"]:
    gpt = MotionGpt(config)
    return decode_codes(
        lambda text: gpt.apply(variables, text, method="prefill"),
        lambda tokens, caches, position: gpt.apply(variables, tokens, caches, position, method="decode_step"),
        text,
        keys,
        strategy=Temperature(),
        max_codes=num_codes,
        min_codes=num_codes,
    ).codes


def benchmark_decoding(
    config: MotionGptConfig, variables: dict[str, Any], *, batch: int, num_codes: int, repeats: int
) -> Timing:
    """Returns how long a batch of full-length motions takes to decode, End held back."""
    text = jax.random.normal(jax.random.key(1), (batch, config.text_dim))
    keys = jax.random.split(jax.random.key(2), batch)
    start = time.perf_counter()
    program = _decode.lower(variables, text, keys, config=config, num_codes=num_codes).compile()
    compile_seconds = time.perf_counter() - start
    jax.block_until_ready(program(variables, text, keys))
    seconds = []
    for _ in range(repeats):
        start = time.perf_counter()
        jax.block_until_ready(program(variables, text, keys))
        seconds.append(time.perf_counter() - start)
    median = float(np.median(seconds)) * 1000.0
    return Timing(median / (batch * num_codes), median / num_codes, compile_seconds)
