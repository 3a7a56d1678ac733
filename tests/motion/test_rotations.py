import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax.motion.rotations import (
    continuous_quaternions,
    euler_from_matrix,
    matrix_from_euler,
    matrix_from_quaternion,
    quaternion_between,
    quaternion_from_matrix,
    quaternion_inverse,
    quaternion_multiply,
    rotate_vectors,
    rotation_6d_from_quaternion,
    slerp,
    turned_about_y,
    unit_vectors,
)
from tests.jit import assert_jit_equals_eager
from tests.motion.rotation_columns import matrix_from_rotation_6d

ORDERS = tuple("".join(letters) for letters in itertools.permutations("XYZ"))
in_both_libraries = pytest.mark.parametrize("asarray", [np.asarray, jnp.asarray], ids=["numpy", "jax"])


@pytest.fixture(scope="module")
def golden(golden_dir):
    return dict(np.load(golden_dir / "motion" / "quat_utils.npz"))


def random_quaternions(*shape, seed=0):
    values = np.random.default_rng(seed).normal(size=(*shape, 4)).astype(np.float32)
    return values / np.linalg.norm(values, axis=-1, keepdims=True)


def random_vectors(*shape, seed=1):
    return np.random.default_rng(seed).normal(size=(*shape, 3)).astype(np.float32)


def assert_same_rotation(actual, expected):
    """Compares quaternions up to sign."""
    cosines = np.abs(np.sum(np.asarray(actual) * np.asarray(expected), axis=-1))
    np.testing.assert_allclose(cosines, 1, atol=1e-6)


REFERENCES = {
    "qmul_q_r": (quaternion_multiply, "q", "r"),
    "qinv_q": (quaternion_inverse, "q"),
    "qrot_q_v0": (rotate_vectors, "q", "v0"),
    "qnormalize_q_unnormalized": (unit_vectors, "q_unnormalized"),
    "qbetween_v0_v1": (quaternion_between, "v0", "v1"),
    "matrix_q": (matrix_from_quaternion, "q"),
    "matrix_q_unnormalized": (matrix_from_quaternion, "q_unnormalized"),
    "cont6d_q": (rotation_6d_from_quaternion, "q"),
    "matrix_cont6d_raw": (matrix_from_rotation_6d, "cont6d_raw"),
    "qfix_out": (continuous_quaternions, "qfix_in"),
}


@in_both_libraries
@pytest.mark.parametrize("result", REFERENCES)
def test_like_the_reference(golden, result, asarray):
    function, *names = REFERENCES[result]
    np.testing.assert_allclose(function(*(asarray(golden[name]) for name in names)), golden[result], atol=1e-6)


@in_both_libraries
def test_like_the_reference_up_to_sign(golden, asarray):
    assert_same_rotation(
        quaternion_from_matrix(matrix_from_rotation_6d(asarray(golden["cont6d_raw"]))), golden["quat_from_cont6d_raw"]
    )
    assert_same_rotation(quaternion_from_matrix(asarray(golden["matrix_q"])), golden["quat_from_matrix_q"])


@in_both_libraries
def test_hard_directions_like_the_reference(golden, asarray):
    # The reference itself keeps about four digits where directions are nearly opposite.
    actual = quaternion_between(asarray(golden["v0"]), asarray(golden["v1_hard"]))
    np.testing.assert_allclose(actual, golden["qbetween_v0_v1_hard"], atol=5e-5)


@pytest.mark.slow
@in_both_libraries
def test_results_stay_in_their_library_as_float32(asarray):
    quaternions = asarray(random_quaternions(2, 3).astype(np.float64))
    vectors, matrices = asarray(random_vectors(2, 3)), matrix_from_quaternion(quaternions)
    results = [
        quaternion_multiply(quaternions, quaternions),
        rotate_vectors(quaternions, vectors),
        quaternion_between(vectors, vectors),
        quaternion_from_matrix(matrices),
        rotation_6d_from_quaternion(quaternions),
        matrix_from_rotation_6d(rotation_6d_from_quaternion(quaternions)),
        matrix_from_euler(vectors, "ZXY"),
        euler_from_matrix(matrices, "ZXY"),
        slerp(quaternions, quaternions, 0.5),
        continuous_quaternions(quaternions),
    ]
    for result in results:
        assert isinstance(result, np.ndarray) == (asarray is np.asarray)
        assert result.dtype == np.float32
        assert result.shape[:2] == (2, 3)


def test_the_product_turns_by_the_second_first():
    a, b, v = random_quaternions(5), random_quaternions(5, seed=3), random_vectors(5)
    np.testing.assert_allclose(
        rotate_vectors(quaternion_multiply(a, b), v), rotate_vectors(a, rotate_vectors(b, v)), atol=1e-5
    )
    np.testing.assert_allclose(
        matrix_from_quaternion(quaternion_multiply(a, b)),
        matrix_from_quaternion(a) @ matrix_from_quaternion(b),
        atol=1e-6,
    )


def test_the_inverse_undoes():
    quaternions, vectors = random_quaternions(6), random_vectors(6)
    back = rotate_vectors(quaternion_inverse(quaternions), rotate_vectors(quaternions, vectors))
    np.testing.assert_allclose(back, vectors, atol=1e-5)


def test_a_matrix_turns_as_its_quaternion_does():
    quaternions, vectors = random_quaternions(6), random_vectors(6)
    by_matrix = np.einsum("bij,bj->bi", matrix_from_quaternion(quaternions), vectors)
    np.testing.assert_allclose(by_matrix, rotate_vectors(quaternions, vectors), atol=1e-5)


def test_quaternions_survive_matrices_and_6d():
    # Turns of nearly half a circle about each axis make each of the four components the largest once.
    quaternions = np.concatenate([random_quaternions(50), np.eye(4, dtype=np.float32), -np.eye(4, dtype=np.float32)])
    for back in (
        quaternion_from_matrix(matrix_from_quaternion(quaternions)),
        quaternion_from_matrix(matrix_from_rotation_6d(rotation_6d_from_quaternion(quaternions))),
    ):
        assert_same_rotation(back, quaternions)
        assert (back[:, 0] >= 0).all()


@in_both_libraries
def test_between_leads_from_one_direction_to_the_other(asarray):
    a, b = random_vectors(40), 3 * random_vectors(40, seed=2)
    b[:10], b[10:20] = -2 * a[:10], a[10:20]  # exactly opposite, parallel
    b[20:30] = -a[20:30] + 1e-4 * b[20:30]
    turn = quaternion_between(asarray(a), asarray(b))
    np.testing.assert_allclose(rotate_vectors(turn, asarray(unit_vectors(a))), unit_vectors(b), atol=2e-6)
    assert (turn[:, 0] >= 0).all()


@in_both_libraries
def test_between_is_the_identity_without_a_direction(asarray):
    a, b = random_vectors(2), np.zeros((2, 3), np.float32)
    np.testing.assert_array_equal(quaternion_between(asarray(a), asarray(b)), [[1, 0, 0, 0]] * 2)


def test_opposite_ground_directions_turn_about_the_vertical():
    turn = quaternion_between(np.array([0.0, 0, -1]), np.array([0.0, 0, 1]))
    np.testing.assert_allclose(np.abs(turn), [0, 0, 1, 0], atol=1e-7)


def test_short_vectors_keep_their_direction():
    np.testing.assert_allclose(unit_vectors(np.array([[3e-25, 0, 4e-25]], np.float32)), [[0.6, 0, 0.8]], atol=1e-6)


def axis_matrix(letter, angle):
    """Writes the turn about one axis out, as textbooks do."""
    c, s = np.cos(angle), np.sin(angle)
    return {
        "X": np.array([[1, 0, 0], [0, c, -s], [0, s, c]]),
        "Y": np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]),
        "Z": np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]),
    }[letter]


@pytest.mark.parametrize("order", ORDERS)
def test_euler_letters_multiply_from_the_left(order):
    angles = [0.3, -0.8, 1.9]
    first, second, third = (axis_matrix(letter, angle) for letter, angle in zip(order, angles, strict=True))
    np.testing.assert_allclose(matrix_from_euler(np.array(angles), order), first @ second @ third, atol=1e-6)


@in_both_libraries
@pytest.mark.parametrize("order", ORDERS)
def test_euler_angles_give_the_matrix_back(order, asarray):
    matrices = matrix_from_quaternion(random_quaternions(30))
    locked = matrix_from_euler(np.array([[0.4, np.pi / 2, 0.9], [-2.0, -np.pi / 2, 0.1], [0, 0, 0]]), order)
    matrices = np.concatenate([matrices, locked])
    angles = euler_from_matrix(asarray(matrices), order)
    np.testing.assert_allclose(matrix_from_euler(angles, order), matrices, atol=1e-6)
    assert np.abs(angles[:, 1]).max() <= np.pi / 2 + 1e-6


@pytest.mark.parametrize("order", ORDERS)
def test_euler_angles_in_range_come_back(order):
    angles = np.random.default_rng(4).uniform([-3, -1.4, -3], [3, 1.4, 3], (30, 3)).astype(np.float32)
    np.testing.assert_allclose(euler_from_matrix(matrix_from_euler(angles, order), order), angles, atol=1e-5)


@in_both_libraries
def test_continuous_quaternions_do_not_jump(asarray):
    angles = np.linspace(0, 4 * np.pi, 60, dtype=np.float32)  # of the half angle: two full turns and back to the start
    smooth = np.stack([np.cos(angles / 2), 0 * angles, np.sin(angles / 2), 0 * angles], axis=-1)[:, None]
    signs = np.random.default_rng(5).choice([-1.0, 1.0], (60, 1, 1)).astype(np.float32)
    signs[0] = 1
    np.testing.assert_allclose(continuous_quaternions(asarray(smooth * signs)), smooth, atol=0)


@in_both_libraries
def test_slerp_goes_the_shorter_way_at_constant_speed(asarray):
    def about_z(angle):
        return np.array([[np.cos(angle / 2), 0, 0, np.sin(angle / 2)]])

    for weight in (0.0, 0.25, 0.5, 1.0):
        for end in (2.0, 1e-5):
            actual = slerp(asarray(about_z(0.0)), asarray(-about_z(end)), weight)
            np.testing.assert_allclose(actual, about_z(weight * end), atol=1e-6)


@in_both_libraries
def test_slerp_takes_a_weight_a_rotation(asarray):
    a, b = random_quaternions(3), random_quaternions(3, seed=7)
    weights = np.array([0.2, 0.5, 0.9], np.float32)
    one_by_one = [slerp(a[i], b[i], float(weights[i])) for i in range(3)]
    np.testing.assert_allclose(slerp(asarray(a), asarray(b), asarray(weights)), np.stack(one_by_one), atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    "function",
    [
        lambda q, v: quaternion_multiply(q, quaternion_inverse(q)),
        rotate_vectors,
        lambda q, v: quaternion_between(v, -v[::-1]),
        lambda q, v: quaternion_from_matrix(matrix_from_quaternion(q)),
        lambda q, v: quaternion_from_matrix(matrix_from_rotation_6d(rotation_6d_from_quaternion(q))),
        lambda q, v: euler_from_matrix(matrix_from_euler(v, "YZX"), "ZXY"),
        lambda q, v: slerp(q, q[::-1], 0.3),
        lambda q, v: continuous_quaternions(q),
    ],
)
def test_jit_changes_nothing(function):
    quaternions, vectors = jnp.asarray(random_quaternions(4, 2)), jnp.asarray(random_vectors(4, 2))
    compiled = assert_jit_equals_eager(jax.jit(function), quaternions, vectors, atol=1e-5)
    plain = function(np.asarray(quaternions), np.asarray(vectors))
    np.testing.assert_allclose(plain, compiled, atol=1e-5)


@in_both_libraries
def test_a_turn_about_y_is_that_of_its_quaternion(asarray):
    vectors, turns = random_vectors(7, 4), np.linspace(-4, 4, 7).astype(np.float32)
    halves = np.stack([np.cos(turns / 2), 0 * turns, np.sin(turns / 2), 0 * turns], axis=-1)
    found = turned_about_y(asarray(vectors), asarray(turns[:, None]))
    np.testing.assert_allclose(found, rotate_vectors(halves[:, None], vectors), atol=1e-5)
    assert type(found) is type(asarray(vectors))
