"""Which nodes of a GLB file are joints, where they are without an animation, and where its mesh was bound to them."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from t2m_jax.errors import UserError
from t2m_jax.motion.glb_file import GlbChunks, read_accessor
from t2m_jax.motion.rig.clip import RigClip
from t2m_jax.motion.rotations import (
    matrix_from_quaternion,
    quaternion_from_matrix,
    quaternion_inverse,
    quaternion_multiply,
    rotate_vectors,
)

W_FIRST = [3, 0, 1, 2]
"""glTF's quaternions are x, y, z, w."""
SAME = np.cos(np.deg2rad(3.0) / 2)
"""Rotations are equal if the inner product of their quaternions is larger, since they differ by less than 3 degrees."""

Matrix = Float[np.ndarray, "4 4"]


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
    notes: tuple[str, ...] = ()
    """What was left out."""


def find_nodes(tree: Mapping[str, Any], animation: Mapping[str, Any] | None = None) -> Nodes:
    """Returns the joints and the nodes above them.

    Joints are the bones that a VRM file names, or the joints of skins or, in files that have only animations, the
    nodes that these move and those below them.

    Args:
        tree: The contents of the file.
        animation: The one for which joints are needed: of several figures, the one that it moves.

    Raises:
        UserError: There are none.
    """
    nodes = tree.get("nodes", [])
    above = _parents(nodes)
    bones = _human_bones(tree)
    skinned, notes = _skinned(tree, above, animation)
    wanted = set(bones) or skinned or _animated(tree.get("animations", []), nodes)
    if not wanted:
        raise UserError(
            "has neither a skin nor an animation of a node, so it is not known which of its nodes are joints"
        )
    order = _parents_first(wanted, above)
    numbers = {number: place for place, number in enumerate(order)}
    parents = tuple(numbers[above[number]] if number in above else -1 for number in order)
    poses = [_rest_pose(nodes[number]) for number in order]
    scales = np.ones(len(order))
    for place, parent in enumerate(parents):
        # Parents come first in this order, so their scale is known.
        scales[place] = 1.0 if parent < 0 else scales[parent] * poses[parent][2]
    names = tuple(bones.get(number) or str(nodes[number].get("name", f"node_{number}")) for number in order)
    translations, rotations, _ = map(np.stack, zip(*poses, strict=True))
    return Nodes(names, parents, numbers, translations, rotations, scales, bool(bones), notes)


def _parents_first(joints: Iterable[int], above: Mapping[int, int]) -> list[int]:
    """Returns joints and the nodes above them, each after its parent."""
    # From each joint upwards to a node whose depth is known; without recursion, because a file may have any depth.
    depths: dict[int, int] = {}
    for joint in joints:
        line: list[int] = []
        number: int | None = joint
        while number is not None and number not in depths:
            line.append(number)
            number = above.get(number)
            if len(line) > len(above) + 1:
                raise ValueError("its nodes are their own parents")
        start = -1 if number is None else depths[number]
        depths |= {below: start + place for place, below in enumerate(reversed(line), start=1)}
    return sorted(depths, key=lambda number: (depths[number], number))


def rest_clip(nodes: Nodes) -> RigClip:
    """Returns the rest pose as a clip of one frame, in the unit of the file."""
    offsets = (nodes.translations * nodes.scales[:, None]).astype(np.float32)
    if not (np.isfinite(offsets).all() and np.isfinite(nodes.rotations).all()):
        raise ValueError("its nodes have values that are not finite")
    rotations = matrix_from_quaternion(nodes.rotations.astype(np.float32))
    return RigClip(
        joint_names=nodes.names,
        parents=nodes.parents,
        offsets=offsets,
        rest_rotations=rotations,
        rotations=rotations[None],
        translations=offsets[None],
        fps=1.0,
        metres_per_unit=1.0,
        is_person=nodes.is_person,
        notes=nodes.notes,
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


def _skinned(
    tree: Mapping[str, Any], above: Mapping[int, int], animation: Mapping[str, Any] | None
) -> tuple[set[int], tuple[str, ...]]:
    """Returns the joints of the figures that an animation moves, and what is to be said of others."""
    nodes = tree.get("nodes", [])
    figures = _figures([skin["joints"] for skin in tree.get("skins", [])], above, num_nodes=len(nodes))
    if animation is not None:
        moved = _animated([animation], nodes)
        figures = [joints for joints in figures if joints & moved] or figures
    found: set[int] = set()
    names: set[Any] = set()
    notes: tuple[str, ...] = ()
    # A person has more joints than what it carries.
    for joints in sorted(figures, key=len, reverse=True):
        own = {nodes[joint].get("name", joint) for joint in joints}
        if names & own:
            # By their names, the joints of both could not be told apart, and a motion would have limbs of each.
            notes = ("the file has several figures with equal names of joints; only one of them is read",)
        else:
            found |= joints
            names |= own
    return found, notes


def _figures(skins: Sequence[Sequence[int]], above: Mapping[int, int], *, num_nodes: int) -> list[set[int]]:
    """Returns the joints of each figure. The skins of one figure share joints, or one hangs on a joint of another."""
    if len(skins) <= 1:
        return [set(joints) for joints in skins]
    from scipy.sparse import coo_array  # here, because it takes long to import
    from scipy.sparse.csgraph import connected_components

    joints = sorted(set().union(*skins))
    is_joint = set(joints)
    tops: dict[int | None, int | None] = {None: None}  # the highest joint at a node or above it
    for number in _parents_first(joints, above):
        top = tops[above.get(number)]
        tops[number] = number if top is None and number in is_joint else top
    links: list[tuple[Any, Any]] = [(skin[0], joint) for skin in skins for joint in skin] + [
        (joint, tops[joint]) for joint in joints
    ]
    graph = coo_array((np.ones(len(links)), np.transpose(links)), (num_nodes, num_nodes))
    labels = connected_components(graph, directed=False)[1]
    figures: dict[int, set[int]] = {}
    for joint in joints:
        figures.setdefault(labels[joint], set()).add(joint)
    return list(figures.values())


def find_movers(tree: Mapping[str, Any]) -> set[int]:
    """Returns the nodes that move a figure: the joints of all figures, and the nodes above them."""
    nodes = tree.get("nodes", [])
    joints = set(_human_bones(tree)).union(*(skin["joints"] for skin in tree.get("skins", [])))
    return set(_parents_first(joints or moved_nodes(tree.get("animations", [])), _parents(nodes)))


def moved_nodes(animations: Iterable[Mapping[str, Any]]) -> set[int]:
    """Returns the nodes that animations turn or move."""
    targets = [channel["target"] for animation in animations for channel in animation.get("channels", ())]
    return {target["node"] for target in targets if target["path"] in ("translation", "rotation") and "node" in target}


def _parents(nodes: Sequence[Mapping[str, Any]]) -> dict[int, int]:
    return {child: number for number, node in enumerate(nodes) for child in node.get("children", [])}


def _animated(animations: Sequence[Mapping[str, Any]], nodes: Sequence[Mapping[str, Any]]) -> set[int]:
    """Returns the nodes that animations turn or move, and those below them, which may be tips of limbs."""
    found: set[int] = set()
    waiting = list(moved_nodes(animations))
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


def _world_matrix(tree: Mapping[str, Any], number: int) -> Matrix:
    """Returns where a node is in the world, with its scale."""
    above = _parents(tree["nodes"])
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


def bind_pose(glb: GlbChunks, nodes: Nodes) -> Nodes:
    """Returns the nodes in the pose in which the skins of a file were bound, `nodes` if that is their pose.

    Some programs save the nodes of a file in the middle of an animation. Only the skin tells how the figure stood.

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
    translations = nodes.translations.copy()
    rotations = nodes.rotations.copy()
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
    view = tree["accessors"][accessor].get("bufferView")
    return view is not None and "extensions" in tree["bufferViews"][view]


def _mesh_of_skin(tree: Mapping[str, Any], skin: int) -> Matrix:
    """Returns where the mesh of a skin is, in whose space the joints were bound."""
    meshes = [number for number, node in enumerate(tree["nodes"]) if node.get("skin") == skin]
    return _world_matrix(tree, meshes[0]) if meshes else np.eye(4)


def _rotation(matrix: Matrix) -> Float[np.ndarray, "3 3"]:
    return matrix[:3, :3] / np.cbrt(np.linalg.det(matrix[:3, :3]))
