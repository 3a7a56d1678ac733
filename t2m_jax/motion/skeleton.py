"""The two skeletons with motion features, HumanML3D (22 joints) and KIT-ML (21 joints), and the columns of features."""

import dataclasses
import itertools
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from t2m_jax.config import config_from_dict
from t2m_jax.errors import UserError
from t2m_jax.motion.namespace import EitherArray
from t2m_jax.tables import packaged_table


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


# TOML, because PyYAML takes 50 ms for this file.
_TABLES = packaged_table(__file__, "skeletons")
SKELETONS = tuple(
    config_from_dict(Skeleton, {"name": name, **table}, source="skeletons.toml") for name, table in _TABLES.items()
)
HUMANML3D, KIT_ML = SKELETONS


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
