"""A clip of a figure with any joints, as BVH, glTF and AMC files have them: local rotations and translations."""

import dataclasses
from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from t2m_jax.motion import resampling
from t2m_jax.motion.kinematics import JointPoses, forward_kinematics, rest_positions
from t2m_jax.motion.part_captions import Parts
from t2m_jax.motion.rotations import continuous_quaternions, matrix_from_quaternion, quaternion_from_matrix

MAX_VALUE = 1e9
"""Size of an offset or a channel from which on it must be a mistake: a thousand kilometers in millimeters."""
MAX_JOINTS = 2000
"""Most joints of a figure. Those with fingers, face and clothes have up to some hundred."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class RigClip:
    """From a file to `retarget`: one clip of one figure. All lengths are in meters, whatever the file's unit was."""

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
    end_sites: Mapping[int, Float[np.ndarray, " 3"]] = dataclasses.field(default_factory=dict)
    """Joint -> place of its End Site in its frame: the tip of a toe, a hand or the head."""
    caption: str = ""
    """What this package wrote about it in a GLB file, or there the name of the animation without the armature's."""
    parts: Parts = ()
    """Where each sentence begins, in files of this package."""
    rest_rotations: Float[np.ndarray, "J 3 3"] | None = None
    """Rotations of the rest pose, which files other than GLB do not have."""
    is_person: bool = False
    """Whether the file itself says which of its joints are those of a person, as VRM files do."""
    notes: tuple[str, ...] = ()
    """What the reader had to assume, each a part of a sentence to show."""

    @property
    def num_frames(self) -> int:
        """Number of frames."""
        return len(self.rotations)

    @property
    def positions(self) -> Float[np.ndarray, "T J 3"]:
        """World positions of all joints in meters."""
        return self.poses.positions

    @property
    def poses(self) -> JointPoses:
        """World positions and rotations of all joints."""
        return forward_kinematics(self.rotations, self.translations, self.parents)

    def from_frame(self, frame: int, end: int | None = None) -> "RigClip":
        """Returns the clip without the frames before `frame`, and without those from `end`."""
        return dataclasses.replace(
            self, rotations=self.rotations[frame:end], translations=self.translations[frame:end], parts=()
        )

    def resampled(self, fps: float) -> "RigClip":
        """Returns the clip at another frame rate. Frame k is the pose at k / `fps` seconds (see `resampling.resample`).

        Raises:
            UserError: The rate is not a number above 0.
        """
        if fps == self.fps:
            return self
        # Quaternions are filtered, so that it does not matter how a file writes its angles.
        quaternions = continuous_quaternions(quaternion_from_matrix(self.rotations))
        return dataclasses.replace(
            self,
            rotations=matrix_from_quaternion(resampling.resample(quaternions, fps=self.fps, new_fps=fps)),
            translations=resampling.resample(self.translations, fps=self.fps, new_fps=fps),
            fps=float(fps),
            parts=(),
        )

    def scaled(self, factor: float) -> "RigClip":
        """Returns the clip of a figure that is larger by a factor."""
        return dataclasses.replace(
            self,
            offsets=(self.offsets * factor).astype(np.float32),
            translations=(self.translations * factor).astype(np.float32),
            metres_per_unit=self.metres_per_unit * factor,
            end_sites={joint: (place * factor).astype(np.float32) for joint, place in self.end_sites.items()},
        )

    @property
    def rest_positions(self) -> Float[np.ndarray, "J 3"]:
        """World positions of all joints without any rotation, in meters."""
        return rest_positions(self.offsets, self.parents)

    def with_end_sites(self) -> "RigClip":
        """Returns the clip with a joint at each End Site, named "<joint> End Site"."""
        joints = list(self.end_sites)
        offsets = np.array(list(self.end_sites.values()), np.float32).reshape(-1, 3)
        still = np.broadcast_to(np.eye(3, dtype=np.float32), (self.num_frames, len(joints), 3, 3))
        return dataclasses.replace(
            self,
            joint_names=(*self.joint_names, *(f"{self.joint_names[joint]} End Site" for joint in joints)),
            parents=(*self.parents, *joints),
            offsets=np.concatenate([self.offsets, offsets]),
            rotations=np.concatenate([self.rotations, still], axis=1),
            # The tip of a limb does not turn, so its place in the joint's frame is constant.
            translations=np.concatenate([self.translations, np.tile(offsets, (self.num_frames, 1, 1))], axis=1),
            end_sites={},
        )
