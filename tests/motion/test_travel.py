"""The travel of a motion, which a root bone carries, and which a motion in place does not have."""

import dataclasses

import numpy as np
import pytest

from t2m_jax import Motion
from t2m_jax.data.importers.synthetic import make_motion
from t2m_jax.motion.features import bone_vectors
from t2m_jax.motion.rotations import matrix_from_quaternion, rotate_vectors
from t2m_jax.motion.skeleton import HUMANML3D, KIT_ML
from t2m_jax.motion.travel import find_travel, keep_in_place, smooth_path

FPS = 30.0
SECONDS = np.arange(300) / FPS
STEPS = 2 * np.pi * 0.9 * SECONDS
SWAY = np.stack([0.03 * np.sin(STEPS), 0 * STEPS, 0.02 * np.cos(2 * STEPS)], axis=-1)


def travelling(path, sway=SWAY):
    """A standing figure that is moved along a path as it heads, and sways as one who walks."""
    pose = make_motion("walk", seed=3, num_frames=2)[0]
    heading = np.unwrap(np.arctan2(*np.gradient(path, axis=0).T[::2])) / 2
    turns = np.stack([np.cos(heading), 0 * heading, np.sin(heading), 0 * heading], axis=-1)
    turned = rotate_vectors(turns[:, None], (pose - pose[0] * (1, 0, 1))[None])
    return (turned + (path + sway)[:, None]).astype(np.float32)


STRAIGHT = SECONDS[:, None] * (0.3, 0.0, 1.2)
CIRCLE = 2.0 * np.stack([np.sin(0.6 * SECONDS), 0 * SECONDS, np.cos(0.6 * SECONDS)], axis=-1)


# On a circle, a smooth path is inside by half of the acceleration times the square of the standard deviation.
@pytest.mark.parametrize(("path", "near"), [(STRAIGHT, 0.01), (CIRCLE, 0.07)], ids=["straight", "circle"])
def test_in_place_keeps_the_sway_but_not_the_travel(path, near):
    positions = travelling(path)
    still = keep_in_place(positions, fps=FPS)
    middle = slice(45, -45)  # at the ends, it is not known what is sway
    np.testing.assert_allclose(still[middle, 0, ::2], SWAY[middle, ::2], atol=near)
    assert np.abs(still[:, 0, ::2]).max() < 0.1 and np.ptp(path[:, 2]) > 3.9
    np.testing.assert_array_equal(still[..., 1], positions[..., 1])
    np.testing.assert_allclose(bone_vectors(still, HUMANML3D), bone_vectors(positions, HUMANML3D), atol=2e-6)


def test_a_motion_in_place_keeps_its_texts_and_drops_what_does_not_fit():
    motion = Motion(make_motion("walk", seed=3, num_frames=60), 20.0, caption="walks")
    still = dataclasses.replace(motion, part_starts=(0,), part_captions=("a",)).in_place()
    assert still.caption == "walks" and still.part_captions == ("a",) and still.features is None


@pytest.mark.parametrize("kind", ["walk", "wave-left-hand"])
def test_a_loop_in_place_stays_a_loop(kind):
    loop = Motion(make_motion(kind, seed=3, num_frames=120), 20.0).looped()
    still = loop.in_place().positions
    np.testing.assert_allclose(still[-1], still[0], atol=1e-4)
    # Played twice, it is the same motion twice.
    twice = np.concatenate([loop.positions[:-1], loop.positions + (loop.positions[-1, 0] - loop.positions[0, 0])])
    again = keep_in_place(twice, fps=loop.fps)
    np.testing.assert_allclose(again[len(still) - 1 :], still, atol=2e-3)


@pytest.mark.parametrize("num_frames", [1, 2, 3])
def test_short_motions_stay_above_the_origin(num_frames):
    still = keep_in_place(travelling(STRAIGHT)[:num_frames], fps=FPS)
    assert np.abs(still[:, 0, ::2]).max() < 1e-2
    assert keep_in_place(still[:, :21], fps=FPS).shape == (num_frames, KIT_ML.num_joints, 3)


def test_the_frame_of_a_travel_begins_at_the_figure_and_faces_as_it_does():
    motion = Motion(make_motion("walk", seed=3, num_frames=100), 20.0).turned(170)
    travel = find_travel(motion.positions, fps=20.0, skeleton=HUMANML3D)
    np.testing.assert_allclose(travel.places[0], motion.positions[0, 0] * (1, 0, 1), atol=1e-6)
    ahead = matrix_from_quaternion(travel.turns)[..., 2]
    path = np.gradient(smooth_path(motion.positions, fps=20.0), axis=0)
    cosines = np.sum(ahead * path, axis=-1) / np.linalg.norm(path, axis=-1)
    assert cosines.min() > 0.9 and ahead[:, 1].max() == 0 and ahead[0] @ ahead[-1] < -0.9
    local = travel.local_places(motion.positions[:, 0])
    assert np.abs(local[:, ::2]).max() < 0.1
