"""The arithmetic of a function: operations of its matrix products and convolutions."""

import math
from collections.abc import Callable, Iterator
from typing import Any

import jax


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
