"""The operators of ONNX that read and change parts of an array whose places are numbers."""

from typing import Any

import numpy as np

from t2m_jax.export.onnx.builder import GraphBuilder, Rule, Value, input_shape, number_of_type, refusal, shape_of


def _bounded_start(builder: GraphBuilder, start: Value, last: int) -> Value:
    """Returns a start [1], int64, that is moved into the array, as JAX does."""
    if isinstance(start, np.ndarray):
        return np.clip(start.reshape(1).astype(np.int64), 0, last)
    wide = builder.node("Cast", builder.node("Reshape", start, [1]), to=number_of_type(np.int64))
    return builder.node("Min", builder.node("Max", wide, [0]), [last])


def dynamic_slice(builder: GraphBuilder, equation: Any, inputs: list[Value]) -> list[Value]:
    """Adds a slice that begins at numbers which are computed."""
    sizes = equation.params["slice_sizes"]
    value = inputs[0]
    # One axis at a time: most begin at 0 and are whole.
    for axis, (size, whole) in enumerate(zip(sizes, input_shape(equation), strict=True)):
        if size != whole:
            begin = _bounded_start(builder, inputs[1 + axis], whole - size)
            end = begin + size if isinstance(begin, np.ndarray) else builder.node("Add", begin, [size])
            value = builder.node("Slice", value, begin, end, [axis])
    return [value]


def dynamic_update_slice(builder: GraphBuilder, equation: Any, inputs: list[Value]) -> list[Value]:
    """Adds a choice between old and new values: faster than scattering them, and known everywhere."""
    whole, part = input_shape(equation), input_shape(equation, 1)
    changed = [axis for axis, sizes in enumerate(zip(whole, part, strict=True)) if sizes[0] != sizes[1]]
    if len(changed) != 1 or part[changed[0]] != 1:
        raise refusal(equation)
    (axis,) = changed
    start = _bounded_start(builder, inputs[2 + axis], whole[axis] - 1)
    shape = [-1 if number == axis else 1 for number in range(len(whole))]
    places = np.arange(whole[axis]).reshape(shape)
    here: Value = places == start if isinstance(start, np.ndarray) else builder.node("Equal", places, start)
    return [builder.node("Where", here, inputs[1], inputs[0])]


def gather(builder: GraphBuilder, equation: Any, inputs: list[Value]) -> list[Value]:
    """Adds a lookup of whole slices along one axis. Numbers of slices are never negative or too large in models."""
    numbers = equation.params["dimension_numbers"]
    shape, places = input_shape(equation), input_shape(equation, 1)[:-1]
    axis = numbers.collapsed_slice_dims[0] if len(numbers.collapsed_slice_dims) == 1 else -1
    slices = tuple(
        1 if number == axis or number in numbers.operand_batching_dims else size for number, size in enumerate(shape)
    )
    if numbers.start_index_map != (axis,) or tuple(equation.params["slice_sizes"]) != slices:
        raise refusal(equation)
    if numbers.operand_batching_dims:
        return [_gather_batch(builder, equation, inputs, axis)]
    found = builder.node("Gather", inputs[0], builder.node("Reshape", inputs[1], list(places)), axis=axis)
    # The axes of slices are where JAX says, those of places are at the others.
    kept = [number for number in range(len(shape) - 1 + len(places)) if not axis <= number < axis + len(places)]
    origins = dict(zip(numbers.offset_dims, kept, strict=True))
    others = iter(range(axis, axis + len(places)))
    order = [origins[number] if number in origins else next(others) for number in range(len(shape_of(equation)))]
    return [found if order == sorted(order) else builder.node("Transpose", found, perm=order)]


def _gather_batch(builder: GraphBuilder, equation: Any, inputs: list[Value], axis: int) -> str:
    """Adds a lookup of slices in each array of a batch; the axes of the batch come first, then that of the lookup."""
    numbers = equation.params["dimension_numbers"]
    batch = tuple(range(axis))
    offsets = tuple(range(axis + 1, len(shape_of(equation))))
    if (numbers.operand_batching_dims, numbers.start_indices_batching_dims, numbers.offset_dims) != (
        batch,
        batch,
        offsets,
    ):
        raise refusal(equation)
    places = builder.node("Cast", inputs[1], to=number_of_type(np.int64))
    return builder.node("GatherND", inputs[0], places, batch_dims=axis)


def scatter(reduction: str) -> Rule:
    """Returns the rule that changes whole slices along one axis; their numbers are in the array."""

    def rule(builder: GraphBuilder, equation: Any, inputs: list[Value]) -> list[Value]:
        numbers = equation.params["dimension_numbers"]
        shape, changes = input_shape(equation), input_shape(equation, 2)
        (axis, *others) = numbers.scatter_dims_to_operand_dims
        batch = numbers.operand_batching_dims
        window = tuple(number for number in range(len(shape)) if number != axis and number not in batch)
        fits = numbers.inserted_window_dims == (axis,) and numbers.update_window_dims == window
        if others or not fits or len(changes) != len(shape) or batch != numbers.scatter_indices_batching_dims:
            raise refusal(equation)
        sizes = [size if number == axis or number in batch else 1 for number, size in enumerate(changes)]
        places = builder.node("Expand", builder.node("Reshape", inputs[1], sizes), list(changes))
        return [builder.node("ScatterElements", inputs[0], places, inputs[2], axis=int(axis), reduction=reduction)]

    return rule
