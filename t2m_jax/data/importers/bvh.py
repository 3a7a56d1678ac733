"""Importing a folder of BVH files of any known rig, with captions from a table, from text files or from file names."""

import csv
import dataclasses
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
from t2m_jax.data.writer import ImportReport, finish_folder, make_layout, new_folder, with_twins, write_twins
from t2m_jax.errors import UserError
from t2m_jax.motion.bvh import load_bvh
from t2m_jax.motion.bvh.resample import resample
from t2m_jax.motion.bvh.retarget import retarget
from t2m_jax.motion.skeleton import HUMANML3D

CAPTION_FILES = ("captions.csv", "captions.txt")
POP = 0.5
"""metres: mean step of the joints from frame 0 to 1 above which frame 0 is a rest pose put before the motion"""


def clip_name(path: Path, source: Path) -> str:
    """Returns the clip name of a BVH file: its path below `source`, without a leading M, which marks twins."""
    name = re.sub(r"[^\w-]+", "_", path.relative_to(source).with_suffix("").as_posix()).strip("_")
    return f"m{name[1:]}" if name.startswith("M") else name


def find_bvh_files(source: Path) -> dict[str, Path]:
    """Returns clip name -> BVH file for all files below `source`, sorted.

    Raises:
        UserError: there are none, or two would get the same clip name.
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


def _caption(text: str, *, source: str, start: str = "", end: str = "") -> Caption:
    """Returns a caption with tags from plain text."""
    if "#" in text:
        raise UserError(f"{source}: the caption holds '#', which the text format cannot carry; remove it")
    text = " ".join(text.split())
    line = f"{text}#{' '.join(tag_words(text))}#{start.strip() or 0.0}#{end.strip() or 0.0}"
    return parse_caption(line, source=source)


def _captions_from_csv(path: Path) -> dict[str, list[Caption]]:
    """Returns file stem -> captions from a table with the columns file, caption and, optionally, start and end."""
    with path.open(encoding="utf-8-sig", newline="") as lines:
        reader = csv.DictReader(lines)
        if not {"file", "caption"} <= set(reader.fieldnames or ()):
            raise UserError(f"{path}:1: expected the columns file,caption[,start,end]")
        result: dict[str, list[Caption]] = {}
        for row in reader:
            source = f"{path}:{reader.line_num}"
            if not row["file"] or not row["caption"]:
                raise UserError(f"{source}: file or caption is empty; fill both in or remove the line")
            caption = _caption(row["caption"], source=source, start=row.get("start") or "", end=row.get("end") or "")
            result.setdefault(_stem(row["file"]), []).append(caption)
    return result


def _captions_from_list(path: Path) -> dict[str, list[Caption]]:
    """Returns file stem -> captions from lines `file: caption` (or a tab between them)."""
    result: dict[str, list[Caption]] = {}
    for number, line in enumerate(path.read_text(encoding="utf-8-sig").split("\n"), start=1):
        if not line.strip():
            continue
        file, mark, text = line.partition("\t") if "\t" in line else line.partition(":")
        if not mark or not text.strip():
            raise UserError(f"{path}:{number}: expected 'file: caption'")
        result.setdefault(_stem(file), []).append(_caption(text, source=f"{path}:{number}"))
    return result


def _stem(file: str) -> str:
    """Returns a file's path without `.bvh`, with forward slashes."""
    return re.sub(r"\.bvh$", "", file.strip().replace("\\", "/"), flags=re.IGNORECASE)


def _captions_beside(path: Path) -> list[Caption]:
    """Returns the captions in the text file beside a BVH file: plain lines or HumanML3D's four fields."""
    beside = path.with_suffix(".txt")
    if not beside.is_file():
        return []
    captions = []
    for number, line in enumerate(beside.read_text(encoding="utf-8-sig").split("\n"), start=1):
        source = f"{beside}:{number}"
        if line.count("#") == 3:
            caption = parse_caption(line, source=source)
            captions.append(caption if caption.tokens else caption._replace(tokens=tag_words(caption.text)))
        elif line.strip():
            captions.append(_caption(line, source=source))
    return captions


def load_caption_table(source: Path, captions: Path | None) -> dict[str, list[Caption]]:
    """Returns file stem -> captions from the given file or from `captions.csv` or `captions.txt` in the folder.

    Raises:
        UserError: the given file is missing, is not UTF-8 or has a broken line, named as `file:line`.
    """
    found = captions or next((source / name for name in CAPTION_FILES if (source / name).is_file()), None)
    if found is None:
        return {}
    if not found.is_file():
        raise UserError(f"{found}: no such file; give a .csv with file,caption or a .txt with 'file: caption' lines")
    try:
        return _captions_from_csv(found) if found.suffix == ".csv" else _captions_from_list(found)
    except (UnicodeDecodeError, csv.Error) as error:
        raise UserError(f"{found}: is not UTF-8 text ({error}); save it as UTF-8") from error


def _captions_of(
    path: Path, source: Path, *, table: Mapping[str, Sequence[Caption]], from_name: bool
) -> tuple[Caption, ...]:
    """Returns the captions of a BVH file, from the table, the text beside it, or its name."""
    relative = path.relative_to(source).with_suffix("").as_posix()
    captions = [
        *table.get(relative, ()),
        *(table.get(path.stem, ()) if relative != path.stem else ()),
        *_captions_beside(path),
    ]
    if not captions and from_name:
        words = re.sub(r"[\W\d_]+", " ", path.stem).strip().lower()
        captions = [_caption(words, source=str(path))] if words else []
    return tuple(dict.fromkeys(captions))


def _load_positions(path: Path, rig: str | None) -> Float[np.ndarray, "T J 3"]:
    """Returns the 22 joints of a BVH file at 20 frames a second, without a rest pose in front."""
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
    """Returns what was written after converting a folder of BVH files into a new data-set folder.

    Clips are resampled to 20 frames a second, retargeted, encoded and mirrored, and split 80/5/15 %. A clip without
    caption, or whose file is broken, is left out and named in the report.

    Args:
        source: folder searched for `*.bvh` at any depth.
        destination: folder to make.
        captions: `.csv` (file,caption[,start,end]) or `.txt` (`file: caption` lines); `captions.csv` or
            `captions.txt` in the
            folder by default. A `.txt` beside a BVH file is read in any case.
        rig: name of a rig or a YAML table `pelvis: Hips`; detected from the joint names by default.
        caption_from_name: a clip without caption gets the words of its file name.
        seed: of the split.

    Raises:
        UserError: no clip can be imported, a caption file is broken, or the destination exists.
    """
    source, destination = Path(source), Path(destination)
    files = find_bvh_files(source)
    table = load_caption_table(source, Path(captions) if captions else None)
    left_out, frames = {}, 0
    with new_folder(destination) as folder:
        make_layout(folder)
        for name, path in tqdm.tqdm(files.items(), unit="clip", desc="converting"):
            said = _captions_of(path, source, table=table, from_name=caption_from_name)
            if not said:
                left_out[name] = f"{path}: no caption; add it to captions.csv or use --caption-from-name"
                continue
            try:
                frames += 2 * write_twins(folder, name, _load_positions(path, rig), captions=said, skeleton=HUMANML3D)
            except UserError as error:
                left_out[name] = str(error)
        names = [name for name in files if name not in left_out]
        if not names:
            raise UserError(
                f"{source}: none of {len(files)} clips could be imported; the first: {next(iter(left_out.values()))}"
            )
        twins = {split: with_twins(members) for split, members in split_by_hash([names], seed=str(seed)).items()}
        info = DatasetInfo(name=source.resolve().name, min_frames=16, source=source.resolve().name)
        sizes = finish_folder(folder, twins, info=info, skeleton=HUMANML3D)
    return ImportReport(2 * len(names), frames, sizes, left_out, ())
