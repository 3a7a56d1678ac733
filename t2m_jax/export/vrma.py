"""VRM animations (`.vrma`): the bones of a person and how they move, for any VRM avatar; there is no mesh."""

from collections.abc import Sequence
from pathlib import Path

from t2m_jax.export.formats import only_motion
from t2m_jax.export.glb import joint_nodes, joint_places, leaves_bone, standing_rest
from t2m_jax.motion.glb_file import GlbWriter, Track, check_motions
from t2m_jax.motion.inverse_kinematics import fit_rig
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.rig.rigs import rig_joint_names
from t2m_jax.motion.rotations import quaternion_from_matrix

EXTENSION = "VRMC_vrm_animation"


def save_vrma(path: Path, motions: Sequence[Motion]) -> None:
    """Writes one motion as a VRM animation, with a T-pose as rest pose, in meters, Y up, facing +Z.

    Bones of a person only turn, and the hips move, as the specification demands. If a joint leaves its rigid bone by
    millimeters, a node without a meaning for avatars moves it, so that readers of joints find all where they are.

    Args:
        path: The file.
        motions: One motion of the 22 HumanML3D joints.

    Raises:
        UserError: There is not exactly one motion, or it has another skeleton.
    """
    motion = only_motion(path, motions)
    check_motions(path, motions)
    rig = fit_rig(motion.positions, fps=motion.fps)
    places = joint_places(rig, motion)
    turns = quaternion_from_matrix(rig.rotations)
    names = rig_joint_names("vrm")
    nodes = joint_nodes(standing_rest(rig), names)
    tracks = [Track(0, "translation", places[:, 0])]
    for joint in range(len(names)):
        tracks.append(Track.of_rotation(joint, turns[:, joint]))
        if joint and leaves_bone(places[:, joint], rig.offsets[joint]):
            # A node between the bone and its parent, because VRM allows bones no translation.
            (above,) = (node for node in nodes if joint in node.get("children", ()))
            above["children"] = [len(nodes) if child == joint else child for child in above["children"]]
            tracks.append(Track(len(nodes), "translation", places[:, joint]))
            start = nodes[joint].pop("translation")
            nodes.append({"name": f"{names[joint]}_place", "translation": start, "children": [joint]})
    glb = GlbWriter()
    bones = {name: {"node": joint} for joint, name in enumerate(names)}
    glb.tree |= {
        "asset": {"version": "2.0", "generator": glb.generator},
        "extensionsUsed": [EXTENSION],
        "extensions": {EXTENSION: {"specVersion": "1.0", "humanoid": {"humanBones": bones}}},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": nodes,
    }
    glb.add_animation(motion, tracks)
    glb.save(path)
