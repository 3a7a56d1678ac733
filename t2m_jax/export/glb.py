"""GLB files (binary glTF 2.0): a skinned figure with a T-pose as rest pose, and an animation per motion."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from PIL import ImageColor

from t2m_jax.export.render.figure import Tint
from t2m_jax.export.render.rendering import TINT_COLORS
from t2m_jax.export.skin import SkinPart, make_skin
from t2m_jax.files.writing import atomic_file
from t2m_jax.motion.bvh.writer import UNITS_PER_METER, Units
from t2m_jax.motion.features import bone_vectors
from t2m_jax.motion.glb_file import GlbWriter, Track, check_motions
from t2m_jax.motion.inverse_kinematics import FittedRig, fit_rig
from t2m_jax.motion.kinematics import forward_kinematics, rest_positions
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.rig.rigs import JointNames, rig_joint_names
from t2m_jax.motion.rotations import quaternion_from_matrix
from t2m_jax.motion.skeleton import HUMANML3D

NEAR = 1e-4
"""Meters by which a joint may be away from where the figure's rigid bones lead, before its translation is animated."""

# OpenGL's numbers of an array buffer and an element array buffer.
_VERTICES = 34962
_INDICES = 34963


def save_glb(path: Path, motions: Sequence[Motion], *, names: JointNames = "lafan1", units: Units = "m") -> None:
    """Writes motions as the animations of one figure, Y up, facing +Z.

    The figure has the bone lengths of the first motion. Where its rigid bones do not lead to the joints of a motion,
    such as at hips and collars, the animation also moves these joints, by millimeters. So all are where the motion has
    them.

    Args:
        path: The file.
        motions: Motions of the 22 HumanML3D joints, at least one.
        names: What the joints are called: as in the rig of that name.
        units: Length of 1. glTF asks for meters; some programs expect centimeters.

    Raises:
        UserError: There is no motion, or one of another skeleton.
    """
    check_motions(path, motions)
    rigs = [fit_rig(motion.positions, fps=motion.fps) for motion in motions]
    scale = UNITS_PER_METER[units]
    glb = GlbWriter()
    # The reader trusts what is in `extras` only of files with this generator.
    glb.tree["asset"] = {"version": "2.0", "generator": glb.generator, "extras": {"units": units}}
    _add_figure(glb, rigs[0], rig_joint_names(names), scale)
    for rig, motion in zip(rigs, motions, strict=True):
        glb.add_animation(motion, _tracks(rig, motion, rigs[0], scale))
    with atomic_file(path) as partial:
        partial.write_bytes(glb.data())


def _add_figure(glb: GlbWriter, rig: FittedRig, names: Sequence[str], scale: float) -> None:
    """Adds the joints, which are the first nodes, and the mesh around them."""
    rest = rest_positions(rig.offsets, HUMANML3D.parents).astype(np.float64)
    rest[:, 1] -= rest[:, 1].min()
    nodes: list[dict[str, Any]] = []
    for joint, name in enumerate(names):
        offset = rest[joint] - (rest[HUMANML3D.parents[joint]] if joint else 0)
        children = HUMANML3D.children(joint)
        node = {"name": name, "translation": (scale * offset).astype(np.float32).tolist()}
        nodes.append(node | ({"children": list(children)} if children else {}))
    nodes.append({"name": "Figure", "mesh": 0, "skin": 0})
    inverse = np.tile(np.eye(4, dtype=np.float32), (len(names), 1, 1))
    inverse[:, 3, :3] = -scale * rest  # columns one after another, as glTF stores matrices
    parts = make_skin(rest, HUMANML3D)
    glb.tree |= {
        "scene": 0,
        "scenes": [{"nodes": [0, len(names)]}],
        "nodes": nodes,
        "skins": [{"joints": list(range(len(names))), "skeleton": 0, "inverseBindMatrices": glb.add(inverse)}],
        "materials": [_material(part.tint) for part in parts],
        "meshes": [{"name": "Figure", "primitives": [_primitive(glb, part, k, scale) for k, part in enumerate(parts)]}],
    }


def _material(tint: Tint) -> dict[str, Any]:
    """Returns the material of a color, decoded with the curve of sRGB."""
    levels = np.array(ImageColor.getrgb(TINT_COLORS[tint])) / 255
    linear = np.where(levels <= 0.04045, levels / 12.92, ((levels + 0.055) / 1.055) ** 2.4)
    surface = {"baseColorFactor": [*linear.round(4).tolist(), 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.8}
    return {"name": tint, "pbrMetallicRoughness": surface}


def _primitive(glb: GlbWriter, part: SkinPart, material: int, scale: float) -> dict[str, Any]:
    """Adds the arrays of a part of the mesh, and returns its description."""
    # A vertex may follow four joints. Here it follows one, with all of its weight.
    joints, weights = np.zeros((2, len(part.joints), 4), np.uint8)
    joints[:, 0] = part.joints
    weights[:, 0] = 255
    attributes = {
        "POSITION": glb.add(scale * part.positions, target=_VERTICES),
        "NORMAL": glb.add(part.normals, target=_VERTICES),
        "JOINTS_0": glb.add(joints, "u1", target=_VERTICES),
        "WEIGHTS_0": glb.add(weights, "u1", target=_VERTICES, normalized=True),
    }
    kind = "<u2" if len(part.joints) < 2**16 else "<u4"
    return {
        "attributes": attributes,
        "indices": glb.add(part.triangles.ravel(), kind, target=_INDICES),
        "material": material,
    }


def _translations(rig: FittedRig, motion: Motion) -> Float[np.ndarray, "T J 3"]:
    """Returns the place of each joint in its parent's frame with which all joints are where the motion has them."""
    turned = np.asarray(forward_kinematics(rig.rotations, rig.translations, HUMANML3D.parents).rotations)
    parents = np.array(HUMANML3D.parents[1:])
    bones = bone_vectors(motion.positions, HUMANML3D)
    local = np.einsum("tjba,tjb->tja", turned[:, parents], bones)
    return np.concatenate([motion.positions[:, :1], local], axis=1)


def _tracks(rig: FittedRig, motion: Motion, figure: FittedRig, scale: float) -> list[Track]:
    """Returns the animation of the figure for a motion."""
    quaternions = quaternion_from_matrix(rig.rotations)
    places = _translations(rig, motion)
    tracks = [Track(0, "translation", scale * places[:, 0])]
    for joint in range(quaternions.shape[1]):
        tracks.append(Track.of_rotation(joint, quaternions[:, joint]))
        # Other joints move only if bones are not rigid; a track of each would add three quarters to the animation.
        if joint and np.abs(places[:, joint] - figure.offsets[joint]).max() > NEAR:
            tracks.append(Track(joint, "translation", scale * places[:, joint]))
    return tracks
