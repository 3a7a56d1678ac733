"""Options for how a motion is written: its speed, path and frame rate, a loop, no travel, names of joints, units."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from t2m_jax.errors import UserError

if TYPE_CHECKING:
    from t2m_jax.motion import Motion


def add_change_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the options; `t2m generate` and `t2m view` have the same."""
    parser.add_argument("--speed", type=float, metavar="FACTOR", help="play this much faster; below 1 is slower")
    paths = parser.add_mutually_exclusive_group()
    paths.add_argument("--turn", type=float, metavar="DEGREES", help="bend the path evenly to the left; below 0: right")
    points = "walk through points on the ground: x and z in meters; +x is at the left of a figure that faces +z"
    paths.add_argument("--path", metavar='"X,Z X,Z ..."', help=points)
    parser.add_argument("--fps", type=float, help="frames per second to write (default: those of the motion)")
    loop = "write the part that repeats best, closed into a loop; at 60 frames per second without --fps"
    parser.add_argument("--loop", action="store_true", help=loop)
    parser.add_argument("--in-place", action="store_true", help="without travel: the root stays above the origin")
    rigs = ("lafan1", "humanml3d", "mixamo", "vrm", "unreal")
    parser.add_argument("--names", choices=rigs, help="names of the joints in .bvh and .glb files (default: lafan1)")
    parser.add_argument("--units", choices=("m", "cm"), help="units of .bvh and .glb files (default: m)")


def check_changes(args: argparse.Namespace, outputs: Sequence[Path]) -> None:
    """Raises `UserError` if an option has a value that no motion can be changed with, or is of none of the outputs."""
    from t2m_jax.motion.paths import check_turn, check_waypoints
    from t2m_jax.motion.resampling import check_fps, check_speed

    if args.speed is not None:
        check_speed(args.speed)
    if args.turn is not None:
        check_turn(args.turn)
    if args.path is not None:
        check_waypoints(_waypoints(args.path))
    if args.fps is not None:
        check_fps(args.fps)
    for name in ("names", "units"):
        if getattr(args, name) is not None and not any(name in file_options(output, args) for output in outputs):
            raise UserError(f"--{name}: is for .bvh and .glb files, and none is written; add -o FILE.glb")


def file_options(output: Path, args: argparse.Namespace) -> dict[str, str]:
    """Returns the options that were given for the format of a file."""
    from t2m_jax.motion.formats import format_options

    given = {name: getattr(args, name) for name in ("names", "units") if getattr(args, name) is not None}
    known = format_options(output) if given else {}
    return {name: value for name, value in given.items() if name in known}


def changed(motion: "Motion", args: argparse.Namespace) -> "Motion":
    """Returns a motion as the options ask for: speed, path, frame rate, loop, no travel, in this order.

    A loop is found in the frames that are written, so that it closes.
    """
    from t2m_jax.motion.looping import output_fps

    if args.speed is not None and args.speed != 1:
        motion = motion.at_speed(args.speed)
    if args.turn is not None:
        motion = motion.turned(args.turn)
    if args.path is not None:
        motion = motion.along(_waypoints(args.path))
    fps = output_fps(motion.fps, asked=args.fps, loop=args.loop)
    if fps != motion.fps:
        motion = motion.resampled(fps)
    if args.loop:
        motion = motion.looped()
    return motion.in_place() if args.in_place else motion


def _waypoints(text: str) -> list[list[float]]:
    """Returns the points of `--path`.

    Raises:
        UserError: The text is not pairs of numbers.
    """
    try:
        return [[float(number) for number in point.split(",")] for point in text.split()]
    except ValueError:
        raise UserError(f'path: {text!r} is not points of two numbers, such as "0,0 1,2 3,2"') from None
