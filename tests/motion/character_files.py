"""Characters as GLB files with a skin, and where the joints of such files are."""

import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from t2m_jax.motion.rotations import (
    matrix_from_quaternion,
    quaternion_inverse,
    quaternion_multiply,
    rotate_vectors,
)
from tests.motion.glb_files import GlbWriter

UPRIGHT = {"rotation": [-(0.5**0.5), 0, 0, 0.5**0.5]}
"""An armature whose joints have Z up, as Blender and Unreal write it."""
LIMBS = {"hip": "UpperLeg", "knee": "LowerLeg", "ankle": "Foot", "foot": "Toes"} | {
    "collar": "Shoulder", "shoulder": "UpperArm", "elbow": "LowerArm", "wrist": "Hand"
}  # fmt: skip
"""Joints of HumanML3D -> those of Bandai-Namco's rig."""


def bone_of(joint: str, side: str) -> str:
    """Returns the joint of Bandai-Namco's rig for one of HumanML3D."""
    return f"{LIMBS[joint]}_{side[0].upper()}"


def table_text(rename: Callable[[str], str]) -> str:
    """Returns a table for Bandai-Namco's rig whose joints have other names."""
    table = {"pelvis": "Hips", "spine1": "Spine", "spine3": "Chest", "neck": "Neck", "head": "Head"}
    table |= {f"{side}_{joint}": bone_of(joint, side) for side in ("left", "right") for joint in LIMBS}
    return "".join(f'{joint}: "{rename(bone)}"\n' for joint, bone in table.items())


def write_character(
    path: Path, joints: dict, *, seed: int | None = None, armature: dict | None = None, z_up: bool = False
) -> Path:
    """Writes a figure with a skin, a mesh with a spindle for each bone, and an animation.

    Args:
        path: The file.
        joints: Name -> (parent, offset in centimeters), parents first, in a world with Y up.
        seed: Draws the directions of the bones' axes, which are those of the world without it.
        armature: Other properties of the node above all joints.
        z_up: Whether the joints are in a world with Z up, for `UPRIGHT`.
    """
    draw = np.random.default_rng(seed)
    writer, numbers, poses, turns = GlbWriter(), {}, {}, {None: np.array([1.0, 0, 0, 0])}
    root = writer.joint("Armature", is_joint=False, **{"scale": [0.01] * 3} | (armature or {}))
    for name, (parent, offset) in joints.items():
        drawn = draw.normal(size=4)
        turns[name] = np.array([1.0, 0, 0, 0]) if seed is None else drawn / np.linalg.norm(drawn)
        x, y, z = offset
        bone = rotate_vectors(quaternion_inverse(turns[parent]), np.array((x, -z, y) if z_up else (x, y, z), float))
        local = quaternion_multiply(quaternion_inverse(turns[parent]), turns[name])
        given = {"translation": bone.tolist(), "rotation": local[[1, 2, 3, 0]].tolist()}
        numbers[name] = writer.joint(name, numbers.get(parent, root), **given)
        above = poses.get(parent, np.eye(4))
        poses[name] = above @ _matrix({"scale": np.ones(3)} | {key: np.array(value) for key, value in given.items()})
    parents = [list(joints).index(parent) if parent else number for number, (parent, _) in enumerate(joints.values())]
    _add_mesh(writer, root, np.stack(list(poses.values())), parents)
    last = next(reversed(numbers.values()))
    writer.animation("nod", [(last, "rotation", [0, 1], [[0, 0, 0, 1]] * 2, "LINEAR", "f4")])
    times = writer.tree["animations"][0]["samplers"][0]["input"]
    writer.tree["accessors"][times] |= {"min": [0], "max": [1]}
    return writer.save(path)


def _add_mesh(writer: GlbWriter, armature: int, poses: np.ndarray, parents: list[int]) -> None:
    """Adds a mesh that the joints move, with a material; `poses` are those of the joints in the armature."""
    inverses = np.linalg.inv(poses).swapaxes(1, 2).reshape(len(poses), 16)
    writer.tree["skins"][0]["inverseBindMatrices"] = writer.accessor(inverses)
    ends = poses[:, :3, 3]
    starts = ends[parents]
    starts[1] = ends[1]  # the hips may be far above the root
    middle = 0.75 * starts + 0.25 * ends
    around = 0.12 * np.linalg.norm(ends - starts, axis=1)[:, None, None] * np.concatenate([np.eye(3), -np.eye(3)])
    ring = middle[:, None] + around
    ends, starts = (np.broadcast_to(points[:, None], ring.shape) for points in (ends, starts))
    sides = [
        np.stack([ring, np.roll(ring, shift, axis=1), tip], axis=2) for shift in (1, 2, 4, 5) for tip in (starts, ends)
    ]
    corners = np.stack(sides, axis=1).reshape(-1, 3).astype(np.float32)
    joints = np.zeros((len(corners), 4))
    joints[:, 0] = np.repeat(parents, len(corners) // len(parents))
    attributes = {
        "POSITION": writer.accessor(corners),
        "JOINTS_0": writer.accessor(joints, "u1"),
        "WEIGHTS_0": writer.accessor(np.tile([1.0, 0, 0, 0], (len(corners), 1))),
    }
    extremes = {"min": corners.min(axis=0).tolist(), "max": corners.max(axis=0).tolist()}
    writer.tree["accessors"][attributes["POSITION"]] |= extremes
    writer.tree["materials"] = [{"name": "cloth", "doubleSided": True, "pbrMetallicRoughness": {"metallicFactor": 0}}]
    writer.tree["meshes"] = [{"primitives": [{"attributes": attributes, "material": 0}]}]
    writer.joint("Body", armature, is_joint=False, mesh=0, skin=0)
    writer.tree |= {"scene": 0, "scenes": [{"nodes": [armature]}]}


def with_matrices(tree: dict) -> None:
    """Writes the poses of all nodes as matrices."""
    for node in tree["nodes"]:
        matrix = _matrix({name: np.array(node.pop(name, at_rest)) for name, at_rest in AT_REST.items()})
        node["matrix"] = matrix.T.ravel().tolist()


def in_another_pose(tree: dict) -> None:
    """Turns all joints, as files that were saved in the middle of an animation."""
    draw = np.random.default_rng(7)
    for number in tree["skins"][0]["joints"]:
        node = tree["nodes"][number]
        drawn = np.array([1.0, *draw.normal(size=3) / 3])
        turned = quaternion_multiply(np.array(node["rotation"])[[3, 0, 1, 2]], drawn / np.linalg.norm(drawn))
        node["rotation"] = turned[[1, 2, 3, 0]].tolist()


AT_REST = {"translation": [0.0, 0, 0], "rotation": [0.0, 0, 0, 1], "scale": [1.0, 1, 1]}


class Parts(NamedTuple):
    """The two chunks of a file."""

    tree: dict[str, Any]
    binary: bytes


def read_parts(path: Path) -> Parts:
    """Returns the chunks of a file."""
    data = path.read_bytes()
    assert struct.unpack_from("<III", data) == (0x46546C67, 2, len(data))
    size = struct.unpack_from("<I", data, 12)[0]
    length = struct.unpack_from("<I", data, 20 + size)[0]
    return Parts(json.loads(data[20 : 20 + size]), data[28 + size : 28 + size + length])


def places(path: Path, animation: int | None = -1) -> dict[str | int, np.ndarray]:
    """Returns where the nodes of a file are in each frame of an animation, by name; None stands for no animation."""
    tree, binary = read_parts(path)
    nodes = tree["nodes"]
    moved: dict[tuple[int, str], np.ndarray] = {}
    played = {"channels": [], "samplers": []} if animation is None else tree["animations"][animation]
    for channel in played["channels"]:
        accessor = tree["accessors"][played["samplers"][channel["sampler"]]["output"]]
        start = tree["bufferViews"][accessor["bufferView"]]["byteOffset"]
        columns = {"VEC3": 3, "VEC4": 4}[accessor["type"]]
        values = np.frombuffer(binary, "<f4", accessor["count"] * columns, start).reshape(-1, columns)
        moved[channel["target"]["node"], channel["target"]["path"]] = values
    parents = {child: number for number, node in enumerate(nodes) for child in node.get("children", ())}

    def world(number: int) -> np.ndarray:
        node = nodes[number]
        pose = {name: moved.get((number, name), np.array(node.get(name, start))) for name, start in AT_REST.items()}
        matrix = np.array(node["matrix"]).reshape(4, 4).T if "matrix" in node else _matrix(pose)
        return world(parents[number]) @ matrix if number in parents else matrix

    return {node.get("name", number): world(number)[..., :3, 3] for number, node in enumerate(nodes)}


def _matrix(pose: dict[str, np.ndarray]) -> np.ndarray:
    turn = matrix_from_quaternion(np.asarray(pose["rotation"], float)[..., [3, 0, 1, 2]]).astype(float)
    matrix = np.zeros((*np.broadcast_shapes(turn.shape[:-2], pose["translation"].shape[:-1]), 4, 4))
    matrix[..., :3, :3] = turn * np.asarray(pose["scale"])[..., None, :]
    matrix[..., :3, 3] = pose["translation"]
    matrix[..., 3, 3] = 1.0
    return matrix
