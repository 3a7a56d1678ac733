"""Where each quantity of a motion lies in a row of features."""

import dataclasses
import itertools


@dataclasses.dataclass(frozen=True)
class FeatureLayout:
    """The columns of a feature row for a skeleton of `num_joints` joints.

    Columns in order: half yaw step (radians a frame), root step x and z, root height, local positions of all joints but
    the root, their 6D rotations, local velocities of all joints, and four foot contacts (left ankle, left toe, right
    ankle, right toe).
    """

    num_joints: int
    """Joints of the skeleton, the root included."""

    @property
    def feature_dim(self) -> int:
        """Returns the number of columns."""
        return 12 * self.num_joints - 1

    @property
    def groups(self) -> tuple[slice, ...]:
        """Returns the seven groups in column order; the columns of one group share one standard deviation."""
        sizes = (1, 2, 1, 3 * (self.num_joints - 1), 6 * (self.num_joints - 1), 3 * self.num_joints, 4)
        ends = tuple(itertools.accumulate(sizes))
        return tuple(slice(end - size, end) for end, size in zip(ends, sizes, strict=True))

    @property
    def root_yaw(self) -> slice:
        """Returns the column of half the yaw step from this frame to the next, in radians."""
        return self.groups[0]

    @property
    def root_velocity(self) -> slice:
        """Returns the two columns of the root's step in x and z, seen in the next frame's heading."""
        return self.groups[1]

    @property
    def root_height(self) -> slice:
        """Returns the column of the root's height over the floor."""
        return self.groups[2]

    @property
    def positions(self) -> slice:
        """Returns the columns of the local positions of joints 1 … J−1, x y z a joint."""
        return self.groups[3]

    @property
    def rotations(self) -> slice:
        """Returns the columns of the 6D rotations of joints 1 … J−1."""
        return self.groups[4]

    @property
    def velocities(self) -> slice:
        """Returns the columns of the local velocities of joints 0 … J−1, length a frame."""
        return self.groups[5]

    @property
    def contacts(self) -> slice:
        """Returns the four columns of foot contacts."""
        return self.groups[6]
