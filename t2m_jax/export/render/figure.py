"""A body around a skeleton: tapered limbs, a head that looks somewhere, hands and feet, for every renderer alike."""

import functools
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from t2m_jax.motion.skeleton import Skeleton

Tint = Literal["body", "left", "right", "face"]
TINTS: tuple[Tint, ...] = ("body", "left", "right", "face")

REFERENCE_LEG = 0.815832
"""Thigh plus shin, metres, of the figure the radii below are written for."""

# Along the spine: fractions of the way from the hips to the base of the neck, radii in metres there.
SPINE_FRACTIONS = (0.0, 0.3, 0.6, 0.85, 1.0)
SPINE_RADII = (0.120, 0.110, 0.118, 0.112, 0.066)


class BodyPart(NamedTuple):
    """A tapered capsule between two points of a figure; radii in metres for a leg of `REFERENCE_LEG`."""

    start: int
    end: int
    start_radius: float
    end_radius: float
    tint: Tint


class Body(NamedTuple):
    """Points as blends of joints (the joints themselves first) and the parts drawn between them."""

    weights: Float[np.ndarray, "P J"]
    parts: tuple[BodyPart, ...]
    head: int
    """Point around which the head is drawn."""

    face: int | None
    """First of two more points, in front of the head, that depend on where it looks; None for a plain skeleton."""


class Roles(NamedTuple):
    """Joints of a person: each limb from the trunk outwards, the spine from the root to the head."""

    spine: tuple[int, ...]
    left_arm: tuple[int, ...]
    right_arm: tuple[int, ...]
    left_leg: tuple[int, ...]
    right_leg: tuple[int, ...]


class _BodyBuilder:
    """Collects points and parts; a point is the number of its row of weights."""

    def __init__(self, num_joints: int):
        self.rows = list(np.eye(num_joints, dtype=np.float32))
        self.parts: list[BodyPart] = []

    def blend(self, **weights: float) -> int:
        """Returns a new point: the sum of points `p7=0.5` times their weights, which have to add up to one."""
        row = sum(weight * self.rows[int(name[1:])] for name, weight in weights.items())
        self.rows.append(np.asarray(row, np.float32))
        return len(self.rows) - 1

    def between(self, start: int, end: int, fraction: float) -> int:
        """Returns the point at `fraction` of the way from `start` to `end`; above one it lies beyond `end`."""
        self.rows.append(np.asarray((1 - fraction) * self.rows[start] + fraction * self.rows[end], np.float32))
        return len(self.rows) - 1

    def add(self, start: int, end: int, start_radius: float, end_radius: float, tint: Tint) -> None:
        """Adds a capsule between two points."""
        self.parts.append(BodyPart(start, end, start_radius, end_radius, tint))


def is_mirrored(skeleton: Skeleton) -> bool:
    """Returns whether joints of this skeleton are mirror images: KIT-ML's y and z axes were exchanged, a reflection."""
    return skeleton.name == "kit_ml"


def roles_from_skeleton(skeleton: Skeleton) -> Roles | None:
    """Returns who is arm, leg and spine, sides as seen once mirroring is undone; None if this is no such skeleton."""
    right_hip, left_hip, right_shoulder, left_shoulder = skeleton.face_joints
    if is_mirrored(skeleton):
        left_hip, right_hip, left_shoulder, right_shoulder = right_hip, left_hip, right_shoulder, left_shoulder

    def outwards(joint: int) -> tuple[int, ...]:
        """Returns the chain through `joint`, from there on."""
        chain = next(chain for chain in skeleton.chains if joint in chain)
        return tuple(chain[chain.index(joint) :])

    limbs = tuple(outwards(joint) for joint in (left_shoulder, right_shoulder, left_hip, right_hip))
    spines = [chain for chain in skeleton.chains if not any(set(limb) & set(chain) for limb in limbs)]
    if len(spines) != 1 or len(spines[0]) < 4 or any(len(limb) < 3 for limb in limbs) or min(map(len, limbs[2:])) < 4:
        return None
    return Roles(tuple(spines[0]), *limbs)


@functools.lru_cache
def body_from_skeleton(skeleton: Skeleton) -> Body:
    """Returns the body to draw around a skeleton: a person where it has the limbs of one, else its bare bones."""
    builder = _BodyBuilder(skeleton.num_joints)
    roles = roles_from_skeleton(skeleton)
    if roles is None:
        return _stick_body(builder, skeleton)
    left: Tint = "left"
    right: Tint = "right"
    for arm, leg, tint in ((roles.left_arm, roles.left_leg, left), (roles.right_arm, roles.right_leg, right)):
        _add_arm(builder, arm, tint)
        _add_leg(builder, leg, tint)
    _add_trunk(builder, roles)
    head = _add_head(builder, roles, skeleton)
    weights = np.stack(builder.rows)
    face = len(weights)
    builder.add(face, face + 1, 0.036, 0.036, "face")
    return Body(weights, tuple(builder.parts), head, face)


def _stick_body(builder: _BodyBuilder, skeleton: Skeleton) -> Body:
    """Returns an even tube around every bone and a ball around the root."""
    for joint, parent in enumerate(skeleton.parents):
        if parent >= 0:
            builder.add(parent, joint, 0.035, 0.028, "body")
    builder.add(0, 0, 0.06, 0.06, "body")
    return Body(np.stack(builder.rows), tuple(builder.parts), 0, None)


def _add_arm(builder: _BodyBuilder, arm: tuple[int, ...], tint: Tint) -> None:
    """Adds upper arm, forearm with its swell below the elbow, and a mitten of a hand."""
    shoulder, elbow, wrist = arm[0], arm[1], arm[2]
    swell = builder.between(elbow, wrist, 0.25)
    palm = builder.between(elbow, wrist, 1.22)
    fingers = builder.between(elbow, wrist, 1.5)
    builder.add(shoulder, elbow, 0.054, 0.038, tint)
    builder.add(elbow, swell, 0.038, 0.040, tint)
    builder.add(swell, wrist, 0.040, 0.026, tint)
    builder.add(wrist, palm, 0.026, 0.037, tint)
    builder.add(palm, fingers, 0.037, 0.019, tint)


def _add_leg(builder: _BodyBuilder, leg: tuple[int, ...], tint: Tint) -> None:
    """Adds thigh, shin with its calf, and a foot with heel and toes."""
    hip, knee, ankle, toe = leg[0], leg[1], leg[2], leg[-1]
    calf = builder.between(knee, ankle, 0.27)
    heel = builder.blend(**{f"p{ankle}": 1.38, f"p{knee}": -0.12, f"p{toe}": -0.26})
    tip = builder.between(heel, toe, 1.28)
    builder.add(hip, knee, 0.086, 0.055, tint)
    builder.add(knee, calf, 0.055, 0.057, tint)
    builder.add(calf, ankle, 0.057, 0.036, tint)
    builder.add(ankle, heel, 0.036, 0.034, tint)
    builder.add(heel, toe, 0.034, 0.036, tint)
    builder.add(ankle, toe, 0.037, 0.034, tint)
    builder.add(toe, tip, 0.036, 0.028, tint)


def _add_trunk(builder: _BodyBuilder, roles: Roles) -> None:
    """Adds pelvis, spine, ribs that widen towards the shoulders, and the shoulder line."""
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
        waist = builder.blend(**{f"p{hips}": 0.25, f"p{hip}": 0.25, f"p{middle}": 0.5})
        flank = builder.blend(**{f"p{middle}": 0.72, f"p{outer}": 0.28})
        builder.add(hips, hip, 0.108, 0.096, "body")
        builder.add(hip, waist, 0.096, 0.090, "body")
        builder.add(flank, outer, 0.090, 0.074, "body")
        builder.add(outer, shoulder, 0.070, 0.056, "body")
        builder.add(neck, outer, 0.050, 0.060, "body")
    builder.add(shoulders, neck, 0.085, 0.055, "body")


def _add_head(builder: _BodyBuilder, roles: Roles, skeleton: Skeleton) -> int:
    """Returns the middle of the head after adding neck, jaw and skull."""
    chest, neck, tip = roles.spine[-3:]
    metre = REFERENCE_LEG / _template_leg(skeleton, roles)
    trunk_length = skeleton.bone_lengths[neck] * metre
    neck_length = skeleton.bone_lengths[tip] * metre

    def above(distance: float) -> int:
        """Returns the point `distance` metres beyond the last joint, partly along the neck, partly along the trunk."""
        along_trunk, along_neck = 0.6 * distance / trunk_length, 0.4 * distance / neck_length
        joints = {f"p{tip}": 1 + along_neck, f"p{neck}": along_trunk - along_neck, f"p{chest}": -along_trunk}
        return builder.blend(**joints)

    jaw, crown = above(0.012), above(0.092)
    builder.add(neck, tip, 0.055, 0.050, "body")
    builder.add(jaw, crown, 0.070, 0.096, "body")
    return above(0.062)


def _template_leg(skeleton: Skeleton, roles: Roles) -> float:
    """Returns thigh plus shin of the template, in the skeleton's unit."""
    return float(skeleton.bone_lengths[roles.left_leg[1]] + skeleton.bone_lengths[roles.left_leg[2]])


def figure_scale(positions: Float[np.ndarray, "T J 3"], skeleton: Skeleton) -> float:
    """Returns leg length over that of the reference figure: what radii have to be multiplied by."""
    roles = roles_from_skeleton(skeleton)
    if roles is None:
        height = float(np.ptp(positions[0], axis=0).max())
        return max(height, 1e-3) / (2 * REFERENCE_LEG)
    bones = [leg[joint : joint + 2] for leg in (roles.left_leg, roles.right_leg) for joint in (0, 1)]
    lengths = [np.linalg.norm(positions[:, end] - positions[:, start], axis=-1) for start, end in bones]
    return max(float(np.median(np.sum(lengths, axis=0))) / 2, 1e-3) / REFERENCE_LEG


def figure_points(positions: Float[np.ndarray, "T J 3"], skeleton: Skeleton) -> Float[np.ndarray, "T P 3"]:
    """Returns the points the parts of `body_from_skeleton` hang on, for every frame; the joints come first."""
    body = body_from_skeleton(skeleton)
    points = np.einsum("pj,tjc->tpc", body.weights, positions, optimize=True)
    if body.face is None:
        return points.astype(np.float32)
    eyes = _eye_points(points, body.head, skeleton) * figure_scale(positions, skeleton)
    return np.concatenate([points, points[:, body.head, None] + eyes], axis=1).astype(np.float32)


def _eye_points(points: Float[np.ndarray, "T P 3"], head: int, skeleton: Skeleton) -> Float[np.ndarray, "T 2 3"]:
    """Returns both ends of the face plate relative to the head's middle, in metres of the reference figure.

    The head looks where the shoulders face, turned by as much as the head joint lies in front of the neck.
    """
    roles = roles_from_skeleton(skeleton)
    assert roles is not None
    _, neck, tip = roles.spine[-3:]
    across = _unit(points[:, roles.left_arm[0]] - points[:, roles.right_arm[0]])
    up = _unit(points[:, head] - points[:, neck])
    forward = _unit(np.cross(across, up))
    lean = points[:, tip] - points[:, neck]
    lean = lean - np.sum(lean * up, axis=-1, keepdims=True) * up
    forward = _unit(
        forward + lean / np.maximum(np.linalg.norm(points[:, tip] - points[:, neck], axis=-1), 1e-6)[:, None]
    )
    side = np.cross(up, forward)
    return np.stack([0.066 * forward + 0.034 * side, 0.066 * forward - 0.034 * side], axis=1) + 0.012 * up[:, None]


def _unit(vectors: Float[np.ndarray, "T 3"]) -> Float[np.ndarray, "T 3"]:
    """Returns the vectors at length one; those without a direction stay zero."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-9)
