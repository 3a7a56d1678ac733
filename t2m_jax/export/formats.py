"""Reading motions from files of all known formats."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from textwrap import shorten

import numpy as np

from t2m_jax.errors import UserError
from t2m_jax.export.npz import load_npz
from t2m_jax.files import load_array
from t2m_jax.motion.amc import load_amc
from t2m_jax.motion.bvh import load_bvh
from t2m_jax.motion.features import positions_from_features
from t2m_jax.motion.gltf import load_gltf
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.rig import retarget
from t2m_jax.motion.skeleton import HUMANML3D, KIT_ML

SKELETONS = (HUMANML3D, KIT_ML)


def load_motion(path: str | Path, *, animation: str | None = None) -> Motion:
    """Returns the motion of a file: `.npz`, `.bvh`, `.glb`, `.amc`, or a data set's `.npy` with joints or features.

    Args:
        path: The file.
        animation: Name of the animation in a `.glb` file, with or without the armature's name; needed if there are
            several.

    Raises:
        UserError: The suffix is unknown, the file does not contain a motion, or it has several and none was chosen.
    """
    path = Path(path)
    readers: dict[str, Callable[[Path], Motion]] = {
        ".npz": load_npz,
        ".bvh": lambda path: retarget(load_bvh(path)),
        ".glb": lambda path: load_animation(path, animation),
        ".amc": lambda path: retarget(load_amc(path)),
        ".npy": load_npy,
    }
    suffix = path.suffix.lower()
    if suffix not in readers:
        known = ", ".join(readers)
        raise UserError(f"{path}: cannot read motions from {suffix or 'no suffix'!r}; known are {known}")
    if not path.is_file():
        raise UserError(f"{path}: there is no such file")
    return readers[suffix](path)


def load_animation(path: Path, name: str | None) -> Motion:
    """Returns an animation of a GLB file; without a name, the only one.

    Raises:
        UserError: The file is damaged, there are several animations, or none has this name.
    """
    clips = load_gltf(path)
    chosen = [(own, clip) for own, clip in clips.items() if name in (None, own, own.rpartition("|")[2])]
    if len(chosen) != 1:
        wanted = "several animations" if name is None else f"no animation {name!r}"
        raise UserError(f"{path}: has {wanted}; choose one of {shorten(', '.join(clips), 200, placeholder=' ...')}")
    ((own, clip),) = chosen
    return dataclasses.replace(retarget(clip, up="y"), caption=own.rpartition("|")[2])


def load_npy(path: Path) -> Motion:
    """Returns the motion of a data set's array: joints [T, 22 or 21, 3] or raw features [T, 263 or 251].

    Raises:
        UserError: The file is damaged, or its array does not have one of these shapes.
    """
    array = load_array(path)
    for skeleton in SKELETONS:
        has_features = array.ndim == 2 and array.shape[1] == skeleton.feature_dim
        if not has_features and array.shape[1:] != (skeleton.num_joints, 3):
            continue
        with np.errstate(over="ignore", invalid="ignore"):  # `Motion` reports values that are not finite
            features = array.astype(np.float32) if has_features else None
            positions = array if features is None else positions_from_features(features, skeleton)
            meters = np.asarray(positions, np.float32) * np.float32(skeleton.metres_per_unit)
        try:
            return Motion(positions=meters, fps=skeleton.fps, skeleton=skeleton, features=features)
        except UserError as error:
            raise UserError(f"{path}: {error}") from error
    known = " or ".join(f"[T, {skeleton.num_joints}, 3], [T, {skeleton.feature_dim}]" for skeleton in SKELETONS)
    raise UserError(f"{path}: an array of shape {list(array.shape)} is not a motion; it needs {known}")
