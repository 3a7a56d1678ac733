"""Speed of sampling: codes for random texts, until every motion has the same number of codes."""

import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.sharding import Mesh

from t2m_jax.bench.flops import count_flops
from t2m_jax.bench.probes import place
from t2m_jax.bench.record import Figure, Peaks, Row
from t2m_jax.bench.timing import compile_program, program_figures, share, time_calls
from t2m_jax.errors import UserError
from t2m_jax.models.system import GeneratorConfig, find_part, make_module
from t2m_jax.sampling.loop import CHUNK, Sampling
from t2m_jax.sampling.programs import generate_codes, sampling_variables
from t2m_jax.sampling.stopping import find_stop_rule
from t2m_jax.sampling.strategies import Temperature

NUM_CODES = 50
"""Most rows of a motion: the longest that T2M-GPT can sample."""
TOKENIZERS = {"gpt": "vqvae", "hifigpt": "rvqvae"}
"""The tokenizer that each generator was published with."""


def random_variables(config: GeneratorConfig) -> dict[str, Any]:
    """Returns a generator's variables before training."""
    module, example = make_module(config), find_part(config.kind).example(config)
    return jax.jit(module.init, static_argnames="train")(jax.random.key(0), *example, train=False)


class Subject(NamedTuple):
    """A generator whose sampling is measured."""

    name: str
    """What rows call it."""
    config: GeneratorConfig
    variables: dict[str, Any]
    downsample: int
    """Frames per row of codes."""
    guidance_scale: float | None = None
    """Strength of the guidance, None for none."""


def published_config(kind: str) -> Any:
    """Returns the config of a kind of generator in its published size, which is the default."""
    return find_part(kind, "generator").config()


def full_size_subjects(kinds: Sequence[str]) -> list[Subject]:
    """Returns generators of the published sizes with random weights: with guidance and without, if they have it."""
    subjects: list[Subject] = []
    for kind in kinds:
        config = published_config(kind)
        variables = random_variables(config)
        plain = Subject(f"{kind} full", config, variables, find_part(TOKENIZERS[kind], "tokenizer").config().downsample)
        subjects.append(plain)
        if config.guidance_scale is not None:
            name, scale = f"{plain.name}, guided", config.guidance_scale
            subjects.append(plain._replace(name=name, guidance_scale=scale))
    return subjects


def benchmark_sampling(
    subject: Subject, *, batch: int, num_codes: int | None = None, mesh: Mesh, peaks: Peaks, repeats: int = 3
) -> Row:
    """Returns how long it takes to sample a batch of motions of `num_codes` rows, none of which ends earlier.

    A step samples one row of codes for every motion, and has to read all weights at least once.

    Args:
        subject: The generator.
        batch: Motions that are sampled together.
        num_codes: Rows of each motion; by default the generator's most, up to `NUM_CODES`.
        mesh: The devices, among which the motions are divided.
        peaks: Of these devices.
        repeats: Calls that are timed.

    Raises:
        UserError: The devices do not divide the batch, or the generator has no motions of so many rows.
    """
    config, num_codes = subject.config, num_codes or min(NUM_CODES, subject.config.max_codes)
    check_sampling([config], batches=[batch], num_codes=num_codes, devices=[mesh.size])
    text = place(jax.random.normal(jax.random.key(1), (batch, config.text_dim)), mesh, by_rows=True)
    keys = place(jax.random.split(jax.random.key(2), batch), mesh, by_rows=True)
    # One more row than the maximum as minimum: rules that keep the last row would end one row before the minimum.
    sampling = Sampling(Temperature(), find_stop_rule(config), num_codes, min_codes=num_codes + 1)
    scale = None if subject.guidance_scale is None else jnp.float32(subject.guidance_scale)
    arguments = (place(sampling_variables(subject.variables, config), mesh), text, keys, scale)
    options: Any = {"generator": make_module(config), "sampling": sampling}
    program = compile_program(lambda: generate_codes.lower(*arguments, **options))
    timing = time_calls(lambda: program.compiled(*arguments), repeats=repeats)
    weights = sum(leaf.nbytes for leaf in jax.tree.leaves(arguments[0]))
    # The loop over chunks is counted once, whatever its length.
    flops = count_flops(lambda *given: generate_codes(*given, **options), *arguments) / CHUNK
    step = timing.median / num_codes
    figures = (
        Figure(name="per step", value=1e3 * step, unit="ms", better="less", spread=timing.spread),
        Figure(name="per row", value=1e3 * step / batch, unit="ms"),
        Figure(name="per frame", value=1e3 * step / (batch * subject.downsample), unit="ms"),
        Figure(name="codes", value=batch * config.num_quantizers / step, unit="1/s"),
        *program_figures(program),
        share("product", flops / step, peaks.float32),
        share("memory", mesh.size * weights / step, peaks.memory),
    )
    devices = f", {mesh.size} devices" if mesh.size > 1 else ""
    return Row(benchmark="sample", name=f"{subject.name}, {num_codes} rows, batch {batch}{devices}", figures=figures)


def check_sampling(
    configs: Sequence[GeneratorConfig], *, batches: Sequence[int], num_codes: int | None, devices: Sequence[int]
) -> None:
    """Raises `UserError` if a batch cannot be divided among the devices, or if motions cannot have so many rows."""
    longest = min(config.max_codes for config in configs)
    if num_codes is not None and num_codes > longest:
        raise UserError(f"bench: --codes {num_codes} is more than the model's {longest}")
    for batch, count in itertools.product(batches, devices):
        if batch % count:
            raise UserError(f"bench: --batch {batch} is not a multiple of the {count} devices; change one of them")
