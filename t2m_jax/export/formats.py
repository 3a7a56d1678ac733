"""The formats that need only a few lines here: BVH, and what is only read (AMC, GLB's animations, NumPy arrays)."""

import dataclasses
import logging
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from t2m_jax.errors import UserError, naming
from t2m_jax.files.reading import load_array
from t2m_jax.motion.amc import load_amc
from t2m_jax.motion.bvh import load_bvh, save_bvh
from t2m_jax.motion.bvh.writer import Units
from t2m_jax.motion.features import positions_from_features
from t2m_jax.motion.formats import check_motion_output
from t2m_jax.motion.gltf import load_gltf_animation
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.rig import RigClip, retarget
from t2m_jax.motion.rig.orientation import Up, on_floor, sides_note
from t2m_jax.motion.rig.retarget import find_rig, lying_note, resolve_rig
from t2m_jax.motion.rig.rigs import JointNames, Rig
from t2m_jax.motion.skeleton import SKELETONS

logger = logging.getLogger(__name__)


def only_motion(path: Path, motions: Sequence[Motion]) -> Motion:
    """Returns the only motion of `motions`, for formats that contain one.

    Raises:
        UserError: There is more than one motion, or none.
    """
    check_motion_output(path, num_motions=len(motions))
    return motions[0]


def save_bvh_file(
    path: Path, motions: Sequence[Motion], *, names: JointNames = "lafan1", units: Units = "m", root_bone: bool = False
) -> None:
    """Writes one motion as a BVH file; see `save_bvh`."""
    save_bvh(path, only_motion(path, motions), names=names, units=units, root_bone=root_bone)


def load_bvh_file(path: Path, *, rig: str | None = None, up: Up = "auto") -> Motion:
    """Returns the motion of a BVH file; see `load_bvh`.

    Args:
        path: The file.
        rig: Name of a rig or a YAML table; by default the joints are recognized (see `find_rig`).
        up: The axis that points up; by default the one along which the figure stands.

    Raises:
        UserError: The file is damaged, does not show a person, or may have either axis up.
    """
    table = None if rig is None else resolve_rig(rig)
    return motion_of_clip(path, load_bvh(path, rig=table), rig=table, up=up)


def load_amc_file(path: Path, *, rig: str | None = None, up: Up = "auto") -> Motion:
    """Returns the motion of an AMC file; see `load_amc`. For `rig`, `up` and errors, see `load_bvh_file`."""
    return motion_of_clip(path, load_amc(path), rig=rig, up=up)


def load_glb_file(path: Path, *, animation: str | None = None, rig: str | None = None, up: Up = "y") -> Motion:
    """Returns an animation of a GLB, VRM or VRMA file by its name; see `load_gltf_animation`.

    For `rig`, see `load_bvh_file`. glTF says that Y is up, but some programs write Z up all the same.

    Raises:
        UserError: The file is damaged or does not show a person, there are several animations, or none has this name.
    """
    clip = load_gltf_animation(path, animation)
    return dataclasses.replace(motion_of_clip(path, clip, rig=rig, up=up), caption=clip.caption)


def motion_of_clip(path: Path, clip: RigClip, *, rig: Rig | str | None, up: Up = "auto") -> Motion:
    """Returns the motion of a clip on the floor, and says what had to be assumed."""
    with naming(path):
        found = find_rig(clip, rig)
        motion = retarget(clip, rig=found, up=up)
    lies = lying_note(clip, found) if up == "y" else ""
    for note in filter(None, (*clip.notes, found.note, lies, sides_note(motion.positions))):
        logger.info("%s: %s", path, note)
    return dataclasses.replace(motion, positions=on_floor(motion.positions))


def load_npy(path: Path) -> Motion:
    """Returns the motion of a data set's array: joints [T, 22 or 21, 3] or raw features [T, 263 or 251].

    Raises:
        UserError: The file is damaged, or its array does not have one of these shapes.
    """
    array = load_array(path)
    # The widths differ, so they tell the skeleton and whether these are joints or features.
    for skeleton in SKELETONS:
        has_features = array.ndim == 2 and array.shape[1] == skeleton.feature_dim
        if not has_features and array.shape[1:] != (skeleton.num_joints, 3):
            continue
        with np.errstate(over="ignore", invalid="ignore"):  # `Motion` reports values that are not finite
            features = array.astype(np.float32) if has_features else None
            positions = array if features is None else positions_from_features(features, skeleton)
            meters = np.asarray(positions, np.float32) * np.float32(skeleton.metres_per_unit)
        with naming(path):
            return Motion(positions=meters, fps=skeleton.fps, skeleton=skeleton, features=features)
    known = " or ".join(f"[T, {skeleton.num_joints}, 3], [T, {skeleton.feature_dim}]" for skeleton in SKELETONS)
    raise UserError(f"{path}: an array of shape {list(array.shape)} is not a motion; it needs {known}")
