"""Small GLB files, written here by the rules of glTF 2.0."""

import json
import struct
from pathlib import Path

import numpy as np

COMPONENTS = {"f4": 5126, "i2": 5122, "u1": 5121}


class GlbWriter:
    """Collects nodes and animations and writes one file."""

    def __init__(self):
        self.binary = b""
        self.tree = {"asset": {"version": "2.0"}, "nodes": [], "skins": [{"joints": []}], "animations": []}
        self.tree |= {"accessors": [], "bufferViews": []}

    def joint(self, name, parent=None, *, is_joint=True, **properties):
        """Adds a node and returns its number; the parent is added to it, so children may come first."""
        number = len(self.tree["nodes"])
        self.tree["nodes"].append({"name": name} | properties)
        if parent is not None:
            self.tree["nodes"][parent].setdefault("children", []).append(number)
        if is_joint:
            self.tree["skins"][0]["joints"].append(number)
        return number

    def accessor(self, values, kind="f4"):
        values = np.asarray(values)
        types = {1: "SCALAR", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
        columns = 1 if values.ndim == 1 else values.shape[1]
        data = values.astype(f"<{kind}").tobytes()
        view = {"buffer": 0, "byteOffset": len(self.binary), "byteLength": len(data)}
        self.binary += data + b"\0" * (-len(data) % 4)
        self.tree["bufferViews"].append(view)
        self.tree["accessors"].append(
            {"bufferView": len(self.tree["bufferViews"]) - 1, "componentType": COMPONENTS[kind], "count": len(values)}
            | {"type": types[columns]}
        )
        return len(self.tree["accessors"]) - 1

    def animation(self, name, tracks):
        """Adds an animation; tracks are (node, path, times, values, interpolation, kind of number)."""
        channels, samplers = [], []
        for node, path, times, values, interpolation, kind in tracks:
            samplers.append(
                {"input": self.accessor(times), "output": self.accessor(values, kind), "interpolation": interpolation}
            )
            channels.append({"sampler": len(samplers) - 1, "target": {"node": node, "path": path}})
        self.tree["animations"].append({"name": name, "channels": channels, "samplers": samplers})

    def data(self) -> bytes:
        text = json.dumps(self.tree | {"buffers": [{"byteLength": len(self.binary)}]}).encode()
        text += b" " * (-len(text) % 4)
        chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
        chunks += struct.pack("<II", len(self.binary), 0x004E4942) + self.binary
        return struct.pack("<III", 0x46546C67, 2, 12 + len(chunks)) + chunks

    def save(self, path: Path) -> Path:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(self.data())
        return path


def about_y(degrees):
    """Quaternions x, y, z, w of turns about Y."""
    half = np.deg2rad(np.asarray(degrees, float)) / 2
    return np.stack([0 * half, np.sin(half), 0 * half, np.cos(half)], axis=-1)


def write_person(path: Path, joints: dict, animations: dict[str, float], *, seconds: float = 1.0) -> Path:
    """Writes a figure as GLB whose joints are listed depth first as name: (parent, offset in centimeters).

    Each animation turns the root by an angle in degrees.
    """
    writer, numbers = GlbWriter(), {}
    armature = writer.joint("Armature", is_joint=False, scale=[0.01, 0.01, 0.01])
    for name, (parent, offset) in joints.items():
        numbers[name] = writer.joint(name, numbers.get(parent, armature), translation=list(map(float, offset)))
    for name, degrees in animations.items():
        writer.animation(
            name, [(numbers[next(iter(joints))], "rotation", [0, seconds], about_y([0, degrees]), "LINEAR", "f4")]
        )
    return writer.save(path)


BONES = {
    "Hips": "hips", "Spine": "spine", "Chest": "chest", "Neck": "neck", "Head": "head",
    "UpperLeg_{S}": "{side}UpperLeg", "LowerLeg_{S}": "{side}LowerLeg", "Foot_{S}": "{side}Foot",
    "Toes_{S}": "{side}Toes", "Shoulder_{S}": "{side}Shoulder", "UpperArm_{S}": "{side}UpperArm",
    "LowerArm_{S}": "{side}LowerArm", "Hand_{S}": "{side}Hand",
}  # fmt: skip
"""Joints of Bandai-Namco's rig -> bones of VRM."""


def edited(path: Path, change) -> Path:
    """Changes the JSON of a GLB file."""
    data = path.read_bytes()
    size = struct.unpack_from("<I", data, 12)[0]
    tree = json.loads(data[20 : 20 + size])
    change(tree)
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    rest = struct.pack("<II", len(text), 0x4E4F534A) + text + data[20 + size :]
    path.write_bytes(struct.pack("<III", 0x46546C67, 2, 12 + len(rest)) + rest)
    return path


def name_bones(tree: dict, version: str) -> None:
    """Makes a file of Bandai-Namco's rig a VRM file, whose nodes have names that say nothing."""
    numbers = {node["name"]: number for number, node in enumerate(tree["nodes"])}
    table = {
        theirs.format(side=side): {"node": numbers[ours.format(S=side[:1].upper())]}
        for side in ("left", "right")
        for ours, theirs in BONES.items()
    }
    rows = [{"bone": bone} | place for bone, place in table.items()]
    tree["extensions"] = {version: {"humanoid": {"humanBones": rows if version == "VRM" else table}}}
    tree["extensionsUsed"] = [version]
    for number, node in enumerate(tree["nodes"]):
        node["name"] = f"Tail_{number}"


def glb_with(*, node: dict | None = None, accessor: dict | None = None) -> bytes:
    """Returns a GLB file of one joint whose node and first accessor have some other values."""
    writer = GlbWriter()
    root = writer.joint("Root", **{"translation": [0, 1, 0]} | (node or {}))
    writer.animation("move", [(root, "rotation", [0, 1], about_y([0, 90]), "LINEAR", "f4")])
    writer.tree["accessors"][0] |= accessor or {}
    return writer.data()
