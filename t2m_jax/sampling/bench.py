"""How fast codes are sampled."""

import time
from typing import Any, NamedTuple

import jax
import numpy as np

from t2m_jax.models.system import GeneratorConfig, find_part, make_module
from t2m_jax.sampling.codec import generate_codes
from t2m_jax.sampling.decoding import Sampling
from t2m_jax.sampling.stopping import make_stop_rule
from t2m_jax.sampling.strategies import Temperature


class Timing(NamedTuple):
    """Median over the repeats. The compile time is separate."""

    milliseconds_per_code: float
    """Wall time divided by the rows of all motions of the batch."""
    milliseconds_per_step: float
    """Wall time divided by the steps, each of which samples one row for every motion."""
    compile_seconds: float


def random_variables(config: GeneratorConfig) -> dict[str, Any]:
    """Returns a generator's variables before training."""
    module, example = make_module(config), find_part(config.kind).example(config)
    return jax.jit(module.init, static_argnames="train")(jax.random.key(0), *example, train=False)


def benchmark_sampling(
    config: GeneratorConfig, variables: dict[str, Any], *, batch: int, num_codes: int, repeats: int
) -> Timing:
    """Returns how long it takes to sample a batch of motions of `num_codes` rows, none of which ends earlier."""
    text = jax.random.normal(jax.random.key(1), (batch, config.text_dim))
    keys = jax.random.split(jax.random.key(2), batch)
    # One more row than the maximum as minimum: rules that keep the last row would end one row before the minimum.
    sampling = Sampling(Temperature(), make_stop_rule(config.stop_rule), num_codes, min_codes=num_codes + 1)
    start = time.perf_counter()
    lowered = generate_codes.lower(variables, text, keys, generator=make_module(config), sampling=sampling)
    program = lowered.compile()
    compile_seconds = time.perf_counter() - start
    jax.block_until_ready(program(variables, text, keys))
    seconds = []
    for _ in range(repeats):
        start = time.perf_counter()
        jax.block_until_ready(program(variables, text, keys))
        seconds.append(time.perf_counter() - start)
    median = float(np.median(seconds)) * 1000.0
    return Timing(median / (batch * num_codes), median / num_codes, compile_seconds)
