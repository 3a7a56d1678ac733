"""The two chunks of a GLB file (glTF 2.0 in one binary file): a tree in JSON, and the numbers of its arrays."""

import contextlib
import itertools
import json
import struct
from collections.abc import Container, Iterator, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from t2m_jax.errors import UserError
from t2m_jax.files.reading import first_line, parse_json
from t2m_jax.files.writing import atomic_file
from t2m_jax.motion.formats import MAX_FRAMES
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.rotations import continuous_quaternions
from t2m_jax.motion.skeleton import HUMANML3D

# The bytes "glTF", "JSON" and "BIN" as little-endian numbers.
MAGIC = 0x46546C67
JSON_CHUNK = 0x4E4F534A
BINARY_CHUNK = 0x004E4942
_HEADER = 12

_KINDS = {np.dtype("<f4"): 5126, np.dtype("<u2"): 5123, np.dtype("<u4"): 5125, np.dtype("u1"): 5121}
_TYPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
_COLUMNS = {name: columns for columns, name in _TYPES.items()}
# NumPy's types of the numbers that are read, by the numbers of OpenGL.
_NUMBERS = {5120: np.int8, 5121: np.uint8, 5122: np.int16, 5123: np.uint16, 5125: np.uint32, 5126: np.float32}


class GlbChunks(NamedTuple):
    """What is in a file."""

    tree: Mapping[str, Any]
    binary: bytes
    others: bytes = b""
    """Further chunks, each with its header."""


class Track(NamedTuple):
    """The values of one property of a node in an animation."""

    node: int
    path: str
    values: Float[np.ndarray, "T C"]

    @classmethod
    def of_rotation(cls, node: int, quaternions: Float[np.ndarray, "T 4"]) -> "Track":
        """Returns a track of rotations as quaternions with w first, which glTF has last."""
        return cls(node, "rotation", continuous_quaternions(quaternions)[:, [1, 2, 3, 0]])


@contextlib.contextmanager
def reading_glb(path: Path) -> Iterator[None]:
    """Turns all errors of a block that works on the content of a file into a `UserError` that names it."""
    try:
        yield
    except UserError as error:
        raise UserError(f"{path}: {error}") from error
    except Exception as error:  # a file may say anything, and each part of it has errors of its own
        raise UserError(f"{path}: is not a correct GLB file ({first_line(error)})") from error


def split_chunks(data: bytes) -> GlbChunks:
    """Returns the chunks of a GLB file. For `reading_glb`, because all errors may come out."""
    if len(data) < _HEADER + 8 or struct.unpack_from("<I", data)[0] != MAGIC:
        raise UserError("is not a GLB file; export as glTF binary (.glb)")
    chunks: dict[int, bytes] = {}
    others = b""
    start = _HEADER
    while start + 8 <= len(data):
        size, kind = struct.unpack_from("<II", data, start)
        end = start + 8 + size
        if kind in chunks or kind not in (JSON_CHUNK, BINARY_CHUNK):
            others += data[start:end]
        else:
            chunks[kind] = data[start + 8 : end]
        start = end
    tree = parse_json(chunks[JSON_CHUNK].decode())
    if not isinstance(tree, dict):
        raise ValueError("its JSON is not an object")
    return GlbChunks(tree, chunks.get(BINARY_CHUNK, b""), others)


def read_accessor(glb: GlbChunks, number: int) -> Float[np.ndarray, "N C"]:
    """Returns the numbers of an accessor; integers are shares of their largest value, as rotations may be stored."""
    accessor = glb.tree["accessors"][number]
    shape = (accessor["count"], _COLUMNS[accessor["type"]])
    dtype = np.dtype(_NUMBERS[accessor["componentType"]])
    # Without a place, all are zeros. A sparse accessor lists the rows that differ.
    values = _stored(glb, accessor, dtype, shape) if "bufferView" in accessor else _zeros(dtype, shape)
    if "sparse" in accessor:
        count, indices, replaced = (accessor["sparse"][name] for name in ("count", "indices", "values"))
        rows = _stored(glb, indices, np.dtype(_NUMBERS[indices["componentType"]]), (count, 1))[:, 0]
        values = values.copy()
        values[rows] = _stored(glb, replaced, dtype, (count, shape[1]))
    scale = 1.0 if dtype.kind == "f" else 1.0 / int(np.iinfo(str(dtype)).max)
    return np.maximum(values * scale, -1.0) if dtype.kind == "i" else values * scale


def _zeros(dtype: np.dtype, shape: tuple[int, int]) -> np.ndarray:
    if not 0 <= shape[0] <= MAX_FRAMES:
        raise ValueError(f"an accessor has {shape[0]:,} values and no data")
    return np.zeros(shape, dtype)


def _stored(glb: GlbChunks, place: Mapping[str, Any], dtype: np.dtype, shape: tuple[int, int]) -> np.ndarray:
    """Returns numbers as they are stored in a buffer view."""
    view = glb.tree["bufferViews"][place["bufferView"]]
    if view.get("extensions"):
        raise UserError(f"its data are compressed ({min(view['extensions'])}), which is not read; export without it")
    if view["buffer"] or "uri" in glb.tree["buffers"][0]:
        raise UserError("its data are in another file; export everything into one .glb")
    count, columns = shape
    start = view.get("byteOffset", 0) + place.get("byteOffset", 0)
    # A stride is how vertices are mixed with other data; keys of animations are not. `frombuffer` takes -1 as "all".
    if min(start, count) < 0 or view.get("byteStride", columns * dtype.itemsize) != columns * dtype.itemsize:
        raise ValueError("an accessor's place is not supported")
    return np.frombuffer(glb.binary, dtype, count=count * columns, offset=start).reshape(shape)


def own_extra(tree: Mapping[str, Any], part: Mapping[str, Any], name: str) -> Any:
    """Returns what this package noted at a part of a file; None for notes of other programs, which may differ."""
    extras = part.get("extras")
    if not isinstance(extras, dict):
        return None
    # An animation that was added to the file of another program says by itself who wrote it.
    program = extras.get("generator", tree.get("asset", {}).get("generator"))
    return extras.get(name) if isinstance(program, str) and program.startswith("t2m_jax ") else None


def check_motions(path: Path, motions: Sequence[Motion]) -> None:
    """Raises `UserError` if motions cannot be the animations of a file: there are none, or of another skeleton."""
    if not motions:
        raise UserError(f"{path}: there is no motion to write; give at least one")
    other = [motion.skeleton.name for motion in motions if motion.skeleton.joint_names != HUMANML3D.joint_names]
    if other:
        kind = path.suffix[1:].upper()
        raise UserError(f"{path}: {kind} files are written for the skeleton {HUMANML3D.name}, not {other[0]}")


def free_name(name: str, taken: Container[str], mark: str = " ", *, first: int) -> str:
    """Returns a name or, if it is taken, the name with the mark and the first number from `first` on that is free."""
    numbered = (f"{name}{mark}{number}" for number in itertools.count(first))
    return next(one for one in itertools.chain([name], numbered) if one not in taken)


class GlbWriter:
    """Collects the JSON tree and the binary data of a file."""

    def __init__(self, chunks: GlbChunks | None = None) -> None:
        """Begins with what a file has already; its bytes and numbers stay as they are."""
        old = chunks or GlbChunks({}, b"")
        self.binary = bytearray(old.binary)
        self.binary += b"\0" * (-len(old.binary) % 4)
        self.others = old.others
        self.tree: dict[str, Any] = dict(old.tree)
        for name in ("bufferViews", "accessors", "animations"):
            self.tree[name] = [*self.tree.get(name, ())]
        self.generator = f"t2m_jax {version('t2m-jax')}"

    def add(self, values: Any, kind: str = "<f4", *, target: int | None = None, **fields: Any) -> int:
        """Adds an array and returns the number of its accessor. Floats get their extremes, as glTF asks of some."""
        array = np.ascontiguousarray(values, dtype=np.dtype(kind))
        view: dict[str, Any] = {"buffer": 0, "byteOffset": len(self.binary), "byteLength": array.nbytes}
        self.tree["bufferViews"].append(view | ({} if target is None else {"target": target}))
        self.binary += array.tobytes() + b"\0" * (-array.nbytes % 4)
        rows = array.reshape(len(array), -1)
        if kind == "<f4":
            fields |= {"min": rows.min(axis=0).tolist(), "max": rows.max(axis=0).tolist()}
        accessor = {"bufferView": len(self.tree["bufferViews"]) - 1, "componentType": _KINDS[array.dtype]}
        self.tree["accessors"].append(accessor | {"count": len(rows), "type": _TYPES[rows.shape[1]], **fields})
        return len(self.tree["accessors"]) - 1

    def add_animation(self, motion: Motion, tracks: Sequence[Track], **notes: Any) -> None:
        """Adds an animation with the caption of a motion as its name, and a number if another has this name."""
        number = len(self.tree["animations"]) + 1
        title = motion.caption or "motion"
        taken = {animation.get("name") for animation in self.tree["animations"]}
        extras = notes | {"caption": motion.caption, "fps": motion.fps, "frames": motion.num_frames}
        if self.tree["asset"].get("generator") != self.generator:
            extras["generator"] = self.generator  # a reader must not trust notes of other programs
        if motion.part_starts:
            extras |= {"part_starts": motion.part_starts, "part_captions": motion.part_captions}
        times = self.add(np.arange(motion.num_frames) / motion.fps)
        animation = {
            "name": free_name(title, taken, first=number),
            "channels": [
                {"sampler": sampler, "target": {"node": track.node, "path": track.path}}
                for sampler, track in enumerate(tracks)
            ],
            "samplers": [{"input": times, "output": self.add(track.values)} for track in tracks],
            "extras": extras,
        }
        self.tree["animations"].append(animation)

    def save(self, path: Path) -> None:
        """Writes the file."""
        with atomic_file(path) as partial:
            partial.write_bytes(self.data())

    def data(self) -> bytes:
        """Returns the bytes of the file."""
        first, *more = self.tree.get("buffers", [{}])
        tree = self.tree | {"buffers": [first | {"byteLength": len(self.binary)}, *more]}
        text = json.dumps(tree, ensure_ascii=False, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        chunks = struct.pack("<II", len(text), JSON_CHUNK) + text
        chunks += struct.pack("<II", len(self.binary), BINARY_CHUNK) + self.binary + self.others
        return struct.pack("<III", MAGIC, 2, _HEADER + len(chunks)) + chunks
