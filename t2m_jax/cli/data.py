"""`t2m data`: makes and checks data-set folders."""

import argparse
import dataclasses
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from t2m_jax.cli.options import add_model_argument, add_seed_argument, show_next, subcommand_adder
from t2m_jax.errors import UserError, printable

if TYPE_CHECKING:
    from t2m_jax.data.audit import AuditReport
    from t2m_jax.data.writer import ImportReport

MAX_LINES = 20
"""Number of clips or problems that are printed; `check --json` has all problems, a contact sheet all of an import."""
SHEET = "contact-sheet.html"
SYNTHETIC_NAME = "synthetic"
MANY_CLIPS = 10_000
"""A set with so many clips in training, with twins, is large enough for the published recipes (HumanML3D: 23,384)."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the sub-commands and their options."""
    add = subcommand_adder(parser)
    importer = add(run_import, "convert motion files into a data-set folder")
    rig = add(run_rig, "guess which joints of a file are HumanML3D's, as a table for --rig")
    sheet = add(run_sheet, "draw some poses of each clip of a data-set folder on one page")
    merge = add(run_merge, "put several data sets into one folder")
    compose = add(
        run_compose, "add motions in turn, at once, repeated or for some time, made of the clips of a data set"
    )
    replay = add(run_replay, "make a data-set folder of motion that a model generates")
    synthetic = add(run_synthetic, "make a data-set folder of computed motions, without a download")
    check = add(run_check, "count the contents of a data-set folder and find its faults")
    _add_importers(importer)
    rig.add_argument(
        "file", type=Path, metavar="FILE", help="a .bvh, .glb, .vrm, .vrma or .amc file, or a .npz file of AMASS"
    )
    rig.add_argument("-o", "--output", type=Path, metavar="FILE", help="table to write (default: print it)")
    for command in (sheet, check):
        command.add_argument("folder", type=Path, metavar="DIR", help="data-set folder")
    sheet.add_argument("-o", "--output", type=Path, metavar="FILE", help=f"page to write (default: DIR/{SHEET})")
    check.add_argument("--json", type=Path, metavar="FILE", help="write the report to this file, too")
    merge.add_argument("sources", nargs="+", type=Path, metavar="SRC", help="folders to read")
    compose.add_argument("source", type=Path, metavar="SRC", help="folder to read; index.csv must have labels")
    for command in (merge, compose, replay, synthetic):
        command.add_argument("destination", type=Path, metavar="DEST", help="folder to make")
    add_model_argument(replay)
    sentences = "what to generate, a sentence per line (default: some captions)"
    replay.add_argument("--sentences", type=Path, metavar="FILE", help=sentences)
    replay.add_argument("--num-clips", type=int, default=120, help="number of motions (default: 120)")
    synthetic.add_argument("--num-clips", type=int, default=200, help="clips before mirroring (default: 200)")
    _add_compositions(compose)
    for command in (compose, replay, synthetic):
        add_seed_argument(command)


def _add_compositions(compose: argparse.ArgumentParser) -> None:
    """Adds what can be made of clips."""
    kinds = {
        "--turns": "two or three actions in turn",
        "--at-once": "the legs of one clip and the arms of another",
        "--repeated": "an action once to five times",
        "--timed": "an action that lasts two to nine seconds",
    }
    for name, shows in kinds.items():
        compose.add_argument(name, type=int, default=0, metavar="N", help=f"motions to add: {shows} (default: 0)")
    compose.add_argument("--still", action="store_true", help="add motions of standing still, cut out of clips")
    compose.add_argument("--slow", action="store_true", help="add slow clips once more, played very slowly")
    compose.add_argument("--workers", type=int, default=1, help="number of processes (default: 1)")


def _add_importers(importer: argparse.ArgumentParser) -> None:
    """Adds a sub-command for each kind of motion files."""
    sources = importer.add_subparsers(dest="source_kind", required=True, metavar="{bandai-namco,bvh,humanml3d}")
    bandai = sources.add_parser("bandai-namco", help="the Bandai-Namco-Research-Motiondataset (CC BY-NC 4.0)")
    bvh = sources.add_parser("bvh", help="a folder of BVH, GLB, AMC and AMASS (.npz) files with captions")
    humanml3d = sources.add_parser("humanml3d", help="a folder with the layout of HumanML3D or KIT-ML")
    for command in (bandai, bvh, humanml3d):
        command.add_argument("source", type=Path, metavar="SRC", help="folder to read")
        command.add_argument("destination", type=Path, metavar="DEST", help="folder to make")
    bandai.add_argument("--splits", type=Path, metavar="DIR", help="folder with train.txt, val.txt and test.txt")
    bandai.add_argument("--composed", type=int, default=0, help="motions of several actions to add")
    bandai.add_argument("--workers", type=int, help="number of processes (default: one per processor)")
    table = "file,caption[,start,end][,action,person,split] or 'file: caption' lines"
    bvh.add_argument("--captions", type=Path, metavar="FILE", help=table)
    bvh.add_argument("--up", choices=("auto", "y", "z"), default="auto", help="axis that points up (default: found)")
    bvh.add_argument("--amc-fps", type=float, default=120.0, help="frames per second of AMC files (default: 120)")
    split = "shares of train, val and test (default: 80/5/15), or a folder of lists"
    bvh.add_argument("--split", default="80/5/15", help=split)
    together = "keep clips together: 'folder', or a column of the table such as actor"
    bvh.add_argument("--split-by", metavar="COLUMN", help=together)
    bvh.add_argument("--rig", help="name of a rig or a YAML file (default: detected from the joint names)")
    bvh.add_argument("--caption-from-name", action="store_true", help="caption clips without captions by file name")
    bvh.add_argument("--info", type=Path, metavar="FILE", help="YAML with name, licence, source and attribution")
    bvh.add_argument("--seed", type=int, default=0, help="seed of the split into train, val and test")
    frozen = "use just the table: no written captions, the same bytes as its column sha256, all rows or nothing"
    bvh.add_argument("--frozen", action="store_true", help=frozen)
    twins = "do not add mirrored twins, whose captions have left and right exchanged only if they are English"
    bvh.add_argument("--no-twins", dest="twins", action="store_false", help=twins)


def run(args: argparse.Namespace) -> None:
    """Runs the chosen sub-command. If it has made a folder, prints what the folder has, and the next command."""
    report = args.run_command(args)
    if report is None:
        return
    from t2m_jax.data.files import MIRROR_PREFIX, read_names

    sizes = ", ".join(f"{split} {size}" for split, size in report.split_sizes.items())
    names = frozenset().union(*(read_names(args.destination / f"{split}.txt") for split in report.split_sizes))
    twins = "; with mirrored twins" if any(f"{MIRROR_PREFIX}{name}" in names for name in names) else ""
    _show(f"{args.destination}: {report.num_clips} clips ({report.num_frames} frames{twins}): {sizes}")
    _print_lines(report.notes, indent="  ")
    if report.left_out:
        _show(f"  {len(report.left_out)} clips left out:")
        _print_lines([f"{name}: {reason}" for name, reason in report.left_out.items()])
    sheet = args.destination / SHEET
    if sheet.exists():  # only imports of files that nobody has looked at draw one
        _show(f"  poses of the clips: {sheet}")
    show_next(f"t2m data check {shlex.quote(str(args.destination))}")


def run_import(args: argparse.Namespace) -> "ImportReport":
    """Writes a folder from motion files."""
    from t2m_jax.data import import_bandai_namco, import_bvh_folder, import_humanml3d
    from t2m_jax.data.folder import open_dataset
    from t2m_jax.export.contact_sheet import save_contact_sheet

    # The options of each kind are the arguments of its function.
    given = {name: value for name, value in vars(args).items() if name not in ("run_command", "source_kind")}
    source = given.pop("source")
    destination = given.pop("destination")
    if args.source_kind == "bandai-namco":
        return import_bandai_namco(source, destination, **given)
    if args.source_kind == "humanml3d":
        return import_humanml3d(source, destination)
    report = import_bvh_folder(source, destination, **given)
    # Nobody has looked at these files yet, and a picture shows wrong joints at once.
    dataset = open_dataset(destination)
    save_contact_sheet(destination / SHEET, dataset, notes=report.notes, left_out=report.left_out)
    return report


def run_merge(args: argparse.Namespace) -> "ImportReport":
    """Writes a folder from others."""
    from t2m_jax.data.merge import merge_datasets

    return merge_datasets(args.sources, args.destination)


def run_compose(args: argparse.Namespace) -> "ImportReport":
    """Writes a folder with more motions for training."""
    from t2m_jax.data.composing.compose import ComposeOptions, compose_dataset

    options = {field.name: getattr(args, field.name) for field in dataclasses.fields(ComposeOptions)}
    return compose_dataset(args.source, args.destination, **options)


def run_synthetic(args: argparse.Namespace) -> "ImportReport":
    """Writes a folder of computed motions."""
    from t2m_jax.data.importers.synthetic import write_synthetic_dataset

    return write_synthetic_dataset(args.destination, num_clips=args.num_clips, seed=args.seed)


def run_replay(args: argparse.Namespace) -> "ImportReport":
    """Writes what a model generates."""
    from t2m_jax.export.replay import write_replay
    from t2m_jax.files.reading import load_text
    from t2m_jax.sampling import TextToMotion

    sentences: list[str] = []
    if args.sentences is not None:
        sentences = [line.strip() for line in load_text(args.sentences).splitlines() if line.strip()]
        if not sentences:
            raise UserError(f"{args.sentences}: has no sentence")
    model = TextToMotion.load(args.model)
    return write_replay(model, args.destination, sentences=sentences, num_clips=args.num_clips, seed=args.seed)


def run_rig(args: argparse.Namespace) -> None:
    """Prints or writes the best guess of a rig's table."""
    from t2m_jax.data.importers.motion_files import open_motion_file
    from t2m_jax.files.writing import check_output, save_text
    from t2m_jax.motion.gltf import load_gltf_joints
    from t2m_jax.motion.rig.guess import rig_table_text

    place = None if args.output is None else check_output(args.output)
    # Any animation: only the joints are read. A character may have none.
    is_gltf = args.file.suffix.lower() in (".glb", ".vrm", ".vrma")
    clip = load_gltf_joints(args.file) if is_gltf else next(iter(open_motion_file(args.file).values()))
    text = rig_table_text(clip, source=args.file.name)
    if place is None:
        for line in text.splitlines():
            _show(line)
        return
    save_text(place, text)
    _show(f"{place}")
    show_next(f"t2m data import bvh {shlex.quote(str(args.file.parent))} data/mine --rig {shlex.quote(str(place))}")


def run_sheet(args: argparse.Namespace) -> None:
    """Writes a contact sheet and prints its name."""
    from t2m_jax.data.folder import open_dataset
    from t2m_jax.export.contact_sheet import save_contact_sheet
    from t2m_jax.files.writing import check_output

    output = check_output(args.output or args.folder / SHEET)
    save_contact_sheet(output, open_dataset(args.folder))
    _show(f"  poses of the clips: {output}")


def run_check(args: argparse.Namespace) -> None:
    """Prints the audit of a folder and exits with code 1 if something is wrong."""
    check_dataset(args.folder, args.json)


def check_dataset(folder: Path, report_file: Path | None) -> None:
    """Prints the audit of a folder and exits with code 1 if something is wrong."""
    from t2m_jax.data.audit import audit_dataset
    from t2m_jax.files.writing import check_output, claim, save_json

    outputs = [] if report_file is None else [check_output(report_file)]
    with claim(outputs):
        report = audit_dataset(folder)
        for output in outputs:
            save_json(output, dataclasses.asdict(report))
    _show(f"{report.folder}: {report.name or 'unnamed'}, skeleton {report.skeleton}, {report.fps:g} frames per second")
    for split, count in report.splits.items():
        _show(
            f"  {split:5} {count.clips:6} clips ({count.mirrored} mirrored), {count.hours:.2f} h, "
            f"{count.captions} captions, {count.shortest} to {count.longest} frames"
        )
    for note in report.notes:
        _show(f"  note: {note}")
    if report.problems:
        _show(f"  {len(report.problems)} problems:")
        _print_lines(report.problems)
        sys.exit(1)
    run_folder = shlex.quote(f"runs/{folder.resolve().name}-vqvae")
    _show("  no problems found")
    given = f"--data {shlex.quote(str(folder))} --run {run_folder}"
    show_next(f"t2m train vqvae {_recipe(report)} --statistics data {given}")


def _recipe(report: "AuditReport") -> str:
    """Returns the config of a VQ-VAE that suits a data set: the published one only for sets of the published sizes."""
    if report.name == SYNTHETIC_NAME:
        return "synthetic/vqvae"
    if report.skeleton == "kit_ml":
        return "kit_ml/official"
    return "official" if report.splits["train"].clips >= MANY_CLIPS else "t2m-gpt/vqvae"


def _print_lines(lines: Sequence[str], *, indent: str = "    ") -> None:
    """Prints the first lines of a list and the number of the others."""
    for line in lines[:MAX_LINES]:
        _show(f"{indent}{line}")
    if len(lines) > MAX_LINES:
        _show(f"{indent}... and {len(lines) - MAX_LINES} more")


def _show(line: str) -> None:
    """Prints a line that may quote names in files of strangers."""
    print(printable(line))
