"""Reading BVH files with any hierarchy, any channel order and both meanings of position channels."""

import contextlib
import re
from pathlib import Path
from typing import cast

import numpy as np
from jaxtyping import Bool, Float

from t2m_jax.errors import UserError
from t2m_jax.files.reading import load_bytes
from t2m_jax.motion.bvh.channels import parse_motion
from t2m_jax.motion.bvh.hierarchy import AXES, POSITION_CHANNELS, ROTATION_CHANNELS, Hierarchy, parse_hierarchy
from t2m_jax.motion.bvh.offsets import PositionRule, translations_from_channels, trunk_of
from t2m_jax.motion.kinematics import line_to
from t2m_jax.motion.part_captions import parts_from_note
from t2m_jax.motion.rig.clip import RigClip
from t2m_jax.motion.rig.recognition import measure_leg, unit_from_leg
from t2m_jax.motion.rig.rigs import Rig
from t2m_jax.motion.rotations import EulerOrder, matrix_from_euler

# Largest reach of a figure without known legs in the file's unit, and the unit in meters that it means. From the first
# branching joint to the farthest leaf, a person measures about 1.2 m, and between 0.5 and 3 m in extreme cases.
_UNITS = ((10.0, 1.0), (300.0, 0.01), (np.inf, 0.001))


LARGEST_RADIANS = 3.2
"""Angles of a file in radians are at most pi, and one of somebody who walks is more than that many degrees."""
SMALLEST_ANGLE = 0.3
"""A figure that only slides has smaller angles, whatever their unit is."""
TRAVEL = 1.0
"""Meters that the root of somebody who walks travels."""
MAX_HIERARCHY_BYTES = 4_000_000
"""Longest text before the word MOTION. That of a figure with fingers and face has about 100 kB."""


def load_bvh(
    path: Path | str,
    *,
    metres_per_unit: float | None = None,
    root_positions: PositionRule = "auto",
    rig: Rig | None = None,
) -> RigClip:
    """Returns the clip of a BVH file.

    Args:
        path: A BVH file with one figure.
        metres_per_unit: Length of the file's unit in meters. By default the unit that makes the figure as large as a
            person; `notes` of the clip say it, unless it is meters, centimeters or millimeters.
        root_positions: "absolute" if position channels replace OFFSET, "add" if they are added to it. By default
            found from the channels (see `translations_from_channels`).
        rig: The rig whose legs tell the size; by default legs are found as `find_rig` does.

    Raises:
        UserError: The file cannot be read, or is not correct. The message names the line.
    """
    path = Path(path)
    data = _read_bytes(path)
    # Only the hierarchy becomes text: the numbers are the larger part, and NumPy parses bytes.
    word = re.search(rb"^[ \t]*MOTION[ \t\r]*$\n?", data, flags=re.IGNORECASE | re.MULTILINE)
    head = data[: word.start()] if word else data
    if len(head) > MAX_HIERARCHY_BYTES:
        raise UserError(f"{path}: its hierarchy has {len(head):,} bytes, more than {MAX_HIERARCHY_BYTES:,}")
    lines = _decode(head).split("\n")
    hierarchy = parse_hierarchy(lines, path)
    if not word:
        raise UserError(f"{path}:{len(lines)}: the file has no MOTION section")
    first_line = head.count(b"\n") + 2
    values, fps = parse_motion(data[word.end() :], path, first_line=first_line, num_channels=hierarchy.num_channels)
    rotations = _rotations(hierarchy, values)
    channels, moving = _positions(hierarchy, values)
    translations = translations_from_channels(hierarchy, channels, moving, rotations, rule=root_positions)
    unit, said = (metres_per_unit, "") if metres_per_unit else _guess_unit(hierarchy, translations, rig)
    notes = filter(None, (said, _angles_note(hierarchy, values, translations[:, 0] * unit)))
    return RigClip(
        joint_names=hierarchy.joint_names,
        parents=hierarchy.parents,
        offsets=(hierarchy.offsets * unit).astype(np.float32),
        rotations=rotations,
        translations=(translations * unit).astype(np.float32),
        fps=fps,
        metres_per_unit=unit,
        end_sites={joint: np.array(place, np.float32) * unit for joint, place in hierarchy.end_sites.items()},
        notes=tuple(notes),
        parts=parts_from_note(hierarchy.note, num_frames=len(values)),
    )


def _read_bytes(path: Path) -> bytes:
    """Returns what is in a file that begins as BVH files do."""
    data = load_bytes(path).removeprefix(b"\xef\xbb\xbf")
    # Old programs of the Mac end lines with a carriage return alone.
    data = data if b"\n" in data else data.replace(b"\r", b"\n")
    if comments := re.match(rb"(?:\s*(?:#|//)[^\n]*\n)+", data):  # lines stay where they are, for errors
        data = b"\n" * comments[0].count(b"\n") + data[comments.end() :]
    if not data.strip():
        raise UserError(f"{path}:1: the file is empty")
    if b"\0" in data[:4096] or not re.match(rb"\s*HIERARCHY\b", data, flags=re.IGNORECASE):
        start = data.lstrip()[:12].decode("utf-8", errors="replace")
        raise UserError(f"{path}:1: not a BVH file: it starts with {start!r} instead of HIERARCHY")
    return data


def _decode(text: bytes) -> str:
    """Returns text in UTF-8, or in what old programs write: Shift JIS, GBK or Latin 1, which has all bytes."""
    # Common characters have such bytes in Shift JIS, and not in GBK. Latin 1 has single letters that are not ASCII.
    asian = ("cp932", "gb18030") if re.search(rb"[\x80-\xa0]", text) else ("gb18030", "cp932")
    for encoding in ("utf-8", *(asian if re.search(rb"[\x80-\xff]{2}", text) else ())):
        with contextlib.suppress(UnicodeDecodeError):
            return text.decode(encoding)
    return text.decode("latin-1")


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


def _angles_note(hierarchy: Hierarchy, values: Float[np.ndarray, "T C"], root: Float[np.ndarray, "T 3"]) -> str:
    """Returns what to say if angles seem to be radians: somebody gets ahead, and no joint turns by more than 3.2."""
    turns = [name in ROTATION_CHANNELS for names in hierarchy.channels for name in names]
    largest = np.abs(values[:, turns]).max(initial=0.0)
    if not (SMALLEST_ANGLE < largest <= LARGEST_RADIANS and np.ptp(root, axis=0).max() > TRAVEL):
        return ""
    return f"angles are read as degrees, as in all BVH files; none is larger than {largest:.2g}, so they may be radians"


def _positions(
    hierarchy: Hierarchy, values: Float[np.ndarray, "T C"]
) -> tuple[Float[np.ndarray, "T J 3"], Bool[np.ndarray, "J 3"]]:
    """Returns the values of the position channels, and which joints and axes have one."""
    places = [columns.get(name, -1) for columns in _columns(hierarchy) for name in POSITION_CHANNELS]
    picked = np.reshape(places, hierarchy.offsets.shape)
    moving = picked >= 0
    channels = values[:, picked]
    channels[:, ~moving] = 0.0
    return channels, moving


def _guess_unit(hierarchy: Hierarchy, translations: Float[np.ndarray, "T J 3"], rig: Rig | None) -> tuple[float, str]:
    """Returns meters per unit and what to say of it, from the legs of a person or, without legs, from its reach.

    The reach is measured from the first joint with two children, because the bones above it may be a position in a
    studio.
    """
    bones = np.median(translations, axis=0)
    leg = measure_leg(hierarchy.joint_names, hierarchy.parents, bones, rig)
    if leg > 0:
        return unit_from_leg(leg)
    lengths = np.median(np.linalg.norm(translations, axis=-1), axis=0)
    start = trunk_of(hierarchy)[-1]
    lines = [line_to(joint, hierarchy.parents) for joint in range(len(lengths))]
    reach = max(lengths[line[line.index(start) + 1 :]].sum() for line in lines if start in line)
    return next(meters for limit, meters in _UNITS if reach < limit), ""
