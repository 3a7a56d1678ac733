"""Times and memory of compiled programs, and the operations of their matrix products and convolutions."""

import math
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import jax
import numpy as np

from t2m_jax.bench.record import Figure

REPEATS = 3
"""Least number of calls that are timed."""
MIN_SECONDS = 0.2
"""Calls are repeated for at least this time, because a few short calls say little."""


class Timing(NamedTuple):
    """Seconds of one call."""

    median: float
    fastest: float
    spread: float
    """Distance of the quartiles, relative to the median."""


class Program(NamedTuple):
    """A compiled program, with what it took to compile it and the memory that it needs."""

    compiled: jax.stages.Compiled
    figures: tuple[Figure, ...]


def compile_program(lower: Callable[[], jax.stages.Lowered]) -> Program:
    """Returns a program that is traced by `lower`, compiled; the time includes both."""
    start = time.perf_counter()
    compiled = lower().compile()
    figures = [Figure(name="compile", value=time.perf_counter() - start, unit="s", better="less")]
    memory = compiled.memory_analysis()
    if memory is not None:  # not every device knows it
        # Of arguments, results and intermediate values.
        total = memory.argument_size_in_bytes + memory.output_size_in_bytes + memory.temp_size_in_bytes
        size = total - memory.alias_size_in_bytes
        figures.append(Figure(name="memory per device", value=size / 1e9, unit="GB", better="less"))
    return Program(compiled, tuple(figures))


def time_calls(call: Callable[[], Any]) -> Timing:
    """Returns the time of a call until its results are ready, after one call that does not count."""
    jax.block_until_ready(call())
    seconds: list[float] = []
    while len(seconds) < REPEATS or sum(seconds) < MIN_SECONDS:
        start = time.perf_counter()
        jax.block_until_ready(call())
        seconds.append(time.perf_counter() - start)
    lower, median, upper = np.quantile(seconds, (0.25, 0.5, 0.75))
    return Timing(float(median), min(seconds), float((upper - lower) / median))


def speed(count: int, timing: Timing) -> Figure:
    """Returns how many things of a call are done in a second."""
    return Figure(name="speed", value=count / timing.median, unit="1/s", better="more", spread=timing.spread)


def share(name: str, rate: float, peak: float) -> Figure:
    """Returns a rate as a share of a measured peak."""
    return Figure(name=f"of {name} peak", value=100 * rate / peak, unit="%")


def peak_memory() -> float | None:
    """Returns the most bytes that the first device had in use, or on a CPU the largest resident size of the process.

    Windows does not tell the latter, so it is None there.
    """
    found = jax.devices()[0].memory_stats()
    if found is not None:
        return float(found["peak_bytes_in_use"])
    try:
        import resource
    except ImportError:  # Windows
        return None
    unit = 1 if sys.platform == "darwin" else 1024
    return float(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit)


def count_flops(function: Callable[..., Any], *arguments: Any) -> float:
    """Returns the floating-point operations of all products in a function; nothing is computed.

    XLA's own count (`cost_analysis`) differs between devices: it leaves out products that are calls of a library, and
    it counts the body of a loop once. Here a `lax.scan` counts for all of its steps. Only a `lax.while_loop` counts
    once, because nobody knows the number of its steps.

    Args:
        function: What to count.
        *arguments: Its arguments, or their shapes.
    """
    return _count(jax.make_jaxpr(function)(*arguments).jaxpr)


def _count(jaxpr: Any) -> float:
    total = 0.0
    for equation in jaxpr.eqns:
        name = equation.primitive.name
        inputs = [variable.aval for variable in equation.invars]
        if name == "dot_general":
            (contracted, _), _ = equation.params["dimension_numbers"]
            total += 2 * equation.outvars[0].aval.size * math.prod(inputs[0].shape[axis] for axis in contracted)
        elif name == "conv_general_dilated":
            # Each output is a product of the kernel without its axis of outputs.
            outputs = inputs[1].shape[equation.params["dimension_numbers"].rhs_spec[0]]
            total += 2 * equation.outvars[0].aval.size * inputs[1].size / outputs
        elif name == "cond":
            # Of a condition, one branch runs.
            total += max(map(_count, _inner(equation.params)))
        else:
            repeats = equation.params["length"] if name == "scan" else 1
            total += repeats * sum(map(_count, _inner(equation.params)))
    return total


def _inner(value: Any) -> Iterator[Any]:
    """Yields the programs among the parameters of an operation."""
    if isinstance(value, dict):
        value = tuple(value.values())
    if isinstance(value, tuple | list):
        for item in value:
            yield from _inner(item)
    elif hasattr(value, "eqns"):
        yield getattr(value, "jaxpr", value)
