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
from t2m_jax.motion.bvh.writer import UNITS_PER_METER, Units
from t2m_jax.motion.features import bone_vectors
from t2m_jax.motion.glb_file import GlbWriter, Track, check_motions
from t2m_jax.motion.inverse_kinematics import FittedRig, fit_rig
from t2m_jax.motion.kinematics import forward_kinematics, rest_positions
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.rig.rigs import JointNames, rig_joint_names, root_name
from t2m_jax.motion.rotations import quaternion_from_matrix
from t2m_jax.motion.skeleton import HUMANML3D
from t2m_jax.motion.travel import Travel, find_travel

NEAR = 1e-4
"""Meters by which a joint may be away from where the figure's rigid bones lead, before its translation is animated."""

# OpenGL's numbers of an array buffer and an element array buffer.
_VERTICES = 34962
_INDICES = 34963


def save_glb(
    path: Path, motions: Sequence[Motion], *, names: JointNames = "lafan1", units: Units = "m", root_bone: bool = False
) -> None:
    """Writes motions as the animations of one figure, Y up, facing +Z.

    The figure has the bone lengths of the first motion. Where its rigid bones do not lead to the joints of a motion,
    such as at hips and collars, the animation also moves these joints, by millimeters. So all are where the motion has
    them.

    Args:
        path: The file.
        motions: Motions of the 22 HumanML3D joints, at least one.
        names: What the joints are called: as in the rig of that name.
        units: Length of 1. glTF asks for meters; some programs expect centimeters.
        root_bone: Whether a joint on the floor carries the travel (see `find_travel`), and the hips only their sway.

    Raises:
        UserError: There is no motion, or one of another skeleton.
    """
    check_motions(path, motions)
    rigs = [fit_rig(motion.positions, fps=motion.fps) for motion in motions]
    scale = UNITS_PER_METER[units]
    glb = GlbWriter()
    # The reader trusts what is in `extras` only of files with this generator.
    glb.tree["asset"] = {"version": "2.0", "generator": glb.generator, "extras": {"units": units}}
    _add_figure(glb, rigs[0], rig_joint_names(names), scale, root=root_name(names) if root_bone else None)
    for rig, motion in zip(rigs, motions, strict=True):
        travel = find_travel(motion.positions, fps=motion.fps, skeleton=HUMANML3D) if root_bone else None
        glb.add_animation(motion, _tracks(rig, motion, rigs[0], scale, travel))
    glb.save(path)


def save_figure(path: Path) -> None:
    """Writes the figure in its rest pose, with the bone lengths of its skeleton and without an animation."""
    rest = rest_positions(HUMANML3D.offsets, HUMANML3D.parents)
    glb = GlbWriter()
    glb.tree["asset"] = {"version": "2.0", "generator": glb.generator, "extras": {"units": "m"}}
    _add_figure(glb, fit_rig(np.asarray(rest)[None], fps=HUMANML3D.fps), rig_joint_names("lafan1"), 1.0, root=None)
    del glb.tree["animations"]  # glTF forbids an empty list
    glb.save(path)


def _add_figure(glb: GlbWriter, rig: FittedRig, names: Sequence[str], scale: float, *, root: str | None) -> None:
    """Adds the joints, which are the first nodes, the mesh around them, and perhaps a root bone, the last node."""
    rest = standing_rest(rig)
    nodes = joint_nodes(rest, names, scale)
    nodes.append({"name": "Figure", "mesh": 0, "skin": 0})
    inverse = np.tile(np.eye(4, dtype=np.float32), (len(names), 1, 1))
    inverse[:, 3, :3] = -scale * rest  # columns one after another, as glTF stores matrices
    joints, top = list(range(len(names))), 0
    if root is not None:
        top = len(nodes)
        nodes.append({"name": root, "children": [0]})
        joints.append(top)  # no vertex follows it, but programs take only the joints of a skin as bones
        inverse = np.concatenate([inverse, np.eye(4, dtype=np.float32)[None]])
    parts = make_skin(rest, HUMANML3D)
    glb.tree |= {
        "scene": 0,
        "scenes": [{"nodes": [top, len(names)]}],
        "nodes": nodes,
        "skins": [{"joints": joints, "skeleton": top, "inverseBindMatrices": glb.add(inverse)}],
        "materials": [_material(part.tint) for part in parts],
        "meshes": [{"name": "Figure", "primitives": [_primitive(glb, part, k, scale) for k, part in enumerate(parts)]}],
    }


def standing_rest(rig: FittedRig) -> Float[np.ndarray, "J 3"]:
    """Returns the joints of a figure in its rest pose, with the lowest ones on the floor."""
    rest = rest_positions(rig.offsets, HUMANML3D.parents).astype(np.float64)
    rest[:, 1] -= rest[:, 1].min()
    return rest


def joint_nodes(rest: Float[np.ndarray, "J 3"], names: Sequence[str], scale: float = 1.0) -> list[dict[str, Any]]:
    """Returns a node for each joint, in their order."""
    nodes: list[dict[str, Any]] = []
    for joint, name in enumerate(names):
        offset = rest[joint] - (rest[HUMANML3D.parents[joint]] if joint else 0)
        children = HUMANML3D.children(joint)
        node = {"name": name, "translation": (scale * offset).astype(np.float32).tolist()}
        nodes.append(node | ({"children": list(children)} if children else {}))
    return nodes


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


def joint_places(rig: FittedRig, motion: Motion) -> Float[np.ndarray, "T J 3"]:
    """Returns the place of each joint in its parent's frame with which all joints are where the motion has them."""
    turned = np.asarray(forward_kinematics(rig.rotations, rig.translations, HUMANML3D.parents).rotations)
    parents = np.array(HUMANML3D.parents[1:])
    bones = bone_vectors(motion.positions, HUMANML3D)
    local = np.einsum("tjba,tjb->tja", turned[:, parents], bones)
    return np.concatenate([motion.positions[:, :1], local], axis=1)


def _tracks(rig: FittedRig, motion: Motion, figure: FittedRig, scale: float, travel: Travel | None) -> list[Track]:
    """Returns the animation of the figure for a motion."""
    quaternions = quaternion_from_matrix(rig.rotations)
    places = joint_places(rig, motion)
    tracks = []
    if travel is not None:
        root = places.shape[1] + 1  # after the joints and the mesh
        tracks = [Track(root, "translation", scale * travel.places), Track.of_rotation(root, travel.turns)]
        places[:, 0] = travel.local_places(places[:, 0])
        quaternions[:, 0] = travel.local_turns(quaternions[:, 0])
    tracks.append(Track(0, "translation", scale * places[:, 0]))
    for joint in range(quaternions.shape[1]):
        tracks.append(Track.of_rotation(joint, quaternions[:, joint]))
        # Other joints move only if bones are not rigid; a track of each would add three quarters to the animation.
        if joint and leaves_bone(places[:, joint], figure.offsets[joint]):
            tracks.append(Track(joint, "translation", scale * places[:, joint]))
    return tracks


def leaves_bone(places: Float[np.ndarray, "T 3"], offset: Float[np.ndarray, "3"]) -> bool:
    """Returns whether a joint is not where the rigid bone above it leads."""
    return bool(np.abs(places - offset).max() > NEAR)
