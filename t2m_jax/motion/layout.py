"""The columns of motion features."""

import itertools
from typing import NamedTuple


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
