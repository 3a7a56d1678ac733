"""The operators of ONNX that do the same as the primitives of JAX that models use."""

import itertools
from typing import Any

import numpy as np

from t2m_jax.errors import UserError
from t2m_jax.export.onnx.builder import GraphBuilder, Rule, Value

_SAME = {
    "abs": "Abs",
    "add": "Add",
    "and": "And",
    "cos": "Cos",
    "div": "Div",
    "eq": "Equal",
    "erf": "Erf",
    "exp": "Exp",
    "ge": "GreaterOrEqual",
    "gt": "Greater",
    "le": "LessOrEqual",
    "log": "Log",
    "logistic": "Sigmoid",
    "lt": "Less",
    "max": "Max",
    "min": "Min",
    "mul": "Mul",
    "neg": "Neg",
    "not": "Not",
    "or": "Or",
    "pow": "Pow",
    "sin": "Sin",
    "sqrt": "Sqrt",
    "sub": "Sub",
    "tanh": "Tanh",
}
"""Primitives with an operator of the same meaning."""
_NOTHING = ("copy", "copy_p", "optimization_barrier", "stop_gradient")
"""Primitives that change no number."""


def _same(operator: str) -> Rule:
    return lambda builder, equation, inputs: [builder.node(operator, *inputs)]


def _shape(equation: Any, number: int = 0) -> list[int]:
    """Returns the shape of an output of an equation."""
    return list(equation.outvars[number].aval.shape)


def _input_shape(equation: Any, number: int = 0) -> tuple[int, ...]:
    return tuple(equation.invars[number].aval.shape)


def _dtype(dtype: Any) -> int:
    from onnx import helper

    return helper.np_dtype_to_tensor_dtype(np.dtype(dtype))


def _refuse(equation: Any) -> UserError:
    return UserError(f"export: {equation.primitive.name!r} is not known in this form; open an issue")


def _reshape(builder: GraphBuilder, equation: Any, inputs: list[Value]) -> list[Value]:
    return [builder.node("Reshape", inputs[0], _shape(equation))]


def _broadcast(builder: GraphBuilder, equation: Any, inputs: list[Value]) -> list[Value]:
    shape = _shape(equation)
    kept = equation.params["broadcast_dimensions"]
    sizes = _input_shape(equation)
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
        raise _refuse(equation)
    return [builder.node("Pad", inputs[0], list(map(int, (*low, *high))), inputs[1])]


def _bounded_start(builder: GraphBuilder, start: Value, last: int) -> Value:
    """Returns a start [1], int64, that is moved into the array, as JAX does."""
    if isinstance(start, np.ndarray):
        return np.clip(start.reshape(1).astype(np.int64), 0, last)
    wide = builder.node("Cast", builder.node("Reshape", start, [1]), to=_dtype(np.int64))
    return builder.node("Min", builder.node("Max", wide, [0]), [last])


def _dynamic_slice(builder: GraphBuilder, equation: Any, inputs: list[Value]) -> list[Value]:
    sizes = equation.params["slice_sizes"]
    value = inputs[0]
    # One axis at a time: most begin at 0 and are whole.
    for axis, (size, whole) in enumerate(zip(sizes, _input_shape(equation), strict=True)):
        if size != whole:
            begin = _bounded_start(builder, inputs[1 + axis], whole - size)
            end = begin + size if isinstance(begin, np.ndarray) else builder.node("Add", begin, [size])
            value = builder.node("Slice", value, begin, end, [axis])
    return [value]


def _dynamic_update_slice(builder: GraphBuilder, equation: Any, inputs: list[Value]) -> list[Value]:
    """Adds a choice between old and new values: faster than scattering them, and known everywhere."""
    whole, part = _input_shape(equation), _input_shape(equation, 1)
    changed = [axis for axis, sizes in enumerate(zip(whole, part, strict=True)) if sizes[0] != sizes[1]]
    if len(changed) != 1 or part[changed[0]] != 1:
        raise _refuse(equation)
    (axis,) = changed
    start = _bounded_start(builder, inputs[2 + axis], whole[axis] - 1)
    shape = [-1 if number == axis else 1 for number in range(len(whole))]
    places = np.arange(whole[axis]).reshape(shape)
    here: Value = places == start if isinstance(start, np.ndarray) else builder.node("Equal", places, start)
    return [builder.node("Where", here, inputs[1], inputs[0])]


def _gather(builder: GraphBuilder, equation: Any, inputs: list[Value]) -> list[Value]:
    """Adds a lookup of whole slices along one axis. Numbers of slices are never negative or too large in models."""
    numbers = equation.params["dimension_numbers"]
    shape, places = _input_shape(equation), _input_shape(equation, 1)[:-1]
    axis = numbers.collapsed_slice_dims[0] if len(numbers.collapsed_slice_dims) == 1 else -1
    before = tuple(range(max(axis, 0)))
    after = tuple(range(axis + len(places), len(_shape(equation))))
    slices = tuple(1 if number == axis else size for number, size in enumerate(shape))
    fits = numbers.start_index_map == (axis,) and numbers.offset_dims == (*before, *after)
    if not fits or tuple(equation.params["slice_sizes"]) != slices:
        raise _refuse(equation)
    return [builder.node("Gather", inputs[0], builder.node("Reshape", inputs[1], list(places)), axis=axis)]


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
    return [builder.node("Cast", found, to=_dtype(equation.params["index_dtype"]))]


def _cumsum(builder: GraphBuilder, equation: Any, inputs: list[Value]) -> list[Value]:
    axis = np.array(equation.params["axis"], np.int64)
    return [builder.node("CumSum", inputs[0], axis, reverse=int(equation.params["reverse"]))]


def _cast(builder: GraphBuilder, equation: Any, inputs: list[Value]) -> list[Value]:
    return [builder.node("Cast", inputs[0], to=_dtype(equation.params["new_dtype"]))]


def _select(builder: GraphBuilder, equation: Any, inputs: list[Value]) -> list[Value]:
    which, *cases = inputs
    if len(cases) != 2 or equation.invars[0].aval.dtype != bool:
        raise _refuse(equation)
    return [builder.node("Where", which, cases[1], cases[0])]


def _dot(builder: GraphBuilder, equation: Any, inputs: list[Value]) -> list[Value]:
    (left, right), (left_batch, right_batch) = equation.params["dimension_numbers"]
    ranks = [len(_input_shape(equation, number)) for number in range(2)]
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
        raise _refuse(equation)
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
    "cumsum": _cumsum,
    "dot_general": _dot,
    "dynamic_slice": _dynamic_slice,
    "dynamic_update_slice": _dynamic_update_slice,
    "erfc": _with_one("Sub", "Erf"),
    "expand_dims": _reshape,
    "gather": _gather,
    "integer_pow": _power,
    "ne": lambda builder, equation, inputs: [builder.node("Not", builder.node("Equal", *inputs))],
    "pad": _pad,
    "reduce_max": _reduce("ReduceMax"),
    "reduce_min": _reduce("ReduceMin"),
    "reduce_sum": _reduce_sum,
    "reshape": _reshape,
    "rsqrt": _with_one("Div", "Sqrt"),
    "select_n": _select,
    "slice": _slice,
    "split": _split,
    "square": lambda builder, equation, inputs: [builder.node("Mul", inputs[0], inputs[0])],
    "squeeze": _reshape,
    "stack": _stack,
    "transpose": _transpose,
    "unstack": _unstack,
}
"""Rules by the names of primitives."""
