"""Options that change a motion before it is written: its frame rate, a loop, no travel."""

import argparse
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from t2m_jax.motion import Motion


def add_change_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the options; `t2m generate` and `t2m view` have the same."""
    parser.add_argument("--fps", type=float, help="frames per second to write (default: those of the motion)")
    parser.add_argument("--loop", action="store_true", help="write the part that repeats best, closed into a loop")
    parser.add_argument("--in-place", action="store_true", help="without travel: the root stays above the origin")


def check_changes(args: argparse.Namespace) -> None:
    """Raises `UserError` if an option has a value that no motion can be changed with."""
    from t2m_jax.motion.editing import check_fps

    if args.fps is not None:
        check_fps(args.fps)


def changed(motion: "Motion", args: argparse.Namespace) -> "Motion":
    """Returns a motion as the options ask for. A loop is found in the frames that are written, so that it closes."""
    if args.fps is not None and args.fps != motion.fps:
        motion = motion.resampled(args.fps)
    if args.loop:
        motion = motion.looped()
    return motion.in_place() if args.in_place else motion
