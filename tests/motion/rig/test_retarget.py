import dataclasses

import numpy as np
import pytest

from t2m_jax.errors import UserError
from t2m_jax.motion.bvh import load_bvh, save_bvh
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.rig.retarget import retarget
from t2m_jax.motion.rig.rigs import RIGS, find_table, load_rig, make_rig
from t2m_jax.motion.rotations import matrix_from_euler
from t2m_jax.motion.skeleton import HUMANML3D
from tests.motion.figures import INDEX, bvh_text, walking_positions


def limbs(thigh: str, shin: str, foot: str, toe: str, *, pelvis: str) -> dict:
    """Returns both legs, patterns with {S} for L or R."""
    joints = {}
    for side, sign in (("L", 1), ("R", -1)):
        names = [pattern.format(S=side) for pattern in (thigh, shin, foot, toe)]
        offsets = [(9.0 * sign, -5.0, 0.0), (0.0, -40.0, 0.0), (0.0, -42.0, 0.0), (0.0, -6.0, 12.0)]
        for name, parent, offset in zip(names, [pelvis, *names[:3]], offsets, strict=True):
            joints[name] = (parent, offset)
    return joints


def arms(collar: str, shoulder: str, elbow: str, wrist: str, *, chest: str) -> dict:
    joints = {}
    for side, sign in (("L", 1), ("R", -1)):
        names = [pattern.format(S=side) for pattern in (collar, shoulder, elbow, wrist)]
        offsets = [(5.0 * sign, 14.0, 0.0), (12.0 * sign, 0.0, 0.0), (26.0 * sign, 0.0, 0.0), (25.0 * sign, 0.0, 0.0)]
        for name, parent, offset in zip(names, [chest, *names[:3]], offsets, strict=True):
            joints[name] = (parent, offset)
    return joints


BANDAI = (
    {"joint_Root": (None, (0.0, 0.0, 0.0)), "Hips": ("joint_Root", (0.0, 93.0, 0.0))}
    | {"Spine": ("Hips", (0.0, 15.7, 0.0)), "Chest": ("Spine", (0.0, 9.0, 0.0)), "Neck": ("Chest", (0.0, 16.4, 0.0))}
    | {"Head": ("Neck", (0.0, 6.5, 0.0))}
    | arms("Shoulder_{S}", "UpperArm_{S}", "LowerArm_{S}", "Hand_{S}", chest="Chest")
    | limbs("UpperLeg_{S}", "LowerLeg_{S}", "Foot_{S}", "Toes_{S}", pelvis="Hips")
)
ICLONE = (
    {"CC_Base_Hip": (None, (0.0, 93.0, 0.0)), "CC_Base_Waist": ("CC_Base_Hip", (0.0, 8.0, 1.4))}
    | {"CC_Base_Spine01": ("CC_Base_Waist", (0.0, 4.7, 1.7)), "CC_Base_Spine02": ("CC_Base_Spine01", (0.0, 14.7, -1.9))}
    | {"CC_Base_NeckTwist01": ("CC_Base_Spine02", (0.0, 27.4, 0.0)), "CC_Base_Head": ("CC_Base_NeckTwist01", (0, 8, 0))}
    | arms(*(f"CC_Base_{{S}}_{part}" for part in ("Clavicle", "Upperarm", "Forearm", "Hand")), chest="CC_Base_Spine02")
    | limbs(*(f"CC_Base_{{S}}_{part}" for part in ("Thigh", "Calf", "Foot", "ToeBase")), pelvis="CC_Base_Hip")
)


def load_still(tmp_path, joints: dict, **options):
    """Returns the clip of a figure that stands still in its rest pose."""
    path = tmp_path / "still.bvh"
    path.write_text(bvh_text(joints, np.zeros((2, 6 + 3 * (len(joints) - 1))), **options))
    return load_bvh(path)


@pytest.mark.parametrize(("joints", "name"), [(BANDAI, "bandai-namco"), (ICLONE, "cmu-iclone")])
def test_known_rigs_are_detected_and_give_a_person(tmp_path, joints, name):
    clip = load_still(tmp_path, joints)
    assert find_table(clip.joint_names) is RIGS[name]
    motion = retarget(clip)
    assert motion.fps == clip.fps
    pose = motion.positions[0]
    assert pose.shape == (22, 3)
    assert pose[INDEX["left_hip"], 0] > 0 > pose[INDEX["right_hip"], 0]
    assert pose[INDEX["left_wrist"], 0] > 0.5
    spine = pose[[INDEX[joint] for joint in ("pelvis", "spine1", "spine2", "spine3", "neck", "head")]]
    assert np.all(np.diff(spine[:, 1]) > 0.02)
    np.testing.assert_allclose(spine[:, 0], 0, atol=1e-6)
    np.testing.assert_allclose(pose[INDEX["pelvis"]], [0, 0.93, 0], atol=1e-6)
    np.testing.assert_allclose(pose[INDEX["left_foot"]], [0.09, 0, 0.12], atol=1e-6)


def test_missing_spine_joints_share_the_spine_as_in_the_template(tmp_path):
    pose = retarget(load_still(tmp_path, BANDAI)).positions[0]
    chest = 0.157 + 0.09
    lengths = np.cumsum([HUMANML3D.bone_lengths[INDEX[joint]] for joint in ("spine1", "spine2", "spine3")])
    for joint, length in zip(("spine1", "spine2", "spine3"), lengths, strict=True):
        assert pose[INDEX[joint], 1] - 0.93 == pytest.approx(chest * length / lengths[-1], abs=1e-5)


def test_missing_spine_joints_follow_a_bent_spine(tmp_path):
    bent = BANDAI | {"Spine": ("Hips", (0.0, 10.0, 0.0)), "Chest": ("Spine", (0.0, 0.0, 10.0))}
    pose = retarget(load_still(tmp_path, bent)).positions[0] - [0, 0.93, 0]
    np.testing.assert_allclose(pose[INDEX["spine1"]], [0, 0.2 * 0.13157 / 0.33212, 0], atol=1e-5)
    np.testing.assert_allclose(pose[INDEX["spine2"]], [0, 0.1, 0.2 * 0.27476 / 0.33212 - 0.1], atol=1e-5)


def test_our_own_files_come_back_exactly(tmp_path):
    positions = walking_positions()
    path = tmp_path / "walk.bvh"
    save_bvh(path, Motion(positions=positions, fps=20.0))
    motion = retarget(load_bvh(path))
    assert np.linalg.norm(motion.positions - positions, axis=-1).max() < 2e-3
    again = tmp_path / "again.bvh"
    save_bvh(again, motion)
    np.testing.assert_allclose(retarget(load_bvh(again)).positions, motion.positions, atol=1e-4)


def test_mixamo_names_match_with_their_namespace(tmp_path):
    path = tmp_path / "walk.bvh"
    save_bvh(path, Motion(positions=walking_positions(5), fps=20.0))
    expected = retarget(load_bvh(path)).positions
    text = path.read_text().replace("LeftToe", "LeftToeBase").replace("RightToe", "RightToeBase")
    path.write_text(text.replace("ROOT ", "ROOT mixamorig:").replace("JOINT ", "JOINT mixamorig:"))
    np.testing.assert_array_equal(retarget(load_bvh(path)).positions, expected)


USER_TABLE = {
    joint: sources for joint, sources in RIGS["bandai-namco"].sources if "collar" not in joint and joint != "head"
}


def test_a_users_table_may_lack_collars_and_head(tmp_path):
    clip = load_still(tmp_path, BANDAI)
    pose = retarget(clip, rig=USER_TABLE).positions[0]
    collar, shoulder, neck = (pose[INDEX[joint]] for joint in ("left_collar", "left_shoulder", "neck"))
    assert 0.03 < collar[0] < shoulder[0]
    assert collar[1] < neck[1]
    assert pose[INDEX["head"], 1] > neck[1]


def test_a_users_table_is_read_from_yaml(tmp_path):
    clip = load_still(tmp_path, BANDAI)
    path = tmp_path / "rig.yaml"
    path.write_text("".join(f"{joint}: {sources[0]}\n" for joint, sources in USER_TABLE.items()))
    np.testing.assert_array_equal(retarget(clip, rig=str(path)).positions, retarget(clip, rig=USER_TABLE).positions)
    assert load_rig(path).name == str(path)
    capitals = path.replace(tmp_path / "RIG.YAML")
    np.testing.assert_array_equal(retarget(clip, rig=str(capitals)).positions, retarget(clip, rig=USER_TABLE).positions)


def test_unknown_rigs_and_joints_are_named(tmp_path):
    clip = load_still(tmp_path, BANDAI)
    with pytest.raises(UserError, match='unknown rig "kinect"; known are humanml3d, bandai-namco'):
        retarget(clip, rig="kinect")
    with pytest.raises(UserError, match='rig cmu-iclone: the file has no joint "CC_Base_Hip" for pelvis'):
        retarget(clip, rig="cmu-iclone")
    with pytest.raises(UserError, match=r"no known rig has its joints \(Root, Tip"):
        retarget(load_still(tmp_path, {"Root": (None, (0.0, 90.0, 0.0)), "Tip": ("Root", (0.0, 10.0, 0.0))}))
    with pytest.raises(UserError, match='unknown joint "hips"'):
        make_rig({"hips": "Hips"}, name="mine")
    with pytest.raises(UserError, match="mine: no joint is given for pelvis, left_hip"):
        make_rig({"neck": "Neck"}, name="mine")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("- a\n", "expected .field: value. lines"),
        ("a: [\n", "cannot read this YAML"),
        ("pelvis: 3\n", "pelvis needs a joint name"),
        (None, "no such config file"),
    ],
)
def test_bad_rig_files_are_named(tmp_path, text, message):
    path = tmp_path / "rig.yaml"
    if text is not None:
        path.write_text(text)
    with pytest.raises(UserError, match=message):
        load_rig(path)


def lower_sides(joints: dict) -> dict:
    """Returns joints whose names begin with l or r in place of L or R."""

    def lower(name):
        return name and name[0].lower() + name[1:]

    return {lower(name): (lower(parent), offset) for name, (parent, offset) in joints.items()}


DAZ = (
    {"hip": (None, (0.0, 93.0, 0.0)), "abdomen": ("hip", (0.0, 20.0, 0.0)), "chest": ("abdomen", (0.0, 12.0, 0.0))}
    | {"neck": ("chest", (0.0, 22.0, 0.0)), "head": ("neck", (0.0, 7.0, 0.0))}
    | lower_sides(arms("{S}Collar", "{S}Shldr", "{S}ForeArm", "{S}Hand", chest="chest"))
    | lower_sides(limbs("{S}Thigh", "{S}Shin", "{S}Foot", "{S}Toe", pelvis="hip"))
)


def test_the_toes_of_a_daz_figure_are_at_its_end_sites(tmp_path):
    """It has no toe joint. An End Site moves with its joint."""
    figure = {name: bone for name, bone in DAZ.items() if not name.endswith("Toe")}
    text = bvh_text(figure, np.zeros((2, 6 + 3 * (len(figure) - 1))))
    for side in "lr":
        before, name, after = text.partition(f"JOINT {side}Foot\n")
        text = before + name + after.replace("OFFSET 0 0 0", "OFFSET 0 -6 12", 1)
    path = tmp_path / "daz.bvh"
    path.write_text(text)
    clip = load_bvh(path)
    assert find_table(clip.with_end_sites().joint_names) is RIGS["daz"]
    pose = retarget(clip).positions[0]
    np.testing.assert_allclose(pose[INDEX["left_foot"]], [0.09, 0, 0.12], atol=1e-6)
    np.testing.assert_allclose(pose[INDEX["right_foot"]], [-0.09, 0, 0.12], atol=1e-6)
    lifted = dataclasses.replace(clip, rotations=clip.rotations.copy())
    lifted.rotations[:, clip.joint_names.index("lFoot")] = matrix_from_euler(np.array([-np.pi / 2, 0, 0]), "XYZ")
    np.testing.assert_allclose(retarget(lifted).positions[0, INDEX["left_foot"]], [0.09, 0.18, 0.06], atol=1e-5)
