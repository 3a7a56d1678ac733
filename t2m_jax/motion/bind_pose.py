"""The pose in which the mesh of a character was bound to its bones.

Some programs save the nodes of a file in the middle of an animation. Only the skin tells how the figure stands then.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from t2m_jax.motion.glb_file import GlbChunks, read_accessor
from t2m_jax.motion.gltf_nodes import Nodes, rest_clip, world_matrix
from t2m_jax.motion.rotations import quaternion_from_matrix, quaternion_inverse, quaternion_multiply, rotate_vectors

SAME = np.cos(np.deg2rad(3.0) / 2)
"""Rotations are equal if the inner product of their quaternions is larger, since they differ by less than 3 degrees."""

Matrix = Float[np.ndarray, "4 4"]


def bind_pose(glb: GlbChunks, nodes: Nodes) -> Nodes:
    """Returns the nodes in the pose in which the skins of a file were bound, `nodes` if that is their pose.

    Args:
        glb: The file.
        nodes: Its joints, in the pose in which they were saved.
    """
    bound = _bound_joints(glb, nodes)
    poses = rest_clip(nodes).poses
    turned = quaternion_from_matrix(poses.rotations[0])
    turns = {place: quaternion_from_matrix(_rotation(matrix)) for place, matrix in bound.items()}
    # Between two poses of the whole figure, the rotation is the same for all of its bones.
    apart = [quaternion_multiply(turned[place], quaternion_inverse(turn)) for place, turn in turns.items()]
    if all(same_rotation(one, apart[0]) for one in apart):
        return nodes
    translations, rotations = nodes.translations.copy(), nodes.rotations.copy()
    world: dict[int, tuple[Any, Any]] = {-1: (np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3))}
    for place, parent in enumerate(nodes.parents):
        above, start = world[parent]
        if place in bound:
            rotations[place] = quaternion_multiply(quaternion_inverse(above), turns[place])
            way = rotate_vectors(quaternion_inverse(above), bound[place][:3, 3] - start)
            translations[place] = way / nodes.scales[place]
        way = rotate_vectors(above, translations[place] * nodes.scales[place])
        world[place] = quaternion_multiply(above, rotations[place]), start + way
    return nodes._replace(translations=translations, rotations=rotations)


def same_rotation(a: Float[np.ndarray, "4"], b: Float[np.ndarray, "4"]) -> bool:
    """Returns whether two unit quaternions are the same rotation, but for some degrees."""
    return bool(abs(np.dot(a, b)) > SAME)


def _bound_joints(glb: GlbChunks, nodes: Nodes) -> dict[int, Matrix]:
    """Returns where the joints of skins were in the world when they were bound: place in `nodes` -> matrix."""
    found: dict[int, Matrix] = {}
    for number, skin in enumerate(glb.tree.get("skins", [])):
        if "inverseBindMatrices" not in skin or _is_compressed(glb.tree, skin["inverseBindMatrices"]):
            continue
        # glTF has them column by column.
        inverses = read_accessor(glb, skin["inverseBindMatrices"]).reshape(-1, 4, 4).swapaxes(1, 2)
        mesh = _mesh_of_skin(glb.tree, number)
        for joint, inverse in zip(skin["joints"], inverses, strict=False):
            # Bones that move nothing may have a matrix of zeros.
            if joint in nodes.numbers and abs(np.linalg.det(inverse)) > 0:
                found.setdefault(nodes.numbers[joint], mesh @ np.linalg.inv(inverse))
    return found


def _is_compressed(tree: Mapping[str, Any], accessor: int) -> bool:
    """Returns whether an extension is needed to read an accessor."""
    return "extensions" in tree["bufferViews"][tree["accessors"][accessor]["bufferView"]]


def _mesh_of_skin(tree: Mapping[str, Any], skin: int) -> Matrix:
    """Returns where the mesh of a skin is, in whose space the joints were bound."""
    meshes = [number for number, node in enumerate(tree["nodes"]) if node.get("skin") == skin]
    return world_matrix(tree, meshes[0]) if meshes else np.eye(4)


def _rotation(matrix: Matrix) -> Float[np.ndarray, "3 3"]:
    return matrix[:3, :3] / np.cbrt(np.linalg.det(matrix[:3, :3]))
