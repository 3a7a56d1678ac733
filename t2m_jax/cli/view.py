"""Converts a motion file to other formats. The suffix of each output selects the format."""

import argparse
import shlex
from pathlib import Path

from t2m_jax.cli.changes import add_change_arguments, changed, check_changes
from t2m_jax.cli.next_step import show_next


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of `t2m view`."""
    parser.add_argument(
        "file", type=Path, metavar="FILE", help="motion to read: .npz, .bvh, .glb, .amc, or .npy of a data set"
    )
    parser.add_argument("--animation", metavar="NAME", help="animation to read from a .glb file that has several")
    add_change_arguments(parser)
    files = "file to write: .html, .gif, .mp4, .bvh or .npz; can be repeated"
    parser.add_argument(
        "-o", "--output", dest="outputs", type=Path, action="append", required=True, metavar="FILE", help=files
    )


def run(args: argparse.Namespace) -> None:
    """Reads the motion, writes all outputs, and prints their names and the next command."""
    from t2m_jax.export import load_motion
    from t2m_jax.files import claim
    from t2m_jax.motion.record import check_motion_output

    check_changes(args)
    for output in args.outputs:
        check_motion_output(output)
    with claim(args.outputs):
        motion = changed(load_motion(args.file, animation=args.animation), args)
        for output in args.outputs:
            motion.save(output)
            print(output)
    chosen = [] if args.animation is None else ["--animation", args.animation]
    again = ["t2m", "view", str(args.file), *chosen]
    pages = [output for output in args.outputs if output.suffix == ".html"]
    show_next(f"open {pages[0]} in a browser" if pages else f"{shlex.join(again)} -o motion.html")
