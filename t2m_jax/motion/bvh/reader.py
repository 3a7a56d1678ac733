"""Reading BVH files with any hierarchy, any channel order and both meanings of position channels."""

import re
from pathlib import Path
from typing import Literal, cast

import numpy as np
from jaxtyping import Float

from t2m_jax.errors import UserError
from t2m_jax.files.reading import reading
from t2m_jax.motion.bvh.channels import parse_motion
from t2m_jax.motion.bvh.hierarchy import AXES, POSITION_CHANNELS, ROTATION_CHANNELS, Hierarchy, parse_hierarchy
from t2m_jax.motion.part_captions import parts_from_note
from t2m_jax.motion.rig.clip import RigClip
from t2m_jax.motion.rotations import EulerOrder, matrix_from_euler

PositionRule = Literal["auto", "absolute", "add"]

# Largest reach of a figure in the file's unit, and the unit in meters that it means. From the first branching joint to
# the farthest leaf, a person measures about 1.2 m, and between 0.5 and 3 m in extreme cases.
_UNITS = ((10.0, 1.0), (300.0, 0.01), (np.inf, 0.001))


MAX_HIERARCHY_BYTES = 4_000_000
"""Longest text before the word MOTION. That of a figure with fingers and face has about 100 kB."""


def load_bvh(
    path: Path | str, *, metres_per_unit: float | None = None, root_positions: PositionRule = "auto"
) -> RigClip:
    """Returns the clip of a BVH file.

    Args:
        path: A BVH file with one figure.
        metres_per_unit: Length of the file's unit in meters. By default the unit is meters, centimeters or
            millimeters, whichever makes the figure as large as a person.
        root_positions: "absolute" if position channels replace OFFSET, "add" if they are added to it. By default
            "absolute" if the channels of the inner joints repeat their OFFSET, and otherwise "add".

    Raises:
        UserError: The file cannot be read, or is not correct. The message names the line.
    """
    path = Path(path)
    with reading(path):
        data = path.read_bytes().removeprefix(b"\xef\xbb\xbf")
    if not data.strip():
        raise UserError(f"{path}:1: the file is empty")
    if b"\0" in data[:4096] or not re.match(rb"\s*HIERARCHY\b", data, flags=re.IGNORECASE):
        start = data.lstrip()[:12].decode("utf-8", errors="replace")
        raise UserError(f"{path}:1: not a BVH file: it starts with {start!r} instead of HIERARCHY")
    # Only the hierarchy becomes text: the numbers are the larger part, and NumPy parses bytes.
    word = re.search(rb"^[ \t]*MOTION[ \t\r]*$\n?", data, flags=re.IGNORECASE | re.MULTILINE)
    head = data[: word.start()] if word else data
    if len(head) > MAX_HIERARCHY_BYTES:
        raise UserError(f"{path}: its hierarchy has {len(head):,} bytes, more than {MAX_HIERARCHY_BYTES:,}")
    lines = head.decode("utf-8", errors="replace").split("\n")
    hierarchy = parse_hierarchy(lines, path)
    if not word:
        raise UserError(f"{path}:{len(lines)}: the file has no MOTION section")
    first_line = head.count(b"\n") + 2
    table = parse_motion(data[word.end() :], path, first_line=first_line, num_channels=hierarchy.num_channels)
    translations = _translations(hierarchy, table.values, rule=root_positions)
    if metres_per_unit is None:
        metres_per_unit = _guess_unit(hierarchy, translations)
    return RigClip(
        joint_names=hierarchy.joint_names,
        parents=hierarchy.parents,
        offsets=(hierarchy.offsets * metres_per_unit).astype(np.float32),
        rotations=_rotations(hierarchy, table.values),
        translations=(translations * metres_per_unit).astype(np.float32),
        fps=table.fps,
        metres_per_unit=metres_per_unit,
        end_sites={
            joint: np.array(offset, np.float32) * metres_per_unit for joint, offset in hierarchy.end_sites.items()
        },
        parts=parts_from_note(hierarchy.note, num_frames=len(table.values)),
    )


def _columns(hierarchy: Hierarchy) -> list[dict[str, int]]:
    """Returns the table column of each channel, one dictionary per joint."""
    result = []
    column = 0
    for names in hierarchy.channels:
        result.append({name: column + i for i, name in enumerate(names)})
        column += len(names)
    return result


def _rotations(hierarchy: Hierarchy, values: Float[np.ndarray, "T C"]) -> Float[np.ndarray, "T J 3 3"]:
    """Returns the local rotation matrices. An axis without a channel has the angle 0."""
    result = np.empty((len(values), len(hierarchy.joint_names), 3, 3), dtype=np.float32)
    radians = np.concatenate((np.deg2rad(values), np.zeros((len(values), 1))), axis=1)
    # Joints with the same order of channels are converted together, which is much faster than one by one.
    groups: dict[EulerOrder, list[tuple[int, list[int]]]] = {}
    for joint, columns in enumerate(_columns(hierarchy)):
        named = "".join(name[0] for name in columns if name in ROTATION_CHANNELS)
        order = cast(EulerOrder, named + "".join(axis for axis in AXES if axis not in named))
        picked = [columns[f"{axis}rotation"] if axis in named else values.shape[1] for axis in order]
        groups.setdefault(order, []).append((joint, picked))
    for order, members in groups.items():
        joints = [joint for joint, _ in members]
        result[:, joints] = matrix_from_euler(radians[:, np.array([picked for _, picked in members])], order)
    return result


def _translations(
    hierarchy: Hierarchy, values: Float[np.ndarray, "T C"], *, rule: PositionRule
) -> Float[np.ndarray, "T J 3"]:
    """Returns the local position of each joint in the file's unit, from OFFSET and position channels."""
    offsets = np.repeat(hierarchy.offsets[None], len(values), axis=0)
    moving = np.zeros(hierarchy.offsets.shape, dtype=bool)
    channels = np.zeros_like(offsets)
    for joint, columns in enumerate(_columns(hierarchy)):
        for axis, name in enumerate(POSITION_CHANNELS):
            if name in columns:
                moving[joint, axis] = True
                channels[:, joint, axis] = values[:, columns[name]]
    inner = moving.all(axis=1) & (np.array(hierarchy.parents) >= 0) & np.any(hierarchy.offsets != 0, axis=1)
    if rule == "auto" and inner.any():
        # The channels repeat the OFFSET if those of most inner joints are nearer to it than to zero.
        from_zero = np.linalg.norm(channels[:, inner], axis=-1).mean(axis=0)
        from_offset = np.linalg.norm(channels[:, inner] - hierarchy.offsets[inner], axis=-1).mean(axis=0)
        rule = "absolute" if np.median(from_offset - from_zero) < 0 else "add"
    return np.where(moving, channels, offsets) if rule == "absolute" else offsets + channels


def _guess_unit(hierarchy: Hierarchy, translations: Float[np.ndarray, "T J 3"]) -> float:
    """Returns meters per unit, from the reach of the figure.

    The reach is measured from the first joint with two children, because the bones above it may be a position in a
    studio.
    """
    lengths = np.median(np.linalg.norm(translations, axis=-1), axis=0)
    children = np.bincount([parent for parent in hierarchy.parents if parent >= 0], minlength=len(lengths))
    start = int(np.argmax(children > 1))
    reach = np.full(len(lengths), -np.inf)
    reach[start] = 0.0
    for joint in range(start + 1, len(lengths)):
        reach[joint] = reach[hierarchy.parents[joint]] + lengths[joint]
    return next(meters for limit, meters in _UNITS if reach.max() < limit)
