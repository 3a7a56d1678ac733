"""How the rest pose of a body turns into the T-pose that rotations of a motion start from.

Limbs are compared by their directions. Spine and collars are not, because programs place these joints by habits of
their own, such as a pelvis behind the hips or collars ahead of the spine. There, the rest pose stands for the mean
posture of the motion, seen from the line between hips and neck.
"""

import itertools

import numpy as np
from jaxtyping import Bool, Float

from t2m_jax.motion.kinematics import rigid_rotations
from t2m_jax.motion.rotations import (
    quaternion_between,
    quaternion_from_matrix,
    quaternion_inverse,
    quaternion_multiply,
    rotate_vectors,
    unit_vectors,
)
from t2m_jax.motion.skeleton import HUMANML3D, JOINT

Quaternion = Float[np.ndarray, "4"]
Matrices = Float[np.ndarray, "T 22 3 3"]
Joints = Float[np.ndarray, "T 22 3"]
Rest = Float[np.ndarray, "22 3"]
Quaternions = Float[np.ndarray, "T 22 4"]

SPINE = ("pelvis", "spine1", "spine2", "spine3", "neck", "head")
UPRIGHT = 0.85
"""The mean posture is that of frames in which the trunk is at least this much along Y (cosine), if there are some."""
MAX_LEAN = np.deg2rad(35.0)
"""Most that a joint of the spine leans against the trunk in the mean posture."""
STANDS = 0.97
"""A body stands upright if the line from hips to neck is this much along Y in its rest pose (cosine)."""
SAME = np.sin(np.deg2rad(1.0))
"""A bone is where the T-pose has it if it is at most this far ahead of it (sine)."""
NEARLY = np.sin(np.deg2rad(5.0))
"""The same above it, since measured bodies are not quite symmetric."""
_X, _Y, _Z = np.eye(3)
_OUT = {"left": _X, "right": -_X}


def align(
    turns: Matrices, positions: Joints, offsets: Rest, rest: Rest, *, foot_pitch: float | None, same_joints: bool
) -> Float[np.ndarray, "22 4"]:
    """Returns the rotation of each joint from the rest pose of a body to the T-pose.

    Args:
        turns: World rotations of the joints of a motion, from the T-pose.
        positions: The motion.
        offsets: Each joint in its parent's frame in the T-pose.
        rest: The joints of the body.
        foot_pitch: Radians by which feet that stand flat point down in the motion. Feet of the body are then flat in
            its rest pose; with None, they are compared by direction.
        same_joints: Whether spine and collars of the body are where the motion has them, and are compared, too.
    """
    if same_joints:
        found = _align_t_pose(offsets, rest)
    else:
        found = _align_posture(_inverse_frame(rest), _mean_posture(turns, positions))
    for side, out in _OUT.items():
        for names, direction in ((("hip", "knee", "ankle"), -_Y), (("shoulder", "elbow", "wrist"), out)):
            # Collars are raised in some rest poses, which is no twist of the arm.
            turn = found["pelvis" if names[0] == "hip" else "facing"]
            for name, following in itertools.pairwise(names):
                turn = found[f"{side}_{name}"] = _swing(turn, _bone(rest, side, name, following), direction)
            found[f"{side}_{names[-1]}"] = turn
        found[f"{side}_ankle"] = _align_foot(found[f"{side}_knee"], _bone(rest, side, "ankle", "foot"), foot_pitch)
        found[f"{side}_foot"] = found[f"{side}_ankle"]
    return np.stack([found[name] for name in HUMANML3D.joint_names])


def _bone(rest: Rest, side: str, first: str, last: str) -> Float[np.ndarray, "3"]:
    return rest[JOINT[f"{side}_{last}"]] - rest[JOINT[f"{side}_{first}"]]


def _swing(start: Quaternion, bone: Float[np.ndarray, "3"], direction: Float[np.ndarray, "3"]) -> Quaternion:
    """Returns a rotation that is followed by the smallest one after which the bone has the direction."""
    return quaternion_multiply(quaternion_between(rotate_vectors(start, bone), direction), start)


def _align_foot(shin: Quaternion, foot: Float[np.ndarray, "3"], pitch: float | None) -> Quaternion:
    if pitch is None:
        return _swing(shin, foot, _Z)
    # Only about the vertical: soles are level in both.
    return quaternion_multiply(_about_x(-pitch), quaternion_between(foot * (_X + _Z), _Z))


def _about_x(angle: float) -> Quaternion:
    return np.array([np.cos(angle / 2), np.sin(angle / 2), 0.0, 0.0], np.float32)


def _frames(
    joints: Joints, low: Float[np.ndarray, "T 3"], high: Float[np.ndarray, "T 3"]
) -> Float[np.ndarray, "T 3 3"]:
    """Returns axes of the trunk as columns: to the left, along the line between two points, and ahead."""
    up = unit_vectors(high - low)
    across = joints[:, JOINT["left_hip"]] - joints[:, JOINT["right_hip"]]
    across = unit_vectors(across - np.sum(across * up, axis=-1, keepdims=True) * up)
    return np.stack([across, up, np.cross(across, up)], axis=-1)


def _trunk_frames(joints: Joints) -> Float[np.ndarray, "T 3 3"]:
    middle = (joints[:, JOINT["left_hip"]] + joints[:, JOINT["right_hip"]]) / 2
    return _frames(joints, middle, joints[:, JOINT["neck"]])


def _inverse_frame(rest: Rest) -> Quaternion:
    """Returns the rotation that turns a rest pose upright and ahead."""
    frame = _trunk_frames(rest[None])
    # Who stands upright may have a neck behind the hips or ahead of them.
    if frame[0, 1, 1] > STANDS:
        frame = _frames(rest[None], np.zeros((1, 3)), _Y[None])
    return quaternion_inverse(quaternion_from_matrix(frame))[0]


def follow_trunk(turns: Quaternions, positions: Joints, rest: Rest) -> None:
    """Turns the spine of a body so that its neck is above its hips as in the motion.

    The joints of a spine are compared with their mean posture, which says nothing of a clip in which a person is bent
    all the time; the line from hips to neck does.

    Args:
        turns: Rotations of the joints from the rest pose; those above the pelvis are changed.
        positions: The motion.
        rest: The joints of the body.
    """
    middle = (rest[JOINT["left_hip"]] + rest[JOINT["right_hip"]]) / 2
    trunk = quaternion_multiply(quaternion_from_matrix(_trunk_frames(positions)), _inverse_frame(rest))
    chain = [JOINT[name] for name in SPINE[:-1]]
    places = rest[chain]
    bones = places - np.concatenate([middle[None], places[:-1]])
    first = rotate_vectors(turns[:, 0], bones[0] + bones[1])
    now = sum(rotate_vectors(turns[:, chain[k - 1]], bones[k]) for k in range(2, len(chain)))
    line = unit_vectors(rotate_vectors(trunk, places[-1] - middle))
    # The neck can only be on a sphere about the lowest joint of the spine: where the line leaves it.
    along = np.sum(first * line, axis=-1, keepdims=True)
    beside = np.sum(first**2, axis=-1, keepdims=True) - along**2
    reach = along + np.sqrt(np.maximum(np.sum(now**2, axis=-1, keepdims=True) - beside, 0))
    turn = quaternion_between(now, reach * line - first)
    for name in (*SPINE[1:], "left_collar", "right_collar"):
        turns[:, JOINT[name]] = quaternion_multiply(turn, turns[:, JOINT[name]])


def is_t_pose(rest: Rest) -> bool:
    """Returns whether spine and collars are straight as in the T-pose, as in files of this package."""
    spine = rest[[JOINT[name] for name in SPINE]]
    collars = np.stack([_bone(rest, side, "collar", "shoulder") for side in _OUT])
    if not np.linalg.norm(spine[1] - spine[0]) > 0:
        return False
    turn = quaternion_inverse(quaternion_from_matrix(_frames(rest[None], spine[None, 0], spine[None, -2])))[0]
    spine, collars = (unit_vectors(rotate_vectors(turn, bones)) for bones in (np.diff(spine, axis=0), collars))
    ahead = np.concatenate([spine[:, 2], collars[:, 2]])
    return bool(np.all(np.abs(ahead) < SAME) and np.all(np.abs(collars[:, 1]) < NEARLY))


def _mean_posture(turns: Matrices, positions: Joints) -> dict[str, Quaternion]:
    """Returns the mean rotation of the joints of the spine in the trunk, and of the collars in the chest.

    Only what is the same on the left and on the right is taken, since a rest pose is symmetric.
    """
    trunk = _trunk_frames(positions)
    counted = _upright(trunk)
    found = {}
    for name in SPINE:
        up = np.einsum("tba,tb->ta", trunk, turns[:, JOINT[name], :, 1])[counted]
        pitch = float(np.median(np.arctan2(up[:, 2], up[:, 1])))
        found[name] = _about_x(float(np.clip(pitch, -MAX_LEAN, MAX_LEAN)))
    chest = turns[counted, JOINT["spine3"]]
    bones = [np.einsum("tba,tb->ta", chest, turns[counted, JOINT[f"{side}_collar"], :, 0]) for side in _OUT]
    # Mirrored, because the T-pose has the right one at -X.
    left = bones[0].mean(axis=0) + bones[1].mean(axis=0) * np.array([1.0, -1.0, -1.0])
    found["left_collar"] = quaternion_between(_X, left)
    found["right_collar"] = quaternion_between(-_X, left * np.array([-1.0, 1.0, 1.0]))
    return found


def _upright(trunk: Float[np.ndarray, "T 3 3"]) -> Bool[np.ndarray, " T"]:
    """Returns which frames count for the mean posture."""
    upright = trunk[:, 1, 1] > UPRIGHT
    return upright if upright.any() else np.ones(len(trunk), bool)


def _align_posture(facing: Quaternion, posture: dict[str, Quaternion]) -> dict[str, Quaternion]:
    """Returns the turns of spine and collars for a rest pose that stands for the mean posture of the motion."""
    found = {name: quaternion_multiply(quaternion_inverse(posture[name]), facing) for name in SPINE}
    for side in _OUT:
        found[f"{side}_collar"] = quaternion_multiply(quaternion_inverse(posture[f"{side}_collar"]), found["spine3"])
    return found | {"facing": facing}


def _align_t_pose(offsets: Rest, rest: Rest) -> dict[str, Quaternion]:
    """Returns the turns of spine and collars for a rest pose with the same directions as the T-pose."""
    found: dict[str, Quaternion] = {}
    for name in ("pelvis", "spine1", "spine2", "spine3", "neck", "left_collar", "right_collar"):
        joint = JOINT[name]
        children = list(HUMANML3D.children(joint))
        bones = rest[children] - rest[joint]
        if len(children) > 1:
            found[name] = quaternion_from_matrix(rigid_rotations(bones, offsets[children]))
        else:
            parent = HUMANML3D.joint_names[HUMANML3D.parents[joint]]
            found[name] = _swing(found[parent], bones[0], offsets[children[0]])
    return found | {"head": found["neck"], "facing": found["spine3"]}
