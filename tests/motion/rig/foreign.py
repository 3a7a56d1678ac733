"""Skeletons of other programs that move: the walk of `walking_positions` on any bones, as a BVH file."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import pytest

from t2m_jax.motion.bvh import save_bvh
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.rig.rigs import rig_joint_names
from t2m_jax.motion.rotations import euler_from_matrix, unit_vectors
from t2m_jax.motion.skeleton import HUMANML3D
from tests.motion.figures import walking_positions

ROLES = HUMANML3D.joint_names


class Joint(NamedTuple):
    """A joint of a file; parents come first."""

    name: str
    parent: str | None
    offset: tuple[float, float, float]
    channels: int = 3
    """3 for rotations, 6 for a position, too, which repeats OFFSET."""


def walk_on(joints: Sequence[Joint], roles: Mapping[str, str], *, num_frames: int = 12) -> dict[str, np.ndarray]:
    """Returns rotations of each joint in its parent's frame so that the bones point as those of a walk.

    Args:
        joints: The skeleton.
        roles: Joints of HumanML3D -> names in the skeleton.
        num_frames: Length.
    """
    walk = walking_positions(num_frames).astype(np.float64)
    target = {name: walk[:, ROLES.index(role)] for role, name in roles.items()}
    by_name = {joint.name: joint for joint in joints}
    world: dict[str, np.ndarray] = {}
    local: dict[str, np.ndarray] = {}
    for joint in joints:
        above = np.eye(3) if joint.parent is None else world[joint.parent]
        turn = np.broadcast_to(above, (num_frames, 3, 3))
        below = _roles_below(joints, joint.name, target) if joint.name in target else []
        if below:
            turn = _fit([_aim(other, joint.name, by_name, target) for other in below])
        world[joint.name] = turn
        local[joint.name] = np.swapaxes(np.broadcast_to(above, (num_frames, 3, 3)), -1, -2) @ turn
    return local


def _roles_below(joints, name, target):
    """Returns the next joints below with a target."""
    found = []
    for joint in joints:
        if joint.parent == name:
            found += [joint.name] if joint.name in target else _roles_below(joints, joint.name, target)
    return found


def _aim(below, name, by_name, target):
    """Returns a rest direction in the frame of `name`, and the directions in the world that it should have."""
    rest, joint = np.zeros(3), by_name[below]
    while joint.name != name:
        rest = rest + joint.offset
        joint = by_name[joint.parent]
    return rest, target[below] - target[name]


def _fit(pairs):
    """Returns the rotations that turn rest directions to those of the walk, by least squares (Kabsch)."""
    cross = sum(
        np.einsum("ti,j->tij", unit_vectors(goal), unit_vectors(np.asarray(rest, float))) for rest, goal in pairs
    )
    if len(pairs) == 1:  # the shortest turn, plus any twist
        cross = cross + 1e-3 * np.eye(3)
    u, _, v = np.linalg.svd(cross)
    sign = np.linalg.det(u @ v)
    u[..., :, 2] *= sign[..., None]
    return u @ v


def bvh_of(
    joints: Sequence[Joint], rotations: Mapping[str, np.ndarray], roots: np.ndarray, *, ends: Mapping[str, tuple] = {}
) -> str:
    """Returns a BVH file; `roots` are the position channels of the root, and `ends` are End Sites that are not 0."""
    lines, order = ["HIERARCHY"], []

    def block(joint: Joint) -> None:
        order.append(joint)
        children = [child for child in joints if child.parent == joint.name]
        lines.extend([f"{'ROOT' if joint.parent is None else 'JOINT'} {joint.name}", "{"])
        lines.append("OFFSET " + " ".join(f"{value:.5f}" for value in joint.offset))
        places = "Xposition Yposition Zposition " if joint.channels == 6 or joint.parent is None else ""
        lines.append(f"CHANNELS {6 if places else 3} {places}Zrotation Yrotation Xrotation")
        for child in children:
            block(child)
        if not children:
            tip = " ".join(map(str, ends.get(joint.name, (0, 0, 0))))
            lines.extend(["End Site", "{", f"OFFSET {tip}", "}"])
        lines.append("}")

    block(joints[0])
    columns = []
    for joint in order:
        if joint.parent is None:
            columns.append(roots)
        elif joint.channels == 6:
            columns.append(np.tile(joint.offset, (len(roots), 1)))
        turns = rotations.get(joint.name, np.broadcast_to(np.eye(3), (len(roots), 3, 3)))
        columns.append(np.rad2deg(euler_from_matrix(turns, "ZYX")))
    rows = [" ".join(f"{value:.5f}" for value in row) for row in np.concatenate(columns, axis=1)]
    return "\n".join([*lines, "MOTION", f"Frames: {len(rows)}", "Frame Time: 0.05", *rows]) + "\n"


@pytest.fixture
def nameless(tmp_path):
    """A BVH file whose names say nothing: q0, q1, ..."""
    path = tmp_path / "nameless.bvh"
    save_bvh(path, Motion(positions=walking_positions(5), fps=20.0))
    lines = path.read_text().split("\n")
    for number, line in enumerate(lines):
        word, _, name = line.strip().partition(" ")
        if word in ("ROOT", "JOINT"):
            lines[number] = f"{word} q{rig_joint_names('lafan1').index(name)}"
    path.write_text("\n".join(lines))
    return path


@pytest.fixture
def nameless_table(tmp_path):
    """The table of `nameless`."""
    path = tmp_path / "table.yaml"
    path.write_text("".join(f"{role}: q{number}\n" for number, role in enumerate(ROLES)))
    return path
