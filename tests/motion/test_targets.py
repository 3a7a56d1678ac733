"""Targets as texts, what nobody can meet, and how far a motion is from them."""

import math

import numpy as np
import pytest

from t2m_jax.data.importers.synthetic import make_motion
from t2m_jax.errors import UserError
from t2m_jax.motion.features import ground_positions
from t2m_jax.motion.joining import place_positions
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.skeleton import HUMANML3D, KIT_ML
from t2m_jax.motion.targets import (
    MAX_TARGETS,
    check_targets,
    distances,
    missed_targets,
    move_target,
    read_target,
    rushed_targets,
    seen_from_root,
    targets_from_text,
)

WRIST = HUMANML3D.joint_names.index("right_wrist")


@pytest.fixture(scope="module")
def motion():
    """A person who walks and turns."""
    return Motion(make_motion("walk", seed=4, num_frames=60), 20.0).turned(80.0)


def text_of(name, place, *, sign="=", frame=30):
    return f"{frame / 20:g} {name}{sign}{','.join(f'{value:.9g}' for value in place)}"


def test_a_motion_is_at_its_own_places(motion):
    pose = motion.positions[30]
    forward = seen_from_root(motion.positions, HUMANML3D)[30]
    targets = [
        read_target(text_of("right_wrist", pose[WRIST])),
        read_target(text_of("root", pose[0, [0, 2]])),
        read_target(text_of("right_wrist", forward[WRIST], sign="+=")),
        read_target((1.5, motion[30:31])),
    ]
    np.testing.assert_allclose(distances(motion, targets), 0, atol=1e-5)
    assert missed_targets(motion, targets) == ""


def test_distances_are_in_meters_and_degrees(motion):
    x, y, z = motion.positions[30, WRIST].tolist()
    root = motion.positions[30, 0]
    targets = [
        read_target(text_of("right_wrist", (x + 0.3, y, z - 0.4))),
        read_target(text_of("root", (root[0], root[2] + 2.0))),
    ]
    np.testing.assert_allclose(distances(motion, targets), [0.5, 2.0], rtol=1e-5)
    assert missed_targets(motion, targets) == "misses right_wrist at 1.5 s by 0.5 m, root at 1.5 s by 2 m"


def test_a_moved_target_is_as_far_from_the_moved_motion(motion):
    place = motion.turned(150.0).positions[-1] + np.array([2.0, 0, -3.0], np.float32)
    pose = motion.positions[12]
    later = np.concatenate([motion.positions[:1]] * 7 + [motion.positions])
    moved = Motion(place_positions(later, pose, place, skeleton=HUMANML3D).astype(np.float32), 20.0)
    texts = ("1 right_wrist=1,1.2,0.3", "0.5:1 left_foot=0.1,0,2", "1 root=1,-2", "1 facing=100", "1 head+=0,1.5,0.2")
    targets = [*map(read_target, texts), read_target((2.0, motion))]
    there = [move_target(target, 0.35, pose, place, skeleton=HUMANML3D) for target in targets]
    np.testing.assert_allclose(distances(moved, there), distances(motion, targets), rtol=1e-3, atol=1e-4)
    assert min(distances(motion, targets)) > 0.03 and there[1].until == 1.35


def test_a_direction_is_to_the_left():
    """Left is +x: a figure that faces +z and turns to the left faces +x after a quarter of a turn."""
    positions = ground_positions(make_motion("walk", seed=4, num_frames=60), HUMANML3D)
    left = Motion(positions[..., [2, 1, 0]] * np.array([1, 1, -1.0]), 20.0)
    targets = [read_target(f"0 facing={angle}") for angle in (90, 270, -90, 450, 80, 0)]
    np.testing.assert_allclose(distances(left, targets), [0, 180, 180, 0, 10, 90], atol=1e-3)


def test_a_target_over_a_time_counts_its_worst_frame(motion):
    x, y, z = motion.positions[20, WRIST].tolist()
    one, all_ = (read_target(f"{time} right_wrist={x},{y},{z}") for time in ("1", "1:2"))
    assert list(one.frames(20.0)) == [20] and list(all_.frames(20.0)) == list(range(20, 41))
    apart = np.linalg.norm(motion.positions[20:41, WRIST] - motion.positions[20, WRIST], axis=-1)
    np.testing.assert_allclose(distances(motion, [one, all_]), [0, apart.max()], atol=1e-5)


def test_a_pose_may_be_a_text(motion):
    pose = motion.positions[20]
    (target,) = targets_from_text(f"1 pose={','.join(f'{number:.3f}' for number in pose.ravel())}")
    check_targets([target], HUMANML3D)
    np.testing.assert_allclose(target.pose, pose, atol=6e-4)
    assert distances(motion, [target])[0] < 1e-3 < distances(motion[:10], [target])[0]


def test_targets_in_one_text():
    first, second = targets_from_text(" 1.5:2 left_wrist += 0.2, 1,0.3 ;4 root=1,-3;")
    assert (first.seconds, first.until, first.joint, first.place) == (1.5, 2.0, "left_wrist", (0.2, 1.0, 0.3))
    assert first.relative and not second.relative
    assert (second.seconds, second.until, second.joint, second.place) == (4.0, None, "root", (1.0, -3.0))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("right_wrist=1,1,1", "is not TIME JOINT=X,Y,Z"),
        ("2 right_wrist", "is not TIME JOINT=X,Y,Z"),
        ("2 right_wrist=a,b,c", "is not TIME JOINT=X,Y,Z"),
        ("x right_wrist=0,1,0", "is not TIME JOINT=X,Y,Z"),
        ("2 pose=1,2", "a pose has three numbers for each joint, not 2"),
        ("2 pose=1,2,nan", "pose at 2 s: is not finite"),
        ("2 pose+=1,2,3", "is not seen from the root"),
        ("2 right_wrist=0,1", "right_wrist at 2 s: needs 3 numbers"),
        ("2 root=0,1,2", "root at 2 s: needs 2 numbers"),
        ("2 facing=0,1", "facing at 2 s: needs 1 number,"),
        ("2 root+=0,1", "is not seen from the root"),
        ("2 root=1", "root at 2 s: needs 2 numbers, not 1"),
        ("2 root=nan,1", "root at 2 s: nan is not a finite number"),
        ("2 right_wrist=0,nan,0", "right_wrist at 2 s: nan is not a finite number"),
        ("2 right_wrist=0,1e400,0", "right_wrist at 2 s: inf is not a finite number"),
        ("-1 root=0,0", "root at -1 s: is not a time from 0"),
        ("nan root=0,0", "is not a time from 0"),
        ("2:1 root=0,0", "root at 2 to 1 s: ends before it begins"),
        ("2:-1 root=0,0", "is not a time from 0"),
        ("2:inf root=0,0", "is not a time from 0"),
        ("1:2 left_foot=0,1", "left_foot at 1 to 2 s: needs 3 numbers, not 2"),
    ],
)
def test_what_is_no_target_is_one_line(text, says):
    with pytest.raises(UserError, match=r"^targets: ") as caught:
        read_target(text)
    assert says in str(caught.value) and "\n" not in str(caught.value)


MOTION = Motion(np.zeros((1, 22, 3)), 20.0)


@pytest.mark.parametrize(
    "given",
    [
        *(3, None, (1.0,), (1.0, "walk.npz"), ("soon", MOTION), ["1 root=0,0"]),
        *((1.0, MOTION, "near"), (1.0, MOTION, np.zeros(2)), (1.0, MOTION, "exact", "exact")),
    ],
)
def test_what_is_no_text_is_one_line(given):
    with pytest.raises(UserError, match="is not a text"):
        read_target(given)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("0.5 root=0,3", "root at 0.5 s: 3 m in 0.5 s is faster than 5 m/s"),
        ("0.1 left_wrist=0,1,3", "left_wrist at 0.1 s: 1.8 m in 0.1 s is faster"),
        ("2 right_wrist=0,3,0", "right_wrist at 2 s: nobody reaches a height of 3 m"),
        ("2 head=0.9,2.5,0.9", "head at 2 s: nobody reaches a height of 2.5 m"),
        ("2 right_wrist=0,-0.5,0", "right_wrist at 2 s: -0.5 m is under the floor; possible: -0.05 to "),
        ("1 left_foot=0.1,-0.5,0.2", "left_foot at 1 s: -0.5 m is under the floor"),
        ("1 left_foot+=0.1,-0.1,0.2", "left_foot at 1 s: -0.1 m is under the floor"),
        ("1 pelvis=0,0,0", "pelvis at 1 s: nobody reaches a height of 0 m; possible: 0.09 to 1.68 m"),
        ("1 pelvis=0,-0.03,0", "pelvis at 1 s: -0.03 m is under the floor; possible: 0.09 to 1.68 m"),
        ("1 left_hip=0,0.05,0", "nobody reaches a height of 0.05 m; possible: 0.09"),
        ("1 head=0,0.05,0", "nobody reaches a height of 0.05 m; possible: 0.09"),
        ("1 left_shoulder=0,0,0", "nobody reaches a height of 0 m; possible: 0.09"),
        ("1 pelvis=0,0.9,0; 1.1 pelvis=0,0.2,0", "pelvis at 1.1 s: 0.7 m in 0.1 s is faster than 5 m/s"),
        ("2 facing=1e9", "facing at 2 s: 1e+09 is not from -720 to 720 degrees"),
        ("2 facing=-721", "facing at 2 s: -721 is not from -720 to 720 degrees"),
        ("2 right_wrist+=0,1,2", "nobody reaches 2 m from the root"),
        ("2 head+=0,1,0.9", "nobody reaches 0.9 m from the root"),
        ("1 root=0,0; 1.2 root=0,3", "root at 1.2 s: 3 m in 0.2 s"),
        ("1:2 left_wrist=0,1,0; 1.5 left_wrist=0,1.5,0", "left_wrist at 1.5 s: 0.5 m in 0 s is faster than 12 m/s"),
        ("1 nose=0,1,0", "nose at 1 s: no such joint; known: pelvis, "),
    ],
)
def test_what_nobody_can_meet_is_one_line(text, says):
    with pytest.raises(UserError) as caught:
        check_targets(targets_from_text(text), HUMANML3D)
    assert says in str(caught.value)


def test_possible_targets_pass():
    texts = "1 root=0,3; 2 root=0,4; 1 left_wrist=0,1,3.5; 1.2 left_wrist=0,1.5,3.8; 3 facing=9; 4 facing=-720"
    check_targets(targets_from_text(texts), HUMANML3D)
    # Who lies on the floor, or kneels and leans on the hands.
    low = [f"1 {name}=0,0.12,0" for name in HUMANML3D.joint_names]
    low += [f"1 {side}_{name}=0,0,0" for side in ("left", "right") for name in ("wrist", "knee", "ankle", "foot")]
    for text in low:
        check_targets(targets_from_text(text), HUMANML3D)


def test_a_body_that_falls_and_gets_up_too_fast_is_said(motion):
    positions = np.repeat(motion.positions[:1], 81, axis=0)

    def sunk(seconds, depth):
        way = depth * np.clip(1 - np.abs(np.arange(81) / 20 - 2) / seconds, 0, 1)
        return Motion(positions - way[:, None, None] * [0, 1, 0], 20.0)

    depth = positions[0, 0, 1] - 0.1
    targets = targets_from_text("2 pelvis=0,0.1,0; 0.2 root=0,0")
    said = rushed_targets(sunk(0.3, depth), targets)
    assert said.startswith("faster than people are: pelvis at 2 s: the root goes up or down near the floor by 2.")
    assert "0.2 s" not in said, "only the target that it is about"
    assert rushed_targets(sunk(1.0, depth), targets) == ""
    assert rushed_targets(sunk(0.15, 0.3), targets) == "", "a jump is fast, and not near the floor"


def test_a_pose_of_another_skeleton_and_too_many_targets_are_refused(motion):
    with pytest.raises(UserError, match=r"pose at 1 s: has 22 joints; skeleton kit_ml has 21"):
        check_targets([read_target((1.0, motion))], KIT_ML)
    with pytest.raises(UserError, match="65 are more than 64"):
        check_targets([read_target("1 root=0,0")] * (MAX_TARGETS + 1), HUMANML3D)


def test_the_root_sees_itself_ahead(motion):
    seen = seen_from_root(motion.positions, HUMANML3D)
    np.testing.assert_allclose(seen[:, 0, [0, 2]], 0, atol=1e-6)
    left, right = (HUMANML3D.joint_names.index(f"{side}_hip") for side in ("left", "right"))
    assert (seen[:, left, 0] > seen[:, right, 0]).all(), "left is +x"
    lengths = np.linalg.norm(seen - seen[:, :1], axis=-1)
    expected = np.linalg.norm(motion.positions - motion.positions[:, :1], axis=-1)
    np.testing.assert_allclose(lengths, expected, atol=1e-5)
    assert math.isclose(seen[..., 1].max(), motion.positions[..., 1].max(), rel_tol=1e-6)
