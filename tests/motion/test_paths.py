"""Motion on other paths over the ground."""

import dataclasses

import numpy as np
import pytest

from t2m_jax import Motion
from t2m_jax.data.importers.synthetic import make_motion
from t2m_jax.errors import UserError
from t2m_jax.motion.features import bone_vectors, facing
from t2m_jax.motion.paths import _curve, route_along, turned_route
from t2m_jax.motion.skeleton import HUMANML3D


def make(kind="walk", *, num_frames=120):
    return Motion(make_motion(kind, seed=3, num_frames=num_frames), 20.0, caption=kind)


def length_of(path):
    return np.linalg.norm(np.diff(path, axis=0), axis=1).sum()


def heading(pose):
    forward = facing(pose, HUMANML3D)
    return np.arctan2(forward[..., 0], forward[..., 2])


def bone_lengths(motion):
    return np.linalg.norm(bone_vectors(motion.positions, HUMANML3D), axis=-1)


def foot_slide(positions):
    """Mean speed of toes that are near the floor, in m/s."""
    toes = positions[:, [10, 11]]
    down = (toes[1:, :, 1] < 0.03) & (toes[:-1, :, 1] < 0.03)
    return (np.linalg.norm(np.diff(toes[..., ::2], axis=0), axis=-1) * down).sum() / down.sum() * 20


@pytest.mark.parametrize("degrees", [90.0, -200.0])
def test_a_turned_path_keeps_its_length_and_ends_in_the_new_direction(degrees):
    motion = make()
    route = turned_route(motion.positions, degrees, fps=20.0)
    assert length_of(route.new) == pytest.approx(length_of(route.old), rel=1e-6)
    turned = motion.turned(degrees)
    change = np.rad2deg(heading(turned.positions) - heading(motion.positions))
    assert np.abs(change[0]) < 0.01
    assert (change[-1] - degrees + 180) % 360 - 180 == pytest.approx(0, abs=0.01)
    way = np.cumsum(np.linalg.norm(np.diff(route.new, axis=0), axis=1))
    assert np.ptp(np.diff(route.turns) / np.diff(way, prepend=0)) < 1e-6  # a part of a circle


def test_positive_angles_turn_left():
    motion = make()
    ahead = motion.positions[-1, 0] - motion.positions[0, 0]
    aside = motion.turned(60).positions[-1, 0] - motion.turned(-60).positions[-1, 0]
    left = motion.positions[0, 1] - motion.positions[0, 2]  # from the right hip to the left one
    assert aside @ left > 0 and abs(aside @ ahead) < 0.1 * np.linalg.norm(aside) * np.linalg.norm(ahead)


def test_a_new_path_keeps_bones_heights_and_what_a_motion_says():
    motion = dataclasses.replace(make(), part_starts=(0, 50), part_captions=("walks", "goes"))
    moved = motion.along([(0, 0), (1, 2), (3, 2)])
    np.testing.assert_allclose(bone_lengths(moved), bone_lengths(motion), atol=1e-4)
    # Only the legs bend, so that standing feet stay where they are.
    rest = [joint for joint in range(22) if joint not in (4, 5, 7, 8, 10, 11)]
    np.testing.assert_allclose(moved.positions[:, rest, 1], motion.positions[:, rest, 1], atol=1e-5)
    assert (moved.part_starts, moved.part_captions) == ((0, 50), ("walks", "goes"))
    assert moved.caption == "walk" and moved.fps == 20 and moved.features is None


def test_a_path_leads_through_its_points_and_straight_on():
    motion = make()
    points = np.array([(0.5, -1.0), (0.5, 0.5), (1.5, 1.0)])
    route = route_along(motion.positions, points.tolist(), fps=20.0)
    places = route.new[:, ::2]
    near = np.linalg.norm(places[:, None] - points, axis=-1).min(axis=0)
    assert near[0] < 1e-6 and near.max() < 0.05
    assert length_of(route.new) == pytest.approx(length_of(route.old), rel=1e-3)
    last, middle = places[-1] - places[-2], places[-10] - places[-11]  # after the last point
    assert abs(last[0] * middle[1] - last[1] * middle[0]) < 1e-6
    moved = motion.along(points.tolist())
    forward = np.diff(route.new, axis=0)
    change = np.unwrap(heading(moved.positions) - heading(motion.positions))
    expected = np.unwrap(np.arctan2(forward[:, 0], forward[:, 2]))
    # The synthetic walk is straight, so its heading changes as the path does.
    np.testing.assert_allclose(change[5:-5] - change[5], expected[5:-4] - expected[5], atol=0.1)


def test_points_far_beyond_the_end_of_a_motion_cost_nothing():
    motion = make()
    near = [(0.0, 0.0), (0.0, 50.0)]
    far = near + 10 * [(900.0, 60.0), (900.0, 900.0), (-900.0, 900.0), (-900.0, -900.0), (900.0, -900.0)]
    routes = [route_along(motion.positions, points, fps=20.0) for points in (near, far)]
    np.testing.assert_allclose(routes[0].new, routes[1].new, atol=0.5)  # the curve bends before the next point
    curve, _, length = _curve(np.array(far), 3.0)
    assert len(curve) < 1000 and length > 20_000


def test_a_curve_is_cut_where_the_motion_ends():
    """Up to a place between two waypoints, the way may be shorter than the line."""
    points = np.array([(0.0, 0.0), (0.928, 0.374), (2.927, 0.438), (-2.612, -7.888)])
    curve, way, length = _curve(points, 4.94)
    whole, whole_way, whole_length = _curve(points, 100.0)
    wanted = np.linspace(0, 4.94, 50)
    for axis in (0, 2):
        found, expected = (np.interp(wanted, *both) for both in ((way, curve[:, axis]), (whole_way, whole[:, axis])))
        np.testing.assert_allclose(found, expected, atol=1e-3)
    assert way[-2] < 7 and length == pytest.approx(whole_length, rel=1e-3)


def test_the_path_that_a_motion_has_changes_little():
    motion = make()
    start, end = motion.positions[0, 0, ::2], motion.positions[-1, 0, ::2]
    same = motion.along([start.tolist(), end.tolist()])
    assert np.linalg.norm(same.positions - motion.positions, axis=-1).max() < 0.1
    assert np.linalg.norm(same.positions - motion.positions, axis=-1).mean() < 0.02


def test_feet_that_stand_do_not_turn_with_the_body():
    motion = make()
    # The feet of the synthetic walk slide, too: they are locked as in the clean-up.
    assert foot_slide(motion.turned(120).positions) < 0.9 * foot_slide(motion.positions)


def test_raw_positions_go_along():
    motion = make()
    both = Motion(motion.positions, 20.0, positions_raw=motion.positions + np.float32([0, 1, 0])).turned(45)
    np.testing.assert_allclose(both.positions_raw[:, 0], both.positions[:, 0] + np.float32([0, 1, 0]), atol=1e-4)


@pytest.mark.slow
def test_other_frame_rates_have_the_same_path():
    motion = make()
    slow, fast = motion.turned(90), motion.resampled(60).turned(90)
    assert np.linalg.norm(fast.positions[::3, 0] - slow.positions[:, 0], axis=-1).max() < 0.03


@pytest.mark.parametrize("degrees", [float("nan"), float("inf"), 721.0, -1e9])
def test_impossible_turns_are_refused(degrees):
    with pytest.raises(UserError, match=r"turn: .* is not a number from -720 to 720 degrees"):
        make().turned(degrees)


@pytest.mark.parametrize(
    ("points", "message"),
    [
        ([], "0 points; give two or more"),
        ([(0, 0)], "1 point; give two or more"),
        ([(0, 0), (1, 2, 3)], "point 2 needs two numbers, x and z in meters, not 3"),
        ([(0,)], "point 1 needs two numbers, x and z in meters, not 1"),
        ([(0, 0), (1, float("nan"))], "point 2 is not within 1000 m"),
        ([(0, 0), (1e9, 0)], "point 2 is not within 1000 m"),
        ([(0, 0), (1, 0), (1, 0)], "points 2 and 3 are at the same place"),
        ([(0, 0), (1, 0), (0, 0.1)], "turns back at point 2"),
    ],
)
def test_what_is_no_path_is_refused(points, message):
    with pytest.raises(UserError, match=message):
        make().along(points)


def test_motion_that_does_not_travel_has_no_path():
    for still in (make("wave-left-hand"), make()[:1]):
        with pytest.raises(UserError, match=r"turn: the motion travels 0\.\d\d m; 0\.5 m or more are needed"):
            still.turned(90)
        with pytest.raises(UserError, match=r"path: the motion travels"):
            still.along([(0, 0), (0, 2)])


def test_a_path_that_is_longer_than_the_motion_is_said(caplog):
    motion = make()
    travelled = float(np.linalg.norm(motion.positions[-1, 0, [0, 2]] - motion.positions[0, 0, [0, 2]]))
    motion.along([(0, 0), (0, 0.9 * travelled)])
    assert not caplog.text
    motion.along([(0, 0), (0, 3 * travelled)])
    assert f"path: it is {3 * travelled:.1f} m long" in caplog.text
    assert f"a motion of about {3 * motion.seconds:.0f} s would reach it" in caplog.text
