"""Wrong shapes are refused in one line and never broadcast, also by JAX and inside of `jit`."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax.errors import UserError
from t2m_jax.motion import features, rotations
from t2m_jax.motion.cleanup import clean_positions
from t2m_jax.motion.facts import measure
from t2m_jax.motion.inverse_kinematics import fit_rig
from t2m_jax.motion.kinematics import forward_kinematics, rigid_rotations
from t2m_jax.motion.normalizer import Normalizer
from t2m_jax.motion.skeleton import HUMANML3D

PARENTS = HUMANML3D.parents


def some(*shape):
    return np.ones(shape, np.float32)


WRONG = {
    "a quaternion of one number": lambda x: rotations.quaternion_multiply(x(2, 1), x(2, 4)),
    "an inverse of three numbers": lambda x: rotations.quaternion_inverse(x(2, 3)),
    "quaternions that turn numbers": lambda x: rotations.rotate_vectors(x(2, 4), x(2, 1)),
    "directions of two numbers": lambda x: rotations.quaternion_between(x(2, 2), x(2, 2)),
    "a cross product of a number": lambda x: rotations.cross_product(x(2, 1), x(2, 3)),
    "a matrix of a vector": lambda x: rotations.matrix_from_quaternion(x(2, 3)),
    "a quaternion of a row": lambda x: rotations.quaternion_from_matrix(x(2, 3)),
    "columns of a vector": lambda x: rotations.rotation_6d_from_quaternion(x(2, 3)),
    "signs of vectors": lambda x: rotations.continuous_quaternions(x(2, 3)),
    "four angles": lambda x: rotations.matrix_from_euler(x(2, 4), "XYZ"),
    "angles of a row": lambda x: rotations.euler_from_matrix(x(2, 3), "XYZ"),
    "an arc between numbers": lambda x: rotations.slerp(x(2, 1), x(2, 4), 0.5),
    "bones of another figure": lambda x: features.bone_vectors(x(4, 21, 3), HUMANML3D),
    "bones of other frames": lambda x: features.positions_from_bones(x(1, 3), x(4, 21, 3), HUMANML3D),
    "the heading of a pelvis": lambda x: features.facing(x(3), HUMANML3D),
    "headings of one frame": lambda x: features.swing_rotations(x(4, 22, 3), x(1, 4), HUMANML3D),
    "feet of one frame": lambda x: features.foot_contacts(x(22, 3), HUMANML3D),
    "a deviation for all columns": lambda x: Normalizer(x(263), x(1)).normalize(x(4, 263)),
    "a mean of each frame": lambda x: Normalizer(x(4, 263), x(263)).denormalize(x(4, 263)),
    "clips of lengths of one clip": lambda x: clean_positions(
        jnp.ones((2, 9, 22, 3)), jnp.ones(1, int), skeleton=HUMANML3D
    ),
    "facts of several clips": lambda x: measure(some(2, 4, 22, 3), fps=20.0),
    "a rig of 21 joints": lambda x: fit_rig(some(4, 21, 3), fps=20.0),
    "rotations of one joint": lambda x: forward_kinematics(some(4, 1, 3, 3), some(4, 22, 3), PARENTS),
    "vectors of one joint": lambda x: rigid_rotations(some(3, 3), some(4, 1, 3)),
}


@pytest.mark.parametrize("library", [np.ones, jnp.ones], ids=["numpy", "jax"])
@pytest.mark.parametrize("call", WRONG.values(), ids=WRONG)
def test_wrong_shapes_are_refused_in_one_line(unchecked, call, library):
    with pytest.raises(AssertionError, match=r"^\[Chex\] Assertion assert_shape failed: [^\n]*expected"):
        call(lambda *shape: library(shape, np.float32))


@pytest.mark.parametrize(
    ("function", "shape", "message"),
    [
        (features.features_from_positions, (4, 21, 3), "positions have 21 joints, but skeleton humanml3d has 22"),
        (features.features_from_positions, (22, 3), "features need at least 2 frames"),
        (features.positions_from_features, (4, 251), r"features have shape \(4, 251\), but skeleton humanml3d needs"),
        (features.positions_from_features, (263,), r"needs \[..., frames, 263\]"),
    ],
)
def test_what_users_give_is_refused_in_their_words_also_when_traced(unchecked, function, shape, message):
    for call in (function, jax.jit(function, static_argnums=1)):
        with pytest.raises(UserError, match=message):
            call(jnp.ones(shape), HUMANML3D)


def test_batch_axes_stay_free(unchecked):
    clip = np.random.default_rng(0).normal(size=(2, 1, 5, 22, 3)).astype(np.float32)
    found = features.positions_from_features(features.features_from_positions(clip, HUMANML3D), HUMANML3D)
    assert found.shape == (2, 1, 4, 22, 3)
    assert rotations.rotate_vectors(some(4), some(2, 5, 3)).shape == (2, 5, 3)
    assert Normalizer(some(263), some(263)).normalize(some(2, 3, 4, 263)).shape == (2, 3, 4, 263)
