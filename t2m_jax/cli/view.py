"""Converts motion files to other formats. The suffix of each output selects the format."""

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, get_args

from t2m_jax.cli.options import add_record, add_rig_arguments, naming_options, option_of, read_record, show_written
from t2m_jax.errors import UserError

if TYPE_CHECKING:
    from t2m_jax.motion.character import Character
    from t2m_jax.motion.motion import Motion

FILE_OPTIONS = {
    "names": ("bvh", "glb"),
    "units": ("bvh", "glb"),
    "root_bone": ("bvh", "glb"),
    "camera": ("gif", "mp4"),
}
"""Options of some formats of files."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of `t2m view`."""
    from t2m_jax.motion.changes import Changes

    parser.add_argument(
        "files",
        nargs="+",
        type=Path,
        metavar="FILE",
        help="motions to read: .npz, .bvh, .glb, .vrma, .amc, or .npy of a data set; several are shown side by side",
    )
    parser.add_argument("--animation", metavar="NAME", help="animation to read from a .glb file that has several")
    add_rig_arguments(parser, "files with other joints")
    join = "make one motion of the files: each begins where the one before it ends; other options change the whole"
    parser.add_argument("--join", action="store_true", help=join)
    add_record(parser, Changes)
    add_file_arguments(parser)
    files = "file to write: .html, .gif, .mp4, .png, .bvh, .glb, .vrma or .npz; can be repeated"
    parser.add_argument(
        "-o", "--output", dest="outputs", type=Path, action="append", required=True, metavar="FILE", help=files
    )


def add_file_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares `FILE_OPTIONS` and `--character`; `t2m generate` has them, too."""
    from t2m_jax.export.render.view import Camera
    from t2m_jax.motion.bvh.writer import Units
    from t2m_jax.motion.rig.rigs import JointNames

    names = "names of the joints in .bvh and .glb files (default: lafan1); smpl writes .npz files as AMASS has them"
    parser.add_argument("--names", choices=get_args(JointNames), help=names)
    parser.add_argument("--units", choices=get_args(Units), help="units of .bvh and .glb files (default: m)")
    root = "add a bone on the floor that carries the travel, in .bvh and .glb files, for Unreal and Godot"
    parser.add_argument("--root-bone", action="store_true", default=None, help=root)
    turntable = "whether the camera of .gif and .mp4 files only follows, or also goes around once (default: follow)"
    parser.add_argument("--camera", choices=get_args(Camera), help=turntable)
    text = "your character, a .glb or .vrm file: .glb files are copies of it that move; --rig is then its table"
    parser.add_argument("--character", type=Path, metavar="FILE", help=text)


def file_options(output: Path, args: argparse.Namespace, outputs: Sequence[Path]) -> dict[str, str | bool]:
    """Returns the options that were given for the format of a file.

    Raises:
        UserError: An option is of none of the outputs.
    """
    from t2m_jax.motion.formats import format_options

    given = {name: getattr(args, name) for name in FILE_OPTIONS if getattr(args, name) is not None}
    known = {one: {} if _shows_character(one, args) else format_options(one) for one in outputs}
    for name, value in given.items():
        if not any(value in options.get(name, ()) for options in known.values()):
            kept = " (a character keeps its own)" if args.character is not None and name != "camera" else ""
            first, last = FILE_OPTIONS[name]
            files = f"is for .{first} and .{last} files, and none is written; add -o FILE.{last}"
            raise UserError(f"{option_of(name)}: {files}{kept}")
    # Formats have different names, such as `smpl` of .npz files: an option is for those that have its value.
    return {name: value for name, value in given.items() if value in known[output].get(name, ())}


def _shows_character(output: Path, args: argparse.Namespace) -> bool:
    return args.character is not None and output.suffix.lower() == ".glb"


def open_character(args: argparse.Namespace, outputs: Sequence[Path]) -> "Character | None":
    """Returns the character that was given.

    Raises:
        UserError: It cannot be used, or no `.glb` file is written.
    """
    if args.character is None:
        return None
    if not any(_shows_character(output, args) for output in outputs):
        raise UserError(f"--character {args.character}: is for .glb files, and none is written; add -o FILE.glb")
    from t2m_jax.motion.character import load_character

    character = load_character(args.character, rig=args.rig)
    for output in outputs:
        if _shows_character(output, args):
            character.check_copy(output)
    return character


def read_options(args: argparse.Namespace) -> dict[Path, dict[str, str]]:
    """Returns the options with which each file is read: of several files, those that its format has.

    Raises:
        UserError: No file has an option that was given.
    """
    from t2m_jax.motion.formats import reader_options

    # With a character, the rig is that of its joints.
    given = {"animation": args.animation, "rig": None if args.character else args.rig, "up": args.up}
    known = {path: reader_options(path) for path in args.files}
    for name, value in given.items():
        if value is not None and not any(name in options for options in known.values()):
            kinds = ", ".join(sorted({path.suffix.lower() for path in args.files}))
            raise UserError(f"--{name}: {kinds} files have none; leave it out")
    return {path: {name: given[name] for name in options if given[name] is not None} for path, options in known.items()}


def joined(files: Sequence[Path], motions: "Sequence[Motion]") -> "Motion":
    """Returns one motion of all, at the frame rate of the first.

    Raises:
        UserError: A file has another skeleton than the first; the message names both.
    """
    whole = motions[0]
    for path, motion in zip(files[1:], motions[1:], strict=True):
        if motion.skeleton != whole.skeleton:
            names = f"{motion.skeleton.name}, that of {files[0]} is {whole.skeleton.name}"
            raise UserError(f"{path}: its skeleton is {names}; they cannot be joined")
        whole += motion.resampled(whole.fps)
    return whole


def save(
    output: Path, motions: "Sequence[Motion]", options: Mapping[str, str | bool], character: "Character | None"
) -> None:
    """Writes motions into a file: on the character if it is a `.glb` file and there is one."""
    from t2m_jax.files.writing import tell_replaced
    from t2m_jax.motion.formats import save_motions

    tell_replaced(output)
    if character is not None and output.suffix.lower() == ".glb":
        character.save(output, motions)
    else:
        save_motions(output, motions, **options)


@naming_options()
def run(args: argparse.Namespace) -> None:
    """Reads the motions, writes all outputs, and prints their names and the next command."""
    from t2m_jax.files.writing import claim
    from t2m_jax.motion.changes import Changes
    from t2m_jax.motion.formats import check_motion_output, load_motion
    from t2m_jax.sampling.compilation import use_compilation_cache

    # All that can be wrong with the options is said before the first file is read.
    for output in args.outputs:
        check_motion_output(output, num_motions=1 if args.join else len(args.files))
    changes = read_record(Changes, args)
    options = {output: file_options(output, args, args.outputs) for output in args.outputs}
    character = open_character(args, args.outputs)
    chosen = read_options(args)
    if changes.clean:
        use_compilation_cache()  # the clean-up takes longer to compile than to run
    with claim(args.outputs, tells=False):
        motions = [load_motion(path, **chosen[path]) for path in args.files]
        if args.join:
            motions = [joined(args.files, motions)]
        motions = [changes.apply(motion) for motion in motions]
        for output in args.outputs:
            save(output, motions, options[output], character)
            print(output)
    show_written(args.outputs, is_glb_read=character is None and len(motions) == 1)
