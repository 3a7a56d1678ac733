"""A motion as BVH files hold it: a hierarchy of joints, local rotations and translations."""

import dataclasses

import numpy as np
from jaxtyping import Float

from t2m_jax.motion.bvh.kinematics import forward_kinematics


@dataclasses.dataclass(frozen=True, kw_only=True)
class BvhClip:
    """One clip of one figure. All lengths are metres, whatever the file's unit was."""

    joint_names: tuple[str, ...]
    """Names in the order of the file."""
    parents: tuple[int, ...]
    """Index of each joint's parent, always smaller than the joint's own; -1 for the root."""
    offsets: Float[np.ndarray, "J 3"]
    """OFFSET of each joint: the rest pose."""
    rotations: Float[np.ndarray, "T J 3 3"]
    """Rotation of each joint in its parent's frame."""
    translations: Float[np.ndarray, "T J 3"]
    """Position of each joint in its parent's frame, position channels resolved."""
    fps: float
    """Frames per second."""
    metres_per_unit: float
    """Factor that was applied to the numbers of the file."""

    @property
    def num_frames(self) -> int:
        """Returns the number of frames."""
        return len(self.rotations)

    @property
    def positions(self) -> Float[np.ndarray, "T J 3"]:
        """Returns the world positions of all joints in metres."""
        return forward_kinematics(self.rotations, self.translations, self.parents).positions
