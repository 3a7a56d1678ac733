"""The rotations by which pelvis and chest of a clip turn as one piece."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax.motion.kinematics import rigid_rotations
from t2m_jax.motion.rotations import matrix_from_quaternion
from t2m_jax.motion.torso import fitted_rotations

rotations_of = jax.jit(fitted_rotations)


def rotated(points, *, noise):
    """Returns points in 200 random rotations, each coordinate with an error."""
    generator = np.random.default_rng(1)
    quaternions = generator.normal(size=(200, 4)).astype(np.float32)
    rotations = matrix_from_quaternion(quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True))
    found = np.einsum("tab,nb->tna", rotations, points)
    return (found + generator.normal(scale=noise, size=found.shape)).astype(np.float32)


@pytest.mark.parametrize("noise", [0.0, 0.005])
def test_rotations_are_those_of_a_singular_value_decomposition(noise):
    pelvis = np.array([[0.1, -0.06, 0.0], [-0.1, -0.06, 0.0], [0.01, 0.12, -0.02]], np.float32)
    goals = rotated(pelvis, noise=noise)
    np.testing.assert_allclose(rotations_of(pelvis, goals), rigid_rotations(pelvis, goals), atol=1e-4)


def test_the_collars_of_people_are_enough_to_tell_how_the_chest_turns():
    # From the spine to both collars and to the neck: about 5 cm wide and 20 cm high, as in a generated motion.
    chest = np.array([[0.018, 0.130, 0.039], [-0.030, 0.133, 0.044], [-0.009, 0.207, 0.071]], np.float32)
    goals = rotated(chest, noise=0.002)
    np.testing.assert_allclose(rotations_of(chest, goals), rigid_rotations(chest, goals), atol=1e-4)


def test_points_on_a_line_are_brought_to_their_goals():
    chest = np.array([[0.0, 0.14, 0.0], [0.0, 0.14, 0.0], [0.0, 0.22, 0.0]], np.float32)
    goals = rotated(chest, noise=0.0)
    found = np.asarray(rotations_of(chest, goals))
    np.testing.assert_allclose(np.einsum("tab,nb->tna", found, chest), goals, atol=1e-5)
    np.testing.assert_allclose(np.einsum("tab,tcb->tac", found, found), np.tile(np.eye(3), (200, 1, 1)), atol=1e-5)


def test_joints_in_one_place_are_not_turned():
    np.testing.assert_allclose(rotations_of(jnp.zeros((3, 3)), jnp.zeros((1, 3, 3)))[0], np.eye(3), atol=1e-6)
