"""The two skeletons with motion features, HumanML3D (22 joints) and KIT-ML (21 joints), and the columns of features."""

import dataclasses
import itertools
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from t2m_jax.errors import UserError
from t2m_jax.motion.namespace import EitherArray

_ROOT = (0.0, 0.0, 0.0)
_X = (1.0, 0.0, 0.0)
_Y = (0.0, 1.0, 0.0)
_Z = (0.0, 0.0, 1.0)
_MINUS_X = (-1.0, 0.0, 0.0)
_MINUS_Y = (0.0, -1.0, 0.0)


class FeatureLayout(NamedTuple):
    """The seven groups of columns of a feature row, in order. The columns of a group share one standard deviation."""

    root_yaw: slice
    """Half the yaw step from this frame to the next, in radians."""
    root_velocity: slice
    """The root's step in x and z, relative to the next frame's heading."""
    root_height: slice
    """The root's height above the floor."""
    positions: slice
    """Local positions of joints 1 … J-1, x y z per joint."""
    rotations: slice
    """6D rotations of joints 1 … J-1."""
    velocities: slice
    """Local velocities of joints 0 … J-1, length per frame."""
    contacts: slice
    """Four foot contacts: left ankle, left toe, right ankle, right toe."""

    @property
    def feature_dim(self) -> int:
        """Number of columns."""
        return self.contacts.stop


def make_layout(num_joints: int) -> FeatureLayout:
    """Returns the columns for a skeleton of `num_joints` joints, including the root."""
    inner = num_joints - 1
    sizes = (1, 2, 1, 3 * inner, 6 * inner, 3 * num_joints, 4)
    ends = itertools.accumulate(sizes)
    return FeatureLayout(*(slice(end - size, end) for end, size in zip(ends, sizes, strict=True)))


@dataclasses.dataclass(frozen=True, kw_only=True)
class Skeleton:
    """A tree of joints with the constants that features depend on. It is hashable, for static arguments of `jit`."""

    name: str
    """Name in `dataset.yaml` and in error messages."""
    joint_names: tuple[str, ...]
    """One name per joint. The first one is the root."""
    parents: tuple[int, ...]
    """Index of each joint's parent, always smaller than the joint's own; -1 for the root."""
    rest_axes: tuple[tuple[float, float, float], ...]
    """Unit vector from the parent to each joint in the rest pose; zero for the root."""
    bone_lengths: tuple[float, ...]
    """Length of the bone that ends at each joint, in the skeleton's unit; zero for the root."""
    chains: tuple[tuple[int, ...], ...]
    """Limbs from their first joint outwards. Each bone is in exactly one."""
    face_joints: tuple[int, int, int, int]
    """Right hip, left hip, right shoulder, left shoulder, as the published code names them. They define the heading."""
    leg_joints: tuple[int, int]
    """Ends of the thigh and the shin whose lengths define the scale of a figure."""
    left_foot: tuple[int, int]
    """Ankle and toe of the first two contact columns."""
    right_foot: tuple[int, int]
    """Ankle and toe of the last two contact columns."""
    mirror_pairs: tuple[tuple[int, int], ...]
    """Left and right joints that mirroring exchanges."""
    fps: float
    """Frames per second of its data sets."""
    metres_per_unit: float
    """Length of one unit of its positions in meters."""
    contact_threshold: float
    """A foot joint touches the ground if its squared step in one frame is below this, in squared units."""
    min_frames: int
    """Shortest clip for training and evaluation, in feature rows."""
    max_frames: int
    """Longest motion for training and evaluation, in feature rows."""

    @property
    def num_joints(self) -> int:
        """Number of joints, including the root."""
        return len(self.parents)

    @property
    def layout(self) -> FeatureLayout:
        """Columns of the features."""
        return make_layout(self.num_joints)

    @property
    def feature_dim(self) -> int:
        """Number of features per frame."""
        return self.layout.feature_dim

    @property
    def offsets(self) -> Float[np.ndarray, "J 3"]:
        """Vectors from parent to joint in the rest pose: rest axis times bone length, float32."""
        return np.asarray(self.rest_axes, np.float32) * np.asarray(self.bone_lengths, np.float32)[:, None]

    def children(self, joint: int) -> tuple[int, ...]:
        """Returns the joints whose parent is `joint`."""
        return tuple(child for child, parent in enumerate(self.parents) if parent == joint)

    def check_joints(self, positions: EitherArray) -> None:
        """Raises `UserError` unless `positions` [..., J, 3] have this skeleton's number of joints."""
        if positions.ndim < 2 or positions.shape[-1] != 3:
            raise UserError(f"positions have shape {tuple(positions.shape)}; give [..., frames, joints, 3]")
        if positions.shape[-2] != self.num_joints:
            raise UserError(
                f"positions have {positions.shape[-2]} joints, but skeleton {self.name} has {self.num_joints}; "
                "choose the joints of the skeleton, in its order"
            )


# fmt: off
HUMANML3D = Skeleton(
    name="humanml3d",
    joint_names=(
        "pelvis", "left_hip", "right_hip", "spine1", "left_knee", "right_knee", "spine2", "left_ankle", "right_ankle",
        "spine3", "left_foot", "right_foot", "neck", "left_collar", "right_collar", "head", "left_shoulder",
        "right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist",
    ),
    parents=(-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19),
    rest_axes=(
        _ROOT, _X, _MINUS_X, _Y, _MINUS_Y, _MINUS_Y, _Y, _MINUS_Y, _MINUS_Y, _Y, _Z, _Z, _Y, _X, _MINUS_X, _Z,
        _MINUS_Y, _MINUS_Y, _MINUS_Y, _MINUS_Y, _MINUS_Y, _MINUS_Y,
    ),
    # These were measured on a person, so the left and right sides differ.
    bone_lengths=(
        0.0, 0.10307397, 0.10988337, 0.13156824, 0.3936232, 0.39018822, 0.14319022, 0.43243307,
        0.42564335, 0.057364736, 0.14338182, 0.14941907, 0.21936005, 0.13748677, 0.14338283, 0.10303922,
        0.13161404, 0.12298438, 0.25684, 0.26309174, 0.26601171, 0.2698764,
    ),
    chains=((0, 2, 5, 8, 11), (0, 1, 4, 7, 10), (0, 3, 6, 9, 12, 15), (9, 14, 17, 19, 21), (9, 13, 16, 18, 20)),
    face_joints=(2, 1, 17, 16),
    leg_joints=(5, 8),
    left_foot=(7, 10),
    right_foot=(8, 11),
    mirror_pairs=((1, 2), (4, 5), (7, 8), (10, 11), (13, 14), (16, 17), (18, 19), (20, 21)),
    fps=20.0,
    metres_per_unit=1.0,
    contact_threshold=0.002,
    # HumanML3D's authors use clips of 2 to 10 seconds.
    min_frames=40,
    max_frames=196,
)

# KIT-ML's body is one meter tall, but its root moves as far as a person's. Drawings need about 1.7 times this scale.
# Its joints are mirrored in a right-handed frame, so left and right are exchanged between joint names and feet or face.
KIT_ML = Skeleton(
    name="kit_ml",
    joint_names=(
        "root", "BP", "BT", "BLN", "BUN", "LS", "LE", "LW", "RS", "RE", "RW", "LH", "LK", "LA", "LMrot", "LF",
        "RH", "RK", "RA", "RMrot", "RF",
    ),
    parents=(-1, 0, 1, 2, 3, 3, 5, 6, 3, 8, 9, 0, 11, 12, 13, 14, 0, 16, 17, 18, 19),
    rest_axes=(
        _ROOT, _Y, _Y, _Y, _Y, _X, _MINUS_Y, _MINUS_Y, _MINUS_X, _MINUS_Y, _MINUS_Y,
        _X, _MINUS_Y, _MINUS_Y, _Z, _Z, _MINUS_X, _MINUS_Y, _MINUS_Y, _Z, _Z,
    ),
    bone_lengths=(
        0.0, 80.0, 120.0, 44.0, 30.0, 110.0, 188.0, 145.0, 110.0, 188.0, 145.0,
        52.0, 245.0, 246.0, 30.273586, 56.28934, 52.0, 245.0, 246.0, 30.273586, 56.287346,
    ),
    chains=((0, 11, 12, 13, 14, 15), (0, 16, 17, 18, 19, 20), (0, 1, 2, 3, 4), (3, 5, 6, 7), (3, 8, 9, 10)),
    face_joints=(11, 16, 5, 8),
    leg_joints=(17, 18),
    left_foot=(19, 20),
    right_foot=(14, 15),
    mirror_pairs=((5, 8), (6, 9), (7, 10), (11, 16), (12, 17), (13, 18), (14, 19), (15, 20)),
    fps=12.5,
    metres_per_unit=0.001,
    contact_threshold=0.05,
    min_frames=24,
    max_frames=196,
)
# fmt: on

JOINT = {name: number for number, name in enumerate(HUMANML3D.joint_names)}
"""Number of each joint of `HUMANML3D`."""
SKELETONS = (HUMANML3D, KIT_ML)


def skeleton_from_name(name: str) -> Skeleton:
    """Returns the skeleton with this name.

    Raises:
        UserError: No skeleton has this name.
    """
    known = {skeleton.name: skeleton for skeleton in SKELETONS}
    if name not in known:
        raise UserError(f"unknown skeleton {name!r}; use one of: {', '.join(known)}")
    return known[name]


def skeleton_from_feature_dim(feature_dim: int) -> Skeleton:
    """Returns the skeleton that has `feature_dim` features.

    Raises:
        UserError: No skeleton has features of this width.
    """
    for skeleton in SKELETONS:
        if skeleton.feature_dim == feature_dim:
            return skeleton
    known = ", ".join(f"{skeleton.feature_dim} ({skeleton.name})" for skeleton in SKELETONS)
    raise UserError(f"no skeleton has motion features of width {feature_dim}; known widths: {known}")
