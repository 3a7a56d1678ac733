"""Targets: where a joint, the root, the direction, or the whole pose of a motion should be at a time.

Places are in meters in the world of a generated motion, which begins above the origin and faces +z: +x is at its left.
"""

import dataclasses
import itertools
import math
import re
from collections.abc import Iterable, Sequence

import numpy as np
from jaxtyping import Float

from t2m_jax.errors import UserError
from t2m_jax.motion.features import facing
from t2m_jax.motion.joining import Pose, place_positions
from t2m_jax.motion.kinematics import line_to
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.namespace import AnyArray, namespace_of
from t2m_jax.motion.paths import LARGEST_TURN
from t2m_jax.motion.rotations import unit_vectors
from t2m_jax.motion.skeleton import Skeleton

ROOT = "root"
"""The place on the ground, x and z."""
FACING = "facing"
"""The direction: degrees to the left of +z."""
POSE = "pose"
"""All joints, seen from the root."""
SIZES = {ROOT: 2, FACING: 1, POSE: 0}
"""Numbers of a target that is not a joint's; a joint has three."""
TOLERANCES = {ROOT: 0.1, FACING: 10.0, POSE: 0.05}
"""Up to here such a target is met: meters, degrees, and the mean over the joints in meters."""
JOINT_TOLERANCE = 0.03
"""Up to here, the target of a joint is met; meters."""
EXACT_TOLERANCE = 0.005
"""Up to here, an exact target is met; meters."""
EXACT_DEGREES = 0.5
"""Up to here, an exact direction is met."""
FASTEST_ROOT = 5.0
"""Nobody travels faster in these motions; meters per second."""
FASTEST_JOINT = 12.0
"""No joint moves faster; meters per second."""
HIGHEST_JUMP = 0.5
"""Nobody jumps higher; meters."""
LOWEST = -0.05
"""No hand, knee or foot gets lower; meters. Floors may be a little off."""
STRETCH = 1.1
"""People of motion data may be larger than the skeleton by this factor, or smaller."""
RUSH_SECONDS = 1.0
"""Time before and after a target in which a body comes to it and goes on."""
FASTEST_LOW = 1.5
"""A root lower than half a leg goes up or down no faster; meters per second. In recordings, it is up to 1.44."""
MAX_TARGETS = 64
"""Most targets of a motion."""
SYNTAX = "TIME JOINT=X,Y,Z, such as '2.0 right_wrist=0.3,1.5,0.2', '4 root=1,3 exact' or '1:2 left_foot=0.1,0,0.5'"
_TARGET = re.compile(r"([^\s:]+)(?::(\S+))? (\w+) ?(\+?=) ?(\S.*?)( exact)?")


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Target:
    """One target."""

    seconds: float
    """When; from the beginning of the motion."""
    joint: str
    """Name of a joint of the skeleton, or `root`, `facing` or `pose`."""
    place: tuple[float, ...] = ()
    """x, y, z of a joint, x and z of the root, or degrees to the left of +z."""
    until: float | None = None
    """Seconds at which it ends to hold; by default it holds for one frame."""
    relative: bool = False
    """Whether the place of a joint is seen from the ground under the root, with +z where the figure faces."""
    pose: Float[np.ndarray, "J 3"] | None = None
    """Joints of a `pose`, in meters."""
    exact: bool = False
    """Whether it is met at the end by moving bones, as `reach_exactly` does: the root, the direction, the pose, or a
    wrist or a foot."""

    def __post_init__(self) -> None:
        """Checks what does not depend on the skeleton.

        Raises:
            UserError: A number cannot be used with any motion.
        """
        end = self.seconds if self.until is None else self.until
        if not (0 <= self.seconds < math.inf and 0 <= end < math.inf):
            raise self.error("is not a time from 0")
        if end < self.seconds:
            raise self.error("ends before it begins")
        size = SIZES.get(self.joint, 3)
        if len(self.place) != size:
            raise self.error(f"needs {size} number{'s' * (size != 1)}, not {len(self.place)}")
        for number in self.place:
            if not math.isfinite(number):
                raise self.error(f"{number:g} is not a finite number")
        if (self.joint == POSE) != (self.pose is not None):
            raise self.error("a pose needs joints, and nothing else has them")
        if self.pose is not None and not np.isfinite(self.pose).all():
            raise self.error("is not finite")
        if self.joint in SIZES and self.relative:
            raise self.error("is not seen from the root; use =")

    def error(self, reason: str) -> UserError:
        """Returns an error that names the target."""
        return UserError(f"targets: {self.name}: {reason}")

    @property
    def name(self) -> str:
        """What and when, for messages."""
        until = "" if self.until is None else f" to {self.until:g}"
        return f"{self.joint} at {self.seconds:g}{until} s"

    @property
    def tolerance(self) -> float:
        """The distance up to which it is met; meters, or degrees of `facing`."""
        if self.exact:
            return EXACT_DEGREES if self.joint == FACING else EXACT_TOLERANCE
        return TOLERANCES.get(self.joint, JOINT_TOLERANCE)

    def is_met(self, distance: float) -> bool:
        """Returns whether a motion that is this far away meets it (see `distances`)."""
        return distance <= self.tolerance

    @property
    def unit(self) -> str:
        """The unit of `tolerance` and of `distances`."""
        return "degrees" if self.joint == FACING else "m"

    def frames(self, fps: float) -> range:
        """Returns the frames in which it holds."""
        first = round(self.seconds * fps)
        return range(first, max(first, round((self.until or 0.0) * fps)) + 1)


def read_target(given: object) -> Target:
    """Returns a target: as given, from a text, or from seconds and a motion whose first frame is the pose.

    A third part of the latter, "exact", makes it exact.

    Raises:
        UserError: It is none of these, or a number cannot be used.
    """
    if isinstance(given, Target):
        return given
    if isinstance(given, str):
        return _from_text(given)
    # After texts, which are sequences, too.
    if isinstance(given, Sequence) and len(given) in (2, 3):
        seconds, motion, *exact = given
        is_known = all(isinstance(word, str) and word == "exact" for word in exact)
        if isinstance(seconds, int | float) and isinstance(motion, Motion) and is_known:
            return Target(seconds=float(seconds), joint=POSE, pose=motion.positions[0], exact=bool(exact))
    raise UserError(f"targets: {given!r:.80} is not a text ({SYNTAX}) or a pair of seconds and a motion")


def _from_text(text: str) -> Target:
    found = _TARGET.fullmatch(" ".join(text.split()))  # with single spaces, no text takes long to match
    begin, until, joint, sign, numbers, exact = found.groups() if found else ("", None, "", "", "", None)
    try:
        seconds = float(begin)
        end = None if until is None else float(until)
        place: tuple[float, ...] = tuple(float(number) for number in numbers.split(","))
    except ValueError:
        raise UserError(f"targets: {text[:80]!r} is not {SYNTAX}") from None
    pose = None
    if joint == POSE:
        if len(place) % 3:
            raise UserError(f"targets: {text[:80]!r}: a pose has three numbers for each joint, not {len(place)}")
        pose, place = np.array(place).reshape(-1, 3), ()
    return Target(
        seconds=seconds, until=end, joint=joint, place=place, relative=sign == "+=", pose=pose, exact=exact is not None
    )


def targets_from_text(text: str) -> tuple[Target, ...]:
    """Returns the targets in a text, with a semicolon between two of them.

    Raises:
        UserError: One of them cannot be read or used.
    """
    return tuple(_from_text(part) for part in text.split(";") if part.strip())


def move_target(target: Target, seconds: float, pose: Pose, place: Pose, *, skeleton: Skeleton) -> Target:
    """Returns a target some seconds later, turned and moved as `pose` is that gets the place of `place`."""
    until = None if target.until is None else target.until + seconds
    later = dataclasses.replace(target, seconds=target.seconds + seconds, until=until)
    # They are seen from the root, so that it does not matter where the figure is.
    if target.joint == POSE or target.relative:
        return later
    if target.joint == FACING:
        before, after = facing_degrees(np.stack([pose, place]), skeleton).tolist()
        return dataclasses.replace(later, place=(target.place[0] + after - before,))
    x, *height, z = target.place
    points = np.broadcast_to([x, *(height or [0.0]), z], pose.shape)[None]
    # As a pose of which all joints are at the place, because the function moves whole poses.
    moved = place_positions(points, pose, place, skeleton=skeleton)[0, 0].tolist()
    return dataclasses.replace(later, place=tuple(moved if height else moved[::2]))


def facing_degrees(positions: Float[np.ndarray, "T J 3"], skeleton: Skeleton) -> Float[np.ndarray, " T"]:
    """Returns where a figure faces in each frame, in degrees to the left of +z."""
    ahead = facing(positions, skeleton)
    return np.degrees(np.arctan2(ahead[:, 0], ahead[:, 2]))


def check_targets(
    targets: Sequence[Target], skeleton: Skeleton, *, start: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> None:
    """Raises `UserError` if a skeleton does not have a joint, or nobody could meet the targets.

    Args:
        targets: Of a motion.
        skeleton: Of the motion.
        start: Seconds at which it is known where the root is, and its x and z.
    """
    known = (*skeleton.joint_names, ROOT, FACING)
    for target in targets:
        if target.joint not in (*known, POSE):
            raise target.error(f"no such joint; known: {', '.join(known)}")
        if target.pose is not None and target.pose.shape != (skeleton.num_joints, 3):
            raise target.error(f"has {len(target.pose)} joints; skeleton {skeleton.name} has {skeleton.num_joints}")
        # The root of KIT-ML is a joint, too, and its name is that of the place on the ground.
        if target.joint in skeleton.joint_names and target.joint not in SIZES:
            _check_reach(target, skeleton)
        if target.joint == FACING and abs(target.place[0]) > LARGEST_TURN:
            raise target.error(f"{target.place[0]:g} is not from -{LARGEST_TURN:.0f} to {LARGEST_TURN:.0f} degrees")
    if len(targets) > MAX_TARGETS:
        raise UserError(f"targets: {len(targets)} are more than {MAX_TARGETS}")
    fixed = [target for target in targets if not target.relative and target.joint not in (FACING, POSE)]
    seconds, *ground = start
    for target in fixed:
        # The root takes its limbs along.
        reach = 0.0 if target.joint == ROOT else limb_reach(target.joint, skeleton)
        way = math.dist((target.place[0], target.place[-1]), ground) - reach
        _check_speed(target, way, target.seconds - seconds, FASTEST_ROOT)
    # Users may give targets in any order.
    ordered = sorted(fixed, key=lambda target: (target.joint, target.seconds))
    for before, after in itertools.pairwise(ordered):
        if before.joint == after.joint:
            fastest = FASTEST_ROOT if after.joint in (ROOT, skeleton.joint_names[0]) else FASTEST_JOINT
            seconds = after.seconds - (before.until or before.seconds)
            _check_speed(after, math.dist(before.place, after.place), max(seconds, 0.0), fastest)


def limb_reach(joint: str, skeleton: Skeleton) -> float:
    """Returns how far a joint can be from the root: the sum of the bones between them, in meters."""
    bones = line_to(skeleton.joint_names.index(joint), skeleton.parents)
    return STRETCH * sum(skeleton.bone_lengths[bone] for bone in bones) * skeleton.metres_per_unit


def possible_heights(joint: str, skeleton: Skeleton) -> tuple[float, float]:
    """Returns the lowest and the highest place of a joint over the floor, in meters."""
    # Hands, knees and feet touch the floor. A trunk that is on it is about half as thick as hips are wide.
    above = line_to(skeleton.joint_names.index(joint), skeleton.parents)[:-1]
    is_limb = not set(skeleton.face_joints).isdisjoint(above)
    half = min(skeleton.bone_lengths[hip] for hip in skeleton.face_joints[:2]) * skeleton.metres_per_unit / STRETCH
    # The root is at most a leg above the floor, or as much higher as people jump.
    toes = skeleton.joint_names[skeleton.left_foot[-1]]
    highest = limb_reach(toes, skeleton) + limb_reach(joint, skeleton) + HIGHEST_JUMP
    return LOWEST if is_limb else half, highest


def _check_reach(target: Target, skeleton: Skeleton) -> None:
    """Raises `UserError` if nobody can bring a joint to its place, wherever the person stands."""
    x, y, z = target.place
    lowest, highest = possible_heights(target.joint, skeleton)
    if not lowest <= y <= highest:
        fault = f"{y:g} m is under the floor" if y < 0 else f"nobody reaches a height of {y:g} m"
        raise target.error(f"{fault}; possible: {lowest:.2f} to {highest:.2f} m")
    reach = limb_reach(target.joint, skeleton)
    if target.relative and math.hypot(x, z) > reach:
        raise target.error(f"nobody reaches {math.hypot(x, z):.2g} m from the root")


def _check_speed(target: Target, far: float, seconds: float, fastest: float) -> None:
    """Raises `UserError` if a target is too far from where the motion was some seconds before."""
    if far > fastest * seconds + JOINT_TOLERANCE:
        raise target.error(f"{far:.2g} m in {seconds:.2g} s is faster than {fastest:g} m/s")


def seen_from_root(positions: Float[AnyArray, "T J 3"], skeleton: Skeleton) -> Float[AnyArray, "T J 3"]:
    """Returns joints from the ground under the root, with +z where the figure faces."""
    xp = namespace_of(positions)
    ahead = unit_vectors(facing(positions, skeleton))
    left = xp.stack([ahead[:, 2], xp.zeros_like(ahead[:, 0]), -ahead[:, 0]], axis=-1)
    moved = positions - positions[:, :1]
    x, z = (xp.einsum("tjc,tc->tj", moved, axis) for axis in (left, ahead))
    return xp.stack([x, positions[..., 1], z], axis=-1)


def distances(motion: Motion, targets: Iterable[Target]) -> list[float]:
    """Returns how far a motion is from each target, in its unit; the largest value of the time in which it holds.

    The distance of a pose is the mean over the joints. Where the motion has ended, its last frame counts.
    """
    return [float(_distances(motion, target).max()) for target in targets]


def _distances(motion: Motion, target: Target) -> Float[np.ndarray, " S"]:
    """Returns the distance in each frame in which a target holds."""
    frames = np.minimum(target.frames(motion.fps), motion.num_frames - 1)
    poses = motion.positions[frames].astype(np.float64)
    place = np.array(target.place)
    if target.joint == FACING:
        difference = facing_degrees(poses, motion.skeleton) - place[0]
        # The shorter way around.
        return np.abs((difference + 180) % 360 - 180)
    if target.joint == ROOT:
        return np.linalg.norm(poses[:, 0, ::2] - place, axis=-1)
    if target.pose is not None:
        wanted = seen_from_root(target.pose[None].astype(np.float64), motion.skeleton)
        return np.linalg.norm(seen_from_root(poses, motion.skeleton) - wanted, axis=-1).mean(axis=-1)
    seen = seen_from_root(poses, motion.skeleton) if target.relative else poses
    return np.linalg.norm(seen[:, motion.skeleton.joint_names.index(target.joint)] - place, axis=-1)


def missed_targets(motion: Motion, targets: Sequence[Target]) -> str:
    """Returns which targets a motion misses, and by how much; "" if it meets all."""
    found = zip(targets, distances(motion, targets), strict=True)
    missed = [f"{one.name} by {far:.2g} {one.unit}" for one, far in found if not one.is_met(far)]
    return f"misses {', '.join(missed)}" if missed else ""


def rushed_targets(motion: Motion, targets: Sequence[Target]) -> str:
    """Returns to or from which targets a body is too fast near the floor; "" if there are none."""
    heights = motion.positions[:, 0, 1]
    leg = limb_reach(motion.skeleton.joint_names[motion.skeleton.left_foot[-1]], motion.skeleton) / STRETCH
    # Higher up, people may be much faster: they jump.
    speeds = (np.maximum(heights[1:], heights[:-1]) < leg / 2) * np.abs(np.diff(heights)) * motion.fps
    reach = round(RUSH_SECONDS * motion.fps)
    rushed = []
    for target in targets:
        frames = target.frames(motion.fps)
        fastest = speeds[max(frames[0] - reach, 0) : frames[-1] + reach].max(initial=0)
        if fastest > FASTEST_LOW:
            rushed.append(f"{target.name}: the root goes up or down near the floor by {fastest:.1f} m/s")
    return f"faster than people are: {', '.join(rushed)}" if rushed else ""
