"""Motion files for download, and what a user's file shows; both run in a process of their own (see `app`)."""

import dataclasses
from collections.abc import Sequence
from typing import Any, Literal

from t2m_jax.config import config_from_dict
from t2m_jax.errors import UserError
from t2m_jax.serving.requests import MAX_SECONDS, motion_file

MAX_MOTIONS = 32
"""Motions in one file."""
FORMATS = ("npz", "bvh", "glb", "gif", "mp4", "png", "html")
SEVERAL = ("glb", "html", "mp4", "gif", "png")
"""Formats that can contain several motions."""
JOINT_NAMES = ("lafan1", "humanml3d", "mixamo", "vrm", "unreal")
FPS_CHOICES = (20, 24, 30, 60)
"""Not any number, so that no file is enormous."""
LONGEST_PICTURES = 4 * MAX_SECONDS
"""Seconds of all motions in a video; it takes as long to make."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class FileOptions:
    """How motions are written: the parameters of `POST /files`."""

    format: Literal["npz", "bvh", "glb", "gif", "mp4", "png", "html"] = "npz"
    """The format of the file."""
    fps: Literal[20, 24, 30, 60] | None = None
    """Frames per second; by default those of the motion, and 60 or more for a loop."""
    names: Literal["lafan1", "humanml3d", "mixamo", "vrm", "unreal"] | None = None
    """Names of the joints in BVH and GLB files."""
    units: Literal["m", "cm"] | None = None
    """Units of BVH and GLB files."""
    in_place: bool = False
    """Without travel."""
    loop: bool = False
    """The part that repeats best, closed into a loop."""
    begin: float | None = None
    """Seconds from where the motion is kept."""
    end: float | None = None
    """Seconds up to where the motion is kept."""


def options_from_query(query: dict[str, str]) -> FileOptions:
    """Returns the options in the parameters of an address.

    Raises:
        UserError: A parameter is unknown, or has a value that cannot be used.
    """
    values: dict[str, Any] = dict(query)
    for name, convert in (("fps", int), ("begin", float), ("end", float)):
        if name in values:
            try:
                values[name] = convert(values[name])
            except ValueError:
                raise UserError(f"{name}: {values[name]!r} is not a number") from None
    for name in ("in_place", "loop"):
        if name in values:
            if values[name] not in ("0", "1"):
                raise UserError(f"{name}: {values[name]!r} is not 0 or 1")
            values[name] = values[name] == "1"
    return config_from_dict(FileOptions, values, source="parameters")


def make_file(inputs: Sequence[bytes], options: FileOptions) -> bytes:
    """Returns the bytes of a file with motions.

    Args:
        inputs: Bytes of an `.npz` file per motion.
        options: What is done with the motions, and the format.

    Raises:
        UserError: A motion cannot be read, changed or written in this format.
    """
    from t2m_jax.motion.formats import format_options, save_motions
    from t2m_jax.serving.records import motion_from_data

    if not 1 <= len(inputs) <= (MAX_MOTIONS if options.format in SEVERAL else 1):
        raise UserError(f"format: a {options.format} file cannot contain {len(inputs)} motions")
    motions = [_changed(motion_from_data(data, "npz"), options) for data in inputs]
    if options.format in ("gif", "mp4") and sum(motion.seconds for motion in motions) > LONGEST_PICTURES:
        raise UserError(f"format: a video of more than {LONGEST_PICTURES:g} seconds takes too long; use .glb or .html")
    with motion_file(b"", options.format) as path:
        given = {"names": options.names, "units": options.units}
        known = format_options(path)
        chosen = {name: value for name, value in given.items() if value is not None and name in known}
        save_motions(path, motions, **chosen)
        return path.read_bytes()


def read_scene(data: bytes, suffix: str, options: FileOptions) -> dict[str, Any]:
    """Returns what the page shows of a motion file: its scene, and its motion as `worker.motion_record` gives it.

    Raises:
        UserError: The file cannot be read or changed.
    """
    from t2m_jax.export.html import scene_record
    from t2m_jax.serving.records import motion_from_data, motion_record

    motion = _changed(motion_from_data(data, suffix), options)
    return {"scene": scene_record([motion]), "motion": motion_record(motion)}


def _changed(motion: Any, options: FileOptions) -> Any:
    """Returns a motion as the options ask for, in the order of `t2m view`."""
    from t2m_jax.motion.looping import output_fps

    if options.begin is not None or options.end is not None:
        begin, end = options.begin or 0.0, motion.seconds if options.end is None else options.end
        if not 0 <= begin < end:
            raise UserError(f"begin: {begin:g} is not between 0 and end, {end:g}")
        motion = motion[slice(*(round(min(time, motion.seconds) * motion.fps) for time in (begin, end)))]
    fps = output_fps(motion.fps, asked=options.fps, loop=options.loop)
    if fps != motion.fps:
        motion = motion.resampled(fps)
    if options.loop:
        motion = motion.looped()
    return motion.in_place() if options.in_place else motion
