"""Speed of an evaluation's networks: motions and captions that are embedded in a second."""

import functools
from typing import Any

import jax
import numpy as np

from t2m_jax.bench.probes import first_devices, on_devices, place
from t2m_jax.bench.record import BenchResult, Peaks
from t2m_jax.bench.timing import compile_program, count_flops, share, speed, time_calls
from t2m_jax.evaluation.embedding import BATCH
from t2m_jax.keys import new_key
from t2m_jax.models.evaluator import Evaluator, EvaluatorConfig, evaluator_shapes
from t2m_jax.models.rows import apply_compiled

FRAMES = 196
"""Frames of a motion: the longest of the protocols."""
WORDS = 22
"""Words of a caption: the longest of the protocols, with its two ends."""


def benchmark_embedding(config: EvaluatorConfig, *, peaks: Peaks) -> list[BenchResult]:
    """Returns how many motions and how many captions are embedded in a second, with random weights.

    Raises:
        UserError: The devices do not divide the batch.
    """
    mesh = first_devices(peaks.num_devices, batch=BATCH)
    generator = np.random.default_rng(0)
    motion = generator.standard_normal((BATCH, FRAMES, config.feature_dim), np.float32)
    words = generator.integers(0, config.num_words, (BATCH, WORDS), np.int32)
    parts = generator.integers(0, config.num_parts_of_speech, (BATCH, WORDS), np.int32)
    work = [
        (f"motions, {BATCH}x{FRAMES}", "embed_motion", (motion, np.full(BATCH, FRAMES, np.int32))),
        (f"captions, {BATCH}x{WORDS}", "embed_text", (words, parts, np.full(BATCH, WORDS, np.int32))),
    ]
    # The speed does not depend on the weights, so one key for all of them is enough.
    key = new_key(0)
    drawn = jax.tree.map(lambda leaf: 0.02 * jax.random.normal(key, leaf.shape, leaf.dtype), evaluator_shapes(config))
    variables = place(drawn, mesh)
    rows = []
    for name, method, inputs in work:
        arguments = (variables, *place(inputs, mesh, by_rows=True))
        options: Any = {"module": Evaluator(config), "method": method}
        program = compile_program(lambda: apply_compiled.lower(*arguments, **options))  # noqa: B023 - called at once
        timing = time_calls(lambda: program.compiled(*arguments))  # noqa: B023
        flops = count_flops(functools.partial(apply_compiled, **options), *arguments)
        figures = (speed(BATCH, timing), *program.figures, share("product", flops / timing.median, peaks.float32))
        rows.append(BenchResult(benchmark="evaluate", name=f"{name}{on_devices(mesh.size)}", figures=figures))
    return rows
