"""Which nodes of a GLB file are joints, where they are without an animation, and where its mesh was bound to them."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from t2m_jax.errors import UserError
from t2m_jax.motion.glb_file import GlbChunks, read_accessor
from t2m_jax.motion.gltf_transforms import Matrix, is_uneven, parents_of, rest_pose, stretch, world_matrix
from t2m_jax.motion.kinematics import forward_kinematics
from t2m_jax.motion.rig.clip import RigClip
from t2m_jax.motion.rotations import (
    matrix_from_quaternion,
    quaternion_from_matrix,
    quaternion_inverse,
    quaternion_multiply,
    rotate_vectors,
)

SAME = np.cos(np.deg2rad(3.0) / 2)
"""Rotations are equal if the inner product of their quaternions is larger, since they differ by less than 3 degrees."""


class Nodes(NamedTuple):
    """The nodes that move the joints, parents first."""

    names: tuple[str, ...]
    parents: tuple[int, ...]
    numbers: dict[int, int]
    """Number in the file -> place in this table."""
    translations: Float[np.ndarray, "J 3"]
    rotations: Float[np.ndarray, "J 4"]
    scales: Float[np.ndarray, " J"]
    """Of each joint's parent and all nodes above it, if they are even."""
    stretches: Float[np.ndarray, "J 3 3"] | None
    """What a node does to vectors before it turns them; None if all scales are even."""
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
    above = parents_of(nodes)
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
    poses = [rest_pose(nodes[number]) for number in order]
    scales = np.ones(len(order))
    for place, parent in enumerate(parents):
        # Parents come first in this order, so their scale is known.
        scales[place] = 1.0 if parent < 0 else scales[parent] * poses[parent][2]
    uneven = any(is_uneven(nodes[number]) for number in order if nodes[number].get("children"))
    stretches = np.stack([stretch(nodes[number]) for number in order]) if uneven else None
    names = tuple(bones.get(number) or str(nodes[number].get("name", f"node_{number}")) for number in order)
    translations, rotations, _ = map(np.stack, zip(*poses, strict=True))
    return Nodes(names, parents, numbers, translations, rotations, scales, stretches, bool(bones), notes)


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
    rotations, translations = scaled_poses(nodes, nodes.rotations[None], nodes.translations[None])
    if not (np.isfinite(translations).all() and np.isfinite(nodes.rotations).all()):
        raise ValueError("its nodes have values that are not finite")
    return RigClip(
        joint_names=nodes.names,
        parents=nodes.parents,
        offsets=translations[0],
        rest_rotations=rotations[0],
        rotations=rotations,
        translations=translations,
        fps=1.0,
        metres_per_unit=1.0,
        is_person=nodes.is_person,
        notes=nodes.notes,
    )


def scaled_poses(
    nodes: Nodes, rotations: Float[np.ndarray, "T J 4"], translations: Float[np.ndarray, "T J 3"]
) -> tuple[Float[np.ndarray, "T J 3 3"], Float[np.ndarray, "T J 3"]]:
    """Returns rotations as matrices, and translations with the scales of the nodes above.

    Uneven scales shear what turns below them. No rotation does that, so then all turns become translations.
    """
    matrices = matrix_from_quaternion(rotations.astype(np.float32))
    if nodes.stretches is None:
        return matrices, (translations * nodes.scales[:, None]).astype(np.float32)
    # The scale above the first node is the unit of the file.
    steps = translations * nodes.scales[0]
    places = forward_kinematics(matrices @ nodes.stretches, steps, nodes.parents).positions
    is_root = np.array(nodes.parents) < 0
    from_parent = places - np.where(is_root[:, None], 0.0, places[:, nodes.parents])
    return np.broadcast_to(np.eye(3, dtype=np.float32), matrices.shape), from_parent.astype(np.float32)


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
    return set(_parents_first(joints or moved_nodes(tree.get("animations", [])), parents_of(nodes)))


def moved_nodes(animations: Iterable[Mapping[str, Any]]) -> set[int]:
    """Returns the nodes that animations turn or move."""
    targets = [channel["target"] for animation in animations for channel in animation.get("channels", ())]
    return {target["node"] for target in targets if target["path"] in ("translation", "rotation") and "node" in target}


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
    return world_matrix(tree, meshes[0]) if meshes else np.eye(4)


def _rotation(matrix: Matrix) -> Float[np.ndarray, "3 3"]:
    return matrix[:3, :3] / np.cbrt(np.linalg.det(matrix[:3, :3]))
