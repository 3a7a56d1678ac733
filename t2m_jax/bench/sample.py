"""Speed of a text-to-motion system: sampling codes for random texts, and encoding and decoding random motion."""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.sharding import Mesh
from jaxtyping import Array, Float

from t2m_jax.bench.probes import first_devices, on_devices, place
from t2m_jax.bench.record import BenchResult, Figure, Peaks
from t2m_jax.bench.timing import compile_program, count_flops, share, time_calls
from t2m_jax.keys import new_key
from t2m_jax.models.system import GeneratorConfig, PartConfig, TokenizerConfig, find_part, make_module
from t2m_jax.sampling.loop import CHUNK, Sampling
from t2m_jax.sampling.programs import generate_codes, sampling_variables
from t2m_jax.sampling.stopping import find_stop_rule
from t2m_jax.sampling.strategies import Temperature

NUM_CODES = 50
"""Most rows of a motion: the longest that T2M-GPT can sample."""
TOKENIZERS = {"gpt": "vqvae", "hifigpt": "rvqvae"}
"""The tokenizer that each generator was published with."""


def random_variables(config: PartConfig) -> dict[str, Any]:
    """Returns the variables of a generator or of a tokenizer before training."""
    example = find_part(config.kind).example(config)
    return jax.jit(make_module(config).init, static_argnames="train")(new_key(0), *example, train=False)


class MeasuredSystem(NamedTuple):
    """From a bundle, or from the published sizes, to its benchmark."""

    name: str
    """What tables call it."""
    generator: GeneratorConfig
    tokenizer: TokenizerConfig
    variables: dict[str, Any]
    """Those of `generator` and of `tokenizer`."""
    guidance_scale: float | None = None
    """Strength of the guidance, None for none."""


def published_config(kind: str) -> Any:
    """Returns the config of a kind of generator or tokenizer in its published size, which is the default."""
    return find_part(kind).config()


def full_size_systems() -> list[MeasuredSystem]:
    """Returns systems of the published sizes with random weights: with guidance and without, if they have it."""
    systems: list[MeasuredSystem] = []
    for kind, other in TOKENIZERS.items():
        generator = published_config(kind)
        tokenizer = published_config(other)
        variables = {"generator": random_variables(generator), "tokenizer": random_variables(tokenizer)}
        plain = MeasuredSystem(f"{kind} full", generator, tokenizer, variables)
        systems.append(plain)
        if generator.guidance_scale is not None:
            systems.append(plain._replace(name=f"{plain.name}, guided", guidance_scale=generator.guidance_scale))
    return systems


def benchmark_sampling(system: MeasuredSystem, *, batch: int, peaks: Peaks) -> BenchResult:
    """Returns how long it takes to sample a batch of motions of up to `NUM_CODES` rows, none of which ends earlier.

    A step samples one row of codes for every motion. It reads the weights of each product once for all motions, those
    of a residual tier again for each depth. Encoding and decoding as many frames as these rows stand for is timed
    separately.

    Args:
        system: Generator and tokenizer.
        batch: Motions that are sampled together.
        peaks: Of the devices, among which the motions are divided.

    Raises:
        UserError: The devices do not divide the batch.
    """
    config = system.generator
    num_codes = min(NUM_CODES, config.max_codes)
    mesh = first_devices(peaks.num_devices, batch=batch)
    text = place(jax.random.normal(new_key(1), (batch, config.text_dim)), mesh, by_rows=True)
    keys = place(jax.random.split(new_key(2), batch), mesh, by_rows=True)
    # One more row than the maximum as minimum: rules that keep the last row would end one row before the minimum.
    sampling = Sampling(Temperature(), find_stop_rule(config), num_codes, min_codes=num_codes + 1)
    scale = None if system.guidance_scale is None else jnp.float32(system.guidance_scale)
    arguments = (place(sampling_variables(system.variables["generator"], config), mesh), text, keys, scale)
    sample = functools.partial(generate_codes, generator=make_module(config), sampling=sampling)
    program = compile_program(lambda: generate_codes.lower(*arguments, **sample.keywords))
    timing = time_calls(lambda: program.compiled(*arguments))
    # The loop over chunks is counted once, whatever its length.
    flops = count_flops(sample, *arguments) / CHUNK
    sequences = batch * (1 if scale is None else 2)
    # With each weight of four bytes, a sequence is multiplied and added up once.
    weights = 4 * flops / (2 * sequences)
    step = timing.median / num_codes
    downsample = system.tokenizer.downsample
    figures = (
        Figure(name="per step", value=1e3 * step, unit="ms", better="less", spread=timing.spread),
        Figure(name="per row", value=1e3 * step / batch, unit="ms"),
        Figure(name="per frame", value=1e3 * step / (batch * downsample), unit="ms"),
        Figure(name="codes", value=batch * config.num_quantizers / step, unit="1/s"),
        encode_and_decode(system, (batch, num_codes * downsample), mesh=mesh),
        *program.figures,
        share("product", flops / step, peaks.float32),
        share("memory", mesh.size * weights / step, peaks.memory),
    )
    name = f"{system.name}, {num_codes} rows, batch {batch}{on_devices(mesh.size)}"
    return BenchResult(benchmark="sample", name=name, figures=figures)


def encode_and_decode(system: MeasuredSystem, size: tuple[int, int], *, mesh: Mesh) -> Figure:
    """Returns the time to encode and decode a frame (table 1 of T2M-HiFiGPT), in a batch of motions [B, T]."""
    tokenizer = make_module(system.tokenizer)

    @jax.jit
    def there_and_back(variables: Any, motion: Float[Array, "B T D"]) -> Float[Array, "B T D"]:
        codes = tokenizer.apply(variables, motion, method="encode")
        return tokenizer.apply(variables, codes, method="decode")

    motion = place(jax.random.normal(new_key(3), (*size, system.tokenizer.feature_dim)), mesh, by_rows=True)
    variables = place(system.variables["tokenizer"], mesh)
    # One program for both, as a tokenizer is used for reconstruction.
    timing = time_calls(lambda: there_and_back(variables, motion))
    per_frame = 1e3 * timing.median / (size[0] * size[1])
    return Figure(name="encode + decode", value=per_frame, unit="ms/frame", better="less", spread=timing.spread)
