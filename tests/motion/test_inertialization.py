"""Motion that goes on from another one: sums of motions, and a new middle."""

import numpy as np
import pytest

from t2m_jax.data.importers.synthetic import make_motion
from t2m_jax.motion.features import bone_vectors, positions_from_bones
from t2m_jax.motion.joining import join_positions, place_positions, replace_middle
from t2m_jax.motion.mirroring import mirror_positions
from t2m_jax.motion.rotations import unit_vectors
from t2m_jax.motion.skeleton import HUMANML3D

from .figures import INDEX, standing_offsets, walking_positions

FPS = 20.0
FADE = 8
"""Frames from a join to the first frame that is as it was."""


def join(first, second):
    return join_positions(first, second, fps=FPS, skeleton=HUMANML3D)


def redo(head, generated, tail, *, first, last):
    return replace_middle(head, generated, tail, first=first, last=last, fps=FPS, skeleton=HUMANML3D)


def with_bones(positions, lengths):
    """The same directions of bones with other lengths."""
    bones = unit_vectors(bone_vectors(positions, HUMANML3D).astype(np.float64)) * lengths[:, None]
    return positions_from_bones(positions[:, 0], bones, HUMANML3D).astype(np.float32)


def motion(kind, num_frames=80, lengths=HUMANML3D.bone_lengths[1:]):
    """A motion whose bones have the same lengths as those of the other kinds."""
    own = walking_positions(num_frames) if kind == "stroll" else make_motion(kind, seed=3, num_frames=num_frames)
    return with_bones(own, np.asarray(lengths))


def standing(num_frames=60):
    """A figure that does not move."""
    pose = positions_from_bones(np.array([[0.0, 0.9, 0.0]]), standing_offsets()[None, 1:], HUMANML3D)
    return np.repeat(pose, num_frames, axis=0).astype(np.float32)


def bone_lengths(positions):
    return np.linalg.norm(bone_vectors(positions.astype(np.float64), HUMANML3D), axis=-1)


def velocity_changes(positions):
    """How much each joint changes its velocity from frame to frame, in m/s."""
    return np.linalg.norm(np.diff(positions.astype(np.float64), n=2, axis=0), axis=-1) * FPS


def turns(positions):
    """By how many degrees each bone turns from frame to frame."""
    bones = unit_vectors(bone_vectors(positions.astype(np.float64), HUMANML3D))
    return np.rad2deg(2 * np.arcsin(np.clip(np.linalg.norm(np.diff(bones, axis=0), axis=-1) / 2, 0, 1)))


def with_turned_forearm(positions, degrees):
    """The left forearm turned, about an axis that is not its own, with the bones as they were."""
    bones = bone_vectors(positions, HUMANML3D).astype(np.float64)
    forearm = bones[:, INDEX["left_wrist"] - 1]
    side = unit_vectors(np.cross(forearm, [0.3, 0.1, 1.0])) * np.linalg.norm(forearm, axis=-1, keepdims=True)
    angle = np.deg2rad(degrees)
    bones[:, INDEX["left_wrist"] - 1] = np.cos(angle) * forearm + np.sin(angle) * side
    return positions_from_bones(positions[:, 0], bones, HUMANML3D).astype(np.float32)


PAIRS = [("stroll", "wave-left-hand"), ("wave-left-hand", "stroll"), ("walk", "squat"), ("stroll", "stroll")]


@pytest.mark.parametrize(("one", "other"), PAIRS)
@pytest.mark.parametrize("end", [50, 57, 63])
def test_a_sum_keeps_bones_and_velocities(one, other, end):
    first = motion(one)[:end]
    second = motion(other)
    joined = join(first, second)
    assert np.abs(bone_lengths(joined) - bone_lengths(first)[0]).max() < 1e-4
    placed = place_positions(second, second[0], first[-1], skeleton=HUMANML3D)
    apart, faster = np.linalg.norm([first[-1] - placed[0], np.diff(first, axis=0)[-1] - placed[1] + placed[0]], axis=-1)
    # A cubic curve from a difference and its velocity to zero accelerates by no more than these.
    needed = (6 * apart / FADE**2 + 4 * faster / FADE) * FPS
    for joints in (slice(0, 1), slice(None)):  # the root alone, and all
        inside = max(velocity_changes(part)[:, joints].max() for part in (first, second))
        found = velocity_changes(joined)[end - 2 : end + 1, joints].max(axis=0)
        assert (found < 1.2 * inside + needed[joints]).all()
    fastest = max(turns(part).max() for part in (first, second))
    assert turns(joined)[end - 2 : end + FADE].max() < fastest + 1.5 * 180 / FADE


@pytest.mark.parametrize(("one", "other"), PAIRS)
def test_frames_outside_of_the_fade_are_as_they_were(one, other):
    first = motion(one)[:50]
    second = motion(other)
    joined = join(first, second)
    assert len(joined) == len(first) + len(second) - 1
    np.testing.assert_array_equal(joined[:50], first)
    placed = place_positions(second, second[0], first[-1], skeleton=HUMANML3D)
    np.testing.assert_array_equal(joined[50 + FADE - 1 :], placed[FADE:].astype(np.float32))
    assert np.abs(joined[50 : 50 + FADE - 1] - placed[1:FADE]).max() > 0.01


@pytest.mark.parametrize("end", [30, 36, 41, 55])
def test_parts_of_a_motion_become_this_motion_again(end):
    whole = motion("stroll")
    np.testing.assert_allclose(join(whole[:end], whole[end - 1 :]), whole, atol=1e-3)
    redone = redo(whole[:end], whole, whole[end + 20 :], first=end, last=end + 20)
    np.testing.assert_allclose(redone, whole, atol=1e-3)


@pytest.mark.parametrize(("one", "other"), PAIRS)
def test_the_mirror_image_of_a_join_joins_mirror_images(one, other):
    first = motion(one)[:50]
    second = motion(other)
    mirrored = [mirror_positions(part, HUMANML3D) for part in (first, second)]
    np.testing.assert_allclose(join(*mirrored), mirror_positions(join(first, second), HUMANML3D), atol=1e-4)
    redone = redo(first, second, second[60:], first=50, last=60)
    other_side = redo(mirrored[0], mirrored[1], mirrored[1][60:], first=50, last=60)
    np.testing.assert_allclose(other_side, mirror_positions(redone, HUMANML3D), atol=1e-4)


def test_a_body_that_walks_does_not_stop_in_one_frame():
    walk = motion("stroll")[:50]
    joined = join(walk, standing())
    speeds = np.linalg.norm(np.diff(joined[:, 0], axis=0), axis=-1) * FPS
    assert speeds[40:49].min() > 1 and speeds[49 + FADE :].max() < 1e-3
    assert speeds[49] > 0.7 * speeds[48]


def test_bones_of_another_figure_go_from_one_length_to_the_other():
    lengths = np.asarray(HUMANML3D.bone_lengths[1:])
    first = motion("stroll")[:50]
    second = motion("wave-left-hand", lengths=1.2 * lengths)
    found = bone_lengths(join(first, second)) / lengths
    steps = np.diff(found, axis=0)
    assert steps.min() > -1e-4 and steps.max() < 2 * 0.2 / FADE
    np.testing.assert_allclose(found[[0, -1]], [np.full(21, 1.0), np.full(21, 1.2)], atol=1e-4)


@pytest.mark.parametrize("degrees", [90, 110, 130, 160, 180])
def test_no_forearm_turns_over_in_one_frame(degrees):
    """However far the poses are from each other, also if each joint would go through the one before it."""
    whole = motion("stroll")
    turned = with_turned_forearm(whole, degrees)
    fastest = turns(whole).max() + 1.5 * degrees / FADE
    redone = redo(whole[:24], turned, whole[56:], first=24, last=56)
    assert turns(redone)[22:58].max() < fastest
    np.testing.assert_array_equal(redone[:24], whole[:24])
    assert turns(join(whole[:40], turned[40:])).max() < fastest


def test_a_jump_of_a_recording_does_not_carry_on():
    walk = motion("stroll")[:50].copy()
    walk[-1] += [0, 0, 3]
    joined = join(walk, standing())
    assert np.linalg.norm(joined[50:, 0] - joined[-1, 0], axis=-1).max() < 1


@pytest.mark.parametrize("lengths", [(1, 40), (40, 1), (2, 40), (40, 2), (1, 1), (40, 5)])
def test_short_motions_can_be_joined(lengths):
    first, second = (motion(kind)[:count] for kind, count in zip(("stroll", "squat"), lengths, strict=True))
    joined = join(first, second)
    assert len(joined) == sum(lengths) - 1 and np.isfinite(joined).all()
    assert np.abs(bone_lengths(joined) - bone_lengths(first)[0]).max() < 1e-4
    np.testing.assert_array_equal(joined[: len(first)], first)


@pytest.mark.parametrize("is_middle", [False, True])
@pytest.mark.parametrize(("kind", "end", "start"), [("walk", 35, 56), ("squat", 59, 29), ("stroll", 53, 20)])
def test_no_foot_goes_through_the_floor_at_a_seam(kind, end, start, is_middle):
    own = motion(kind, num_frames=120)
    head = own[:end]
    joined = redo(head, own[30:70], own[start:], first=10, last=30) if is_middle else join(head, own[start:])
    feet = np.array([HUMANML3D.left_foot, HUMANML3D.right_foot])
    assert (joined[:, feet, 1].min(axis=(0, 1)) > own[:, feet, 1].min(axis=(0, 1)) - 1e-4).all()
    np.testing.assert_allclose(bone_lengths(joined), bone_lengths(own)[[0] * len(joined)], atol=1e-4)
    np.testing.assert_array_equal(joined[:end], head)
