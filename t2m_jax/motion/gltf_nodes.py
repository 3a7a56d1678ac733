"""Which nodes of a GLB file are joints, and where they are without an animation."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from t2m_jax.errors import UserError
from t2m_jax.motion.rig.clip import RigClip
from t2m_jax.motion.rotations import matrix_from_quaternion, quaternion_from_matrix

W_FIRST = [3, 0, 1, 2]
"""glTF's quaternions are x, y, z, w."""


class Nodes(NamedTuple):
    """The nodes that move the joints, parents first."""

    names: tuple[str, ...]
    parents: tuple[int, ...]
    numbers: dict[int, int]
    """Number in the file -> place in this table."""
    translations: Float[np.ndarray, "J 3"]
    rotations: Float[np.ndarray, "J 4"]
    scales: Float[np.ndarray, " J"]
    """Of each joint's parent and all nodes above it."""
    is_person: bool
    """Whether the file names the bones of a person, as VRM files do."""


def find_nodes(tree: Mapping[str, Any]) -> Nodes:
    """Returns the joints and the nodes above them.

    Joints are the bones that a VRM file names, or the joints of all skins or, in files that have only an animation, the
    nodes that it moves and those below them.

    Raises:
        UserError: There are none.
    """
    nodes = tree.get("nodes", [])
    above = {child: number for number, node in enumerate(nodes) for child in node.get("children", [])}
    bones = _human_bones(tree)
    skinned = {joint for skin in tree.get("skins", []) for joint in skin["joints"]}
    wanted = set(bones) or skinned or _animated(tree, nodes)
    if not wanted:
        raise UserError(
            "has neither a skin nor an animation of a node, so it is not known which of its nodes are joints"
        )
    # From each joint upwards to a node whose depth is known; without recursion, because a file may have any depth.
    depths: dict[int, int] = {}
    for joint in wanted:
        line: list[int] = []
        number: int | None = joint
        while number is not None and number not in depths:
            line.append(number)
            number = above.get(number)
            if len(line) > len(nodes):
                raise ValueError("its nodes are their own parents")
        start = -1 if number is None else depths[number]
        depths |= {below: start + place for place, below in enumerate(reversed(line), start=1)}
    order = sorted(depths, key=lambda number: (depths[number], number))
    numbers = {number: place for place, number in enumerate(order)}
    parents = tuple(numbers[above[number]] if number in above else -1 for number in order)
    poses = [_rest_pose(nodes[number]) for number in order]
    scales = np.ones(len(order))
    for place, parent in enumerate(parents):
        # Parents come first in this order, so their scale is known.
        scales[place] = 1.0 if parent < 0 else scales[parent] * poses[parent][2]
    names = tuple(bones.get(number) or str(nodes[number].get("name", f"node_{number}")) for number in order)
    translations, rotations, _ = map(np.stack, zip(*poses, strict=True))
    return Nodes(names, parents, numbers, translations, rotations, scales, bool(bones))


def rest_clip(nodes: Nodes) -> RigClip:
    """Returns the rest pose as a clip of one frame, in the unit of the file."""
    offsets = (nodes.translations * nodes.scales[:, None]).astype(np.float32)
    if not (np.isfinite(offsets).all() and np.isfinite(nodes.rotations).all()):
        raise ValueError("its nodes have values that are not finite")
    return RigClip(
        joint_names=nodes.names,
        parents=nodes.parents,
        offsets=offsets,
        rotations=matrix_from_quaternion(nodes.rotations.astype(np.float32))[None],
        translations=offsets[None],
        fps=1.0,
        metres_per_unit=1.0,
        is_person=nodes.is_person,
    )


def _human_bones(tree: Mapping[str, Any]) -> dict[int, str]:
    """Returns the nodes that a VRM avatar or a VRM animation names as bones of a person."""
    extensions = tree.get("extensions", {})
    for name in ("VRMC_vrm_animation", "VRMC_vrm", "VRM"):
        if name in extensions:
            bones = extensions[name]["humanoid"]["humanBones"]
            # VRM 0 has a list of records, VRM 1 a table.
            pairs = bones.items() if isinstance(bones, dict) else [(bone["bone"], bone) for bone in bones]
            return {bone["node"]: str(title) for title, bone in pairs}
    return {}


def _animated(tree: Mapping[str, Any], nodes: Sequence[Mapping[str, Any]]) -> set[int]:
    """Returns the nodes that animations turn or move, and those below them, which may be tips of limbs."""
    found: set[int] = set()
    waiting = [
        channel["target"]["node"]
        for animation in tree.get("animations", [])
        for channel in animation["channels"]
        if channel["target"]["path"] in ("translation", "rotation") and "node" in channel["target"]
    ]
    while waiting:
        number = waiting.pop()
        if number not in found:
            found.add(number)
            waiting += nodes[number].get("children", [])
    return found


def _rest_pose(node: Mapping[str, Any]) -> tuple[Float[np.ndarray, " 3"], Float[np.ndarray, " 4"], float]:
    """Returns translation, rotation (w first) and scale of a node."""
    if "matrix" in node:
        matrix = np.array(node["matrix"], float).reshape(4, 4).T
        scale = float(np.cbrt(np.linalg.det(matrix[:3, :3])))
        return matrix[:3, 3], quaternion_from_matrix(matrix[:3, :3] / scale).astype(float), scale
    translation = np.array(node.get("translation", (0, 0, 0)), float).reshape(3)
    rotation = np.array(node.get("rotation", (0, 0, 0, 1)), float).reshape(4)[W_FIRST]
    return translation, rotation, float(np.mean(np.array(node.get("scale", 1), float)))


def world_matrix(tree: Mapping[str, Any], number: int) -> Float[np.ndarray, "4 4"]:
    """Returns where a node is in the world, with its scale."""
    above = {child: parent for parent, node in enumerate(tree["nodes"]) for child in node.get("children", [])}
    matrix = np.eye(4)
    line: list[int] = []
    while number not in line:
        line.append(number)
        translation, rotation, scale = _rest_pose(tree["nodes"][number])
        pose = np.eye(4)
        pose[:3, :3] = scale * matrix_from_quaternion(rotation)
        pose[:3, 3] = translation
        matrix = pose @ matrix
        number = above.get(number, number)
    return matrix


def without_matrix(node: dict[str, Any]) -> None:
    """Writes the matrix of a node as translation, rotation and scale, since only these can be animated."""
    if "matrix" in node:
        translation, rotation, scale = _rest_pose(node)
        del node["matrix"]
        node["translation"] = translation.tolist()
        node["rotation"] = rotation[[1, 2, 3, 0]].tolist()
        node["scale"] = [scale] * 3
