from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax.errors import UserError
from t2m_jax.motion.features import (
    features_from_positions,
    ground_positions,
    heading_quaternions,
    positions_from_features,
    retarget_positions,
    root_from_features,
    smooth_over_time,
    swing_rotations,
)
from t2m_jax.motion.skeleton import HUMANML3D, KIT_ML
from tests.jit import assert_jit_equals_eager
from tests.motion.rotation_columns import positions_from_rotations

CLIPS = {"synth22_walk": HUMANML3D, "synth22_spin": HUMANML3D, "synth21_walk": KIT_ML}
# What float32 allows: metres and millimetres differ by a thousand.
TOLERANCE = {"humanml3d": 5e-6, "kit_ml": 5e-3}
DECODE_TOLERANCE = {"humanml3d": 2e-6, "kit_ml": 2e-3}
every_clip = pytest.mark.parametrize(
    "clip", [pytest.param("synth22_walk", marks=pytest.mark.slow), "synth22_spin", "synth21_walk"]
)
encode = jax.jit(features_from_positions, static_argnums=1)
decode = jax.jit(positions_from_features, static_argnums=1)
decode_rotations = jax.jit(positions_from_rotations, static_argnums=1)


@pytest.fixture(scope="module")
def golden(golden_dir):
    return {clip: dict(np.load(golden_dir / "motion" / f"{clip}.npz")) for clip in CLIPS}


def walk(golden, frames=None):
    return golden["synth22_walk"]["joints_in"][:frames]


def turned(positions, angle):
    c, s = np.cos(angle), np.sin(angle)
    return positions @ np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]], np.float32)


def test_smoothing_is_the_references(golden_dir):
    reference = np.load(golden_dir / "motion" / "quat_utils.npz")
    for length in "ab":  # shorter and longer than the Gaussian
        values, expected = reference[f"gauss_in_{length}"], reference[f"gauss_out_{length}"]
        precise, single = (smooth_over_time(a, sigma=20.0) for a in (values, jnp.asarray(values)))
        assert (precise.dtype, single.dtype) == (np.float64, np.float32)
        np.testing.assert_allclose(precise, expected, atol=1e-7)
        np.testing.assert_allclose(single, expected, atol=1e-6)


@every_clip
def test_every_step_is_the_references(golden, clip):
    reference, skeleton = golden[clip], CLIPS[clip]
    tolerance = TOLERANCE[skeleton.name]
    retargeted = retarget_positions(reference["joints_in"], skeleton)
    np.testing.assert_allclose(retargeted, reference["uniform"], atol=tolerance)
    ground = ground_positions(retargeted, skeleton)
    np.testing.assert_allclose(ground, reference["ground_positions"], atol=tolerance)
    headings = heading_quaternions(ground, skeleton)
    np.testing.assert_allclose(headings, reference["ik_quat"][:, 0], atol=2e-6)
    rotations = swing_rotations(ground, headings, skeleton)
    determined = reference["bone_align"] > -0.999
    determined[:, 0] = True
    np.testing.assert_allclose(rotations[determined], reference["ik_quat"][determined], atol=5e-5)


@every_clip
def test_features_are_the_references(golden, clip):
    reference, skeleton = golden[clip], CLIPS[clip]
    plain = features_from_positions(reference["joints_in"], skeleton)
    traced = encode(jnp.asarray(reference["joints_in"]), skeleton)
    assert isinstance(plain, np.ndarray) and isinstance(traced, jax.Array)
    assert plain.dtype == traced.dtype == np.float32
    assert_features_close(plain, reference["features"], skeleton)
    assert_features_close(traced, reference["features"], skeleton)


def assert_features_close(actual, expected, skeleton):
    layout, actual = skeleton.layout, np.asarray(actual)
    np.testing.assert_array_equal(actual[:, layout.contacts], expected[:, layout.contacts])
    for group in layout:
        tolerance = (
            2e-4 if group == layout.rotations else 2e-6 if group == layout.root_yaw else TOLERANCE[skeleton.name]
        )
        np.testing.assert_allclose(actual[:, group], expected[:, group], atol=tolerance)


@every_clip
def test_decoding_is_the_references(golden, clip):
    reference, skeleton = golden[clip], CLIPS[clip]
    tolerance, features = DECODE_TOLERANCE[skeleton.name], reference["features"]
    headings, root = root_from_features(features, skeleton)
    np.testing.assert_allclose(headings, reference["root_quat"], atol=1e-6)
    np.testing.assert_allclose(root, reference["root_pos"], atol=tolerance)
    traced = jnp.asarray(features)
    for actual, expected in (
        (positions_from_features(features, skeleton), reference["joints_ric"]),
        (decode(traced, skeleton), reference["joints_ric"]),
        (positions_from_rotations(features, skeleton), reference["joints_rot"]),
        (decode_rotations(traced, skeleton), reference["joints_rot"]),
    ):
        np.testing.assert_allclose(actual, expected, atol=tolerance)
        assert actual.dtype == np.float32


def test_a_published_clip(shared_dir):
    reference = np.load(shared_dir / "golden" / "motion" / "real_012314.npz")
    features, positions = reference["features"], reference["new_joints"]
    np.testing.assert_allclose(positions_from_features(features, HUMANML3D), positions, atol=2e-6)
    np.testing.assert_allclose(decode(jnp.asarray(features), HUMANML3D), positions, atol=2e-6)
    np.testing.assert_allclose(positions_from_rotations(features, HUMANML3D), reference["joints_rot"], atol=5e-6)
    ground = ground_positions(retarget_positions(positions, HUMANML3D), HUMANML3D)
    np.testing.assert_allclose(ground, reference["reencoded_ground_positions"], atol=5e-6)
    for encoded in (features_from_positions(positions, HUMANML3D), encode(jnp.asarray(positions), HUMANML3D)):
        assert_features_close(encoded, reference["reencoded_features"], HUMANML3D)


def test_decoding_undoes_encoding(golden):
    ground = ground_positions(retarget_positions(walk(golden), HUMANML3D), HUMANML3D)
    features = features_from_positions(walk(golden), HUMANML3D)
    np.testing.assert_allclose(positions_from_features(features, HUMANML3D), ground[:-1], atol=1e-5)
    np.testing.assert_allclose(positions_from_rotations(features, HUMANML3D), ground[:-1], atol=1e-5)


def test_a_turn_past_half_a_circle_has_the_sign_flip_of_the_original(golden):
    positions = golden["synth22_spin"]["joints_in"]
    ground = ground_positions(retarget_positions(positions, HUMANML3D), HUMANML3D)[:-1]
    plain = features_from_positions(positions, HUMANML3D)
    repaired = plain.copy()
    repaired[51, 0] *= -1
    np.testing.assert_allclose(positions_from_features(repaired, HUMANML3D), ground, atol=1e-5)
    assert np.abs(positions_from_features(plain, HUMANML3D) - ground).max() > 0.1


def test_features_do_not_know_place_heading_or_size(golden):
    positions = walk(golden)
    moved = turned(1.7 * positions, 2.2) + np.array([3.0, -1.0, 8.0], np.float32)
    expected, actual = (features_from_positions(p, HUMANML3D) for p in (positions, moved))
    np.testing.assert_allclose(actual, expected, atol=1e-4)


def test_a_turn_to_the_left_has_negative_half_steps():
    angles = 0.01 * np.arange(300, dtype=np.float32)  # less than half a circle
    figure = np.asarray(rest_pose())
    positions = np.stack([turned(figure, angle) for angle in angles])
    yaw = features_from_positions(positions, HUMANML3D)[90:200, 0]
    np.testing.assert_allclose(yaw, -0.005, atol=1e-4)  # +Y is a turn to the left


def rest_pose():
    joints = np.zeros((22, 3), np.float32)
    for joint, parent in enumerate(HUMANML3D.parents[1:], start=1):
        joints[joint] = joints[parent] + HUMANML3D.offsets[joint]
    return joints


def test_a_standing_figure():
    positions = np.broadcast_to(rest_pose(), (50, 22, 3))
    features, layout = features_from_positions(positions, HUMANML3D), HUMANML3D.layout
    for still in (layout.root_yaw, layout.root_velocity, layout.velocities):
        np.testing.assert_allclose(features[:, still], 0, atol=1e-6)
    np.testing.assert_array_equal(features[:, layout.contacts], 1)
    identity = np.tile([1, 0, 0, 0, 1, 0], 21)
    np.testing.assert_allclose(features[0, layout.rotations], identity, atol=1e-5)
    np.testing.assert_allclose(features[:, layout.root_height], -rest_pose()[:, 1].min(), atol=1e-6)


def test_retargeting_keeps_directions_and_takes_the_templates_lengths(golden):
    positions, parents = walk(golden), np.array(HUMANML3D.parents[1:])
    retargeted = retarget_positions(positions, HUMANML3D)
    before, after = (p[:, 1:] - p[:, parents] for p in (positions, retargeted))
    lengths = np.linalg.norm(after, axis=-1)
    np.testing.assert_allclose(lengths, np.broadcast_to(HUMANML3D.bone_lengths[1:], lengths.shape), atol=1e-6)
    cosines = (before * after).sum(-1) / np.linalg.norm(before, axis=-1) / lengths
    np.testing.assert_allclose(cosines, 1, atol=1e-5)
    np.testing.assert_allclose(retarget_positions(retargeted, HUMANML3D), retargeted, atol=2e-6)


def test_batch_axes_are_clips_of_their_own(golden):
    clips = np.stack([walk(golden, 60), golden["synth22_spin"]["joints_in"][:60]])[:, None]
    features = features_from_positions(clips, HUMANML3D)
    assert features.shape == (2, 1, 59, 263)
    for clip, row in zip(clips, features, strict=True):
        np.testing.assert_allclose(row[0], features_from_positions(clip[0], HUMANML3D), atol=2e-5)
    for back in (positions_from_features, positions_from_rotations):
        positions = back(features, HUMANML3D)
        assert positions.shape == (2, 1, 59, 22, 3)
        np.testing.assert_allclose(positions[1, 0], back(features[1, 0], HUMANML3D), atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("function", [positions_from_features, positions_from_rotations])
def test_jit_and_vmap_change_nothing(golden, function):
    clips = jnp.asarray(golden["synth22_walk"]["features"][:16].reshape(2, 8, -1))
    compiled = assert_jit_equals_eager(jax.jit(partial(function, skeleton=HUMANML3D)), clips, atol=1e-5)
    vmapped = jax.jit(jax.vmap(partial(function, skeleton=HUMANML3D)))
    np.testing.assert_allclose(vmapped(clips), compiled, atol=1e-5)


@pytest.mark.slow
def test_encoding_under_vmap_is_encoding_with_numpy(golden):
    # Eager means NumPy here: one by one, the many small steps would each be compiled.
    clips = walk(golden)[:16].reshape(2, 8, 22, 3)
    eager = features_from_positions(clips, HUMANML3D)
    vmapped = jax.vmap(lambda clip: encode(clip, HUMANML3D))
    np.testing.assert_allclose(vmapped(jnp.asarray(clips)), eager, atol=5e-5)


@pytest.mark.slow
def test_decoding_is_causal_and_differentiable(golden):
    features = jnp.asarray(golden["synth22_walk"]["features"][:12])
    gradient = jax.grad(lambda rows: decode(rows, HUMANML3D)[6].sum())(features)
    assert np.isfinite(gradient).all()
    assert (gradient[7:] == 0).all() and (gradient[6, :3] == 0).all()  # a row's steps lead to the next frame
    assert (np.abs(gradient[5, :3]) > 0).all()


@pytest.mark.slow
@pytest.mark.parametrize("skeleton", [HUMANML3D, KIT_ML], ids=lambda skeleton: skeleton.name)
def test_odd_figures_give_finite_features(skeleton):
    joints = np.random.default_rng(0).normal(size=(30, skeleton.num_joints, 3)).astype(np.float32)
    no_bones = joints.copy()
    no_bones[:, 5:12] = joints[:, 4:5]
    # Every bone straight against its rest axis: no swing is the shortest.
    opposite = np.zeros_like(joints)
    for joint, parent in enumerate(skeleton.parents[1:], start=1):
        opposite[:, joint] = opposite[:, parent] - skeleton.offsets[joint]
    clips = np.stack([joints, no_bones, opposite, np.zeros_like(joints)])
    for features in (
        features_from_positions(clips, skeleton),
        np.asarray(encode(jnp.asarray(clips), skeleton)),
        features_from_positions(joints[:2], skeleton),
    ):
        assert np.isfinite(features).all()
        assert np.isfinite(positions_from_features(features, skeleton)).all()
        assert np.isfinite(positions_from_rotations(features, skeleton)).all()


def test_double_precision_is_taken(golden):
    features = features_from_positions(walk(golden).astype(np.float64), HUMANML3D)
    assert features.dtype == np.float32
    np.testing.assert_array_equal(features, features_from_positions(walk(golden), HUMANML3D))


def test_positions_that_are_no_motion_are_refused(golden):
    with pytest.raises(UserError, match="positions have 22 joints, but skeleton kit_ml has 21"):
        features_from_positions(walk(golden), KIT_ML)
    with pytest.raises(UserError, match="features need at least 2 frames"):
        features_from_positions(walk(golden, 1), HUMANML3D)
    with pytest.raises(UserError, match=r"\(5, 263\), but skeleton kit_ml needs \[..., frames, 251\]"):
        positions_from_features(np.zeros((5, 263), np.float32), KIT_ML)
