"""Reading `.npz` files in the layout of AMASS: rotations of the body model SMPL."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from t2m_jax.errors import UserError
from t2m_jax.files.reading import load_archive
from t2m_jax.motion.rig.clip import MAX_VALUE, RigClip
from t2m_jax.motion.skeleton import HUMANML3D
from t2m_jax.motion.smpl import clip_from_smpl

RATES = ("mocap_framerate", "mocap_frame_rate")
"""What AMASS calls frames per second, in its files for SMPL+H and for SMPL-X."""


def is_amass(archive: Mapping[str, np.ndarray]) -> bool:
    """Returns whether an archive has rotations of SMPL and no positions."""
    return {"poses", "trans"} <= archive.keys() and "positions" not in archive


def load_amass(path: Path) -> RigClip:
    """Returns the motion of a file of AMASS, on SMPL's mean body.

    Raises:
        UserError: The file is damaged, or is not such a file.
    """
    archive = load_archive(path)
    if not is_amass(archive):
        raise UserError(f"{path}: has no entries 'poses' and 'trans', as files of AMASS have")
    return clip_from_amass(path, archive)


def clip_from_amass(path: Path, archive: Mapping[str, np.ndarray]) -> RigClip:
    """Returns the motion of an archive, on SMPL's mean body: the shape of a body needs the model.

    Raises:
        UserError: An entry is missing or is not as in AMASS.
    """
    name = next((name for name in RATES if name in archive), None)
    if name is None:
        raise UserError(f"{path}: there is no entry {RATES[0]!r} with the frames per second")
    poses, trans, rate = (_numbers(path, archive, key) for key in ("poses", "trans", name))
    # Joints of hands and face follow those of the body, in numbers that depend on the model.
    width = 3 * HUMANML3D.num_joints
    if poses.ndim != 2 or not len(poses) or poses.shape[1] < width:
        raise UserError(f"{path}: entry 'poses' has shape {list(poses.shape)}; it needs [frames, {width} or more]")
    if trans.shape != (len(poses), 3):
        raise UserError(f"{path}: entry 'trans' has shape {list(trans.shape)}; it needs {[len(poses), 3]}")
    if rate.size != 1 or not rate.item() > 0:
        raise UserError(f"{path}: entry {name!r} is not one number above zero")
    is_mean = "betas" not in archive or not np.any(archive["betas"])
    notes = () if is_mean else ("its betas are not used, so the bones have the lengths of SMPL's mean body",)
    return clip_from_smpl(poses, trans, fps=rate.item(), notes=notes)


def _numbers(path: Path, archive: Mapping[str, np.ndarray], key: str) -> np.ndarray:
    """Returns an entry as real numbers."""
    value = archive[key]
    if value.dtype.kind not in "fiu" or not (np.abs(value) < MAX_VALUE).all():
        raise UserError(f"{path}: entry {key!r} has other values than finite numbers below {MAX_VALUE:g}")
    return value.astype(np.float64)
