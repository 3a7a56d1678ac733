"""Motions from files of any known kind."""

import pathlib
from collections.abc import Callable
from tokenize import TokenError

import numpy as np

from t2m_jax.errors import UserError
from t2m_jax.export.npz import load_npz
from t2m_jax.motion.bvh import load_bvh
from t2m_jax.motion.bvh.retarget import retarget
from t2m_jax.motion.features import positions_from_features
from t2m_jax.motion.record import Motion
from t2m_jax.motion.skeleton import HUMANML3D, KIT_ML, Skeleton

SKELETONS = (HUMANML3D, KIT_ML)


def load_motion(path: str | pathlib.Path) -> Motion:
    """Returns the motion in a file: `.npz` or `.bvh`, or `.npy` with joints or features as data sets hold them.

    Raises:
        UserError: The suffix is unknown, or the file does not hold what it should.
    """
    path = pathlib.Path(path)
    readers: dict[str, Callable[[pathlib.Path], Motion]] = {".npz": load_npz, ".bvh": load_bvh_file, ".npy": load_npy}
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise UserError(
            f"{path}: cannot read motions from {path.suffix or 'no suffix'!r}; known are {', '.join(readers)}"
        )
    if not path.is_file():
        raise UserError(f"{path}: there is no such file")
    return reader(path)


def load_bvh_file(path: pathlib.Path) -> Motion:
    """Returns a BVH file's motion on the 22 joints, captioned with the file's name."""
    return retarget(load_bvh(path))


def load_npy(path: pathlib.Path) -> Motion:
    """Returns a data set's array as a motion: joints [T, 22 or 21, 3] or raw features [T, 263 or 251]."""
    try:
        array = np.load(path, allow_pickle=False)
    except (ValueError, EOFError, OSError, TokenError) as error:  # the last from a damaged header
        raise UserError(f"{path}: this is no array file ({error})") from error
    if not isinstance(array, np.ndarray) or array.dtype.kind != "f":
        raise UserError(f"{path}: this does not hold an array of real numbers")
    features = None
    for skeleton in SKELETONS:
        if array.ndim == 2 and array.shape[1] == skeleton.feature_dim:
            features = array.astype(np.float32)
            return _motion(path, np.asarray(positions_from_features(features, skeleton)), skeleton, features)
        if array.ndim == 3 and array.shape[1:] == (skeleton.num_joints, 3):
            return _motion(path, array.astype(np.float32), skeleton, None)
    widths = " or ".join(f"[T, {skeleton.num_joints}, 3], [T, {skeleton.feature_dim}]" for skeleton in SKELETONS)
    raise UserError(f"{path}: an array of shape {list(array.shape)} is no motion; it has to be {widths}")


def _motion(path: pathlib.Path, positions: np.ndarray, skeleton: Skeleton, features: np.ndarray | None) -> Motion:
    """Returns the motion of joints in the skeleton's own unit."""
    metres = positions * np.float32(skeleton.metres_per_unit)
    try:
        return Motion(positions=metres, fps=skeleton.fps, skeleton=skeleton, features=features)
    except UserError as error:
        raise UserError(f"{path}: {error}") from error
