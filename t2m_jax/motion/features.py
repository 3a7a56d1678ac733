"""Motion features from joint positions, and joint positions from motion features.

This is the encoding of HumanML3D (Guo et al., CVPR 2022). It includes the quirks of the original code, because the
published statistics, models and metrics depend on them: the first heading is +Z, headings are smoothed over about a
second, hips and shoulders contribute to the heading with opposite signs, and rotations are swings from a rest axis
without twist. Positions are in the skeleton's unit (meters for HumanML3D, millimeters for KIT-ML) with Y up. Velocities
are per frame, and angles are in radians.

All functions accept NumPy or JAX arrays with leading batch axes. They return float32 arrays of the same library. Under
`jit`, the skeleton is a static argument.
"""

import itertools

import chex
import numpy as np
from jaxtyping import Float

from t2m_jax.errors import UserError
from t2m_jax.motion.kinematics import line_to
from t2m_jax.motion.namespace import AnyArray, namespace_of
from t2m_jax.motion.rotations import (
    quaternion_between,
    quaternion_inverse,
    quaternion_multiply,
    rotate_vectors,
    rotation_6d_from_quaternion,
    unit_vectors,
)
from t2m_jax.motion.skeleton import Skeleton

HEADING_SIGMA = 20.0
"""Standard deviation of the Gaussian that smooths headings, in frames."""

_TRUNCATE = 4  # standard deviations after which the Gaussian is cut off, as in SciPy
_AHEAD = (0.0, 0.0, 1.0)


def _checked_positions(positions: AnyArray, skeleton: Skeleton) -> AnyArray:
    """Returns `positions` as float32. Raises `UserError` if they cannot be positions of the skeleton."""
    skeleton.check_joints(positions)
    frames = 1 if positions.ndim < 3 else positions.shape[-3]
    if frames < 2:
        raise UserError(f"positions of {frames} frame(s); features need at least 2 frames")
    xp = namespace_of(positions)
    return xp.asarray(positions, dtype=xp.float32)


def _checked_features(features: AnyArray, skeleton: Skeleton) -> AnyArray:
    """Returns `features` as float32. Raises `UserError` if they cannot be features of the skeleton."""
    if features.ndim < 2 or features.shape[-1] != skeleton.feature_dim:
        raise UserError(
            f"features have shape {tuple(features.shape)}, but skeleton {skeleton.name} needs "
            f"[..., frames, {skeleton.feature_dim}]; choose the skeleton of the features"
        )
    xp = namespace_of(features)
    return xp.asarray(features, dtype=xp.float32)


def _constant(values: object, like: AnyArray, ndim: int) -> AnyArray:
    """Returns `values` as float32 in the library of `like`, with leading axes of size 1 up to `ndim` axes."""
    array = np.asarray(values, np.float32)
    return namespace_of(like).asarray(array.reshape((1,) * (ndim - array.ndim) + array.shape))


def bone_vectors(positions: Float[AnyArray, "*batch T J 3"], skeleton: Skeleton) -> Float[AnyArray, "*batch T J-1 3"]:
    """Returns the vectors from the parent to each joint but the root."""
    chex.assert_shape(positions, (..., skeleton.num_joints, 3))
    return positions[..., 1:, :] - positions[..., np.array(skeleton.parents[1:]), :]


def local_positions(features: Float[AnyArray, "*batch D"], skeleton: Skeleton) -> Float[AnyArray, "*batch J 3"]:
    """Returns the joints in features, which may be normalized: relative to the floor below the root and to its heading.

    The root is at (0, root height, 0).
    """
    xp = namespace_of(features)
    height = features[..., skeleton.layout.root_height]
    root = xp.concatenate([xp.zeros_like(height), height, xp.zeros_like(height)], axis=-1)
    others = features[..., skeleton.layout.positions].reshape((*features.shape[:-1], -1, 3))
    return xp.concatenate([root[..., None, :], others], axis=-2)


def chain_predecessors(skeleton: Skeleton) -> np.ndarray:
    """Returns the joint before each joint in its chain. Chains that begin at the chest continue from the root, too."""
    predecessors = np.array(skeleton.parents)
    # The original code starts every chain at the root's heading, also the arms.
    for chain in skeleton.chains:
        predecessors[chain[1]] = 0
    return predecessors


def retarget_positions(
    positions: Float[AnyArray, "*batch T J 3"], skeleton: Skeleton
) -> Float[AnyArray, "*batch T J 3"]:
    """Returns the motion with the bone lengths of the template, which all data of a skeleton share.

    Bones keep their directions. The root's path is scaled by the template's leg length divided by that of the first
    frame. Only one leg is measured. Bones of length zero stay zero, and a figure without a leg keeps its path.
    """
    positions = _checked_positions(positions, skeleton)
    xp = namespace_of(positions)
    bones = bone_vectors(positions, skeleton)
    leg = np.array(skeleton.leg_joints)
    source = xp.sqrt((bones[..., 0, leg - 1, :] ** 2).sum(-1)).sum(-1)
    template = sum(skeleton.bone_lengths[joint] for joint in skeleton.leg_joints)
    # The inner `where` keeps the gradient finite, because both branches are differentiated.
    scale = xp.where(source > 0, template / xp.where(source > 0, source, xp.ones_like(source)), xp.ones_like(source))
    bones = unit_vectors(bones) * _constant(skeleton.bone_lengths[1:], bones, bones.ndim - 1)[..., None]
    root = positions[..., :1, :] * scale[..., None, None, None]
    return positions_from_bones(root[..., 0, :], bones, skeleton)


def positions_from_bones(
    root: Float[AnyArray, "*batch T 3"], bones: Float[AnyArray, "*batch T S 3"], skeleton: Skeleton
) -> Float[AnyArray, "*batch T S+1 3"]:
    """Returns the joints of a root's path and of the vectors from the parent to each joint; inverts `bone_vectors`."""
    chex.assert_shape([root, bones], [(..., 3), (*root.shape[:-1], skeleton.num_joints - 1, 3)])
    xp = namespace_of(root, bones)
    root = root[..., None, :]
    bones = xp.concatenate([xp.zeros_like(root), bones], axis=-2)
    # A joint's position is the sum of the bones on its path to the root. All paths have one length after padding with
    # the root, whose bone is zero, so that one sum serves all joints.
    paths = [line_to(joint, skeleton.parents)[::-1] for joint in range(skeleton.num_joints)]
    padded = np.array(list(itertools.zip_longest(*paths, fillvalue=0))).T
    return root + bones[..., padded, :].sum(-2)


def ground_positions(positions: Float[AnyArray, "*batch T J 3"], skeleton: Skeleton) -> Float[AnyArray, "*batch T J 3"]:
    """Returns the motion with its lowest joint at height 0. It starts above the origin and faces +Z."""
    xp = namespace_of(positions)
    # Of the whole clip, so that a jump stays above the floor.
    floor = positions[..., 1].min(axis=(-2, -1))
    start = positions[..., 0, 0, :]
    origin = xp.stack([start[..., 0], floor, start[..., 2]], axis=-1)
    positions = positions - origin[..., None, None, :]
    forward = facing(positions[..., 0, :, :], skeleton)
    turn = quaternion_between(forward, _constant(_AHEAD, forward, forward.ndim))
    return rotate_vectors(turn[..., None, None, :], positions)


def facing(pose: Float[AnyArray, "*batch J 3"], skeleton: Skeleton) -> Float[AnyArray, "*batch 3"]:
    """Returns the horizontal direction in which a figure faces, of any length."""
    chex.assert_shape(pose, (..., skeleton.num_joints, 3))
    right_hip, left_hip, right_shoulder, left_shoulder = (pose[..., j, :] for j in skeleton.face_joints)
    return _forward((right_hip - left_hip) + (right_shoulder - left_shoulder))


def _forward(across: Float[AnyArray, "*batch 3"]) -> Float[AnyArray, "*batch 3"]:
    """Returns Y × across with y = 0: the forward direction if `across` points to the right side of the body."""
    xp = namespace_of(across)
    return xp.stack([across[..., 2], xp.zeros_like(across[..., 0]), -across[..., 0]], axis=-1)


def gaussian_kernel(sigma: float) -> Float[np.ndarray, " K"]:
    """Returns a Gaussian of a standard deviation in frames, cut off as in SciPy; its sum is 1."""
    radius = int(_TRUNCATE * sigma + 0.5)
    kernel = np.exp(-0.5 * (np.arange(-radius, radius + 1) / sigma) ** 2)
    return kernel / kernel.sum()


def smooth_over_time(values: Float[AnyArray, "*batch T C"], *, sigma: float) -> Float[AnyArray, "*batch T C"]:
    """Returns `values` smoothed over time by a Gaussian. The first and last frames are repeated as padding.

    The unit of `sigma` is frames. NumPy arrays are computed and returned in float64, JAX arrays in float32.
    """
    xp = namespace_of(values)
    dtype = np.float64 if xp is np else np.float32
    # NumPy as precise as SciPy, with which the published data were made; JAX has no float64 by default.
    kernel = gaussian_kernel(sigma).astype(dtype)
    radius = len(kernel) // 2
    steps = np.arange(-radius, radius + 1)
    num_frames = values.shape[-2]
    windows = np.clip(np.arange(num_frames)[:, None] + steps, 0, num_frames - 1)
    neighbors = xp.asarray(values, dtype=dtype)[..., windows, :]
    return (neighbors * kernel.reshape((1,) * (neighbors.ndim - 2) + (-1, 1))).sum(-2)


def heading_quaternions(
    positions: Float[AnyArray, "*batch T J 3"], skeleton: Skeleton
) -> Float[AnyArray, "*batch T 4"]:
    """Returns the rotation about Y of each frame's smoothed heading to +Z, which is the identity for frame 0.

    The hips contribute with the opposite sign of the shoulders. This is an error of the original code, which all
    published data contain. The smoothing makes it harmless.
    """
    xp = namespace_of(positions)
    right_hip, left_hip, right_shoulder, left_shoulder = (positions[..., j, :] for j in skeleton.face_joints)
    across = unit_vectors((left_hip - right_hip) + (right_shoulder - left_shoulder))
    forward = unit_vectors(smooth_over_time(_forward(across), sigma=HEADING_SIGMA))
    headings = quaternion_between(forward, _constant(_AHEAD, forward, forward.ndim))
    identity = xp.broadcast_to(_constant((1.0, 0.0, 0.0, 0.0), headings, headings.ndim), headings[..., :1, :].shape)
    return xp.concatenate([identity, headings[..., 1:, :]], axis=-2)


def swing_rotations(
    positions: Float[AnyArray, "*batch T J 3"], headings: Float[AnyArray, "*batch T 4"], skeleton: Skeleton
) -> Float[AnyArray, "*batch T J 4"]:
    """Returns local rotations as quaternions. The root's rotations are `headings`.

    The rotation of a bone is the shortest swing from its rest axis, relative to the bone before it in its chain. Chains
    start at the heading. A bone opposite to its rest axis swings about an arbitrary axis. A bone of length zero does
    not swing.
    """
    chex.assert_shape(headings, (*positions.shape[:-2], 4))
    bones = bone_vectors(positions, skeleton)
    axes = _constant(skeleton.rest_axes[1:], bones, bones.ndim)
    swings = quaternion_between(axes, bones)
    xp = namespace_of(swings)
    swings = xp.concatenate([headings[..., None, :], swings], axis=-2)
    before = swings[..., chain_predecessors(skeleton)[1:], :]
    local = quaternion_multiply(quaternion_inverse(before), swings[..., 1:, :])
    return xp.concatenate([headings[..., None, :], local], axis=-2)


def foot_contacts(positions: Float[AnyArray, "*batch T J 3"], skeleton: Skeleton) -> Float[AnyArray, "*batch T-1 4"]:
    """Returns 1 for each foot joint (left ankle and toe, right ankle and toe) that hardly moves to the next frame."""
    chex.assert_shape(positions, (..., None, skeleton.num_joints, 3))
    feet = positions[..., np.array(skeleton.left_foot + skeleton.right_foot), :]
    steps = ((feet[..., 1:, :, :] - feet[..., :-1, :, :]) ** 2).sum(-1)
    return (steps < skeleton.contact_threshold).astype(np.float32)


def features_from_positions(
    positions: Float[AnyArray, "*batch T J 3"], skeleton: Skeleton
) -> Float[AnyArray, "*batch T-1 D"]:
    """Returns raw motion features of joint positions. The features have one frame less.

    First, the clip gets the template's bone lengths and is moved to the floor, the origin and the heading +Z. The
    smoothing of headings uses 80 frames on each side, so the features of a crop differ from the crop of the features.
    Finite positions give finite features.

    If a motion turns past 180 degrees from its start, the yaw step of that frame has the wrong sign, as in published
    data. So `positions_from_features` turns the rest of such a motion a little the other way.

    Args:
        positions: Joints in the skeleton's unit, Y up, at the skeleton's frame rate.
        skeleton: The joints, and the template for their bone lengths.

    Raises:
        UserError: The number of joints is not the skeleton's, or there are fewer than two frames.
    """
    ground = ground_positions(retarget_positions(positions, skeleton), skeleton)
    xp = namespace_of(ground)
    headings = heading_quaternions(ground, skeleton)
    rotations = swing_rotations(ground, headings, skeleton)[..., :-1, 1:, :]
    now = headings[..., :-1, :]
    ahead = headings[..., 1:, :]

    # The turn from one heading to the next is about Y, whose component of the quaternion is the sine of half the angle.
    turn = quaternion_multiply(ahead, quaternion_inverse(now))
    half_yaw = xp.arcsin(xp.clip(turn[..., 2:3], -1, 1))

    # The original code turns the step of the root by the heading after it, and all other steps by the one before.
    steps = ground[..., 1:, :, :] - ground[..., :-1, :, :]
    root_step = rotate_vectors(ahead, steps[..., 0, :])
    root = ground[..., :-1, :1, :]
    over_origin = xp.concatenate([root[..., :1], xp.zeros_like(root[..., :1]), root[..., 2:]], axis=-1)
    local = rotate_vectors(now[..., None, :], ground[..., :-1, 1:, :] - over_origin)
    velocities = rotate_vectors(now[..., None, :], steps)

    def flat(values: AnyArray) -> AnyArray:
        return values.reshape((*values.shape[:-2], -1))

    columns = (
        half_yaw,
        root_step[..., ::2],
        root[..., 0, 1:2],
        flat(local),
        flat(rotation_6d_from_quaternion(rotations)),
        flat(velocities),
        foot_contacts(ground, skeleton),
    )
    return xp.concatenate(columns, axis=-1)


def root_from_features(
    features: Float[AnyArray, "*batch T D"], skeleton: Skeleton
) -> tuple[Float[AnyArray, "*batch T 4"], Float[AnyArray, "*batch T 3"]]:
    """Returns the rotations of each frame's heading to +Z, and the positions of the root.

    The clip starts above the origin and faces +Z.
    """
    features = _checked_features(features, skeleton)
    xp = namespace_of(features)
    layout = skeleton.layout
    # A frame has the step to the next one, so the first frame has no step before it, and the last one's leads nowhere.
    half_yaw = features[..., layout.root_yaw]
    angle = xp.cumsum(xp.concatenate([xp.zeros_like(half_yaw[..., :1, :]), half_yaw[..., :-1, :]], axis=-2), axis=-2)
    zero = xp.zeros_like(angle)
    headings = xp.concatenate([xp.cos(angle), zero, xp.sin(angle), zero], axis=-1)

    step = features[..., :-1, layout.root_velocity]
    step = xp.concatenate([step[..., :1], zero[..., 1:, :], step[..., 1:]], axis=-1)
    step = rotate_vectors(quaternion_inverse(headings[..., 1:, :]), step)
    path = xp.cumsum(xp.concatenate([xp.zeros_like(features[..., :1, :3]), step], axis=-2), axis=-2)
    root = xp.concatenate([path[..., :1], features[..., layout.root_height], path[..., 2:]], axis=-1)
    return headings, root


def positions_from_features(
    features: Float[AnyArray, "*batch T D"], skeleton: Skeleton
) -> Float[AnyArray, "*batch T J 3"]:
    """Returns the joint positions of raw features, in the skeleton's unit.

    The clip starts above the origin and faces +Z. Only the root's columns and the local positions are used, as in all
    published evaluations.

    Raises:
        UserError: The number of features is not the skeleton's.
    """
    features = _checked_features(features, skeleton)
    xp = namespace_of(features)
    headings, root = root_from_features(features, skeleton)
    local = features[..., skeleton.layout.positions].reshape((*features.shape[:-1], skeleton.num_joints - 1, 3))
    over_origin = xp.concatenate([root[..., :1], xp.zeros_like(root[..., :1]), root[..., 2:]], axis=-1)
    joints = rotate_vectors(quaternion_inverse(headings)[..., None, :], local) + over_origin[..., None, :]
    return xp.concatenate([root[..., None, :], joints], axis=-2)
