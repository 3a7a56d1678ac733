"""The way back from the columns of features that the package writes but does not read: rotations."""

from t2m_jax.motion.features import chain_predecessors, root_from_features
from t2m_jax.motion.namespace import namespace_of
from t2m_jax.motion.rotations import cross_product, matrix_from_quaternion, unit_vectors


def matrix_from_rotation_6d(rotations_6d):
    """Returns rotation matrices. The first vector keeps its direction, the second is made perpendicular to it."""
    x = unit_vectors(rotations_6d[..., :3])
    z = unit_vectors(cross_product(x, rotations_6d[..., 3:]))
    return namespace_of(rotations_6d).stack([x, cross_product(z, x), z], axis=-1)


def positions_from_rotations(features, skeleton):
    """Returns the joint positions of raw features, from their rotations and the template's bones."""
    headings, root = root_from_features(features, skeleton)
    columns = features[..., skeleton.layout.rotations].reshape((*features.shape[:-1], skeleton.num_joints - 1, 6))
    local = matrix_from_rotation_6d(columns)
    before = chain_predecessors(skeleton)
    turns = [matrix_from_quaternion(headings)]
    joints = [root]
    for joint in range(1, skeleton.num_joints):
        turns.append(turns[before[joint]] @ local[..., joint - 1, :, :])
        offset = namespace_of(root).asarray(skeleton.offsets[joint].reshape((1,) * (root.ndim - 1) + (3,)))
        bone = (turns[joint] * offset[..., None, :]).sum(-1)
        joints.append(joints[skeleton.parents[joint]] + bone)
    return namespace_of(features).stack(joints, axis=-2)
