"""The operators of ONNX that do the same as the primitives of JAX that models use."""

import functools
import itertools
from typing import Any

import jax.numpy as jnp
import numpy as np

from t2m_jax.export.onnx.builder import GraphBuilder, Rule, Value, input_shape, number_of_type, refusal, shape_of
from t2m_jax.export.onnx.indexing import dynamic_slice, dynamic_update_slice, gather, scatter

# Most operators have the name of the primitive, with a capital letter.
_ALIKE = "abs acos add and ceil cos div erf exp floor log max min mul neg not or pow sin sqrt sub tanh"
_RENAMED = {
    "eq": "Equal",
    "ge": "GreaterOrEqual",
    "gt": "Greater",
    "le": "LessOrEqual",
    "logistic": "Sigmoid",
    "lt": "Less",
}
_SAME = {name: name.title() for name in _ALIKE.split()} | _RENAMED
"""Primitives with an operator of the same meaning."""
_NOTHING = ("copy", "copy_p", "optimization_barrier", "stop_gradient")
"""Primitives that change no number."""


def _same(operator: str) -> Rule:
    return lambda builder, equation, inputs: [builder.node(operator, *inputs)]


def _reshape(builder: GraphBuilder, equation: Any, inputs: list[Value]) -> list[Value]:
    return [builder.node("Reshape", inputs[0], shape_of(equation))]


def _broadcast(builder: GraphBuilder, equation: Any, inputs: list[Value]) -> list[Value]:
    shape = shape_of(equation)
    kept = equation.params["broadcast_dimensions"]
    sizes = input_shape(equation)
    narrow = [sizes[kept.index(axis)] if axis in kept else 1 for axis in range(len(shape))]
    value = builder.node("Reshape", inputs[0], narrow)
    return [value if narrow == shape else builder.node("Expand", value, shape)]


def _transpose(builder: GraphBuilder, equation: Any, inputs: list[Value]) -> list[Value]:
    return [builder.node("Transpose", inputs[0], perm=list(equation.params["permutation"]))]


def _concatenate(builder: GraphBuilder, equation: Any, inputs: list[Value]) -> list[Value]:
    return [builder.node("Concat", *inputs, axis=equation.params["dimension"])]


def _stack(builder: GraphBuilder, equation: Any, inputs: list[Value]) -> list[Value]:
    axis = equation.params["axis"]
    parts = [builder.node("Unsqueeze", value, [axis]) for value in inputs]
    return [builder.node("Concat", *parts, axis=axis)]


def _unstack(builder: GraphBuilder, equation: Any, inputs: list[Value]) -> list[Value]:
    axis = equation.params["axis"]
    return [
        builder.node("Gather", inputs[0], np.array(number, np.int64), axis=axis)
        for number in range(len(equation.outvars))
    ]


def _slice(builder: GraphBuilder, equation: Any, inputs: list[Value]) -> list[Value]:
    begins, ends, steps = (equation.params[name] for name in ("start_indices", "limit_indices", "strides"))
    axes = list(range(len(begins)))
    return [builder.node("Slice", inputs[0], list(begins), list(ends), axes, list(steps or [1] * len(axes)))]


def _split(builder: GraphBuilder, equation: Any, inputs: list[Value]) -> list[Value]:
    axis = equation.params["axis"]
    ends = np.cumsum(equation.params["sizes"]).tolist()
    return [builder.node("Slice", inputs[0], [begin], [end], [axis]) for begin, end in itertools.pairwise([0, *ends])]


def _pad(builder: GraphBuilder, equation: Any, inputs: list[Value]) -> list[Value]:
    low, high, inner = zip(*equation.params["padding_config"], strict=True)
    if any(inner) or min(*low, *high) < 0:
        raise refusal(equation)
    return [builder.node("Pad", inputs[0], list(map(int, (*low, *high))), inputs[1])]


def _reduce_window(builder: GraphBuilder, equation: Any, inputs: list[Value]) -> list[Value]:
    """Adds what combines the neighbors along one axis: the array and its shifted copies, one after another."""
    params = equation.params
    operator = {"or": "Or", "max": "Max"}.get(params["jaxpr"].eqns[0].primitive.name)
    axes = [number for number, size in enumerate(params["window_dimensions"]) if size != 1]
    steps = (*params["window_strides"], *params["base_dilation"], *params["window_dilation"])
    if operator is None or len(axes) != 1 or set(steps) != {1} or len(params["jaxpr"].eqns) != 1:
        raise refusal(equation)
    (axis,) = axes
    low, high = zip(*params["padding"], strict=True)
    padded = builder.node("Pad", inputs[0], [*low, *high], inputs[1])
    count = shape_of(equation)[axis]
    shifted = [
        builder.node("Slice", padded, [number], [number + count], [axis])
        for number in range(params["window_dimensions"][axis])
    ]
    return [functools.reduce(lambda one, other: builder.node(operator, one, other), shifted, inputs[1])]


def _cumulative(operator: str) -> Rule:
    """Returns the rule of a running maximum or minimum, over 1, 2, 4 and more neighbors."""

    def rule(builder: GraphBuilder, equation: Any, inputs: list[Value]) -> list[Value]:
        axis, reverse = equation.params["axis"], equation.params["reverse"]
        shape = input_shape(equation)
        dtype = equation.invars[0].aval.dtype
        limits = jnp.finfo(dtype) if jnp.issubdtype(dtype, jnp.floating) else jnp.iinfo(dtype)
        nothing = np.array(limits.min if operator == "Max" else limits.max, dtype)
        value = inputs[0]
        for step in (2**power for power in range((shape[axis] - 1).bit_length())):
            sides = np.zeros((2, len(shape)), int)
            sides[int(reverse), axis] = step
            padded = builder.node("Pad", value, sides.ravel().tolist(), nothing)
            first = step if reverse else 0
            shifted = builder.node("Slice", padded, [first], [first + shape[axis]], [axis])
            value = builder.node(operator, value, shifted)
        return [value]

    return rule


def _sort(builder: GraphBuilder, equation: Any, inputs: list[Value]) -> list[Value]:
    axis = equation.params["dimension"]
    if len(inputs) != 1:
        raise refusal(equation)
    count = input_shape(equation)[axis]
    values = builder.node("TopK", inputs[0], [count], axis=axis, largest=0, sorted=1)
    builder.nodes[-1].output.append(f"{values}_places")  # the operator has two outputs
    return [values]


def _loop(builder: GraphBuilder, equation: Any, inputs: list[Value]) -> list[Value]:
    """Adds the rounds of a loop whose number is known, one after another."""
    params = equation.params
    if "ft_in" in params:  # since JAX 0.12
        before, carried = map(len, params["ft_in"].unpack()[:2])
    else:
        before = params["num_consts"]
        carried = params["num_carry"]
    if before + carried != len(inputs) or len(equation.outvars) != carried:
        raise refusal(equation)
    constants = inputs[:before]
    state = inputs[before:]
    for _ in range(params["length"]):
        state = builder.run(params["jaxpr"], [*constants, *state])
    return state


def _reduce_sum(builder: GraphBuilder, equation: Any, inputs: list[Value]) -> list[Value]:
    return [builder.node("ReduceSum", inputs[0], list(equation.params["axes"]), keepdims=0)]


def _reduce(operator: str) -> Rule:
    # Their axes are an attribute, unlike those of ReduceSum.
    return lambda builder, equation, inputs: [
        builder.node(operator, inputs[0], axes=list(equation.params["axes"]), keepdims=0)
    ]


def _argmax(builder: GraphBuilder, equation: Any, inputs: list[Value]) -> list[Value]:
    (axis,) = equation.params["axes"]
    found = builder.node("ArgMax", inputs[0], axis=int(axis), keepdims=0)
    return [builder.node("Cast", found, to=number_of_type(equation.params["index_dtype"]))]


def _cumsum(builder: GraphBuilder, equation: Any, inputs: list[Value]) -> list[Value]:
    axis = np.array(equation.params["axis"], np.int64)
    return [builder.node("CumSum", inputs[0], axis, reverse=int(equation.params["reverse"]))]


def _cast(builder: GraphBuilder, equation: Any, inputs: list[Value]) -> list[Value]:
    return [builder.node("Cast", inputs[0], to=number_of_type(equation.params["new_dtype"]))]


def _select(builder: GraphBuilder, equation: Any, inputs: list[Value]) -> list[Value]:
    which, *cases = inputs
    if len(cases) != 2 or equation.invars[0].aval.dtype != bool:
        raise refusal(equation)
    return [builder.node("Where", which, cases[1], cases[0])]


def _dot(builder: GraphBuilder, equation: Any, inputs: list[Value]) -> list[Value]:
    (left, right), (left_batch, right_batch) = equation.params["dimension_numbers"]
    ranks = [len(input_shape(equation, number)) for number in range(2)]
    if not left_batch and right == (0,) and left == (ranks[0] - 1,) and ranks[1] == 2:
        return [builder.node("MatMul", *inputs)]
    letters = iter("abcdefghijklmnopqrstuvwxyz")
    names = [[next(letters) for _ in range(rank)] for rank in ranks]
    for ours, theirs in ((left, right), (left_batch, right_batch)):
        for one, other in zip(ours, theirs, strict=True):
            names[1][other] = names[0][one]
    # The order of outputs: batch, then what is left of each side.
    taken = [(*left, *left_batch), (*right, *right_batch)]
    free = [name for side in range(2) for axis, name in enumerate(names[side]) if axis not in taken[side]]
    output = "".join([*(names[0][axis] for axis in left_batch), *free])
    return [builder.node("Einsum", *inputs, equation=f"{''.join(names[0])},{''.join(names[1])}->{output}")]


def _convolution(builder: GraphBuilder, equation: Any, inputs: list[Value]) -> list[Value]:
    params = equation.params
    numbers = params["dimension_numbers"]
    if any(step != 1 for step in params["lhs_dilation"]) or params["batch_group_count"] != 1:
        raise refusal(equation)
    kernel = inputs[1]
    if isinstance(kernel, np.ndarray):
        kernel = kernel.transpose(numbers.rhs_spec)
    else:
        kernel = builder.node("Transpose", kernel, perm=list(numbers.rhs_spec))
    low, high = zip(*params["padding"], strict=True)
    found = builder.node(
        "Conv",
        builder.node("Transpose", inputs[0], perm=list(numbers.lhs_spec)),
        kernel,
        strides=list(params["window_strides"]),
        dilations=list(params["rhs_dilation"]),
        pads=[*low, *high],
        group=params["feature_group_count"],
    )
    return [builder.node("Transpose", found, perm=np.argsort(numbers.out_spec).tolist())]


def _with_one(operator: str, before: str) -> Rule:
    """Returns the rule of a primitive that is an operator on 1 and another operator's result."""

    def rule(builder: GraphBuilder, equation: Any, inputs: list[Value]) -> list[Value]:
        one = np.ones((), equation.outvars[0].aval.dtype)
        return [builder.node(operator, one, builder.node(before, inputs[0]))]

    return rule


def _power(builder: GraphBuilder, equation: Any, inputs: list[Value]) -> list[Value]:
    return [builder.node("Pow", inputs[0], np.array(equation.params["y"], equation.outvars[0].aval.dtype))]


RULES: dict[str, Rule] = {
    **{name: _same(operator) for name, operator in _SAME.items()},
    **{name: (lambda builder, equation, inputs: inputs) for name in _NOTHING},
    "argmax": _argmax,
    "broadcast_in_dim": _broadcast,
    "clamp": lambda builder, equation, inputs: [
        builder.node("Min", builder.node("Max", inputs[1], inputs[0]), inputs[2])
    ],
    "concatenate": _concatenate,
    "conv_general_dilated": _convolution,
    "convert_element_type": _cast,
    "cummax": _cumulative("Max"),
    "cummin": _cumulative("Min"),
    "cumsum": _cumsum,
    "dot_general": _dot,
    "dynamic_slice": dynamic_slice,
    "dynamic_update_slice": dynamic_update_slice,
    "erfc": _with_one("Sub", "Erf"),
    "expand_dims": _reshape,
    "gather": gather,
    "integer_pow": _power,
    "ne": lambda builder, equation, inputs: [builder.node("Not", builder.node("Equal", *inputs))],
    "pad": _pad,
    "reduce_max": _reduce("ReduceMax"),
    "reduce_min": _reduce("ReduceMin"),
    "reduce_sum": _reduce_sum,
    "reduce_window": _reduce_window,
    "reshape": _reshape,
    "rsqrt": _with_one("Div", "Sqrt"),
    "scan": _loop,
    "scatter": scatter("none"),
    "scatter-add": scatter("add"),
    "select_n": _select,
    "slice": _slice,
    "sort": _sort,
    "split": _split,
    "square": lambda builder, equation, inputs: [builder.node("Mul", inputs[0], inputs[0])],
    "squeeze": _reshape,
    "stack": _stack,
    "transpose": _transpose,
    "unstack": _unstack,
}
"""Rules by the names of primitives."""
