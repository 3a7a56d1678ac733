"""Converts motion files to other formats. The suffix of each output selects the format."""

import argparse
import shlex
from pathlib import Path

from t2m_jax.cli.changes import add_change_arguments, changed, check_changes, file_options
from t2m_jax.cli.next_step import show_next


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of `t2m view`."""
    parser.add_argument(
        "files",
        nargs="+",
        type=Path,
        metavar="FILE",
        help="motions to read: .npz, .bvh, .glb, .amc, or .npy of a data set; several are shown side by side",
    )
    parser.add_argument("--animation", metavar="NAME", help="animation to read from a .glb file that has several")
    add_change_arguments(parser)
    files = "file to write: .html, .gif, .mp4, .png, .bvh, .glb or .npz; can be repeated"
    parser.add_argument(
        "-o", "--output", dest="outputs", type=Path, action="append", required=True, metavar="FILE", help=files
    )


def run(args: argparse.Namespace) -> None:
    """Reads the motions, writes all outputs, and prints their names and the next command."""
    from t2m_jax.files import claim
    from t2m_jax.motion.formats import check_motion_output, load_motion, save_motions

    for output in args.outputs:
        check_motion_output(output)
    check_changes(args, args.outputs)
    with claim(args.outputs):
        motions = [changed(load_motion(path, animation=args.animation), args) for path in args.files]
        for output in args.outputs:
            save_motions(output, motions, **file_options(output, args))
            print(output)
    chosen = [] if args.animation is None else ["--animation", args.animation]
    again = ["t2m", "view", *map(str, args.files), *chosen]
    pages = [output for output in args.outputs if output.suffix == ".html"]
    show_next(f"open {pages[0]} in a browser" if pages else f"{shlex.join(again)} -o motion.html")
