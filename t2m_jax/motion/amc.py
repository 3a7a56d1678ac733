"""Reading Acclaim motion files: a skeleton (`.asf`) and a motion of it (`.amc`), as in the CMU database."""

import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple, cast

import numpy as np
from jaxtyping import Float

from t2m_jax.errors import UserError
from t2m_jax.files.reading import load_text
from t2m_jax.motion.resampling import MAX_FPS
from t2m_jax.motion.rig.clip import MAX_JOINTS, MAX_VALUE, RigClip
from t2m_jax.motion.rig.recognition import in_human_size
from t2m_jax.motion.rotations import EulerOrder, matrix_from_euler

AMC_FPS = 120.0
"""Frames per second of the CMU database. The files do not say it."""
# The published files have lengths in inches times 0.45, which is their `length`.
METERS_PER_INCH = 0.0254
"""An ASF file divides inches by its `length`."""
MIN_UNIT = 1e-4
"""Smallest `length`, with which a bone of length 1 is 254 meters long."""
MAX_BYTES = 2**28
"""The largest file. A frame of 30 bones has about 1 kB, so this is half an hour at 120 frames per second."""
ROOT = "root"
_Line = tuple[str, list[str]]
"""Where a line is, for error messages, and its words."""
_AXES = "xyz"
_RADIANS = {"deg": float(np.deg2rad(1.0)), "rad": 1.0}


class _Bone(NamedTuple):
    """A bone, which begins where its parent ends."""

    offset: Float[np.ndarray, " 3"]
    """From its beginning to its end, in meters."""
    axis: Float[np.ndarray, "3 3"]
    """The frame in which it turns."""
    freedoms: tuple[str, ...]
    """Its columns in the motion: rx, ry, rz, tx, ty or tz."""


class _Skeleton(NamedTuple):
    bones: Mapping[str, _Bone]
    parents: Mapping[str, str]
    """Parent of each bone but the root; parents come first."""
    radians_per_unit: float
    metres_per_unit: float


def load_amc(path: Path | str, *, fps: float = AMC_FPS) -> RigClip:
    """Returns the clip of an AMC file. Joint j of the clip is the beginning of bone j.

    The ASF file says the unit. If no person can have this size, as in files whose lengths are centimeters, the bones
    tell another unit, and `notes` say which.

    Args:
        path: The motion. Its skeleton is the only ASF file in the folder, or `02.asf` for `02_01.amc`.
        fps: Frames per second, which the files do not say.

    Raises:
        UserError: A file is missing or damaged, or they do not fit each other. The message names the line.
    """
    path = Path(path)
    if not 0 < fps <= MAX_FPS:
        raise UserError(f"{path}: {fps} is not a number of frames per second above 0, up to {MAX_FPS:.0f}")
    figure = _read_skeleton(find_skeleton(path))
    names = (ROOT, *figure.parents)
    parents = (-1, *(names.index(parent) for parent in figure.parents.values()))
    # Bones without a line in the motion do not turn.
    values, figure = _read_motion(path, figure)
    num_frames = len(values[ROOT])
    rotations = np.empty((num_frames, len(names), 3, 3), np.float32)
    # A joint is where its bone begins, which is where its parent's bone ends.
    offsets = np.array([figure.bones[names[max(parent, 0)]].offset for parent in parents], np.float32)
    offsets[0] = 0.0
    translations = np.tile(offsets, (num_frames, 1, 1))
    for joint, name in enumerate(names):
        rotations[:, joint], move = _transform(figure.bones[name], values.get(name), figure)
        translations[:, joint] += move
    # Bones without children end in the air, where other formats have an End Site.
    ends = [joint for joint in range(len(names)) if joint not in parents]
    clip = RigClip(
        joint_names=names,
        parents=parents,
        offsets=offsets,
        rotations=rotations,
        translations=translations,
        fps=fps,
        metres_per_unit=figure.metres_per_unit,
        end_sites={joint: figure.bones[names[joint]].offset.astype(np.float32) for joint in ends},
        notes=(f"AMC files do not say their rate; {fps:g} frames per second were assumed",),
    )
    return in_human_size(clip)


def find_skeleton(path: Path) -> Path:
    """Returns the ASF file of an AMC file: the only one in its folder, or the one whose name its name begins with.

    Of several such names, the longest is that of its skeleton.

    Raises:
        UserError: There is none.
    """
    found = sorted(file for file in path.parent.glob("*") if file.suffix.lower() == ".asf")
    fitting = [file for file in found if _begins_with(path.stem, file.stem)]
    longest = max((len(file.stem) for file in fitting), default=0)
    named = [file for file in fitting if len(file.stem) == longest]
    if len(found) != 1 and len(named) != 1:
        problem = "there is no .asf file next to it" if not found else f"no one of {len(found)} .asf files has its name"
        # One wrong choice would give a motion with another person's bones, which nobody would notice.
        raise UserError(f"{path}: {problem}; put the skeleton into its folder, as 02.asf for 02_01.amc")
    return (named if len(named) == 1 else found)[0]


def _begins_with(name: str, start: str) -> bool:
    """Returns whether a name begins with a whole word or number: 10_01 does with 10, waltz1 with waltz, 100_01 not."""
    more = r"\d" if start[-1:].isdigit() else r"[^\W\d_]"
    return re.match(rf"{re.escape(start)}(?!{more})", name, re.IGNORECASE) is not None


def _transform(
    bone: _Bone, values: Float[np.ndarray, "T F"] | None, figure: _Skeleton
) -> tuple[Float[np.ndarray, "#T 3 3"], Float[np.ndarray, "#T 3"]]:
    """Returns how a bone turns and moves in its parent's frame."""
    if values is None:
        return np.eye(3, dtype=np.float32)[None], np.zeros((1, 3), np.float32)
    columns = dict(zip(bone.freedoms, values.T, strict=True))
    missing = np.zeros(len(values))
    turns = [name[1] for name in bone.freedoms if name[0] == "r"]
    # The first angle of the list turns first, so that it is the last factor of the product.
    order = turns[::-1] + [axis for axis in _AXES if axis not in turns]
    angles = np.stack([columns.get(f"r{axis}", missing) for axis in order], axis=1) * figure.radians_per_unit
    turn = bone.axis @ matrix_from_euler(angles, cast(EulerOrder, "".join(order).upper())) @ bone.axis.T
    moves = np.stack([columns.get(f"t{axis}", missing) for axis in _AXES], axis=1) * figure.metres_per_unit
    return turn.astype(np.float32), moves.astype(np.float32)


def _lines(path: Path) -> Iterator[_Line]:
    """Yields the lines of a file that have words, without comments."""
    for number, line in enumerate(load_text(path, max_bytes=MAX_BYTES).split("\n"), start=1):
        if words := line.partition("#")[0].split():
            yield f"{path}:{number}", words


def _fields(lines: Iterable[_Line]) -> dict[str, _Line]:
    """Returns lines by their first words."""
    return {words[0].lower(): (place, words) for place, words in lines}


def _numbers(words: list[str], place: str) -> list[float]:
    try:
        values = [float(word) for word in words]
    except ValueError:
        values = [MAX_VALUE]  # refused below, with the numbers that are too large or NaN
    if not all(abs(value) < MAX_VALUE for value in values):
        raise UserError(f"{place}: {' '.join(words)[:60]!r} are not numbers below {MAX_VALUE:g}")
    return values


def _read_skeleton(path: Path) -> _Skeleton:
    """Returns the figure of an ASF file."""
    # The order of the sections is free, so they are collected first. `:root` and others are words on their own lines.
    sections: dict[str, list[_Line]] = {}
    section = ""
    for place, words in _lines(path):
        if words[0].startswith(":"):
            section = words[0].lower()
        sections.setdefault(section, []).append((place, words))
    missing = [name for name in (":root", ":bonedata", ":hierarchy") if name not in sections]
    if missing:
        raise UserError(f"{path}: is not an ASF file; it has no {' and no '.join(missing)}")
    units = _fields(sections.get(":units", []))
    length = _field(units, "length", 1, ["1.0"])[0]
    if not MIN_UNIT <= length <= 1 / MIN_UNIT:
        raise UserError(f"{units['length'][0]}: length is {length:g}; expected {MIN_UNIT:g} to {1 / MIN_UNIT:g}")
    metres = METERS_PER_INCH / length
    radians = _RADIANS["rad" if units.get("angle", ("", []))[1][1:2] == ["rad"] else "deg"]
    bones = {ROOT: _make_bone(_fields(sections[":root"]), metres=metres, radians=radians, is_root=True)}
    fields: dict[str, _Line] = {}
    for place, words in sections[":bonedata"][1:]:
        if words[0].lower() == "begin":
            fields = {}
        elif words[0].lower() == "end":
            name = " ".join(fields.get("name", (place, ["name"]))[1][1:])
            if not name or name in bones or len(bones) == MAX_JOINTS:
                raise UserError(f"{place}: bone {name!r} has no name, is there twice, or is one of over {MAX_JOINTS:,}")
            bones[name] = _make_bone(fields | {"place": (place, [])}, metres=metres, radians=radians)
        else:
            fields[words[0].lower()] = (place, words)
    return _Skeleton(bones, _read_hierarchy(sections[":hierarchy"][1:], bones), radians, metres)


def _field(fields: Mapping[str, _Line], name: str, count: int, default: list[str]) -> list[float]:
    """Returns the numbers of a field."""
    place, words = fields.get(name, (fields.get("place", ("", []))[0], [name, *default]))
    numbers = _numbers(words[1 : count + 1], place)
    if len(numbers) != count:
        raise UserError(f"{place}: {name} needs {count} numbers, has {len(numbers)}")
    return numbers


def _make_bone(fields: Mapping[str, _Line], *, metres: float, radians: float, is_root: bool = False) -> _Bone:
    """Returns the bone that the fields of its section describe."""
    place, words = fields.get("axis", ("", ["axis", "0", "0", "0", "XYZ"]))
    order = words[-1].upper()
    if sorted(order) != ["X", "Y", "Z"]:
        raise UserError(f"{place}: the order of the axes is {words[-1]!r}; expected such as XYZ")
    # As in the motion, the first axis of the order turns first. The root has its angles in another field.
    angles = np.array(_field(fields, "orientation" if is_root else "axis", 3, ["0", "0", "0"])) * radians
    axis = matrix_from_euler(angles[::-1].copy(), cast(EulerOrder, order[::-1]))
    direction = [0.0, 0.0, 0.0] if is_root else _field(fields, "direction", 3, [])
    length = 0.0 if is_root else _field(fields, "length", 1, [])[0]
    place, words = fields.get("order" if is_root else "dof", (place, [""]))
    freedoms = tuple(word.lower() for word in words[1:] if word.lower() != "l")
    if not set(freedoms) <= {kind + name for kind in "rt" for name in _AXES} or len(set(freedoms)) < len(freedoms):
        raise UserError(f"{place}: {' '.join(words)[:60]!r}: expected rx, ry, rz, tx, ty, tz, each at most once")
    return _Bone(np.array(direction) * length * metres, axis.astype(np.float64), freedoms)


def _read_hierarchy(lines: list[_Line], bones: Mapping[str, _Bone]) -> dict[str, str]:
    """Returns the parent of each bone, parents first."""
    parents: dict[str, str] = {}
    for place, words in lines:
        if len(words) == 1 and words[0].lower() in ("begin", "end"):
            continue
        for child in words[1:]:
            # Parents come first, as clips need them, so a parent that is not known yet is refused.
            if words[0] not in (ROOT, *parents) or child not in bones or child in (ROOT, *parents):
                raise UserError(f"{place}: {words[0]} {child}: a bone is unknown, has two parents, or comes too early")
            parents[child] = words[0]
    return parents


def _read_motion(path: Path, figure: _Skeleton) -> tuple[dict[str, Float[np.ndarray, "T F"]], _Skeleton]:
    """Returns the values of each bone that moves, and the skeleton with their unit of angles."""
    names = {ROOT, *figure.parents}
    frames: list[dict[str, list[float]]] = []
    number = 0
    for place, words in _lines(path):
        if words[0].startswith(":"):
            unit = _RADIANS.get(words[0][1:4].lower(), figure.radians_per_unit)
            figure = figure._replace(radians_per_unit=unit)
            continue
        if len(words) == 1 and re.fullmatch(r"\d{1,9}", words[0]):
            if frames and int(words[0]) != number + 1:
                raise UserError(f"{place}: frame {words[0]} comes after frame {number}; frames are missing or doubled")
            number = int(words[0])
            frames.append({})
            continue
        if not frames or words[0] not in names or words[0] in frames[-1]:
            raise UserError(f"{place}: expected the number of a frame or a bone of the skeleton, not {words[0]!r}")
        frames[-1][words[0]] = _numbers(words[1:], place)
        if len(words) - 1 != (wanted := len(figure.bones[words[0]].freedoms)):
            raise UserError(f"{place}: {words[0]} has {len(words) - 1} values, its skeleton says {wanted}")
    # Every frame must have all bones, because a missing line would shift a motion without a sign of it.
    if not frames or ROOT not in frames[0]:
        raise UserError(f"{path}: has no frames with a root; is it an AMC file?")
    for number, frame in enumerate(frames, start=1):
        if frame.keys() != frames[0].keys():
            raise UserError(f"{path}: frame {number} has other bones than the first one; is the file cut?")
    return {name: np.array([frame[name] for frame in frames]) for name in frames[0]}, figure
