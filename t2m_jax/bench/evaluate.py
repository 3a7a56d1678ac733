"""Speed of an evaluation's networks: motions and captions that are embedded in a second."""

from typing import Any

import jax
import numpy as np
from jax.sharding import Mesh

from t2m_jax.bench.flops import count_flops
from t2m_jax.bench.probes import place
from t2m_jax.bench.record import BenchResult, Figure, Peaks
from t2m_jax.bench.timing import compile_program, program_figures, share, time_calls
from t2m_jax.errors import UserError
from t2m_jax.evaluation.embedding import BATCH, embed_motion, embed_text
from t2m_jax.models.evaluator import EvaluatorConfig, evaluator_shapes

FRAMES = 196
"""Frames of a motion: the longest of the protocols."""
WORDS = 22
"""Words of a caption: the longest of the protocols, with its two ends."""
DEMO_SIZES = EvaluatorConfig(
    movement_hidden=256, movement_dim=256, motion_hidden=384, text_hidden=256, embedding_dim=256, word_dim=128
)
"""Sizes of `configs/evaluator/bandai-namco.yaml`."""


def benchmark_embedding(
    config: EvaluatorConfig,
    *,
    size: str,
    mesh: Mesh,
    peaks: Peaks,
    batch: int = BATCH,
    frames: int = FRAMES,
    repeats: int = 3,
) -> list[BenchResult]:
    """Returns how many motions and how many captions are embedded in a second, with random weights.

    Args:
        config: Sizes of the evaluator.
        size: Name of these sizes, for the rows.
        mesh: The devices, among which the batch is divided.
        peaks: Of these devices.
        batch: Motions or captions that are embedded together.
        frames: Frames of a motion.
        repeats: Calls that are timed.

    Raises:
        UserError: The devices do not divide the batch.
    """
    if batch % mesh.size:
        raise UserError(f"bench: --batch {batch} is not a multiple of the {mesh.size} devices; change one of them")
    generator = np.random.default_rng(0)
    motion = generator.standard_normal((batch, frames, config.feature_dim), np.float32)
    words = generator.integers(0, config.num_words, (batch, WORDS), np.int32)
    parts = generator.integers(0, config.num_parts_of_speech, (batch, WORDS), np.int32)
    work: list[tuple[str, Any, tuple[Any, ...]]] = [
        ("motions", embed_motion, (motion, np.full(batch, frames, np.int32))),
        ("captions", embed_text, (words, parts, np.full(batch, WORDS, np.int32))),
    ]
    # The speed does not depend on the weights, so one key for all of them is enough.
    key = jax.random.key(0)
    drawn = jax.tree.map(lambda leaf: 0.02 * jax.random.normal(key, leaf.shape, leaf.dtype), evaluator_shapes(config))
    variables = place(drawn, mesh)
    rows = []
    for name, function, inputs in work:
        arguments = (variables, *place(inputs, mesh, by_rows=True))
        program = compile_program(lambda: function.lower(*arguments, config=config))  # noqa: B023 - called at once
        timing = time_calls(lambda: program.compiled(*arguments), repeats=repeats)  # noqa: B023
        flops = count_flops(lambda *given: function(*given, config=config), *arguments)  # noqa: B023
        figures = (
            Figure(name="speed", value=batch / timing.median, unit="1/s", better="more", spread=timing.spread),
            *program_figures(program),
            share("product", flops / timing.median, peaks.float32),
        )
        devices = f", {mesh.size} devices" if mesh.size > 1 else ""
        shape = f"{batch}x{frames if name == 'motions' else WORDS}"
        rows.append(BenchResult(benchmark="evaluate", name=f"{name}, {size} {shape}{devices}", figures=figures))
    return rows
