"""Importing a folder of BVH files of any known rig, with captions from a table, from text files or from file names."""

import csv
import dataclasses
import io
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import tqdm
from jaxtyping import Float

from t2m_jax.data.folder import DatasetInfo
from t2m_jax.data.importers.lexicon import tag_words
from t2m_jax.data.splits import split_by_hash
from t2m_jax.data.texts import Caption, parse_caption
from t2m_jax.data.writer import ImportReport, finish_folder, new_folder, with_twins, write_twins
from t2m_jax.errors import UserError
from t2m_jax.files import load_text
from t2m_jax.motion.bvh import load_bvh
from t2m_jax.motion.bvh.resample import resample
from t2m_jax.motion.bvh.retarget import retarget
from t2m_jax.motion.skeleton import HUMANML3D

CAPTION_FILES = ("captions.csv", "captions.txt")
BYTE_ORDER_MARK = "\ufeff"
"""Some editors and spreadsheets write it at the beginning of a UTF-8 file."""
POP = 0.5
"""Meters: if the joints move by more (on average) from frame 0 to 1, frame 0 is a rest pose before the motion."""


def clip_name(path: Path, source: Path) -> str:
    """Returns the clip name of a BVH file: its path below `source`, without a leading M, which marks mirrored twins."""
    name = re.sub(r"[^\w-]+", "_", path.relative_to(source).with_suffix("").as_posix()).strip("_")
    return f"m{name[1:]}" if name.startswith("M") else name


def find_bvh_files(source: Path) -> dict[str, Path]:
    """Returns clip name -> BVH file for all files below `source`, sorted.

    Raises:
        UserError: There are none, or two would get the same clip name.
    """
    files: dict[str, Path] = {}
    for path in sorted(source.rglob("*.[bB][vV][hH]")):
        name = clip_name(path, source)
        if name in files:
            raise UserError(f"{path}: would be named {name} like {files[name]}; rename one of them")
        files[name] = path
    if not files:
        raise UserError(f"{source}: no .bvh files below it")
    return files


def _tagged_caption(text: str, *, source: str, start: str = "", end: str = "") -> Caption:
    """Returns a caption with tokens from plain text."""
    if "#" in text:
        raise UserError(f"{source}: the caption has a '#', which the text format cannot store; remove it")
    text = " ".join(text.split())
    line = f"{text}#{' '.join(tag_words(text))}#{start.strip() or 0.0}#{end.strip() or 0.0}"
    return parse_caption(line, source=source)


def load_caption_table(source: Path, captions: Path | None) -> dict[str, list[Caption]]:
    """Returns file stem -> captions from a file: the given one, or `captions.csv` or `captions.txt` in the folder.

    A `.csv` file has the columns file, caption and, optionally, start and end. Any other file has lines `file: caption`
    (or a tab in place of the colon).

    Raises:
        UserError: The given file is missing, is not UTF-8 or has a broken line, which the message names.
    """
    path = captions or next((source / name for name in CAPTION_FILES if (source / name).is_file()), None)
    if path is None:
        return {}
    if not path.is_file():
        raise UserError(f"{path}: no such file; give a .csv with file,caption or a .txt with 'file: caption' lines")
    text = load_text(path).removeprefix(BYTE_ORDER_MARK)
    rows: list[tuple[int, str | None, str | None, str, str]] = []
    if path.suffix == ".csv":
        reader = csv.DictReader(io.StringIO(text))
        try:
            rows += [
                (reader.line_num, row.get("file"), row.get("caption"), row.get("start") or "", row.get("end") or "")
                for row in reader
            ]
        except csv.Error as error:
            raise UserError(f"{path}:{reader.line_num}: is not a table ({error}); save it as CSV") from error
        if not {"file", "caption"} <= set(reader.fieldnames or ()):
            raise UserError(f"{path}:1: expected the columns file,caption[,start,end]")
    else:
        for number, line in enumerate(text.split("\n"), start=1):
            parts = line.partition("\t" if "\t" in line else ":")
            rows += [(number, parts[0], parts[2], "", "")] * bool(line.strip())
    result: dict[str, list[Caption]] = {}
    for number, file, said, start, end in rows:
        if not file or not said or not said.strip():
            raise UserError(f"{path}:{number}: file or caption is empty; fill in both or remove the line")
        stem = re.sub(r"\.bvh$", "", file.strip().replace("\\", "/"), flags=re.IGNORECASE)
        result.setdefault(stem, []).append(_tagged_caption(said, source=f"{path}:{number}", start=start, end=end))
    return result


def _find_captions(
    path: Path, source: Path, *, table: Mapping[str, Sequence[Caption]], from_name: bool
) -> tuple[Caption, ...]:
    """Returns the captions of a BVH file: from the table, from the text file beside it, or from its name.

    The text file has plain lines or HumanML3D's four fields.
    """
    relative = path.relative_to(source).with_suffix("").as_posix()
    captions = [*table.get(relative, ()), *(table.get(path.stem, ()) if relative != path.stem else ())]
    beside = path.with_suffix(".txt")
    text = load_text(beside).removeprefix(BYTE_ORDER_MARK) if beside.is_file() else ""
    for number, line in enumerate(text.split("\n"), start=1):
        place = f"{beside}:{number}"
        if line.count("#") == 3:
            caption = parse_caption(line, source=place)
            captions.append(caption if caption.tokens else caption._replace(tokens=tag_words(caption.text)))
        elif line.strip():
            captions.append(_tagged_caption(line, source=place))
    words = re.sub(r"[\W\d_]+", " ", path.stem).strip().lower()
    if not captions and from_name and words:
        captions = [_tagged_caption(words, source=str(path))]
    return tuple(dict.fromkeys(captions))


def _load_positions(path: Path, rig: str | None) -> Float[np.ndarray, "T J 3"]:
    """Returns the 22 joints of a BVH file at 20 frames per second, without a rest pose at the beginning."""
    clip = load_bvh(path)
    motion = retarget(clip, rig=rig)
    if motion.num_frames > 2 and np.linalg.norm(np.diff(motion.positions[:2], axis=0), axis=-1).mean() > POP:
        clip = dataclasses.replace(clip, rotations=clip.rotations[1:], translations=clip.translations[1:])
    return retarget(resample(clip, HUMANML3D.fps), rig=rig).positions


def import_bvh_folder(
    source: str | Path,
    destination: str | Path,
    *,
    captions: str | Path | None = None,
    rig: str | None = None,
    caption_from_name: bool = False,
    seed: int = 0,
) -> ImportReport:
    """Converts a folder of BVH files into a new data-set folder and returns a report of what was written.

    Clips are resampled to 20 frames per second, retargeted, encoded and mirrored, and split 80/5/15 %. A clip that has
    no caption or whose BVH file is broken is left out, and the report names it.

    Args:
        source: Folder that is searched for `*.bvh` at any depth.
        destination: Folder to make.
        captions: `.csv` (file,caption[,start,end]) or `.txt` (`file: caption` lines); by default `captions.csv` or
            `captions.txt` in the folder. A `.txt` beside a BVH file is always read.
        rig: Name of a rig, or a YAML table such as `pelvis: Hips`; by default detected from the joint names.
        caption_from_name: A clip without captions gets the words of its file name.
        seed: Seed of the split.

    Raises:
        UserError: No clip can be imported, a caption file is broken, or the destination exists.
    """
    source = Path(source)
    files = find_bvh_files(source)
    table = load_caption_table(source, Path(captions) if captions else None)
    left_out, frames = {}, 0
    with new_folder(destination) as folder:
        for name, path in tqdm.tqdm(files.items(), unit="clip", desc="converting"):
            said = _find_captions(path, source, table=table, from_name=caption_from_name)
            if not said:
                left_out[name] = f"{path}: no caption; add it to captions.csv or use --caption-from-name"
                continue
            try:
                frames += 2 * write_twins(folder, name, _load_positions(path, rig), captions=said, skeleton=HUMANML3D)
            except UserError as error:
                left_out[name] = str(error)
        names = [name for name in files if name not in left_out]
        if not names:
            reason = next(iter(left_out.values()))
            raise UserError(f"{source}: none of {len(files)} clips could be imported; the first: {reason}")
        twins = {split: with_twins(members) for split, members in split_by_hash([names], seed=str(seed)).items()}
        info = DatasetInfo(name=source.resolve().name, min_frames=16, source=source.resolve().name)
        sizes = finish_folder(folder, twins, info=info, skeleton=HUMANML3D)
    return ImportReport(2 * len(names), frames, sizes, left_out, ())
