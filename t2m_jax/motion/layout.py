"""The columns of motion features."""

import dataclasses
import itertools


@dataclasses.dataclass(frozen=True)
class FeatureLayout:
    """The columns of a feature row for a skeleton of `num_joints` joints.

    The columns are: half the yaw step (radians per frame), root step in x and z, root height, local positions of all
    joints except the root, their 6D rotations, local velocities of all joints, and four foot contacts (left ankle, left
    toe, right ankle, right toe).
    """

    num_joints: int
    """Number of joints, including the root."""

    @property
    def feature_dim(self) -> int:
        """Number of columns."""
        return 12 * self.num_joints - 1

    @property
    def groups(self) -> tuple[slice, ...]:
        """The seven groups in column order. The columns of a group share one standard deviation."""
        sizes = (1, 2, 1, 3 * (self.num_joints - 1), 6 * (self.num_joints - 1), 3 * self.num_joints, 4)
        ends = tuple(itertools.accumulate(sizes))
        return tuple(slice(end - size, end) for end, size in zip(ends, sizes, strict=True))

    @property
    def root_yaw(self) -> slice:
        """Column of half the yaw step from this frame to the next, in radians."""
        return self.groups[0]

    @property
    def root_velocity(self) -> slice:
        """Two columns of the root's step in x and z, relative to the next frame's heading."""
        return self.groups[1]

    @property
    def root_height(self) -> slice:
        """Column of the root's height above the floor."""
        return self.groups[2]

    @property
    def positions(self) -> slice:
        """Columns of the local positions of joints 1 … J−1, x y z per joint."""
        return self.groups[3]

    @property
    def rotations(self) -> slice:
        """Columns of the 6D rotations of joints 1 … J−1."""
        return self.groups[4]

    @property
    def velocities(self) -> slice:
        """Columns of the local velocities of joints 0 … J−1, length per frame."""
        return self.groups[5]

    @property
    def contacts(self) -> slice:
        """Four columns of foot contacts."""
        return self.groups[6]
