"""From functions of JAX to files of ONNX: conversion, small weights, and a comparison of both."""

import importlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from t2m_jax.errors import UserError
from t2m_jax.export.onnx.builder import OPSET, GraphBuilder
from t2m_jax.export.onnx.graphs import Graph
from t2m_jax.export.onnx.operators import RULES
from t2m_jax.files.writing import atomic_file

IR_VERSION = 8
"""Version of the files, that of the operators; new ones are not read by older programs."""
SMALL = 256
"""Arrays with fewer numbers stay as they are."""
TOLERANCE = 1e-3
"""Largest difference between a graph and JAX, as a share of the largest number of an array."""

Quantized = Sequence[tuple[np.ndarray, np.ndarray]]
"""Matrices of 8 bits [R, C] with scales [R, G]."""


def check_extra() -> None:
    """Raises `UserError` if the extra `onnx` is not installed."""
    for name in ("onnx", "onnxruntime"):
        try:
            # Imported, not only found: a package may be there and not work on this system.
            importlib.import_module(name)
        except ImportError as error:
            raise UserError(f"export: {name} is missing; pip install 't2m-jax[onnx]'") from error


def save_graph(path: Path, graph: Graph, *, quantized: Quantized = ()) -> None:
    """Writes a graph.

    Weights have 16 bits, or 8 bits and scales, where these are exactly the weights of the model.

    Args:
        path: The file.
        graph: The part of a model.
        quantized: Matrices from which weights were restored.

    Raises:
        UserError: The file gives other results than JAX.
    """
    import onnx

    model = _convert(path.stem, graph)
    _store_quantized(model, quantized)
    _store_halves(model)
    onnx.checker.check_model(model, full_check=True)
    with atomic_file(path) as partial:
        partial.write_bytes(model.SerializeToString(deterministic=True))
    _compare(path, graph)


def _convert(name: str, graph: Graph) -> Any:
    """Returns the model of a function."""
    from onnx import helper, numpy_helper

    builder = GraphBuilder(RULES)
    outputs = builder.add(graph.function, graph.inputs)
    # Nodes of their own, because an output may be an input, or another output.
    for output, value in zip(graph.outputs, outputs, strict=True):
        builder.node("Identity", value, output=output)
    sides = [
        [
            helper.make_tensor_value_info(name, helper.np_dtype_to_tensor_dtype(np.dtype(array.dtype)), array.shape)
            for name, array in arrays.items()
        ]
        for arrays in (graph.inputs, graph.outputs)
    ]
    constants = [numpy_helper.from_array(array, name) for name, array in builder.constants.items()]
    made = helper.make_graph(builder.nodes, name, *sides, initializer=constants)
    return helper.make_model(made, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR_VERSION)


def _weights(model: Any) -> Iterator[tuple[Any, np.ndarray]]:
    """Yields the large float32 arrays of a model."""
    import onnx

    for tensor in list(model.graph.initializer):
        if tensor.data_type == onnx.TensorProto.FLOAT and np.prod(tensor.dims) >= SMALL:
            yield tensor, onnx.numpy_helper.to_array(tensor)


def _replace(model: Any, tensor: Any, arrays: dict[str, np.ndarray], nodes: list[Any]) -> None:
    """Replaces an array by others, and nodes that compute it from them."""
    import onnx

    model.graph.initializer.remove(tensor)
    model.graph.initializer.extend(onnx.numpy_helper.from_array(array, name) for name, array in arrays.items())
    # In front of the others, since nodes come after those whose results they read.
    rest = [*nodes, *model.graph.node]
    del model.graph.node[:]
    model.graph.node.extend(rest)


def _store_halves(model: Any) -> None:
    """Stores arrays in 16 bits if these are exactly the same numbers."""
    from onnx import TensorProto, helper

    for tensor, array in _weights(model):
        with np.errstate(over="ignore"):
            half = array.astype(np.float16)
        if np.array_equal(half.astype(np.float32), array):
            name = f"{tensor.name}_16"
            cast = helper.make_node("Cast", [name], [tensor.name], to=TensorProto.FLOAT)
            _replace(model, tensor, {name: half}, [cast])


def _store_quantized(model: Any, quantized: Quantized) -> None:
    """Stores arrays in 8 bits with scales if they were restored from such, also transposed ones."""
    known: dict[bytes, tuple[np.ndarray, np.ndarray, bool]] = {}
    for numbers, scales in quantized:
        matrix = (numbers.reshape(*scales.shape, -1) * scales[:, :, None].astype(np.float32)).reshape(numbers.shape)
        known |= {array.tobytes(): (numbers, scales, array is not matrix) for array in (matrix, matrix.T)}
    for tensor, array in _weights(model):
        if (found := known.get(array.tobytes())) is not None:
            _replace(model, tensor, *_restored(tensor.name, *found))


def _restored(
    name: str, numbers: np.ndarray, scales: np.ndarray, transposed: bool
) -> tuple[dict[str, np.ndarray], list[Any]]:
    """Returns the arrays and nodes from which a matrix of 8 bits is restored."""
    from onnx import TensorProto, helper

    arrays = {
        f"{name}_8": numbers.reshape(*scales.shape, -1),
        f"{name}_scales": scales[:, :, None],
        f"{name}_shape": np.array(numbers.shape, np.int64),
    }
    stored, scale, shape = arrays
    steps = [f"{name}_{step}" for step in ("numbers", "factors", "parts", "rows")]
    nodes = [
        helper.make_node("Cast", [stored], [steps[0]], to=TensorProto.FLOAT),
        helper.make_node("Cast", [scale], [steps[1]], to=TensorProto.FLOAT),
        helper.make_node("Mul", steps[:2], [steps[2]]),
        helper.make_node("Reshape", [steps[2], shape], [steps[3] if transposed else name]),
    ]
    if transposed:
        nodes.append(helper.make_node("Transpose", [steps[3]], [name], perm=[1, 0]))
    return arrays, nodes


def _compare(path: Path, graph: Graph) -> None:
    """Raises `UserError` if a file and JAX give different results for random inputs."""
    import onnxruntime

    random = np.random.default_rng(0)
    inputs = {
        name: random.uniform(0.5, 1.5, shape.shape).astype(np.float32)
        if shape.dtype == np.float32
        else np.ones(shape.shape, shape.dtype)
        for name, shape in graph.inputs.items()
    }
    options = onnxruntime.SessionOptions()
    options.log_severity_level = 3  # errors only: it warns about each array that a graph does not need
    session = onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
    found = session.run(list(graph.outputs), inputs)
    for name, ours, theirs in zip(graph.outputs, jax.jit(graph.function)(*inputs.values()), found, strict=True):
        wanted = np.asarray(ours)
        if not np.abs(wanted - theirs).max() <= TOLERANCE * max(np.abs(wanted).max(), 1.0):
            raise UserError(
                f"{path.name}: {name} is not what JAX computes; this is a fault of the export, open an issue"
            )
