"""Importing a folder of BVH and GLB files of any known rig, with captions from a table, from text files or names."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import tqdm
from jaxtyping import Float

from t2m_jax.config import load_config
from t2m_jax.data.folder import DatasetInfo
from t2m_jax.data.importers.caption_files import Source, find_captions, load_caption_table
from t2m_jax.data.splits import split_by_hash
from t2m_jax.data.writer import ImportReport, finish_folder, new_folder, with_twins, write_twins
from t2m_jax.errors import UserError
from t2m_jax.motion.bvh import BvhClip, load_bvh
from t2m_jax.motion.bvh.resample import resample
from t2m_jax.motion.bvh.retarget import retarget
from t2m_jax.motion.gltf import load_gltf
from t2m_jax.motion.skeleton import HUMANML3D

POP_SPEED, POP_RATIO = 3.0, 5.0
"""Frame 0 is a rest pose before the motion if the joints then move faster than this (meters per second, on average) and
this many times as fast as in the next frames."""
NEXT_FRAMES = 5


def clip_name(key: str) -> str:
    """Returns the clip name of a motion by its key, without a leading M, which marks mirrored twins."""
    name = re.sub(r"[^\w-]+", "_", key).strip("_")
    return f"m{name[1:]}" if name.startswith("M") else name


def find_motion_files(source: Path) -> list[Path]:
    """Returns all BVH and GLB files below `source`, sorted.

    Raises:
        UserError: There are none.
    """
    files = sorted(path for path in source.rglob("*") if path.suffix.lower() in (".bvh", ".glb"))
    if not files:
        raise UserError(f"{source}: no .bvh or .glb files below it")
    return files


def _open_file(path: Path) -> dict[Source, BvhClip]:
    """Returns the motions of a file."""
    if path.suffix.lower() == ".bvh":
        return {Source(path, None): load_bvh(path)}
    # Blender writes "armature|action".
    return {Source(path, name.rpartition("|")[2]): clip for name, clip in load_gltf(path, fps=HUMANML3D.fps).items()}


def _load_positions(clip: BvhClip, rig: str | None) -> Float[np.ndarray, "T J 3"]:
    """Returns the 22 joints of a clip at 20 frames per second, without a rest pose at the beginning."""
    if _begins_with_rest_pose(retarget(clip, rig=rig).positions, fps=clip.fps):
        clip = dataclasses.replace(clip, rotations=clip.rotations[1:], translations=clip.translations[1:])
    return retarget(resample(clip, HUMANML3D.fps), rig=rig).positions


def _begins_with_rest_pose(positions: Float[np.ndarray, "T J 3"], *, fps: float) -> bool:
    """Returns whether the figure jumps from frame 0 to frame 1."""
    steps = np.diff(positions[: NEXT_FRAMES + 2], axis=0)
    speeds = np.linalg.norm(steps, axis=-1).mean(axis=1) * fps
    return len(speeds) > 1 and bool(speeds[0] > max(POP_SPEED, POP_RATIO * speeds[1:].max()))


def _load_info(source: Path, info: str | Path | None) -> DatasetInfo:
    """Returns what is known of the data: from a file, or the folder's name."""
    if info is None:
        return DatasetInfo(name=source.resolve().name, min_frames=16, source=source.resolve().name)
    about = load_config(Path(info), DatasetInfo)
    if (about.skeleton, about.fps) != (HUMANML3D.name, HUMANML3D.fps):
        raise UserError(f"{info}: skeleton and fps are {HUMANML3D.name} and {HUMANML3D.fps:g} here; leave them out")
    return about


def import_bvh_folder(
    source: str | Path,
    destination: str | Path,
    *,
    captions: str | Path | None = None,
    rig: str | None = None,
    caption_from_name: bool = False,
    info: str | Path | None = None,
    seed: int = 0,
) -> ImportReport:
    """Converts a folder of BVH and GLB files into a new data-set folder and returns a report of what was written.

    Clips are resampled to 20 frames per second, retargeted, encoded and mirrored, and split 80/5/15 %. Each animation
    of a GLB file is a clip. A clip without a caption or with a broken file is left out, and the report names it.

    Args:
        source: Folder that is searched for `*.bvh` and `*.glb` at any depth.
        destination: Folder to make.
        captions: `.csv` (file,caption[,start,end]) or `.txt` (`file: caption` lines); by default `captions.csv` or
            `captions.txt` in the folder. An animation of a GLB file is called `file/animation`. A `.txt` beside a BVH
            file is always read.
        rig: Name of a rig, or a YAML table such as `pelvis: Hips`; by default detected from the joint names.
        caption_from_name: A clip without captions gets the words of its file's or its animation's name.
        info: YAML file with the name, license, source and attribution of the data, as in `dataset.yaml`.
        seed: Seed of the split.

    Raises:
        UserError: No clip can be imported, a table or `info` is broken, or the destination exists.
    """
    source = Path(source)
    files, about = find_motion_files(source), _load_info(source, info)
    table = load_caption_table(source, Path(captions) if captions else None)
    seen: dict[str, Source] = {}
    left_out, frames = {}, 0
    with new_folder(destination) as folder:
        for path in tqdm.tqdm(files, unit="file", desc="converting"):
            try:
                motions = _open_file(path)
            except UserError as error:
                left_out[clip_name(Source(path, None).key(source))] = str(error)
                continue
            for motion, clip in motions.items():
                name = clip_name(motion.key(source))
                if name in seen:
                    raise UserError(f"{motion}: would be named {name} like {seen[name]}; rename one of them")
                seen[name] = motion
                try:
                    said = find_captions(motion, source, table=table, from_name=caption_from_name)
                    positions = _load_positions(clip, rig)
                    frames += 2 * write_twins(folder, name, positions, captions=said, skeleton=HUMANML3D)
                except UserError as error:
                    left_out[name] = str(error)
        names = [name for name in seen if name not in left_out]
        if not names:
            first = next(iter(left_out.values()))
            raise UserError(f"{source}: none of {len(left_out)} clips could be imported; the first: {first}")
        twins = {split: with_twins(members) for split, members in split_by_hash([names], seed=str(seed)).items()}
        sizes = finish_folder(folder, twins, info=about, skeleton=HUMANML3D)
    return ImportReport(2 * len(names), frames, sizes, left_out, ())
