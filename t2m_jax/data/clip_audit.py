"""Checking the files of one clip: its features, its joints and its captions."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from t2m_jax.data.body_checks import ClipBody, check_body, check_joints, measure_body
from t2m_jax.data.caption_checks import check_captions, check_words
from t2m_jax.data.files import FEATURES, MIN_FRAMES, POSITIONS, TEXTS
from t2m_jax.data.folder import Dataset
from t2m_jax.data.texts import Caption, read_captions
from t2m_jax.errors import UserError
from t2m_jax.files.reading import load_array
from t2m_jax.motion.features import local_positions, positions_from_features
from t2m_jax.motion.motion import MAX_METERS
from t2m_jax.motion.skeleton import Skeleton

MAX_JOINT_SPEED = 30.0
"""Meters per second; no limb moves faster."""
FLOOR_RANGE = (-0.1, 0.5)
"""Height in meters that the lowest joint of a clip may have."""


class AuditedClip(NamedTuple):
    """What was found in the files of one clip."""

    problems: tuple[str, ...]
    num_frames: int
    """0 if the features cannot be read."""
    captions: tuple[Caption, ...]
    body: ClipBody | None
    """None if the features cannot be those of a motion."""


def audit_clip(dataset: Dataset, name: str) -> AuditedClip:
    """Returns the faults of the files of one clip, and what is compared with other clips."""
    problems: list[str] = []
    num_frames = 0
    body = None
    positions = None
    try:
        features = dataset.features(name)
        num_frames = len(features)
        positions, local = _decode(features, dataset.skeleton, path=Path(FEATURES) / f"{name}.npy")
        body = measure_body(features, local, dataset.skeleton)
        faults = _check_positions(positions, fps=dataset.skeleton.fps)
        faults += check_body(features, local, dataset.skeleton)
        problems += [f"{FEATURES}/{name}.npy: {fault}" for fault in faults]
    except UserError as error:
        problems.append(str(error))
    problems += _audit_joints(dataset, name, positions)
    captions: tuple[Caption, ...] = ()
    try:
        captions, broken = read_captions(dataset.folder / TEXTS / f"{name}.txt")
        problems += broken
        # A file in which every line is broken has a message for each; that it has no caption would be one more.
        faults = check_captions(captions, seconds=num_frames / dataset.info.fps) if captions or not broken else []
        # The joints of the other skeleton are mirrored, so its words for sides are not known.
        if body is not None and dataset.skeleton.name == "humanml3d":
            faults += check_words(captions, body)
        problems += [f"{TEXTS}/{name}.txt: {fault}" for fault in faults]
    except UserError as error:
        problems.append(str(error))
    return AuditedClip(tuple(problems), num_frames, captions, body)


def _decode(
    features: Float[np.ndarray, "T D"], skeleton: Skeleton, *, path: Path
) -> tuple[Float[np.ndarray, "T J 3"], Float[np.ndarray, "T J 3"]]:
    """Returns the joints of features in meters, in the coordinates of the world and in facing ones.

    Raises:
        UserError: The features cannot be those of a motion.
    """
    # All later faults would only follow from these.
    if not np.all(np.isfinite(features)):
        raise UserError(f"{path}: has {int(np.sum(~np.isfinite(features)))} values that are NaN or infinite")
    if len(features) < MIN_FRAMES:
        raise UserError(f"{path}: has {len(features)} frames")
    with np.errstate(over="ignore", invalid="ignore"):
        positions = positions_from_features(features, skeleton) * np.float32(skeleton.metres_per_unit)
        local = local_positions(features, skeleton) * np.float32(skeleton.metres_per_unit)
    # Finite but huge features overflow on the way.
    if not (np.all(np.isfinite(positions)) and np.all(np.abs(local) < MAX_METERS)):
        raise UserError(f"{path}: decodes to positions that are not finite")
    return positions, local


def _check_positions(positions: Float[np.ndarray, "T J 3"], *, fps: float) -> list[str]:
    problems = []
    speed = float(np.linalg.norm(np.diff(positions, axis=0), axis=-1).max()) * fps
    if speed > MAX_JOINT_SPEED:
        problems.append(f"a joint moves at {speed:.0f} m/s; frames are missing or the unit is wrong")
    lowest = float(positions[..., 1].min())
    if not FLOOR_RANGE[0] <= lowest <= FLOOR_RANGE[1]:
        problems.append(f"its lowest joint is at {lowest:.2f} m, not on the floor")
    return problems


def _audit_joints(dataset: Dataset, name: str, positions: Float[np.ndarray, "T J 3"] | None) -> list[str]:
    """Returns the faults of the file with the joints of a clip, which a data set need not have."""
    path = dataset.folder / POSITIONS / f"{name}.npy"
    if not path.exists():
        return []
    shape = (dataset.skeleton.num_joints, 3)
    try:
        joints = load_array(path)
    except UserError as error:
        return [str(error)]
    if joints.shape[1:] != shape:
        return [f"{POSITIONS}/{name}.npy: does not have the shape T x {shape[0]} x 3 of its skeleton"]
    if not np.isfinite(joints).all():
        return [f"{POSITIONS}/{name}.npy: has values that are NaN or infinite"]
    if positions is None:
        return []
    meters = joints * dataset.skeleton.metres_per_unit
    return [f"{POSITIONS}/{name}.npy: {fault}" for fault in check_joints(meters, positions)]
