"""Reading the animations of a GLB file (glTF 2.0 in one binary file) as clips of a hierarchy of joints.

Scales are taken as equal along x, y and z and as constant, which they are in files of people.
"""

import json
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from t2m_jax.errors import UserError
from t2m_jax.files.reading import first_line, reading
from t2m_jax.motion.part_captions import checked_parts
from t2m_jax.motion.resampling import MAX_FPS
from t2m_jax.motion.rig.clip import RigClip
from t2m_jax.motion.rotations import matrix_from_quaternion, quaternion_from_matrix, slerp
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
_W_FIRST = [3, 0, 1, 2]
"""glTF's quaternions are x, y, z, w."""


class _GlbChunks(NamedTuple):
    tree: Mapping[str, Any]
    binary: bytes


class _Keyframes(NamedTuple):
    """The keys of one property of one node."""

    times: Float[np.ndarray, " K"]
    values: Float[np.ndarray, "K M C"]
    """M is 1, or 3 with cubic splines: tangent before the key, value, tangent after it."""
    interpolation: str


class _Nodes(NamedTuple):
    """The nodes that move the joints, parents first."""

    names: tuple[str, ...]
    parents: tuple[int, ...]
    numbers: dict[int, int]
    """Number in the file -> place in this table."""
    translations: Float[np.ndarray, "J 3"]
    rotations: Float[np.ndarray, "J 4"]
    scales: Float[np.ndarray, " J"]
    """Of each joint's parent and all nodes above it."""


def load_gltf(path: Path | str, *, fps: float | None = None) -> dict[str, RigClip]:
    """Returns the animations of a GLB file by name. Equal names get a number.

    Lengths are in meters, as glTF demands, unless the file says that this package wrote centimeters.

    Args:
        path: The file.
        fps: Frames per second to sample the keys at. By default the rate that this package wrote into the file, and for
            other files 20, after a filter.

    Raises:
        UserError: The file cannot be read, is damaged, or has no skin or no animation.
    """
    path = Path(path)
    with reading(path):
        data = path.read_bytes()
    try:
        glb = _split_chunks(data)
        nodes = _find_nodes(glb.tree)
        # A length of 1 has another meaning only in files of this package.
        unit = 0.01 if _own_extra(glb.tree, glb.tree.get("asset", {}), "units") == "cm" else 1.0
        nodes = nodes._replace(scales=nodes.scales * unit)
        clips: dict[str, RigClip] = {}
        room = MAX_POSES
        for number, animation in enumerate(glb.tree.get("animations", [])):
            name = str(animation.get("name") or f"animation_{number}")
            with np.errstate(over="ignore", invalid="ignore"):  # what is too large is then found not to be finite
                rate = fps or _own_rate(glb.tree, animation)
                clip = _sample(glb, nodes, animation, fps=rate or DENSE_FPS, room=room)
            clip = clip if rate else clip.resampled(HUMANML3D.fps)
            room -= clip.num_frames * len(nodes.names)
            clips[name if name not in clips else f"{name}_{number}"] = clip
    except UserError as error:
        raise UserError(f"{path}: {error}") from error
    except (LookupError, TypeError, ValueError, AttributeError, struct.error, RecursionError) as error:
        raise UserError(f"{path}: is not a correct GLB file ({first_line(error)})") from error
    if not clips:
        raise UserError(f"{path}: has no animation")
    return clips


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
    tree = json.loads(chunks[JSON_CHUNK])
    if not isinstance(tree, dict):
        raise ValueError("its JSON is not an object")
    return _GlbChunks(tree, chunks.get(BINARY_CHUNK, b""))


def _find_nodes(tree: Mapping[str, Any]) -> _Nodes:
    """Returns the joints of all skins and the nodes above them."""
    nodes = tree.get("nodes", [])
    above = {child: number for number, node in enumerate(nodes) for child in node.get("children", [])}
    wanted = {joint for skin in tree.get("skins", []) for joint in skin["joints"]}
    if not wanted:
        raise UserError("has no skin, so it is not known which of its nodes are joints")
    # From each joint upwards to a node whose depth is known; without recursion, because a file may have any depth.
    depths: dict[int, int] = {}
    for joint in wanted:
        line: list[int] = []
        number: int | None = joint
        while number is not None and number not in depths:
            line.append(number)
            number = above.get(number)
            if len(line) > len(nodes):
                raise ValueError("its nodes are their own parents")
        start = -1 if number is None else depths[number]
        depths |= {below: start + place for place, below in enumerate(reversed(line), start=1)}
    order = sorted(depths, key=lambda number: (depths[number], number))
    numbers = {number: place for place, number in enumerate(order)}
    parents = tuple(numbers[above[number]] if number in above else -1 for number in order)
    poses = [_rest_pose(nodes[number]) for number in order]
    scales = np.ones(len(order))
    for place, parent in enumerate(parents):
        # Parents come first in this order, so their scale is known.
        scales[place] = 1.0 if parent < 0 else scales[parent] * poses[parent][2]
    names = tuple(str(nodes[number].get("name", f"node_{number}")) for number in order)
    translations, rotations, _ = map(np.stack, zip(*poses, strict=True))
    return _Nodes(names, parents, numbers, translations, rotations, scales)


def _rest_pose(node: Mapping[str, Any]) -> tuple[Float[np.ndarray, " 3"], Float[np.ndarray, " 4"], float]:
    """Returns translation, rotation (w first) and scale of a node."""
    if "matrix" in node:
        matrix = np.array(node["matrix"], float).reshape(4, 4).T
        scale = float(np.cbrt(np.linalg.det(matrix[:3, :3])))
        return matrix[:3, 3], quaternion_from_matrix(matrix[:3, :3] / scale).astype(float), scale
    translation = np.array(node.get("translation", (0, 0, 0)), float).reshape(3)
    rotation = np.array(node.get("rotation", (0, 0, 0, 1)), float).reshape(4)[_W_FIRST]
    return translation, rotation, float(np.mean(np.array(node.get("scale", 1), float)))


def _sample(glb: _GlbChunks, nodes: _Nodes, animation: Mapping[str, Any], *, fps: float, room: int) -> RigClip:
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
        parts=checked_parts(*said, num_frames=len(times)),
    )


def _read_track(glb: _GlbChunks, sampler: Mapping[str, Any]) -> _Keyframes:
    interpolation = sampler.get("interpolation", "LINEAR")
    times = _read_accessor(glb, sampler["input"])[:, 0]
    values = _read_accessor(glb, sampler["output"])
    per_key = 3 if interpolation == "CUBICSPLINE" else 1
    if values.shape[1] == 4:
        values = values[:, _W_FIRST]
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
