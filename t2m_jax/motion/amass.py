"""Reading `.npz` files in the layout of AMASS: rotations of the body model SMPL."""

from collections.abc import Mapping, Sequence, Set
from pathlib import Path

import numpy as np
from jaxtyping import Float

from t2m_jax.errors import UserError
from t2m_jax.files.reading import load_archive
from t2m_jax.motion.rig.clip import MAX_VALUE, RigClip
from t2m_jax.motion.skeleton import HUMANML3D
from t2m_jax.motion.smpl import clip_from_smpl

RATES = ("mocap_framerate", "mocap_frame_rate")
"""What AMASS calls frames per second, in its files for SMPL+H and for SMPL-X."""
_READ_RATES = (*RATES, "fps")
ROTATIONS = (("poses",), ("root_orient", "pose_body"), ("smpl_poses",))
"""Entries that have all rotations one after another, in AMASS, in parts of it and in AIST++."""
_PLACES = ("trans", "smpl_trans")


def is_amass(entries: Set[str]) -> bool:
    """Returns whether an archive with these entries has rotations of SMPL and no positions."""
    return "positions" not in entries and any(entries >= {*names} for names in ROTATIONS)


def load_amass(path: Path) -> RigClip:
    """Returns the motion of a file of AMASS, on SMPL's mean body.

    Raises:
        UserError: The file is damaged, or is not such a file.
    """
    archive = load_archive(path)
    if not is_amass(archive.keys()):
        raise UserError(f"{path}: has no rotations of SMPL, such as the entry 'poses' in files of AMASS")
    return clip_from_amass(path, archive)


def clip_from_amass(path: Path, archive: Mapping[str, np.ndarray]) -> RigClip:
    """Returns the motion of an archive, on SMPL's mean body: the shape of a body needs the model.

    Raises:
        UserError: An entry is missing or is not as in AMASS.
    """
    rate_name = _first_of(path, archive, _READ_RATES, "frames per second")
    place_name = _first_of(path, archive, _PLACES, "places of the pelvis")
    poses = _rotations(path, archive)
    trans, rate = (_numbers(path, archive, key) for key in (place_name, rate_name))
    if trans.shape != (len(poses), 3):
        raise UserError(f"{path}: entry {place_name!r} has shape {list(trans.shape)}; it needs {[len(poses), 3]}")
    if rate.size != 1 or not rate.item() > 0:
        raise UserError(f"{path}: entry {rate_name!r} is not one number above zero")
    if "smpl_scaling" in archive:  # AIST++ has places in centimeters of a body that is larger by this factor
        trans /= max(_numbers(path, archive, "smpl_scaling").max(initial=0), 1e-3)
    is_mean = "betas" not in archive or not np.any(archive["betas"])
    notes = () if is_mean else ("its betas are not used, so the bones have the lengths of SMPL's mean body",)
    return clip_from_smpl(poses, trans, fps=rate.item(), notes=notes)


def _first_of(path: Path, archive: Mapping[str, np.ndarray], names: Sequence[str], content: str) -> str:
    """Returns the first of these names that an archive has."""
    found = next((name for name in names if name in archive), None)
    if found is None:
        raise UserError(f"{path}: there is no entry {' or '.join(map(repr, names))} with the {content}")
    return found


def _rotations(path: Path, archive: Mapping[str, np.ndarray]) -> Float[np.ndarray, "T C"]:
    """Returns the rotations of all joints, of which some programs have one row for each."""
    names = next(names for names in ROTATIONS if archive.keys() >= {*names})
    parts = [_numbers(path, archive, name) for name in names]
    # Joints of hands and face follow those of the body, in numbers that depend on the model.
    width = 3 * HUMANML3D.num_joints
    if all(part.ndim and part.size and part.shape[2:] in ((), (3,)) and len(part) == len(parts[0]) for part in parts):
        poses = np.concatenate([part.reshape(len(part), -1) for part in parts], axis=1)
        if poses.shape[1] >= width:
            return poses
    shapes = " and ".join(f"{name!r} has shape {list(part.shape)}" for name, part in zip(names, parts, strict=True))
    raise UserError(f"{path}: entry {shapes}; it needs [frames, {width} or more]")


def _numbers(path: Path, archive: Mapping[str, np.ndarray], key: str) -> np.ndarray:
    """Returns an entry as real numbers."""
    value = archive[key]
    if value.dtype.kind not in "fiu" or not (np.abs(value) < MAX_VALUE).all():
        raise UserError(f"{path}: entry {key!r} has other values than finite numbers below {MAX_VALUE:g}")
    return value.astype(np.float64)
