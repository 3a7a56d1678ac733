"""What a node of a GLB file does to points: its translation, rotation and scale."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from t2m_jax.motion.rotations import matrix_from_quaternion, quaternion_from_matrix

W_FIRST = [3, 0, 1, 2]
"""glTF's quaternions are x, y, z, w."""
UNEVEN = 0.01
"""Share by which scales along x, y and z may differ."""

Matrix = Float[np.ndarray, "4 4"]


def parents_of(nodes: Sequence[Mapping[str, Any]]) -> dict[int, int]:
    """Returns the parent of each node that has one."""
    return {child: number for number, node in enumerate(nodes) for child in node.get("children", [])}


def rest_pose(node: Mapping[str, Any]) -> tuple[Float[np.ndarray, " 3"], Float[np.ndarray, " 4"], float]:
    """Returns translation, rotation (w first) and scale of a node."""
    if "matrix" in node:
        matrix = np.array(node["matrix"], float).reshape(4, 4).T
        scale = float(np.cbrt(np.linalg.det(matrix[:3, :3])))
        return matrix[:3, 3], quaternion_from_matrix(matrix[:3, :3] / scale).astype(float), scale
    translation = np.array(node.get("translation", (0, 0, 0)), float).reshape(3)
    rotation = np.array(node.get("rotation", (0, 0, 0, 1)), float).reshape(4)[W_FIRST]
    return translation, rotation, float(np.mean(np.array(node.get("scale", 1), float)))


def stretch(node: Mapping[str, Any]) -> Float[np.ndarray, "3 3"]:
    """Returns what a node does to vectors before its rotation."""
    if "matrix" not in node:
        return np.diag(np.broadcast_to(np.array(node.get("scale", 1), float), 3))
    turn = matrix_from_quaternion(rest_pose(node)[1])
    return np.linalg.solve(turn, np.array(node["matrix"], float).reshape(4, 4).T[:3, :3])


def is_uneven(node: Mapping[str, Any]) -> bool:
    """Returns whether a node scales along x, y and z by different factors, or mirrors one of them."""
    matrix = stretch(node)
    return bool(np.abs(matrix - matrix[0, 0] * np.eye(3)).max() > UNEVEN * np.abs(matrix).max())


def world_matrix(tree: Mapping[str, Any], number: int) -> Matrix:
    """Returns where a node is in the world, with its scale."""
    above = parents_of(tree["nodes"])
    matrix = np.eye(4)
    line: list[int] = []
    while number not in line:
        line.append(number)
        node = tree["nodes"][number]
        translation, rotation, _ = rest_pose(node)
        pose = np.eye(4)
        pose[:3, :3] = matrix_from_quaternion(rotation) @ stretch(node)
        pose[:3, 3] = translation
        matrix = pose @ matrix
        number = above.get(number, number)
    return matrix


def without_matrix(node: dict[str, Any]) -> None:
    """Writes the matrix of a node as translation, rotation and scale, since only these can be animated."""
    if "matrix" in node:
        translation, rotation, scale = rest_pose(node)
        del node["matrix"]
        node["translation"] = translation.tolist()
        node["rotation"] = rotation[[1, 2, 3, 0]].tolist()
        node["scale"] = [scale] * 3
