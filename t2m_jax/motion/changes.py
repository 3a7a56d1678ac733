"""What may be changed of a motion before it is shown or written: one record for Python, command line and server."""

import dataclasses
import math

from t2m_jax.errors import UserError
from t2m_jax.field_checks import check_number
from t2m_jax.motion.looping import LOOP_FPS
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.paths import check_turn, check_waypoints
from t2m_jax.motion.resampling import check_fps, check_speed


def path_from_text(text: str) -> tuple[tuple[float, float], ...]:
    """Returns the points of `Changes.path` in a text such as "0,0 1,2 3,2".

    Raises:
        UserError: The text is not two or more points of two numbers.
    """
    try:
        points = [[float(number) for number in point.split(",")] for point in text.split()]
    except ValueError:
        raise UserError(f'path: {text!r} is not points of two numbers, such as "0,0 1,2 3,2"') from None
    check_waypoints(points)
    return tuple((x, z) for x, z in points)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Changes:
    """From a motion to the motion that is shown or written. The fields are in the order in which they are applied."""

    begin: float | None = None
    """Seconds at which the motion begins; what is before is cut off."""
    end: float | None = None
    """Seconds at which the motion ends; what is after is cut off."""
    clean: bool = False
    """Whether trembling is smoothed, bones get constant lengths, and feet stand still, as in generated motion."""
    mirror: bool = False
    """Whether left and right are exchanged, also in the caption."""
    speed: float = 1.0
    """How much faster the motion is played, 0.1 to 10; below 1 is slower."""
    turn: float = 0.0
    """Degrees, -720 to 720, by which the path bends evenly to the left; below 0 to the right. Excludes `path`."""
    path: tuple[tuple[float, float], ...] = ()
    """Points on the ground to walk through: x and z in meters; +x is at the left of a figure that faces +z."""
    fps: float | None = None
    """Frames per second; by default those of the motion, and at least 60 for a loop."""
    loop: bool = False
    """Whether the part that repeats best is kept and closed into a loop."""
    in_place: bool = False
    """Whether the motion stays around its place: it does not travel, and its hips sway as before."""

    def __post_init__(self) -> None:
        """Checks each field.

        Raises:
            UserError: A value cannot be used with any motion, or two fields exclude each other.
        """
        # The default is None and not 0: a cut, even of no frame, would drop the codes.
        begin = 0.0 if self.begin is None else check_number("begin", self.begin)
        if not 0 <= begin < math.inf:
            raise UserError(f"begin: {begin:g} is not a number of seconds from 0")
        if self.end is not None and not 0 <= check_number("end", self.end) < math.inf:
            raise UserError(f"end: {self.end:g} is not a number of seconds from 0")
        if self.end is not None and self.end <= begin:
            raise UserError(f"end: {self.end:g} s is not after {begin:g} s, where the motion begins")
        check_speed(self.speed)
        check_turn(self.turn)
        if self.path:
            check_waypoints(self.path)
        if self.path and self.turn:
            raise UserError("turn: excludes path, which says where the motion turns")
        if self.fps is not None:
            check_fps(self.fps)

    def apply(self, motion: Motion) -> Motion:
        """Returns the changed motion; the same object if nothing changes.

        A loop is found in the frames that are written, so that it closes.

        Raises:
            UserError: A change does not fit this motion: it is too short, does not travel, or does not repeat.
        """
        if self.begin is not None or self.end is not None:
            motion = motion.trimmed(self.begin, self.end)
        if self.clean:
            motion = motion.cleaned()
        if self.mirror:
            motion = motion.mirrored()
        if self.speed != 1:
            motion = motion.at_speed(self.speed)
        if self.turn:
            motion = motion.turned(self.turn)
        if self.path:
            motion = motion.along(self.path)
        # After speed and path, which are computed at the motion's own rate.
        fps = self.fps or (max(motion.fps, LOOP_FPS) if self.loop else motion.fps)
        if fps != motion.fps:
            motion = motion.resampled(fps)
        if self.loop:
            motion = motion.looped()
        return motion.in_place() if self.in_place else motion
