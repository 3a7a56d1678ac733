"""The motion files of a folder, and the motions in a file."""

import zipfile
from collections import Counter
from pathlib import Path

from t2m_jax.data.importers.caption_files import Source
from t2m_jax.errors import UserError
from t2m_jax.motion.amass import is_amass, load_amass
from t2m_jax.motion.amc import AMC_FPS, load_amc
from t2m_jax.motion.bvh import load_bvh
from t2m_jax.motion.formats import check_size
from t2m_jax.motion.gltf import load_gltf
from t2m_jax.motion.rig import RigClip
from t2m_jax.motion.rig.retarget import resolve_rig

SUFFIXES = (".bvh", ".glb", ".amc", ".npz")


def find_motion_files(source: Path) -> list[Path]:
    """Returns all BVH, GLB, AMC and AMASS files below `source`, sorted.

    Raises:
        UserError: There are none.
    """
    found = (path for path in source.rglob("*") if path.suffix.lower() in SUFFIXES)
    # What macOS puts beside files in archives.
    files = sorted(path for path in found if not (path.name.startswith("._") or _is_other_npz(path)))
    if not files:
        raise UserError(f"{source}: is no folder with {', '.join(SUFFIXES[:-1])} or {SUFFIXES[-1]} files at any depth")
    return files


def _is_other_npz(path: Path) -> bool:
    """Returns whether a file is an archive without rotations, such as the `shape.npz` of AMASS or one of ours."""
    if path.suffix.lower() != ".npz":
        return False
    try:
        with zipfile.ZipFile(path) as archive:
            return not is_amass({name.removesuffix(".npy") for name in archive.namelist()})
    except (OSError, zipfile.BadZipFile):
        return False  # its reader says what is wrong


def open_motion_file(path: Path, *, amc_fps: float = AMC_FPS, rig: str | None = None) -> dict[Source, RigClip]:
    """Returns the motions of a file. In a BVH file, the legs of `rig` tell the unit.

    Raises:
        UserError: The file is damaged or too long, or there is no such rig.
    """
    motions = _read_motion_file(path, amc_fps=amc_fps, rig=rig)
    for clip in motions.values():
        check_size(path, clip)
    return motions


def _read_motion_file(path: Path, *, amc_fps: float, rig: str | None) -> dict[Source, RigClip]:
    suffix = path.suffix.lower()
    if suffix == ".glb":
        # Keys at any rate become 20 frames per second in one step, as they always did: frozen data stay the same.
        clips = load_gltf(path, at_keys=False)
        # Animations of two armatures may have equal captions; their names differ.
        counts = Counter(clip.caption for clip in clips.values())
        return {Source(path, clip.caption if counts[clip.caption] == 1 else name): clip for name, clip in clips.items()}
    if suffix == ".amc":
        return {Source(path, None): load_amc(path, fps=amc_fps)}
    if suffix == ".npz":
        return {Source(path, None): load_amass(path)}
    return {Source(path, None): load_bvh(path, rig=None if rig is None else resolve_rig(rig))}
