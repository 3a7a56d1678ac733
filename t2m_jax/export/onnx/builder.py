"""From the program of a JAX function to nodes of ONNX.

A function that is traced by JAX is a list of equations, each with one primitive. `operators` says which nodes of ONNX
do the same as a primitive. What depends on no input, such as transposed weights, is computed at once. The package
`jax2onnx` does this for all of JAX, but needs older versions of packages, and not all of its rules fit ours.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import numpy as np
from jax.extend.core import Literal

from t2m_jax.errors import UserError

OPSET = 17
"""Version of ONNX's operators. Newer ones are not needed, and not all engines know them."""

Value = str | np.ndarray
"""The name of an array that is computed when the graph runs, or an array that is known."""
Rule = Callable[["GraphBuilder", Any, list[Value]], list[Value]]
"""From a builder, an equation and its inputs to its outputs."""


class GraphBuilder:
    """The nodes and constants of a graph while it is made."""

    def __init__(self, rules: Mapping[str, Rule]):
        """Begins without nodes; `rules` are by the names of primitives."""
        self.rules = rules
        self.nodes: list[Any] = []
        self.constants: dict[str, np.ndarray] = {}
        self._names: dict[tuple[Any, ...], str] = {}

    def name(self, value: Value) -> str:
        """Returns the name of a value; a known array becomes a constant, once for equal ones."""
        if isinstance(value, str):
            return value
        array = np.ascontiguousarray(value).reshape(value.shape)  # a scalar would get an axis
        key = (array.dtype.str, array.shape, array.tobytes())
        if key not in self._names:
            self._names[key] = f"constant_{len(self._names)}"
            self.constants[self._names[key]] = array
        return self._names[key]

    def node(self, operator: str, *inputs: Value | Sequence[int], output: str | None = None, **attributes: Any) -> str:
        """Adds a node and returns the name of its output; whole numbers as input are shapes or axes."""
        from onnx import helper

        names = [self.name(value if isinstance(value, Value) else np.array(value, np.int64)) for value in inputs]
        output = output or f"{operator.lower()}_{len(self.nodes)}"
        self.nodes.append(helper.make_node(operator, names, [output], **attributes))
        return output

    def add(self, function: Callable[..., Any], inputs: Mapping[str, jax.ShapeDtypeStruct]) -> list[Value]:
        """Adds a function of named arrays and returns its outputs.

        Raises:
            UserError: It has a primitive that no rule knows.
        """
        return self.run(jax.make_jaxpr(function)(*inputs.values()), list(inputs))

    def run(self, traced: Any, inputs: Sequence[Value]) -> list[Value]:
        """Adds a traced function."""
        # In newer versions of JAX, a traced function has its constants itself.
        program = getattr(traced, "jaxpr", traced)
        values: dict[Any, Value] = dict(zip(program.constvars, map(np.asarray, traced.consts), strict=True))
        values |= dict(zip(program.invars, inputs, strict=True))

        def value_of(variable: Any) -> Value:
            if not isinstance(variable, Literal):
                return values[variable]
            kind: Any = variable.aval  # a number of Python would get 64 bits
            return np.asarray(variable.val, kind.dtype)

        for equation in program.eqns:
            found = self._apply(equation, [value_of(variable) for variable in equation.invars])
            values |= dict(zip(equation.outvars, found, strict=True))
        return [value_of(variable) for variable in program.outvars]

    def _apply(self, equation: Any, inputs: list[Value]) -> list[Value]:
        """Adds an equation."""
        name = equation.primitive.name
        inner = [value for value in equation.params.values() if hasattr(value, "eqns") or hasattr(value, "jaxpr")]
        # A function in a function, such as one that is jitted or has its own gradient.
        if inner and name not in self.rules:
            return self.run(inner[0], inputs)
        if all(isinstance(value, np.ndarray) for value in inputs):
            found = equation.primitive.bind(*inputs, **equation.params)
            return [np.asarray(array) for array in (found if equation.primitive.multiple_results else [found])]
        if name not in self.rules:
            raise UserError(f"export: the model computes {name!r}, for which there is no rule yet; open an issue")
        return self.rules[name](self, equation, inputs)


def shape_of(equation: Any, number: int = 0) -> list[int]:
    """Returns the shape of an output of an equation."""
    return list(equation.outvars[number].aval.shape)


def input_shape(equation: Any, number: int = 0) -> tuple[int, ...]:
    """Returns the shape of an input of an equation."""
    return tuple(equation.invars[number].aval.shape)


def number_of_type(dtype: Any) -> int:
    """Returns ONNX's number of a type."""
    from onnx import helper

    return helper.np_dtype_to_tensor_dtype(np.dtype(dtype))


def refusal(equation: Any) -> UserError:
    """Returns the error of a rule that does not know an equation in its form."""
    return UserError(f"export: {equation.primitive.name!r} is not known in this form; open an issue")
