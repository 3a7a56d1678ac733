"""`t2m data`: make and check data-set folders."""

import argparse
import dataclasses
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from t2m_jax.data.writer import ImportReport

DESCRIPTION = "make a data-set folder from motion files, or check one"
MAX_LINES = 20


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the sub-commands `import`, `synthetic` and `check`."""
    commands = parser.add_subparsers(dest="data_command", required=True, metavar="{import,synthetic,check}")
    _add_import_arguments(commands.add_parser("import", help="convert motion files into a data-set folder"))
    synthetic = commands.add_parser(
        "synthetic", help="make a data-set folder of procedural motions, no download needed"
    )
    synthetic.add_argument("destination", type=Path, metavar="DEST", help="folder to make")
    synthetic.add_argument(
        "--num-clips", type=int, help="clips before mirroring (default 200; 14614 with --like-humanml3d)"
    )
    synthetic.add_argument(
        "--like-humanml3d",
        action="store_true",
        help="HumanML3D's names, lengths and, by default, size, cut from some hundred motions: for trying what a data "
        "set of that size needs (5 GB, some minutes)",
    )
    synthetic.add_argument("--seed", type=int, default=0)
    check = commands.add_parser("check", help="count what is in a data-set folder and find what is wrong with it")
    check.add_argument("folder", type=Path, metavar="DIR")
    check.add_argument("--json", type=Path, metavar="FILE", help="write the report to this file, too")


def _add_import_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds one sub-command for each kind of source."""
    sources = parser.add_subparsers(dest="source_kind", required=True, metavar="{bandai-namco,bvh,humanml3d}")
    bandai = sources.add_parser("bandai-namco", help="the Bandai-Namco-Research-Motiondataset (CC BY-NC 4.0)")
    bvh = sources.add_parser("bvh", help="a folder of BVH files with captions")
    humanml3d = sources.add_parser("humanml3d", help="a folder with the layout of HumanML3D or KIT-ML")
    for command in (bandai, bvh, humanml3d):
        command.add_argument("source", type=Path, metavar="SRC", help="folder to read")
        command.add_argument("destination", type=Path, metavar="DEST", help="folder to make")
    bandai.add_argument("--splits", type=Path, metavar="DIR", help="folder with train.txt, val.txt and test.txt")
    bandai.add_argument("--workers", type=int, default=None, help="processes (default: one a processor)")
    bvh.add_argument(
        "--captions", type=Path, metavar="FILE", help="table: file,caption[,start,end], or text: 'file: caption'"
    )
    bvh.add_argument("--rig", help="name of a rig or a YAML file (default: detected from the joint names)")
    bvh.add_argument(
        "--caption-from-name", action="store_true", help="clips without caption get the words of their file name"
    )
    bvh.add_argument("--seed", type=int, default=0, help="of the split into train, val and test")


def run(args: argparse.Namespace) -> None:
    """Runs the chosen sub-command; `check` ends the program with code 1 when it found problems."""
    if args.data_command == "check":
        _check(args)
    elif args.data_command == "synthetic":
        _show_import(_make_synthetic(args), args.destination)
    else:
        _show_import(_import(args), args.destination)


def _make_synthetic(args: argparse.Namespace) -> "ImportReport":
    """Returns the report of the chosen maker of motions."""
    if args.like_humanml3d:
        from t2m_jax.data.importers import synthetic_scale as scale

        num_clips = scale.NUM_CLIPS if args.num_clips is None else args.num_clips
        return scale.write_scaled_dataset(args.destination, num_clips=num_clips, seed=args.seed)
    from t2m_jax.data.importers import synthetic

    num_clips = synthetic.NUM_CLIPS if args.num_clips is None else args.num_clips
    return synthetic.write_synthetic_dataset(args.destination, num_clips=num_clips, seed=args.seed)


def _import(args: argparse.Namespace) -> "ImportReport":
    """Returns the report of the chosen importer."""
    if args.source_kind == "bandai-namco":
        from t2m_jax.data.importers.bandai_namco.importer import import_bandai_namco

        return import_bandai_namco(args.source, args.destination, splits=args.splits, workers=args.workers)
    if args.source_kind == "bvh":
        from t2m_jax.data.importers.bvh import import_bvh_folder

        return import_bvh_folder(
            args.source,
            args.destination,
            captions=args.captions,
            rig=args.rig,
            caption_from_name=args.caption_from_name,
            seed=args.seed,
        )
    from t2m_jax.data.importers.humanml3d import import_humanml3d

    return import_humanml3d(args.source, args.destination)


def _show_import(report: "ImportReport", destination: Path) -> None:
    """Prints what an import wrote and what it left out."""
    sizes = ", ".join(f"{split} {size}" for split, size in report.split_sizes.items())
    print(f"{destination}: {report.num_clips} clips ({report.num_frames} frames; mirrored twins included): {sizes}")
    for note in report.notes:
        print(f"  {note}")
    if report.left_out:
        print(f"  {len(report.left_out)} clips left out:")
        _show_lines([f"{name}: {reason}" for name, reason in report.left_out.items()])


def _show_lines(lines: list[str]) -> None:
    """Prints the first lines of a list and how many more there are."""
    for line in lines[:MAX_LINES]:
        print(f"    {line}")
    if len(lines) > MAX_LINES:
        print(f"    ... and {len(lines) - MAX_LINES} more")


def _check(args: argparse.Namespace) -> None:
    """Prints an audit and ends with code 1 if something is wrong."""
    from t2m_jax.data.audit import audit_dataset

    report = audit_dataset(args.folder)
    if args.json:
        args.json.write_text(
            json.dumps(dataclasses.asdict(report), indent=2, ensure_ascii=False) + "\n", encoding="utf-8"
        )
    print(f"{report.folder}: {report.name or 'unnamed'}, skeleton {report.skeleton}, {report.fps:g} frames a second")
    for split, count in report.splits.items():
        print(
            f"  {split:5} {count.clips:6} clips ({count.mirrored} mirrored), {count.hours:.2f} h, "
            f"{count.captions} captions, {count.shortest} to {count.longest} frames"
        )
    for note in report.notes:
        print(f"  note: {note}")
    if not report.problems:
        print("  no problems found")
        return
    print(f"  {len(report.problems)} problems:")
    _show_lines(report.problems)
    sys.exit(1)
