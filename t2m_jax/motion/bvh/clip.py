"""The content of a BVH file: a hierarchy of joints, local rotations and translations."""

import dataclasses

import numpy as np
from jaxtyping import Float

from t2m_jax.motion.bvh.kinematics import forward_kinematics


@dataclasses.dataclass(frozen=True, kw_only=True)
class BvhClip:
    """One clip of one figure. All lengths are in meters, whatever the file's unit was."""

    joint_names: tuple[str, ...]
    """Names in their order in the file."""
    parents: tuple[int, ...]
    """Index of each joint's parent, always smaller than the joint's own; -1 for the root."""
    offsets: Float[np.ndarray, "J 3"]
    """OFFSET of each joint, which is the rest pose."""
    rotations: Float[np.ndarray, "T J 3 3"]
    """Rotation of each joint in its parent's frame."""
    translations: Float[np.ndarray, "T J 3"]
    """Position of each joint in its parent's frame, with the position channels applied."""
    fps: float
    """Frames per second."""
    metres_per_unit: float
    """Factor by which the numbers of the file were multiplied."""

    @property
    def num_frames(self) -> int:
        """Number of frames."""
        return len(self.rotations)

    @property
    def positions(self) -> Float[np.ndarray, "T J 3"]:
        """World positions of all joints in meters."""
        return forward_kinematics(self.rotations, self.translations, self.parents).positions
