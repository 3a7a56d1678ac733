"""Speed of sampling: codes for random texts, until every motion has the same number of codes."""

import itertools
from collections.abc import Sequence
from typing import Any

import jax
from jax.sharding import Mesh

from t2m_jax.bench.flops import count_flops
from t2m_jax.bench.probes import place
from t2m_jax.bench.record import Figure, Peaks, Row
from t2m_jax.bench.timing import compile_program, program_figures, share, time_calls
from t2m_jax.errors import UserError
from t2m_jax.models.system import GeneratorConfig, find_part, make_module
from t2m_jax.sampling.codec import generate_codes, sampling_variables
from t2m_jax.sampling.decoding import CHUNK, Sampling
from t2m_jax.sampling.stopping import make_stop_rule
from t2m_jax.sampling.strategies import Temperature


def random_variables(config: GeneratorConfig) -> dict[str, Any]:
    """Returns a generator's variables before training."""
    module, example = make_module(config), find_part(config.kind).example(config)
    return jax.jit(module.init, static_argnames="train")(jax.random.key(0), *example, train=False)


def benchmark_sampling(
    config: GeneratorConfig,
    variables: dict[str, Any],
    *,
    name: str,
    batch: int,
    num_codes: int,
    mesh: Mesh,
    peaks: Peaks,
    repeats: int = 3,
) -> Row:
    """Returns how long it takes to sample a batch of motions of `num_codes` rows, none of which ends earlier.

    A step samples one row of codes for every motion, and has to read all weights once.

    Args:
        config: Sizes of the generator.
        variables: Its weights.
        name: What the row calls the generator.
        batch: Motions that are sampled together.
        num_codes: Rows of each motion.
        mesh: The devices, among which the motions are divided.
        peaks: Of these devices.
        repeats: Calls that are timed.

    Raises:
        UserError: The devices do not divide the batch, or the generator has no motions of so many rows.
    """
    check_sampling(config, batches=[batch], num_codes=num_codes, devices=[mesh.size])
    text = place(jax.random.normal(jax.random.key(1), (batch, config.text_dim)), mesh, by_rows=True)
    keys = place(jax.random.split(jax.random.key(2), batch), mesh, by_rows=True)
    # One more row than the maximum as minimum: rules that keep the last row would end one row before the minimum.
    sampling = Sampling(Temperature(), make_stop_rule(config.stop_rule), num_codes, min_codes=num_codes + 1)
    arguments = (place(sampling_variables(variables, config), mesh), text, keys)
    options: Any = {"generator": make_module(config), "sampling": sampling}
    program = compile_program(lambda: generate_codes.lower(*arguments, **options))
    timing = time_calls(lambda: program.compiled(*arguments), repeats=repeats)
    weights = sum(leaf.nbytes for leaf in jax.tree.leaves(arguments[0]))
    # The loop over chunks is counted once, whatever its length.
    flops = count_flops(lambda *given: generate_codes(*given, **options), *arguments) / CHUNK
    step = timing.median / num_codes
    figures = (
        Figure(name="per code", value=1e3 * timing.median / (batch * num_codes), unit="ms"),
        Figure(name="per step", value=1e3 * step, unit="ms", better="less", spread=timing.spread),
        Figure(name="codes", value=batch * num_codes / timing.median, unit="1/s"),
        *program_figures(program),
        share("product", flops / step, peaks.float32),
        share("memory", mesh.size * weights / step, peaks.memory),
    )
    devices = f", {mesh.size} devices" if mesh.size > 1 else ""
    return Row(benchmark="sample", name=f"{name}, {num_codes} codes, batch {batch}{devices}", figures=figures)


def check_sampling(config: GeneratorConfig, *, batches: Sequence[int], num_codes: int, devices: Sequence[int]) -> None:
    """Raises `UserError` if a batch cannot be divided among the devices, or if motions cannot have so many rows."""
    if num_codes > config.max_codes:
        raise UserError(f"bench: --codes {num_codes} is more than the model's {config.max_codes}")
    for batch, count in itertools.product(batches, devices):
        if batch % count:
            raise UserError(f"bench: --batch {batch} is not a multiple of the {count} devices; change one of them")
