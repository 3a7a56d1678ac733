"""A body around a person's skeleton: tapered limbs, a head with a direction of view, hands and feet.

All renderers use it.
"""

import functools
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from t2m_jax.motion.rotations import unit_vectors
from t2m_jax.motion.skeleton import Skeleton

Tint = Literal["body", "left", "right", "face"]
TINTS: tuple[Tint, ...] = ("body", "left", "right", "face")

REFERENCE_LEG = 0.815832
"""Thigh plus shin, in meters, of the figure to which the radii below belong."""

# Fractions of the way from the hips to the base of the neck, and the radii there in meters.
SPINE_FRACTIONS = (0.0, 0.3, 0.6, 0.85, 1.0)
SPINE_RADII = (0.120, 0.110, 0.118, 0.112, 0.066)


class BodyPart(NamedTuple):
    """A tapered capsule between two points of a figure. Radii are in meters for a leg of `REFERENCE_LEG`."""

    start: int
    end: int
    start_radius: float
    end_radius: float
    tint: Tint


class Body(NamedTuple):
    """Points as weighted sums of joints (the joints themselves first), and the parts between them."""

    weights: Float[np.ndarray, "P J"]
    parts: tuple[BodyPart, ...]
    head: int
    """Center of the head."""


class Roles(NamedTuple):
    """Joints of a person: limbs from the trunk outwards, and the spine from the root to the head."""

    spine: tuple[int, ...]
    left_arm: tuple[int, ...]
    right_arm: tuple[int, ...]
    left_leg: tuple[int, ...]
    right_leg: tuple[int, ...]


class _BodyBuilder:
    """Collects points and parts. A point is the index of its row of weights."""

    def __init__(self, num_joints: int):
        self.rows = list(np.eye(num_joints, dtype=np.float32))
        self.parts: list[BodyPart] = []

    def blend(self, weights: dict[int, float]) -> int:
        """Adds and returns a point: the weighted sum of points. The weights must add up to one."""
        row = sum(weight * self.rows[point] for point, weight in weights.items())
        self.rows.append(np.asarray(row, np.float32))
        return len(self.rows) - 1

    def between(self, start: int, end: int, fraction: float) -> int:
        """Adds and returns the point at `fraction` of the way from `start` to `end`, beyond `end` if it is above 1."""
        return self.blend({start: 1 - fraction, end: fraction})

    def add(self, start: int, end: int, start_radius: float, end_radius: float, tint: Tint) -> None:
        """Adds a capsule between two points."""
        self.parts.append(BodyPart(start, end, start_radius, end_radius, tint))


def is_mirrored(skeleton: Skeleton) -> bool:
    """Returns whether the joints of this skeleton are mirrored. KIT-ML's y and z axes were exchanged."""
    return skeleton.name == "kit_ml"


def roles_from_skeleton(skeleton: Skeleton) -> Roles:
    """Returns the arms, legs and spine, with the sides after mirroring is undone."""
    right_hip, left_hip, right_shoulder, left_shoulder = skeleton.face_joints
    if is_mirrored(skeleton):
        left_hip, right_hip, left_shoulder, right_shoulder = right_hip, left_hip, right_shoulder, left_shoulder

    def outwards(joint: int) -> tuple[int, ...]:
        """Returns the part of the chain that starts at `joint`."""
        chain = next(chain for chain in skeleton.chains if joint in chain)
        return tuple(chain[chain.index(joint) :])

    limbs = tuple(outwards(joint) for joint in (left_shoulder, right_shoulder, left_hip, right_hip))
    (spine,) = (chain for chain in skeleton.chains if not any(set(limb) & set(chain) for limb in limbs))
    return Roles(tuple(spine), *limbs)


@functools.lru_cache
def body_from_skeleton(skeleton: Skeleton) -> Body:
    """Returns the body of a skeleton."""
    builder = _BodyBuilder(skeleton.num_joints)
    roles = roles_from_skeleton(skeleton)
    _add_limbs(builder, roles.left_arm, roles.left_leg, "left")
    _add_limbs(builder, roles.right_arm, roles.right_leg, "right")
    _add_trunk(builder, roles)
    head = _add_head(builder, roles, skeleton)
    weights = np.stack(builder.rows)
    face = len(weights)
    # The two points of the face come after all weighted points (see `figure_points`).
    builder.add(face, face + 1, 0.036, 0.036, "face")
    return Body(weights, tuple(builder.parts), head)


def _add_limbs(builder: _BodyBuilder, arm: tuple[int, ...], leg: tuple[int, ...], tint: Tint) -> None:
    """Adds an arm with a mitten as hand, and a leg with calf, heel and toes."""
    shoulder, elbow, wrist = arm[:3]
    swell = builder.between(elbow, wrist, 0.25)
    palm = builder.between(elbow, wrist, 1.22)
    fingers = builder.between(elbow, wrist, 1.5)
    builder.add(shoulder, elbow, 0.054, 0.038, tint)
    builder.add(elbow, swell, 0.038, 0.040, tint)
    builder.add(swell, wrist, 0.040, 0.026, tint)
    builder.add(wrist, palm, 0.026, 0.037, tint)
    builder.add(palm, fingers, 0.037, 0.019, tint)
    hip, knee, ankle = leg[:3]
    toe = leg[-1]
    calf = builder.between(knee, ankle, 0.27)
    heel = builder.blend({ankle: 1.38, knee: -0.12, toe: -0.26})
    tip = builder.between(heel, toe, 1.28)
    builder.add(hip, knee, 0.086, 0.055, tint)
    builder.add(knee, calf, 0.055, 0.057, tint)
    builder.add(calf, ankle, 0.057, 0.036, tint)
    builder.add(ankle, heel, 0.036, 0.034, tint)
    builder.add(heel, toe, 0.034, 0.036, tint)
    builder.add(ankle, toe, 0.037, 0.034, tint)
    builder.add(toe, tip, 0.036, 0.028, tint)


def _add_trunk(builder: _BodyBuilder, roles: Roles) -> None:
    """Adds pelvis, spine, ribs that widen toward the shoulders, and shoulders."""
    sides: tuple[tuple[int, int, Tint], ...] = (
        (roles.left_leg[0], roles.left_arm[0], "left"),
        (roles.right_leg[0], roles.right_arm[0], "right"),
    )
    hips = builder.between(sides[0][0], sides[1][0], 0.5)
    shoulders = builder.between(sides[0][1], sides[1][1], 0.5)
    spine = (hips, *roles.spine[1:-1])
    radii = np.interp(np.linspace(0, 1, len(spine)), SPINE_FRACTIONS, SPINE_RADII).tolist()
    for start, end, start_radius, end_radius in zip(spine, spine[1:], radii, radii[1:], strict=False):
        builder.add(start, end, start_radius, end_radius, "body")
    middle = spine[len(spine) // 2]
    neck = spine[-1]
    for hip, shoulder, _ in sides:
        outer = builder.between(shoulders, shoulder, 0.62)
        waist = builder.blend({hips: 0.25, hip: 0.25, middle: 0.5})
        flank = builder.blend({middle: 0.72, outer: 0.28})
        builder.add(hips, hip, 0.108, 0.096, "body")
        builder.add(hip, waist, 0.096, 0.090, "body")
        builder.add(flank, outer, 0.090, 0.074, "body")
        builder.add(outer, shoulder, 0.070, 0.056, "body")
        builder.add(neck, outer, 0.050, 0.060, "body")
    builder.add(shoulders, neck, 0.085, 0.055, "body")


def _add_head(builder: _BodyBuilder, roles: Roles, skeleton: Skeleton) -> int:
    """Adds neck, jaw and skull, and returns the center of the head."""
    chest, neck, tip = roles.spine[-3:]
    leg = skeleton.bone_lengths[roles.left_leg[1]] + skeleton.bone_lengths[roles.left_leg[2]]
    meter = REFERENCE_LEG / float(leg)
    trunk_length = skeleton.bone_lengths[neck] * meter
    neck_length = skeleton.bone_lengths[tip] * meter

    def above(distance: float) -> int:
        """Returns the point `distance` meters beyond the last joint, in a direction between those of neck and trunk."""
        along_trunk = 0.6 * distance / trunk_length
        along_neck = 0.4 * distance / neck_length
        return builder.blend({tip: 1 + along_neck, neck: along_trunk - along_neck, chest: -along_trunk})

    jaw = above(0.012)
    crown = above(0.092)
    builder.add(neck, tip, 0.055, 0.050, "body")
    builder.add(jaw, crown, 0.070, 0.096, "body")
    return above(0.062)


def figure_scale(positions: Float[np.ndarray, "T J 3"], skeleton: Skeleton) -> float:
    """Returns the leg length relative to the reference figure. Radii have to be multiplied by it."""
    roles = roles_from_skeleton(skeleton)
    bones = [leg[joint : joint + 2] for leg in (roles.left_leg, roles.right_leg) for joint in (0, 1)]
    lengths = [np.linalg.norm(positions[:, end] - positions[:, start], axis=-1) for start, end in bones]
    # The median, because a decoder stretches bones in single frames.
    return max(float(np.median(np.sum(lengths, axis=0))) / 2, 1e-3) / REFERENCE_LEG


def figure_points(positions: Float[np.ndarray, "T J 3"], skeleton: Skeleton) -> Float[np.ndarray, "T P 3"]:
    """Returns the points of `body_from_skeleton` for each frame. The joints come first."""
    body = body_from_skeleton(skeleton)
    points = np.einsum("pj,tjc->tpc", body.weights, positions, optimize=True)
    # Both ends of the face plate. The head looks in the direction of the shoulders, turned by the displacement of the
    # head joint from the neck.
    roles = roles_from_skeleton(skeleton)
    _, neck, tip = roles.spine[-3:]
    across = unit_vectors(points[:, roles.left_arm[0]] - points[:, roles.right_arm[0]])
    up = unit_vectors(points[:, body.head] - points[:, neck])
    forward = unit_vectors(np.cross(across, up))
    lean = points[:, tip] - points[:, neck]
    lean = lean - np.sum(lean * up, axis=-1, keepdims=True) * up
    forward = unit_vectors(
        forward + lean / np.maximum(np.linalg.norm(points[:, tip] - points[:, neck], axis=-1), 1e-6)[:, None]
    )
    side = np.cross(up, forward)
    eyes = np.stack([0.066 * forward + 0.034 * side, 0.066 * forward - 0.034 * side], axis=1) + 0.012 * up[:, None]
    eyes *= figure_scale(positions, skeleton)
    return np.concatenate([points, points[:, body.head, None] + eyes], axis=1).astype(np.float32)
