"""Motion files for download, and what the page shows of a user's file.

All of it runs in a process of its own (see `app`): files of strangers are read there, not where motions are generated.
"""

import base64
import contextlib
import dataclasses
import io
import json
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple, cast

from t2m_jax.errors import UserError
from t2m_jax.export.html import scene_record
from t2m_jax.export.npz import write_npz
from t2m_jax.motion.changes import Changes
from t2m_jax.motion.character import load_character
from t2m_jax.motion.formats import load_motion, save_motions
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.rig.rigs import RIGS
from t2m_jax.motion.targets import Target, distances
from t2m_jax.serving import answers, schema
from t2m_jax.serving.priority import lower_priority

LONGEST_PICTURES = 4 * schema.LIMITS["seconds"]["le"]
"""Seconds of all motions in a video; it takes as long to make."""


MAX_FRAMES = int(schema.MAX_TOTAL_SECONDS * schema.LIMITS["fps"]["le"])
"""Of a motion, as read and as changed."""
MAX_MEMORY = 2 * 2**30
"""Bytes that the process may use for its data."""


TABLE = "rig.yaml"
"""Name of the file with a user's table of joints."""


class Names(NamedTuple):
    """What errors call a user's files, whose names here say nothing to the user."""

    motion: str
    rig: str = "rig"


def apart(function: Callable[..., Any], *args: Any) -> Any:
    """Returns what a function returns; runs in the process of files, and limits its memory and priority.

    Raises:
        UserError: It needs more memory, or the function raised it.
    """
    lower_priority()
    with contextlib.suppress(ModuleNotFoundError):  # Windows has no such limits
        import resource

        hard = resource.getrlimit(resource.RLIMIT_DATA)[1]
        most = MAX_MEMORY if hard == resource.RLIM_INFINITY else min(MAX_MEMORY, hard)
        resource.setrlimit(resource.RLIMIT_DATA, (most, hard))
    try:
        return function(*args)
    except MemoryError:
        raise UserError("the file needs too much memory; give a shorter motion") from None


def make_file(inputs: Sequence[bytes], options: schema.FileOptions) -> bytes:
    """Returns the bytes of a file with motions.

    Args:
        inputs: Bytes of an `.npz` file per motion.
        options: What is done with the motions, and the format.

    Raises:
        UserError: A motion cannot be read, changed or written in this format.
    """
    if not 1 <= len(inputs) <= (schema.MAX_MOTIONS if options.format in schema.SEVERAL else 1):
        raise UserError(f"format: a {options.format} file cannot contain {len(inputs)} motions")
    motions = [_changed(read_motion(data, "npz"), options.changes) for data in inputs]
    if options.format in ("gif", "mp4") and sum(motion.seconds for motion in motions) > LONGEST_PICTURES:
        raise UserError(f"format: a video of more than {LONGEST_PICTURES:g} seconds takes too long; use .glb or .html")
    with motion_file(b"", options.format) as path:
        given = {name: getattr(options, name) for name in ("names", "units", "root_bone", "camera")}
        # Without those that were not given, `save_motions` refuses what the format does not have.
        save_motions(path, motions, **{name: value for name, value in given.items() if value})
        return path.read_bytes()


def open_file(
    data: bytes,
    suffix: str,
    changes: Changes,
    rig: str | None = None,
    names: Names | None = None,
    split: float | None = None,
) -> bytes:
    """Returns what the page shows of a motion file, a `answers.OpenedFile` as JSON. For the rest, see `read_motion`.

    Args:
        data: The file.
        suffix: Its format.
        changes: What is changed.
        rig: Of the file.
        names: Of the user's files.
        split: Seconds of the changed motion at which a sentence becomes two.

    Raises:
        UserError: The file cannot be read or changed.
    """
    motion = _changed(read_motion(data, suffix, rig, names), changes)
    if split is not None:
        motion = _split(motion, split)
    scene = cast(answers.SceneData, scene_record([motion]))
    opened: answers.OpenedFile = {"scene": scene, "motion": motion_record(motion)}
    # As JSON, because the server's event loop would stand still while it makes a long text.
    return json.dumps(opened, separators=(",", ":"), allow_nan=False).encode()


def _changed(motion: Motion, changes: Changes) -> Motion:
    """Returns the changed motion.

    Raises:
        UserError: A change does not fit the motion, or the result would be too long.
    """
    end = motion.seconds if changes.end is None else min(changes.end, motion.seconds)
    seconds = (end - min(changes.begin or 0.0, end)) / changes.speed
    _check_frames(seconds * (changes.fps or motion.fps), "the changed motion")
    return changes.apply(motion)


def _split(motion: Motion, seconds: float) -> Motion:
    """Returns a motion that says that its sentence begins again at a time.

    Raises:
        UserError: No sentence is in two parts there.
    """
    frame = round(seconds * motion.fps)
    parts = dict(zip(motion.part_starts, motion.part_captions, strict=True)) or {0: motion.caption}
    if not 0 < frame < motion.num_frames or frame in parts:
        raise UserError(f"split: {seconds:g} s is not in a sentence; choose a time between its begin and its end")
    before = max(start for start in parts if start < frame)
    parts = dict(sorted((parts | {frame: parts[before]}).items()))
    return dataclasses.replace(motion, part_starts=tuple(parts), part_captions=tuple(parts.values()))


def _check_frames(frames: float, name: str) -> None:
    """Raises `UserError` if a motion has too many frames, which could fill the memory."""
    if frames > MAX_FRAMES:
        raise UserError(f"{name}: has {frames:,.0f} frames; at most {MAX_FRAMES:,} are allowed")


def read_motion(data: bytes, suffix: str, rig: str | None = None, names: Names | None = None) -> Motion:
    """Returns the motion in the bytes of a file.

    Args:
        data: The file.
        suffix: Its format.
        rig: Name of its rig, or the text of a table; never a path, because users may not read files of the server.
        names: What errors call the two; by default by what they are.

    Raises:
        UserError: There is none, or it is too long.
    """
    with motion_file(data, suffix, names) as path:
        motion = load_motion(path, rig=_rig_name(path, rig))
        if motion.seconds > schema.MAX_TOTAL_SECONDS:  # at another frame rate, it could fill the memory
            most = f"at most {schema.MAX_TOTAL_SECONDS:g} are read"
            raise UserError(f"{path}: has {motion.seconds:g} seconds; {most}")
        _check_frames(motion.num_frames, str(path))
        return motion


def _rig_name(path: Path, rig: str | None) -> str | None:
    """Returns the name of a rig, or the file of a table, which is written beside a user's file."""
    if rig is None or rig in RIGS:
        return rig
    table = path.with_name(TABLE)
    table.write_text(rig, encoding="utf-8")
    return str(table)


def move_character(
    character: bytes, inputs: Sequence[bytes], changes: Changes, rig: str | None = None, names: Names | None = None
) -> bytes:
    """Returns the bytes of a GLB file: a user's character with an animation for each motion.

    Args:
        character: Bytes of a `.glb` or `.vrm` file.
        inputs: Bytes of an `.npz` file per motion.
        changes: What is changed of the motions.
        rig: See `read_motion`.
        names: What errors call the files.

    Raises:
        UserError: A motion or the character cannot be read, or bones were not found.
    """
    motions = [_changed(read_motion(data, "npz"), changes) for data in inputs]
    _check_frames(sum(motion.num_frames for motion in motions), "all motions together")
    with motion_file(character, "vrm", names) as path:
        # Its name begins as that of the character, so errors call it by that, too.
        output = path.with_name(f"{path.name}.glb")
        load_character(path, rig=_rig_name(path, rig)).save(output, motions)
        return output.read_bytes()


def motion_record(motion: Motion, targets: Sequence[Target] = ()) -> answers.MotionData:
    """Returns a motion as plain data for the page, with how far it is from the targets of its request."""
    data = io.BytesIO()
    write_npz(data, motion, compress=False)
    return {
        "caption": motion.caption,
        "seed": motion.seed,
        "fps": motion.fps,
        "frames": motion.num_frames,
        "seconds": motion.seconds,
        "codes": None if motion.codes is None else motion.codes.tolist(),
        "part_starts": list(motion.part_starts),
        "part_captions": list(motion.part_captions),
        "targets": [_target_record(*found) for found in zip(targets, distances(motion, targets), strict=True)],
        "npz": base64.b64encode(data.getvalue()).decode("ascii"),
    }


def _target_record(target: Target, far: float) -> answers.TargetData:
    return {"name": target.name, "distance": far, "unit": target.unit, "met": target.is_met(far)}


@contextmanager
def motion_file(data: bytes, suffix: str, names: Names | None = None) -> Iterator[Path]:
    """Writes a motion of a user into a file, whose name the user does not choose; it is deleted after the block.

    Errors of the block do not say where the file was.
    """
    names = names or Names(f"motion.{suffix}")
    with tempfile.TemporaryDirectory(prefix="t2m-") as folder:
        path = Path(folder) / f"motion.{suffix}"
        path.write_bytes(data)
        try:
            yield path
        except UserError as error:
            text = str(error).replace(str(path.with_name(TABLE)), names.rig).replace(str(path), names.motion)
            raise UserError(text) from None
