"""The clean-up: what trembles, stretches or slides is corrected, and what is right stays."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from t2m_jax.data import make_motion
from t2m_jax.metrics.quality import measure_quality
from t2m_jax.motion import cleanup
from t2m_jax.motion.cleanup import (
    SIGMA,
    _standing,
    clean_long,
    clean_positions,
    fix_bones,
    lock_feet,
    lock_shift,
)
from t2m_jax.motion.legs import eased_bends, limit_speed, move_foot
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.resampling import resample_positions
from t2m_jax.motion.skeleton import HUMANML3D, KIT_ML
from t2m_jax.motion.smoothing import smooth_over_clip
from t2m_jax.motion.torso import calm_torso, make_hubs_rigid

FRAMES = 60
ALL = jnp.asarray(FRAMES)
EVERY = jnp.ones(FRAMES, bool)
LEFT_LEG, LEFT_FOOT = (1, 4, 7, 10), 10
smooth = jax.jit(functools.partial(smooth_over_clip, sigma=0.9))
fix = jax.jit(functools.partial(fix_bones, skeleton=HUMANML3D))
calm = jax.jit(functools.partial(calm_torso, skeleton=HUMANML3D))
keep = jax.jit(functools.partial(make_hubs_rigid, skeleton=HUMANML3D))
lock = jax.jit(functools.partial(lock_feet, skeleton=HUMANML3D), static_argnames="fps")
bends_of, move = jax.jit(eased_bends), jax.jit(move_foot)
measure = jax.jit(measure_quality, static_argnames="skeleton")
clean = functools.partial(clean_positions, skeleton=HUMANML3D)
lock_shift_of = jax.jit(lock_shift)
standing_of = jax.jit(_standing, static_argnames="fps")


def walk(*, seed=0, kind="walk"):
    return make_motion(kind, seed=seed, num_frames=FRAMES).astype(np.float32)


def rigid(*, seed, kind):
    """Returns a synthetic motion whose pelvis, which bends in a squat, is rigid, while the feet stand."""
    return np.array(lock(keep(walk(seed=seed, kind=kind), ALL), ALL))


def shapes(positions, skeleton=HUMANML3D):
    """Returns the distances between the joints that pelvis and chest move, frame by frame."""
    pieces = {"humanml3d": ((1, 2, 3), (12, 13, 14)), "kit_ml": ((1, 11, 16),)}[skeleton.name]
    pairs = [(one, other) for piece in pieces for one in piece for other in piece if one < other]
    return np.stack([distances(positions[:, one], positions[:, other]) for one, other in pairs], axis=1)


def cleaned(positions, length=None):
    """Returns a cleaned motion, in a batch of two, as those of other tests."""
    return np.asarray(clean(np.stack([positions] * 2), np.full(2, length or len(positions)))[0])


def bone_lengths(positions, skeleton=HUMANML3D):
    return np.linalg.norm(positions[:, 1:] - positions[:, list(skeleton.parents[1:])], axis=-1)


def distances(one, other):
    return np.linalg.norm(np.asarray(one) - np.asarray(other), axis=-1)


def quality(positions):
    found = measure(jnp.asarray(positions)[None], jnp.ones((1, len(positions)), bool), skeleton=HUMANML3D)
    return {name: float(values[0]) for name, values in found._asdict().items()}


def trembling(positions, size, seed=0):
    return positions + size * np.random.default_rng(seed).standard_normal(positions.shape).astype(np.float32)


def test_straight_movement_is_not_smoothed_not_even_at_the_ends():
    line = np.linspace(0, 3, FRAMES, dtype=np.float32)[:, None, None] * np.array([1, -0.5, 2], np.float32)
    np.testing.assert_allclose(smooth(line, ALL), line, atol=1e-5)


def test_the_swing_of_a_runner_stays():
    """Two and a half times a second, and 40 cm wide."""
    swing = 0.2 * np.sin(2 * np.pi * 2.5 * np.arange(FRAMES) / 20)[:, None, None] * np.ones((1, 1, 3))
    smooth = jax.jit(functools.partial(smooth_over_clip, sigma=SIGMA * 20))
    smoothed = np.asarray(smooth(swing.astype(np.float32), ALL))
    assert np.abs(smoothed - swing)[10:-10].max() < 0.0015


def test_slow_movement_stays_and_trembling_goes():
    seconds = np.arange(FRAMES)[:, None, None] / 20
    slow = np.sin(2 * np.pi * seconds) * np.ones((1, 1, 3))
    fast = 0.01 * (-1.0) ** np.arange(FRAMES)[:, None, None]
    inner = slice(8, -8)
    assert np.abs(smooth(slow.astype(np.float32), ALL) - slow)[inner].max() < 0.005
    assert np.abs(smooth((slow + fast).astype(np.float32), ALL) - slow)[inner].max() < 0.006


def test_bones_get_their_lengths_and_the_root_stays():
    positions = trembling(walk(), 0.02)
    fixed = np.asarray(fix(positions))
    expected = np.tile(HUMANML3D.bone_lengths[1:], (FRAMES, 1))
    np.testing.assert_allclose(bone_lengths(fixed), expected, rtol=1e-4)
    np.testing.assert_array_equal(fixed[:, 0], positions[:, 0])


def test_one_stretched_bone_does_not_move_a_whole_limb():
    positions = walk()
    stretched = positions.copy()
    # The forearm is 6 cm too long, and the wrist is at its end.
    forearm = stretched[:, 20] - stretched[:, 18]
    stretched[:, 20] += 0.06 * forearm / np.linalg.norm(forearm, axis=-1, keepdims=True)
    fixed = np.asarray(fix(stretched))
    np.testing.assert_allclose(bone_lengths(fixed)[:, 19], HUMANML3D.bone_lengths[20], rtol=1e-4)
    others = [joint for joint in range(22) if joint not in (16, 18, 20)]
    assert distances(fixed, stretched)[:, others].max() < 0.01


def test_right_bones_are_not_changed():
    np.testing.assert_allclose(fix(walk()), walk(), atol=1e-5)


SPINE = [HUMANML3D.joint_names.index(name) for name in ("spine1", "spine2", "spine3", "neck")]


def bones(positions):
    return positions[:, 1:] - positions[:, list(HUMANML3D.parents[1:])]


def test_a_torso_that_only_moves_as_a_whole_is_not_changed():
    angles = np.linspace(0, 2, FRAMES)
    turns = np.zeros((FRAMES, 3, 3))
    turns[:, 0, 0] = turns[:, 2, 2] = np.cos(angles)
    turns[:, 0, 2], turns[:, 2, 0], turns[:, 1, 1] = np.sin(angles), -np.sin(angles), 1
    body = walk(kind="wave-left-hand")[0]
    turning = (np.einsum("tab,jb->tja", turns, body) + np.linspace(0, 2, FRAMES)[:, None, None]).astype(np.float32)
    np.testing.assert_allclose(calm(turning, ALL), turning, atol=1e-5)


def test_a_trembling_spine_becomes_calm_and_limbs_keep_their_directions():
    positions = walk(kind="wave-left-hand")
    shaken = positions.copy()
    shaken[:, SPINE] = trembling(shaken, 0.005)[:, SPINE]
    shaken = np.asarray(fix(shaken))
    calmed = np.asarray(calm(shaken, ALL))
    turns = [
        np.linalg.norm(np.diff(bones(one), axis=0), axis=-1)[:, np.array(SPINE) - 1].mean() for one in (shaken, calmed)
    ]
    assert turns[1] < 0.5 * turns[0]
    np.testing.assert_allclose(bone_lengths(calmed), bone_lengths(shaken), atol=1e-5)
    limbs = [joint - 1 for joint in (4, 5, 7, 8, 10, 11, 18, 19, 20, 21)]
    np.testing.assert_allclose(bones(calmed)[:, limbs], bones(shaken)[:, limbs], atol=1e-5)


def slide_of(seed, size):
    """Returns a person who stands and waves, and whose left foot slides over the ground by up to a size."""
    positions, generator = walk(seed=seed, kind="wave-right-hand"), np.random.default_rng(seed)
    phases = generator.uniform(0, 2 * np.pi, 2)
    time = np.arange(FRAMES)[:, None] / 20
    slide = np.zeros((FRAMES, 3), np.float32)
    slide[:, ::2] = size * np.sin(2 * np.pi * 0.7 * time + phases)
    leg = [jnp.asarray(positions[:, joint]) for joint in LEFT_LEG]
    moved = move(*leg, jnp.asarray(slide), bends_of(*leg[:3], jnp.asarray(slide)))
    for joint, values in zip(LEFT_LEG[1:], moved, strict=True):
        positions[:, joint] = values
    return positions


def toe_speed(positions):
    """Returns the mean speed of the left toe over the ground."""
    return float(20 * np.linalg.norm(np.diff(positions[:, LEFT_FOOT, ::2], axis=0), axis=1).mean())


@given(seed=st.integers(0, 30), size=st.floats(0.005, 0.03))
@settings(max_examples=15, deadline=None)
def test_a_sliding_foot_is_locked(seed, size):
    positions = slide_of(seed, size)
    locked = np.asarray(lock(positions, ALL))
    assert toe_speed(locked) < 0.2 * toe_speed(positions)
    assert distances(locked, positions)[:, (7, 8, 10, 11)].max() <= cleanup.LARGEST_SHIFT + 1e-4
    np.testing.assert_allclose(bone_lengths(locked), bone_lengths(positions), atol=1e-4)
    others = [joint for joint in range(22) if joint not in (4, 5, 7, 8, 10, 11)]
    np.testing.assert_array_equal(locked[:, others], positions[:, others])
    # A foot keeps its height, and no knee jumps.
    assert np.abs(locked[:, (10, 11), 1] - positions[:, (10, 11), 1]).max() < 0.005
    steps = [np.linalg.norm(np.diff(one[:, (4, 5)], n=2, axis=0), axis=-1).max() for one in (locked, positions)]
    assert steps[0] < steps[1] + 0.03


def test_a_foot_that_goes_away_is_not_held():
    """A lock that needs more than the largest shift is released, in the frames that are too far away."""
    toe = np.zeros((FRAMES, 3), np.float32)
    toe[30:, 0] = np.linspace(0, 1, FRAMES - 30)
    shift = np.asarray(lock_shift_of(toe, np.ones(FRAMES, bool)))
    assert np.linalg.norm(shift, axis=-1).max() <= cleanup.LARGEST_SHIFT
    np.testing.assert_allclose(shift[45:], 0, atol=1e-6)


def test_a_lock_fades_in_and_out():
    """The foot rests 4 cm beside itself, so the shift falls to zero within some frames after it stands."""
    toe = np.zeros((FRAMES, 3), np.float32)
    toe[20:25, 0], toe[25:30, 0] = -0.04, 0.04
    standing = (np.arange(FRAMES) >= 20) & (np.arange(FRAMES) < 30)
    shift = np.asarray(lock_shift_of(toe, standing))[:, 0]
    np.testing.assert_allclose((toe[:, 0] + shift)[20:30], 0, atol=1e-6)
    assert (np.diff(np.abs(shift[29:36])) <= 0).all() and shift[35] == 0 == shift[14]
    assert np.abs(np.diff(shift[29:40])).max() < 0.02


@pytest.mark.slow
def test_a_lock_is_as_gentle_at_a_higher_rate():
    """In a step of the walk, the foot changes its speed by no more than with three times fewer frames."""
    slow = walk(seed=1)
    fast = resample_positions(slow, fps=20.0, new_fps=60.0, skeleton=HUMANML3D)
    moved = np.asarray(lock(fast, jnp.asarray(len(fast)), fps=60.0)) - fast
    expected = np.asarray(lock(slow, ALL)) - slow
    faster, slower = (np.abs(np.diff(shift[:, LEFT_FOOT], axis=0)).max() for shift in (moved[::3], expected))
    assert faster < 1.1 * slower


def test_between_two_stands_the_shift_is_between_theirs():
    toe = np.zeros((FRAMES, 3), np.float32)
    toe[20:25, 0], toe[25:30, 0], toe[31:36, 0], toe[36:41, 0] = -0.03, 0.03, -0.02, 0.02
    frames = np.arange(FRAMES)
    shift = np.asarray(lock_shift_of(toe, ((frames >= 20) & (frames < 30)) | ((frames >= 31) & (frames < 41))))[:, 0]
    assert min(shift[29], shift[31]) <= shift[30] <= max(shift[29], shift[31])


def test_a_leg_reaches_no_further_than_it_is_long():
    leg = [jnp.asarray(walk()[:, joint]) for joint in LEFT_LEG]
    far = jnp.tile(jnp.array([[0.0, -5.0, 0.0]]), (FRAMES, 1))
    knee, ankle, toe = move(*leg, far, bends_of(*leg[:3], far))
    np.testing.assert_allclose(distances(knee, leg[0]), distances(leg[1], leg[0]), atol=1e-4)
    np.testing.assert_allclose(distances(ankle, knee), distances(leg[2], leg[1]), atol=1e-4)
    np.testing.assert_allclose(distances(toe, ankle), distances(leg[3], leg[2]), atol=1e-4)


def knee_angles(positions):
    """Returns the angles of both knees, 180 degrees for a straight leg."""
    hips, knees, ankles = (np.asarray(positions, np.float64)[:, joints] for joints in ((1, 2), (4, 5), (7, 8)))
    thighs, shins = hips - knees, ankles - knees
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(thighs, shins), axis=-1), np.sum(thighs * shins, axis=-1)))


def excess_of_knees(found, before, fps):
    """Returns by how much a knee is faster than it was in the 0.1 s around, in degrees per second."""
    reach = round(0.1 * fps)
    new, old = (fps * np.abs(np.diff(knee_angles(one), axis=0)) for one in (found, before))
    around = np.lib.stride_tricks.sliding_window_view(np.pad(old, ((reach, reach), (0, 0))), 2 * reach + 1, axis=0)
    return float((new - around.max(axis=-1)).max())


@pytest.mark.parametrize("fps", [20.0, 60.0])
def test_a_lock_makes_no_knee_faster(fps):
    """Its legs are nearly straight when a foot comes down, so that each millimeter further turns a knee by degrees."""
    positions = resample_positions(walk(seed=1), fps=20.0, new_fps=fps, skeleton=HUMANML3D)
    locked = np.asarray(lock(positions, jnp.asarray(len(positions)), fps=fps))
    assert distances(locked, positions)[:, (7, 8)].max() > 0.03
    assert excess_of_knees(locked, positions, fps) < 1


@pytest.mark.slow
def test_the_clean_up_makes_no_knee_faster():
    """Not even where the knee of a recording flips to the other side of its leg, and smoothing takes it through it."""
    positions = walk(seed=1)
    flipped = positions.copy()
    hip, knee, ankle = (positions[30:33, joint] for joint in LEFT_LEG[:3])
    line = (ankle - hip) / np.linalg.norm(ankle - hip, axis=-1, keepdims=True)
    flipped[30:33, LEFT_LEG[1]] -= 2 * ((knee - hip) - np.sum((knee - hip) * line, axis=-1, keepdims=True) * line)
    for one in (positions, trembling(positions, 0.006), flipped):
        assert excess_of_knees(cleaned(one), one, 20) < 1


def test_bends_change_as_fast_as_before_and_slow_ones_stay():
    time = np.arange(FRAMES, dtype=np.float32)
    before = np.where(time < 30, 0.1 * time, 3.0)
    bends = np.where(time < 20, 0.05 * time, 1.0) + 0.5 * (time == 40)
    limit = jax.jit(functools.partial(limit_speed, fps=20.0))
    found = np.asarray(limit(*(jnp.asarray(one, jnp.float32) for one in (bends, before)), EVERY))
    steps = np.abs(np.diff(found))
    assert steps[:31].max() < 0.1001 and steps[32:].max() < 1e-5
    np.testing.assert_allclose(found[:20], bends[:20], atol=1e-5)


@pytest.mark.slow
def test_no_knee_is_faster_in_a_long_motion_of_many_windows():
    """A cross-fade of two windows moves a foot, too."""
    fps = 120.0
    slow = make_motion("walk", seed=2, num_frames=500).astype(np.float32)
    positions = resample_positions(slow, fps=20.0, new_fps=fps, skeleton=HUMANML3D)
    assert excess_of_knees(Motion(positions, fps).cleaned().positions, positions, fps) < 1


@pytest.mark.slow
def test_any_motion_is_cleaned_at_its_own_rate_with_its_own_bones():
    still = 1.1 * walk(seed=3, kind="wave-left-hand")
    positions = resample_positions(still, fps=20.0, new_fps=30.0, skeleton=HUMANML3D)
    shaken = Motion(trembling(positions, 0.004), 30.0, caption="a person waves", codes=np.zeros(3, int))
    motion = shaken.cleaned()
    np.testing.assert_allclose(bone_lengths(motion.positions)[0], bone_lengths(positions)[0], rtol=0.02)
    assert np.ptp(bone_lengths(motion.positions), axis=0).max() < 1e-4
    assert distances(motion.positions, positions).mean() < 0.8 * distances(shaken.positions, positions).mean()
    np.testing.assert_array_equal(motion.positions_raw, shaken.positions)
    assert (motion.fps, motion.caption, len(motion.codes)) == (30.0, "a person waves", 3)
    np.testing.assert_array_equal(motion.cleaned().positions_raw, shaken.positions)


@pytest.mark.slow
@pytest.mark.parametrize(("count", "fps"), [(1, 30.0), (3, 1.0), (50, 1000.0)])
def test_motions_of_all_rates_and_lengths_can_be_cleaned(count, fps):
    positions = make_motion("walk", seed=0, num_frames=max(2, count))[:count]
    assert Motion(positions, fps).cleaned().positions.shape == positions.shape


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["walk", "wave-left-hand", "squat"])
def test_trembling_motion_becomes_quiet_and_rigid(kind):
    real = rigid(kind=kind, seed=2)
    shaken = trembling(real, 0.006)
    found, before, aim = quality(cleaned(shaken)), quality(shaken), quality(real)
    assert found["bone_variation"] < 1e-4 < before["bone_variation"]
    assert found["jerk"] < 0.7 * before["jerk"]
    assert found["skating_ratio"] <= before["skating_ratio"] + 0.01
    if kind != "walk":  # whose feet slide by themselves
        assert distances(cleaned(shaken), real).mean() < distances(shaken, real).mean()
    assert found["floating"] <= aim["floating"] + 0.02 and found["penetration"] <= aim["penetration"] + 0.02


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["raise-up-both-hands", "wave-left-hand", "squat"])
def test_good_motion_is_hardly_moved_and_a_second_pass_less(kind):
    once = cleaned(rigid(kind=kind, seed=3))
    assert distances(once, rigid(kind=kind, seed=3)).mean() < 0.005
    assert distances(cleaned(once), once).mean() < 0.002


@pytest.mark.slow
def test_what_follows_a_clip_does_not_matter_nor_do_its_neighbors():
    one, other = trembling(walk(), 0.005), trembling(walk(kind="squat"), 0.005)
    padded = np.stack([np.concatenate([one[:40], np.full((20, 22, 3), np.nan, np.float32)]), other])
    both = np.asarray(clean(padded, np.array([40, FRAMES])))
    # XLA of JAX 0.12 adds up the padded clip in another order, which moves a coordinate by 20 micrometers.
    np.testing.assert_allclose(both[0, :40], cleaned(one, 40)[:40], atol=3e-5)
    np.testing.assert_allclose(both[1], cleaned(other), atol=1e-5)


def test_whether_a_foot_stands_at_the_end_does_not_depend_on_what_follows():
    # The figure stands, and glides away in the last two frames at 1.1 meters per second.
    stays = np.repeat(walk(kind="squat")[:1], FRAMES, axis=0)
    stays[38:] += np.array([0.055, 0, 0], np.float32)
    stays[39:] += np.array([0.055, 0, 0], np.float32)
    jumps = np.concatenate([stays[:40], np.zeros_like(stays[40:])])
    found, wanted = (np.asarray(lock(positions, jnp.asarray(40)))[:40] for positions in (stays, jumps))
    np.testing.assert_allclose(found, wanted, atol=1e-5)
    np.testing.assert_allclose(found[38:], stays[38:40], atol=0.03)


def test_where_a_toe_stands_does_not_depend_on_padding():
    random = np.random.default_rng(0)
    for length in range(5, 25):
        toe = np.cumsum(random.normal(0, 0.04, (30, 3)), axis=0).astype(np.float32)
        found = [
            standing_of(toe[:size], jnp.arange(size) < length, jnp.float32(0), fps=20.0)[:length]
            for size in (length, 30)
        ]
        np.testing.assert_array_equal(*found)


@pytest.mark.parametrize("length", [1, 2, 3, 5])
def test_short_clips_are_possible(length):
    assert np.isfinite(cleaned(walk(), length)[:length]).all()


def trembling_figures(skeleton):
    """Returns two standing figures [2, FRAMES, J, 3] in meters, each of whose joints trembles by itself."""
    joints = np.zeros((skeleton.num_joints, 3))
    offsets = skeleton.offsets * skeleton.metres_per_unit
    for joint, parent in enumerate(skeleton.parents[1:], start=1):
        joints[joint] = joints[parent] + offsets[joint]
    noise = np.random.default_rng(0).normal(0, 0.01, (2, FRAMES, *joints.shape))
    return (joints + noise).astype(np.float32)


@pytest.mark.slow
def test_other_skeletons_have_their_own_lengths():
    positions = trembling_figures(KIT_ML)
    found = np.asarray(clean_positions(positions, np.full(2, FRAMES), skeleton=KIT_ML)[0])
    expected = np.array(KIT_ML.bone_lengths[1:]) * KIT_ML.metres_per_unit
    np.testing.assert_allclose(bone_lengths(found, KIT_ML).mean(axis=0), expected, rtol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("skeleton", [HUMANML3D, KIT_ML])
def test_pelvis_and_chest_keep_their_shapes(skeleton):
    positions = trembling_figures(skeleton)
    assert np.ptp(shapes(positions[0], skeleton), axis=0).min() > 0.02
    found = np.asarray(clean_positions(positions, np.full(2, FRAMES), skeleton=skeleton)[0])
    assert np.ptp(shapes(found, skeleton), axis=0).max() < 1e-4


@pytest.mark.slow
def test_a_shape_is_that_of_the_clip_and_not_of_what_follows():
    positions = trembling_figures(HUMANML3D)
    whole = keep(positions[0, :20], jnp.asarray(20))
    np.testing.assert_allclose(keep(positions[0], jnp.asarray(20))[:20], whole, atol=1e-6)


def test_a_chest_whose_joints_are_on_a_line_turns_as_the_torso():
    positions = walk()
    chest, collars, neck = 9, [13, 14], 12
    flat = slice(20, 40)
    positions[flat, collars] = positions[flat, [chest]] + 0.6 * (positions[flat, [neck]] - positions[flat, [chest]])
    # The last digit of a number must not turn it.
    other = positions + np.random.default_rng(0).normal(size=positions.shape).astype(np.float32) * 1e-6
    np.testing.assert_allclose(keep(positions, ALL), keep(other, ALL), atol=5e-4)
    left, right = np.moveaxis(np.asarray(keep(positions, ALL))[:, collars], 1, 0)
    across = positions[:, 16] - positions[:, 17]
    sizes = np.linalg.norm(left - right, axis=1) * np.linalg.norm(across, axis=1)
    assert (np.sum((left - right) * across, axis=1) > 0.8 * sizes).all()


@pytest.mark.slow
def test_shoulders_without_collars_can_be_raised():
    positions = trembling_figures(KIT_ML)[0]
    kept = np.asarray(jax.jit(make_hubs_rigid, static_argnums=2)(positions, ALL, KIT_ML))
    upper = list(range(3, 11))
    np.testing.assert_allclose(kept[:, upper] - kept[:, [3]], positions[:, upper] - positions[:, [3]], atol=1e-6)


@pytest.mark.slow
def test_a_long_motion_is_cleaned_as_a_short_one():
    positions = make_motion("walk", seed=2, num_frames=400)
    positions += np.random.default_rng(0).normal(size=positions.shape).astype(np.float32) * 0.004
    lengths = jnp.array([len(positions)])
    whole = np.asarray(clean_positions(jnp.asarray(positions[None]), lengths, skeleton=HUMANML3D))[0]
    found = clean_long(positions, skeleton=HUMANML3D, size=200)
    assert found.shape == whole.shape
    assert np.linalg.norm(found - whole, axis=-1).mean() < 1e-3
    assert np.ptp(shapes(found), axis=0).max() < 1e-4
    # Rounding differs with the program, here by 2 micrometers at a distance of 8 m.
    np.testing.assert_allclose(clean_long(positions, skeleton=HUMANML3D, size=400), whole, atol=1e-6, rtol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("count", [1, 40, 199, 200, 201, 361, 1000])
def test_windows_cover_motions_of_all_lengths(count):
    positions = make_motion("walk", seed=2, num_frames=max(count, 40))[:count]
    found = clean_long(positions, skeleton=HUMANML3D, size=200)
    assert np.linalg.norm(found - positions, axis=-1).max() < 0.2
