"""A skinned mesh of a person: the body of the pictures, in the rest pose. Its shape is free for any use (CC0)."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from t2m_jax.export.render.figure import TINTS, Tint, body_from_skeleton, figure_points, figure_scale
from t2m_jax.export.render.scene import SOLE
from t2m_jax.motion.skeleton import Skeleton

SIDES = 16
"""Corners of the rings around a limb."""
CAP_RINGS = 5
"""Rings of each half sphere at the ends of a limb."""
_LAST_BONE = 0.7
"""Length of hands, toes and head beyond their joints, relative to the bone before."""


class SkinPart(NamedTuple):
    """Triangles of one color. Each vertex moves with one joint."""

    tint: Tint
    positions: Float[np.ndarray, "V 3"]
    normals: Float[np.ndarray, "V 3"]
    joints: Int[np.ndarray, " V"]
    triangles: Int[np.ndarray, "F 3"]


def make_skin(rest: Float[np.ndarray, "J 3"], skeleton: Skeleton) -> list[SkinPart]:
    """Returns the body around a rest pose, a part per color.

    Args:
        rest: Joints in meters, Y up.
        skeleton: Of the joints.
    """
    points = figure_points(rest[None].astype(np.float32), skeleton)[0].astype(np.float64)
    scale = figure_scale(rest[None], skeleton)
    pieces: dict[Tint, list[SkinPart]] = {tint: [] for tint in TINTS}
    for part in body_from_skeleton(skeleton).parts:
        start = points[part.start]
        end = points[part.end]
        joint = _owner((start + end) / 2, rest, skeleton)
        lift = SOLE * scale if joint in (*skeleton.left_foot, *skeleton.right_foot) else 0.0
        positions, normals = _capsule(start, end, part.start_radius * scale, part.end_radius * scale)
        positions[:, 1] += lift  # so that soles are on the ground, on which the joints of standing feet are
        joints = np.full(len(positions), joint)
        pieces[part.tint].append(SkinPart(part.tint, positions, normals, joints, _triangles(len(positions))))
    return [_merge(parts) for parts in pieces.values() if parts]


def _owner(place: Float[np.ndarray, " 3"], rest: Float[np.ndarray, "J 3"], skeleton: Skeleton) -> int:
    """Returns the joint that moves what is at a place: that of the nearest bone from a joint to its child."""
    parents = np.array(skeleton.parents)
    tips = [joint for joint in range(1, len(parents)) if not skeleton.children(joint)]
    owners = np.concatenate([parents[1:], tips])
    starts = rest[owners]
    ends = np.concatenate([rest[1:], rest[tips] + _LAST_BONE * (rest[tips] - rest[parents[tips]])])
    along = ends - starts
    shares = np.sum((place - starts) * along, axis=1) / np.maximum(np.sum(along**2, axis=1), 1e-12)
    distances = np.linalg.norm(place - starts - np.clip(shares, 0, 1)[:, None] * along, axis=1)
    # Both bones of a joint may be equally near; rounding must not choose between them.
    return int(owners[np.argmax(distances < distances.min() + 1e-9)])


def _capsule(
    start: Float[np.ndarray, " 3"], end: Float[np.ndarray, " 3"], start_radius: float, end_radius: float
) -> tuple[Float[np.ndarray, "V 3"], Float[np.ndarray, "V 3"]]:
    """Returns positions and normals of the rings of a limb with round ends."""
    axis = end - start
    length = np.linalg.norm(axis)
    # A limb of no length is a ball, whose axis may be any.
    axis = axis / length if length > 1e-9 else np.array([0.0, 1.0, 0.0])
    # Across the coordinate axis that is the least along the limb.
    side = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    side /= np.linalg.norm(side)
    around = 2 * np.pi * np.arange(SIDES) / SIDES
    radial = np.cos(around)[:, None] * side + np.sin(around)[:, None] * np.cross(axis, side)
    lower = np.linspace(-np.pi / 2, 0, CAP_RINGS)
    angles = np.concatenate([lower, -lower[::-1]])[:, None, None]
    normals = np.cos(angles) * radial + np.sin(angles) * axis
    half = CAP_RINGS * SIDES
    normals = normals.reshape(-1, 3)
    centers = np.repeat([start, end], half, axis=0)
    radii = np.repeat([start_radius, end_radius], half)
    return centers + radii[:, None] * normals, normals


def _triangles(num_vertices: int) -> Int[np.ndarray, "F 3"]:
    """Returns the triangles between rings, seen from outside against the clock."""
    ring, corner = np.divmod(np.arange(num_vertices - SIDES), SIDES)
    here = ring * SIDES + corner
    beside = ring * SIDES + (corner + 1) % SIDES
    lower = np.stack([here, beside, here + SIDES], axis=1)
    return np.concatenate([lower, np.stack([beside, beside + SIDES, here + SIDES], axis=1)])


def _merge(parts: list[SkinPart]) -> SkinPart:
    """Returns parts of one color as one."""
    starts = np.cumsum([0] + [len(part.positions) for part in parts[:-1]])
    positions, normals, joints = (np.concatenate([part[field] for part in parts]) for field in (1, 2, 3))
    triangles = np.concatenate([part.triangles + start for part, start in zip(parts, starts, strict=True)])
    return SkinPart(parts[0].tint, positions, normals, joints, triangles)
