"""Reading the animations of a GLB file (glTF 2.0 in one binary file) as clips of a hierarchy of joints.

Scales are taken as equal along x, y and z and as constant, which they are in files of people.
"""

import dataclasses
import itertools
import struct
from collections.abc import Callable, Mapping, Sequence, Set
from pathlib import Path
from textwrap import shorten
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from t2m_jax.errors import UserError
from t2m_jax.files.reading import first_line, parse_json, reading
from t2m_jax.motion.gltf_nodes import W_FIRST, Nodes, find_nodes
from t2m_jax.motion.part_captions import checked_parts
from t2m_jax.motion.resampling import MAX_FPS
from t2m_jax.motion.rig.clip import RigClip
from t2m_jax.motion.rig.recognition import in_human_size
from t2m_jax.motion.rotations import matrix_from_quaternion, slerp
from t2m_jax.motion.skeleton import HUMANML3D

MAX_SECONDS = 3600.0
"""A longer animation is taken as an error in the file."""
DENSE_FPS = 60.0
"""Rate to sample keys at, for a filter that makes it lower: lines between keys bend at each key."""
MAX_POSES = 20_000_000
"""Joints times frames of all animations; an hour of 60 joints at 20 frames per second has 4 million."""
# The bytes "glTF", "JSON" and "BIN" as little-endian numbers.
MAGIC = 0x46546C67
JSON_CHUNK = 0x4E4F534A
BINARY_CHUNK = 0x004E4942
# Components of a type and NumPy's types of its numbers, by the numbers of OpenGL. Animations have no others.
_SIZES = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}
_TYPES = {5120: np.int8, 5121: np.uint8, 5122: np.int16, 5123: np.uint16, 5126: np.float32}


class _GlbChunks(NamedTuple):
    tree: Mapping[str, Any]
    binary: bytes


class _Keyframes(NamedTuple):
    """The keys of one property of one node."""

    times: Float[np.ndarray, " K"]
    values: Float[np.ndarray, "K M C"]
    """M is 1, or 3 with cubic splines: tangent before the key, value, tangent after it."""
    interpolation: str


def load_gltf(path: Path | str, *, fps: float | None = None) -> dict[str, RigClip]:
    """Returns the animations of a GLB file by name. Equal names get a number.

    Lengths are in meters, as glTF demands, unless the file says that this package wrote centimeters.

    Args:
        path: The file.
        fps: Frames per second to sample the keys at. By default the rate that this package wrote into the file, and for
            other files 20, after a filter.

    Raises:
        UserError: The file cannot be read, is damaged, or has no joints or no animation.
    """
    return _load(Path(path), fps, list)


def load_gltf_animation(path: Path | str, animation: str | None = None) -> RigClip:
    """Returns one animation of a GLB file; the others are not read.

    Args:
        path: The file.
        animation: Its name or its caption; by default the only one.

    Raises:
        UserError: As for `load_gltf`, or there are several animations, or none has this name.
    """

    def choose(captions: Mapping[str, str]) -> list[str]:
        if animation is not None and animation in captions:  # others may have it as their caption
            return [animation]
        chosen = [title for title, caption in captions.items() if animation in (None, caption)]
        if len(chosen) != 1:
            wanted = "several animations" if animation is None or chosen else f"no animation {animation!r}"
            raise UserError(f"has {wanted}; choose one of {shorten(', '.join(captions), 200, placeholder=' ...')}")
        return chosen

    (clip,) = _load(Path(path), None, choose).values()
    return clip


def _load(path: Path, fps: float | None, choose: Callable[[Mapping[str, str]], list[str]]) -> dict[str, RigClip]:
    """Returns the animations that a function chooses from the captions of all, by name."""
    with reading(path):
        data = path.read_bytes()
    try:
        glb = _split_chunks(data)
        animations = _titles(glb.tree.get("animations", []))
        if not animations:
            raise UserError("has no animation")
        nodes = find_nodes(glb.tree)
        # A length of 1 has another meaning only in files of this package.
        unit = 0.01 if _own_extra(glb.tree, glb.tree.get("asset", {}), "units") == "cm" else 1.0
        nodes = nodes._replace(scales=nodes.scales * unit)
        clips: dict[str, RigClip] = {}
        room = MAX_POSES
        owners = {str(node.get("name")) for node in glb.tree.get("nodes", [])}
        captions = {title: _caption(glb.tree, animation, title, owners) for title, animation in animations.items()}
        for title in choose(captions):
            animation = animations[title]
            with np.errstate(over="ignore", invalid="ignore"):  # what is too large is then found not to be finite
                rate = fps or _own_rate(glb.tree, animation)
                clip = _sample(glb, nodes, animation, fps=rate or DENSE_FPS, room=room)
            clip = in_human_size(clip if rate else clip.resampled(HUMANML3D.fps))
            room -= clip.num_frames * len(nodes.names)
            clips[title] = dataclasses.replace(clip, caption=captions[title])
    except UserError as error:
        raise UserError(f"{path}: {error}") from error
    except Exception as error:  # a file may say anything, and each part of it has errors of its own
        raise UserError(f"{path}: is not a correct GLB file ({first_line(error)})") from error
    return clips


def _titles(animations: Sequence[Mapping[str, Any]]) -> dict[str, Mapping[str, Any]]:
    """Returns animations by names, of which no two are equal."""
    found: dict[str, Mapping[str, Any]] = {}
    for number, animation in enumerate(animations):
        name = str(animation.get("name") or f"animation_{number}")
        found[name if name not in found else f"{name}_{number}"] = animation
    return found


def _caption(tree: Mapping[str, Any], animation: Mapping[str, Any], title: str, owners: Set[str]) -> str:
    """Returns what this package wrote about an animation, or its name without those of nodes (owners) before a `|`."""
    own = _own_extra(tree, animation, "caption")
    if isinstance(own, str):
        return own
    # Blender writes "armature|action"; other text before a `|` is a part of the name.
    *before, last = title.split("|")
    return "|".join([*itertools.dropwhile(owners.__contains__, before), last])


def _own_extra(tree: Mapping[str, Any], part: Mapping[str, Any], name: str) -> Any:
    """Returns what this package noted at a part of a file; None in files of other programs, whose notes may differ."""
    extras = part.get("extras")
    generator = tree.get("asset", {}).get("generator")
    if not (isinstance(extras, dict) and isinstance(generator, str) and generator.startswith("t2m_jax ")):
        return None
    return extras.get(name)


def _own_rate(tree: Mapping[str, Any], animation: Mapping[str, Any]) -> float | None:
    """Returns the frames per second that this package wrote an animation with."""
    rate = _own_extra(tree, animation, "fps")
    return float(rate) if isinstance(rate, (int, float)) and 0 < rate <= MAX_FPS else None


def _split_chunks(data: bytes) -> _GlbChunks:
    """Returns the two chunks of a GLB file."""
    if len(data) < 20 or struct.unpack_from("<I", data)[0] != MAGIC:
        raise UserError("is not a GLB file; export as glTF binary (.glb)")
    chunks: dict[int, bytes] = {}
    start = 12
    while start + 8 <= len(data):
        size, kind = struct.unpack_from("<II", data, start)
        chunks.setdefault(kind, data[start + 8 : start + 8 + size])
        start += 8 + size
    tree = parse_json(chunks[JSON_CHUNK].decode())
    if not isinstance(tree, dict):
        raise ValueError("its JSON is not an object")
    return _GlbChunks(tree, chunks.get(BINARY_CHUNK, b""))


def _sample(glb: _GlbChunks, nodes: Nodes, animation: Mapping[str, Any], *, fps: float, room: int) -> RigClip:
    """Returns one animation at `fps` frames per second, if it has at most `room` poses of joints."""
    tracks: dict[tuple[int, str], _Keyframes] = {}
    for channel in animation["channels"]:
        target = channel["target"]
        sampler = animation["samplers"][channel["sampler"]]
        if target.get("node") in nodes.numbers and target["path"] in ("translation", "rotation"):
            tracks[nodes.numbers[target["node"]], target["path"]] = _read_track(glb, sampler)
    # Tracks may end at different times; those that end earlier keep their last value.
    seconds = max((float(track.times[-1]) for track in tracks.values()), default=0.0)
    if not 0 <= seconds <= MAX_SECONDS:
        raise UserError(f"an animation ends after {seconds:g} seconds; expected at most {MAX_SECONDS:g}")
    # 1e-4 frames, because the time of the last key is a float32 that may be just below a whole frame.
    times = np.arange(int(np.floor(seconds * fps + 1e-4)) + 1) / fps
    if len(times) * len(nodes.names) > room:
        raise UserError(f"its animations have more than {MAX_POSES} poses of joints; split the file")
    translations = np.tile(nodes.translations, (len(times), 1, 1))
    rotations = np.tile(nodes.rotations, (len(times), 1, 1))
    for (joint, kind), track in tracks.items():
        (rotations if kind == "rotation" else translations)[:, joint] = _interpolate(track, times, kind)
    if not (np.isfinite(translations).all() and np.isfinite(rotations).all()):
        raise ValueError("an animation has values that are not finite")
    own = fps == _own_rate(glb.tree, animation)  # at another rate, sentences begin at other frames
    said = [_own_extra(glb.tree, animation, name) if own else () for name in ("part_starts", "part_captions")]
    return RigClip(
        joint_names=nodes.names,
        parents=nodes.parents,
        offsets=(nodes.translations * nodes.scales[:, None]).astype(np.float32),
        rotations=matrix_from_quaternion(rotations.astype(np.float32)),
        translations=(translations * nodes.scales[:, None]).astype(np.float32),
        fps=fps,
        metres_per_unit=1.0,
        is_person=nodes.is_person,
        parts=checked_parts(*said, num_frames=len(times)),
    )


def _read_track(glb: _GlbChunks, sampler: Mapping[str, Any]) -> _Keyframes:
    interpolation = sampler.get("interpolation", "LINEAR")
    times = _read_accessor(glb, sampler["input"])[:, 0]
    values = _read_accessor(glb, sampler["output"])
    per_key = 3 if interpolation == "CUBICSPLINE" else 1
    if values.shape[1] == 4:
        values = values[:, W_FIRST]
    if not (len(times) and len(values) == per_key * len(times) and np.all(np.diff(times) >= 0)):
        raise ValueError("an animation has as many times as it has no values, or times that go back")
    return _Keyframes(times, values.reshape(len(times), per_key, -1), interpolation)


def _read_accessor(glb: _GlbChunks, number: int) -> Float[np.ndarray, "N C"]:
    """Returns the numbers of an accessor; integers are shares of their largest value, as rotations may be stored."""
    accessor = glb.tree["accessors"][number]
    if "sparse" in accessor:
        raise UserError("sparse accessors are not supported")
    view = glb.tree["bufferViews"][accessor["bufferView"]]
    if view["buffer"] or "uri" in glb.tree["buffers"][0]:
        raise UserError("its animations are in another file; export everything into one .glb")
    dtype = np.dtype(_TYPES[accessor["componentType"]])
    columns = _SIZES[accessor["type"]]
    count = accessor["count"]
    start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
    # A stride is how vertices are mixed with other data; keys of animations are not. `frombuffer` takes -1 as "all".
    if min(start, count) < 0 or view.get("byteStride", columns * dtype.itemsize) != columns * dtype.itemsize:
        raise ValueError("an accessor's place is not supported")
    values = np.frombuffer(glb.binary, dtype, count=count * columns, offset=start).reshape(count, columns)
    scale = 1.0 if dtype.kind == "f" else 1.0 / int(np.iinfo(str(dtype)).max)
    return np.maximum(values * scale, -1.0) if dtype.kind == "i" else values * scale


def _interpolate(track: _Keyframes, times: Float[np.ndarray, " T"], kind: str) -> Float[np.ndarray, "T C"]:
    """Returns the values at `times`; before the first key and after the last, theirs (glTF 2.0, appendix C)."""
    keys = track.times
    before = np.clip(np.searchsorted(keys, times, side="right") - 1, 0, len(keys) - 1)
    after = np.minimum(before + 1, len(keys) - 1)
    length = keys[after] - keys[before]
    share = np.clip(np.divide(times - keys[before], length, out=np.zeros_like(times), where=length > 0), 0, 1)
    if track.interpolation == "STEP":
        return track.values[before, 0]
    if track.interpolation == "CUBICSPLINE":
        t = share[:, None]
        # A Hermite spline. Tangents are per second.
        return (
            (2 * t**3 - 3 * t**2 + 1) * track.values[before, 1]
            + (t**3 - 2 * t**2 + t) * (length[:, None] * track.values[before, 2])
            + (3 * t**2 - 2 * t**3) * track.values[after, 1]
            + (t**3 - t**2) * (length[:, None] * track.values[after, 0])
        )
    start = track.values[before, 0]
    end = track.values[after, 0]
    return slerp(start, end, share) if kind == "rotation" else start + (end - start) * share[:, None]
