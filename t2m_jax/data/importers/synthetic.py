"""A procedural data set: simple labeled motions, for tests and for a first training run without downloads.

A motion consists of bone directions in the body's frame over time. Speed, amplitude, phase and heading are drawn from a
seed. The bones of the template are joined along these directions, the root walks, and the lowest joint is on the floor.
"""

import functools
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from t2m_jax.data.captioning.captions import Labels, write_captions
from t2m_jax.data.folder import DatasetInfo
from t2m_jax.data.index import IndexEntry, save_index
from t2m_jax.data.splits import split_by_hash
from t2m_jax.data.writer import ImportReport, check_count, finish_folder, new_folder, with_twins, write_twins
from t2m_jax.errors import UserError
from t2m_jax.field_checks import check_seed
from t2m_jax.motion.facts import measure
from t2m_jax.motion.inertialization import fade
from t2m_jax.motion.rotations import turned_about_y
from t2m_jax.motion.skeleton import HUMANML3D

FPS = HUMANML3D.fps
NUM_CLIPS = 200
FEWEST_CLIPS = 20
"""With fewer, a split would be empty."""
# Thigh and shin: with the swing of the thigh, they make the length of a step.
_LEG = HUMANML3D.bone_lengths[4] + HUMANML3D.bone_lengths[7]


class Swing(NamedTuple):
    """Angles of one limb over time, radians."""

    upper: Float[np.ndarray, " T"]
    """Thigh or upper arm: 0 hangs down, positive is forward and up."""
    bend: Float[np.ndarray, " T"]
    """Knee or elbow: 0 is straight."""
    spread: Float[np.ndarray, " T"]
    """Away from the body's middle: 0 is in the forward plane."""


class Pose(NamedTuple):
    """One procedural motion: limbs, path of the root, and trunk."""

    left_leg: Swing
    right_leg: Swing
    left_arm: Swing
    right_arm: Swing
    heading: Float[np.ndarray, " T"]
    """Radians about +Y, positive to the left."""
    speed: Float[np.ndarray, " T"]
    """Meters per second along the heading."""
    lean: Float[np.ndarray, " T"]
    """Forward lean of the trunk, radians."""


def _swing(num_frames: int, *, upper: object = 0.0, bend: object = 0.0, spread: object = 0.0) -> Swing:
    """Returns a limb from constants or curves."""
    return Swing(*(np.broadcast_to(np.asarray(value, np.float64), (num_frames,)) for value in (upper, bend, spread)))


def _ramp(time: Float[np.ndarray, " T"], start: float, stop: float) -> Float[np.ndarray, " T"]:
    """Returns a smooth rise from 0 to 1 between two moments."""
    return fade((time - start) / (stop - start))


def _walking(time: Float[np.ndarray, " T"], generator: np.random.Generator, *, direction: float = 0.0) -> Pose:
    """Returns someone who walks ahead and, if `direction` is +1 (left) or -1, turns by about ninety degrees."""
    turn = direction * np.deg2rad(generator.uniform(75, 105)) if direction else 0.0
    frames = len(time)
    seconds = time[-1]
    stride = generator.uniform(0.75, 1.15)
    amplitude = generator.uniform(0.28, 0.48)
    cycle = 2 * np.pi * (stride * time + generator.uniform())
    step = generator.uniform(0.15, 0.45)
    middle = seconds * generator.uniform(0.4, 0.6)
    heading = turn * _ramp(time, middle - 0.6, middle + 0.6)

    def leg(phase: float) -> Swing:
        lifted = np.maximum(0.0, np.cos(cycle + phase)) ** 2
        return _swing(
            frames, upper=amplitude * np.sin(cycle + phase), bend=0.1 + 0.9 * lifted * amplitude / 0.4, spread=0.03
        )

    def arm(phase: float) -> Swing:
        return _swing(frames, upper=step * np.sin(cycle + phase), bend=0.3, spread=0.1)

    # A cycle is two steps, and a step is as long as the feet are apart, so that they slide little.
    speed = np.full(frames, 4 * _LEG * np.sin(amplitude) * stride)
    return Pose(leg(0.0), leg(np.pi), arm(np.pi), arm(0.0), heading, speed, np.full(frames, 0.05))


def _waving_arm(time: Float[np.ndarray, " T"], generator: np.random.Generator) -> Swing:
    """Returns an arm that goes up, waves and comes down."""
    up = _ramp(time, 0.1, 0.6) - _ramp(time, time[-1] - 0.6, time[-1] - 0.1)
    wave = np.sin(2 * np.pi * generator.uniform(1.2, 2.2) * time + generator.uniform(0, 6))
    spread = 0.12 + up * (0.2 + generator.uniform(0.25, 0.45) * wave)
    return _swing(len(time), upper=up * generator.uniform(2.2, 2.8), bend=0.15 + 0.2 * up, spread=spread)


def _raising_arm(time: Float[np.ndarray, " T"], generator: np.random.Generator) -> Swing:
    """Returns an arm that goes straight up once and comes down."""
    up = _ramp(time, 0.1, generator.uniform(0.5, 0.9)) - _ramp(
        time, time[-1] - generator.uniform(0.5, 0.9), time[-1] - 0.1
    )
    return _swing(len(time), upper=up * generator.uniform(2.8, 3.05), bend=0.15, spread=0.12 * (1 - up))


def _gesture(
    time: Float[np.ndarray, " T"], generator: np.random.Generator, *, sides: str, arm: Callable[..., Swing]
) -> Pose:
    """Returns someone who stands, breathes a little and moves only the arms named in `sides` ("L", "R")."""
    frames = len(time)
    moving = arm(time, generator)
    hanging = _swing(frames, bend=0.15, spread=0.12)
    left, right = (moving if side in sides else hanging for side in "LR")
    zero = np.zeros(frames)
    leg = _swing(frames, bend=0.05, upper=0.03, spread=0.05)
    return Pose(leg, leg, left, right, zero, zero, 0.02 * np.sin(generator.uniform(0.5, 1.5) * time))


def _squat(time: Float[np.ndarray, " T"], generator: np.random.Generator) -> Pose:
    """Returns someone who squats several times."""
    count = generator.integers(1, 4)
    down = 0.5 * (1 - np.cos(2 * np.pi * count * time / time[-1]))
    depth = generator.uniform(0.9, 1.3)
    leg = _swing(len(time), upper=depth * down, bend=2 * depth * down, spread=0.08)
    arm = _swing(len(time), upper=1.4 * down, bend=0.1, spread=0.1)
    zero = np.zeros(len(time))
    return Pose(leg, leg, arm, arm, zero, zero, 0.6 * down)


KINDS: dict[str, Callable[[Float[np.ndarray, " T"], np.random.Generator], Pose]] = {
    "walk": _walking,
    "walk-turn-left": functools.partial(_walking, direction=1.0),
    "walk-turn-right": functools.partial(_walking, direction=-1.0),
    "wave-left-hand": functools.partial(_gesture, sides="L", arm=_waving_arm),
    "wave-right-hand": functools.partial(_gesture, sides="R", arm=_waving_arm),
    "wave-both-hands": functools.partial(_gesture, sides="LR", arm=_waving_arm),
    "raise-up-left-hand": functools.partial(_gesture, sides="L", arm=_raising_arm),
    "raise-up-right-hand": functools.partial(_gesture, sides="R", arm=_raising_arm),
    "raise-up-both-hands": functools.partial(_gesture, sides="LR", arm=_raising_arm),
    "squat": _squat,
}
"""Content label -> maker of its poses."""


def _limb(swing: Swing, *, side: float, bend_sign: float) -> tuple[Float[np.ndarray, "T 3"], Float[np.ndarray, "T 3"]]:
    """Returns directions of a limb's upper and lower bone; `side` is +1 on the left, `bend_sign` -1 for knees."""

    def direction(angle: Float[np.ndarray, " T"], spread: Float[np.ndarray, " T"]) -> Float[np.ndarray, "T 3"]:
        down = -np.cos(angle)
        return np.stack([side * np.sin(spread) * np.abs(down), np.cos(spread) * down, np.sin(angle)], axis=-1)

    lower = swing.upper + bend_sign * swing.bend
    return direction(swing.upper, swing.spread), direction(lower, swing.spread)


def _directions(pose: Pose) -> dict[str, Float[np.ndarray, "T 3"]]:
    """Returns the direction of the bone that ends at each joint, in the body's frame."""
    frames = len(pose.heading)

    def fixed(x: float, y: float, z: float) -> Float[np.ndarray, "T 3"]:
        return np.tile(np.array([x, y, z]) / np.linalg.norm([x, y, z]), (frames, 1))

    trunk = np.stack([np.zeros(frames), np.cos(pose.lean), np.sin(pose.lean)], axis=-1)
    result = dict.fromkeys(("spine1", "spine2", "spine3", "neck"), trunk) | {"head": fixed(0.0, 0.9, 0.45)}
    for name, side, leg, arm in (
        ("left", 1.0, pose.left_leg, pose.left_arm),
        ("right", -1.0, pose.right_leg, pose.right_arm),
    ):
        thigh, shin = _limb(leg, side=side, bend_sign=-1.0)
        upper, lower = _limb(arm, side=side, bend_sign=1.0)
        result |= {f"{name}_hip": fixed(0.6 * side, -0.8, 0.0), f"{name}_knee": thigh, f"{name}_ankle": shin}
        result |= {f"{name}_foot": fixed(0.0, -0.35, 0.94), f"{name}_collar": fixed(0.7 * side, 0.7, 0.0)}
        result |= {f"{name}_shoulder": fixed(side, 0.05, 0.0), f"{name}_elbow": upper, f"{name}_wrist": lower}
    return result


def make_motion(kind: str, *, seed: int, num_frames: int | None = None) -> Float[np.ndarray, "T J 3"]:
    """Returns positions of one motion in meters at 20 frames per second, Y up, the lowest joint on the floor.

    Args:
        kind: A key of `KINDS`.
        seed: Draws speed, amplitude, phase, heading and, if it is not given, the length (2 to 6 seconds).
        num_frames: Number of frames, at least 40.

    Raises:
        UserError: The kind is unknown.
    """
    if kind not in KINDS:
        raise UserError(f"unknown motion '{kind}'; known are {', '.join(KINDS)}")
    # With the kind in the seed, two kinds of one seed share no draws.
    generator = np.random.default_rng([seed, *kind.encode()])
    frames = num_frames or int(generator.integers(40, 121))
    pose = KINDS[kind](np.arange(frames) / FPS, generator)
    return positions_from_pose(pose._replace(heading=pose.heading + generator.uniform(-np.pi, np.pi)))


def positions_from_pose(pose: Pose) -> Float[np.ndarray, "T J 3"]:
    """Returns the joint positions of a procedural motion in meters, Y up, the lowest joint on the floor."""
    directions = _directions(pose)
    local = np.zeros((len(pose.heading), HUMANML3D.num_joints, 3))
    for joint in range(1, HUMANML3D.num_joints):
        bone = HUMANML3D.bone_lengths[joint] * directions[HUMANML3D.joint_names[joint]]
        local[:, joint] = local[:, HUMANML3D.parents[joint]] + bone
    world = turned_about_y(local, pose.heading[:, None])
    steps = pose.speed[:, None] / FPS * np.stack([np.sin(pose.heading), np.cos(pose.heading)], axis=1)
    world[:, :, [0, 2]] += np.cumsum(steps, axis=0)[:, None]
    # In each frame, so that somebody who squats comes down instead of lifting the feet.
    world[:, :, 1] -= world[:, :, 1].min(axis=1, keepdims=True)
    return world.astype(np.float32)


def write_synthetic_dataset(destination: str | Path, *, num_clips: int = NUM_CLIPS, seed: int = 0) -> ImportReport:
    """Makes a complete data-set folder of procedural motions, including mirrored twins, and returns a report.

    Args:
        destination: Folder to make.
        num_clips: Number of clips before mirroring, evenly distributed over the kinds.
        seed: Another seed gives other motions.

    Raises:
        UserError: There are fewer clips than the splits need (20), the seed is not from 0 to 2**32 - 1, or the
            destination exists.
    """
    check_count("num-clips", num_clips, least=FEWEST_CLIPS)
    check_seed(seed)
    # A clip has one row of features less than it has poses.
    info = DatasetInfo(name="synthetic", min_frames=HUMANML3D.min_frames - 1, licence="CC0-1.0", source="t2m_jax")
    names = [f"synthetic_{number:05d}" for number in range(num_clips)]
    frames = 0
    kinds = [tuple(KINDS)[number % len(KINDS)] for number in range(num_clips)]
    with new_folder(destination) as folder:
        for number, (name, kind) in enumerate(zip(names, kinds, strict=True)):
            # The factor keeps the motions of different data-set seeds apart.
            positions = make_motion(kind, seed=seed * 1_000_003 + number)
            captions = write_captions(f"{seed} {name}", Labels(kind, "normal"), measure(positions, fps=FPS))
            frames += 2 * write_twins(folder, name, positions, captions=captions, skeleton=HUMANML3D)
        splits = split_by_hash([names[first :: len(KINDS)] for first in range(len(KINDS))])
        twins = {split: with_twins(members) for split, members in splits.items()}
        sizes = finish_folder(folder, twins, info=info, skeleton=HUMANML3D)
        save_index(folder, (IndexEntry(name, name, kind) for name, kind in zip(names, kinds, strict=True)))
    return ImportReport(2 * num_clips, frames, sizes, {}, ())
