"""Motion on characters of other programs: where their joints go, and what stays in their files."""

from pathlib import Path

import numpy as np
import pytest

from t2m_jax import Motion
from t2m_jax.data.importers.synthetic import make_motion
from t2m_jax.errors import UserError
from t2m_jax.motion import load_character
from t2m_jax.motion.formats import load_motion
from t2m_jax.motion.skeleton import HUMANML3D
from tests.export.validator import validator_issues
from tests.motion.character_files import (
    UPRIGHT,
    bone_of,
    in_another_pose,
    places,
    read_parts,
    table_text,
    with_matrices,
    write_character,
)
from tests.motion.figures import INDEX, walking_positions
from tests.motion.glb_files import edited, name_bones
from tests.motion.rig.test_retarget import BANDAI, ICLONE

SIDES = ("left", "right")
LIMBS = (("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"), ("elbow", "wrist"))


def walk(num_frames=24, **fields):
    return Motion(walking_positions(num_frames), 20.0, **fields)


def lowered(joints):
    """The same figure in an A-pose."""
    angle = np.deg2rad(50)
    return {
        name: (parent, (x * np.cos(angle), y - abs(x) * np.sin(angle), z))
        if name.startswith(("LowerArm", "Hand"))
        else (parent, (x, y, z))
        for name, (parent, (x, y, z)) in joints.items()
    }


def same_figure(tmp_path, kind):
    """Returns the file of the same figure with other axes, units, directions or names."""
    path = tmp_path / f"{kind}.glb"
    if kind == "other axes":
        return write_character(path, BANDAI, seed=3)
    if kind == "z up":
        return write_character(path, BANDAI, seed=4, armature=UPRIGHT, z_up=True)
    if kind == "faces -z":
        return write_character(path, BANDAI, armature={"rotation": [0, 1, 0, 0]})
    write_character(path, BANDAI, seed=5)
    if kind == "another pose":
        return edited(path, in_another_pose)
    if kind == "matrices":
        return edited(path, with_matrices)
    return edited(path, lambda tree: name_bones(tree, kind))


def on(path, motion, tmp_path, **options):
    """Returns the file of a character with a motion."""
    output = tmp_path / "moved.glb"
    load_character(path, **options).save(output, [motion])
    return output


def degrees(a, b):
    cosine = np.sum(a * b, axis=-1) / np.linalg.norm(a, axis=-1) / np.linalg.norm(b, axis=-1)
    return np.rad2deg(np.arccos(np.clip(cosine, -1, 1)))


@pytest.mark.parametrize("joints", [BANDAI, lowered(BANDAI)], ids=["T-pose", "A-pose"])
def test_limbs_point_as_in_the_motion(tmp_path, joints):
    motion = walk()
    moved = places(on(write_character(tmp_path / "hero.glb", joints, seed=1), motion, tmp_path))
    for side in SIDES:
        for first, last in LIMBS:
            here = moved[bone_of(last, side)] - moved[bone_of(first, side)]
            there = motion.positions[:, INDEX[f"{side}_{last}"]] - motion.positions[:, INDEX[f"{side}_{first}"]]
            # Legs bend a little more or less, because hips of another width and feet have their places, too.
            assert degrees(here, there).max() < (0.05 if first in ("shoulder", "elbow") else 6)


def bent(motion, degrees):
    """The same motion with another lean of all that is above the hips."""
    angle = np.deg2rad(degrees)
    turn = np.array([[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]], np.float32)
    above = [INDEX[name] for name in HUMANML3D.joint_names if not name.endswith(("hip", "knee", "ankle", "foot"))]
    positions, pelvis = motion.positions.copy(), motion.positions[:, :1]
    positions[:, above] = (positions[:, above] - pelvis) @ turn.T + pelvis
    return Motion(positions, motion.fps)


def hunched(motion):
    """The same motion with a spine that is far behind the line from hips to neck."""
    positions = motion.positions.copy()
    positions[:, [INDEX["spine1"], INDEX["spine2"]]] -= np.float32([0, 0.06, 0.2])
    return Motion(positions, motion.fps)


def test_the_trunk_leans_as_in_the_motion(tmp_path):
    hero = write_character(tmp_path / "hero.glb", ICLONE)
    leans = []
    for motion in (walk(8), bent(walk(8), 25), hunched(walk(8))):
        moved = places(on(hero, motion, tmp_path))
        hips = (moved["CC_Base_L_Thigh"] + moved["CC_Base_R_Thigh"]) / 2
        leans.append(degrees(moved["CC_Base_NeckTwist01"] - hips, np.array([0.0, 1.0, 0.0])).mean())
    assert 15 < leans[1] - leans[0] < 30
    assert abs(leans[2] - leans[0]) < 4


@pytest.mark.parametrize("kind", ["other axes", "z up", "faces -z", "matrices", "another pose", "VRMC_vrm", "VRM"])
def test_axes_units_and_names_of_a_file_do_not_matter(tmp_path, kind):
    motion = walk()
    expected = list(places(on(write_character(tmp_path / "plain.glb", BANDAI), motion, tmp_path)).values())
    path = same_figure(tmp_path, kind)
    moved = list(places(on(path, motion, tmp_path)).values())
    joints = slice(2, len(BANDAI) + 1)  # the armature and the root above the hips may be elsewhere
    # The chest of VRM is lower in the spine than that of the table for this rig.
    np.testing.assert_allclose(moved[joints], expected[joints], atol=0.025 if kind.startswith("VRM") else 2e-4)
    # At rest, the figure is what it was.
    np.testing.assert_allclose(
        list(places(tmp_path / "moved.glb", None).values()), list(places(path, None).values()), atol=1e-6
    )


def test_only_the_animation_is_added(tmp_path):
    path = write_character(tmp_path / "hero.glb", BANDAI, seed=1)
    old, new = read_parts(path), read_parts(on(path, walk(caption="nod"), tmp_path))
    assert new.binary[: len(old.binary)] == old.binary
    for name, part in old.tree.items():
        if name in ("accessors", "bufferViews", "animations"):
            assert new.tree[name][: len(part)] == part
        elif name != "buffers":
            assert new.tree[name] == part
    assert new.tree.keys() == old.tree.keys()
    assert [animation["name"] for animation in new.tree["animations"]] == ["nod", "nod 2"]


def test_bones_keep_their_lengths_and_a_root_bone_carries_the_travel(tmp_path):
    motion = Motion(walking_positions(24) + np.linspace(0, 2, 24)[:, None, None] * np.float32([1, 0, 1]), 20.0)
    path = write_character(tmp_path / "hero.glb", BANDAI, seed=1)
    output = on(path, motion, tmp_path)
    nodes = read_parts(output).tree["nodes"]
    channels = [channel["target"] for channel in read_parts(output).tree["animations"][-1]["channels"]]
    moved = {nodes[one["node"]]["name"] for one in channels if one["path"] == "translation"}
    assert moved == {"joint_Root", "Hips"} and {one["path"] for one in channels} == {"translation", "rotation"}
    now, rest = places(output), places(path, None)
    for name, (parent, offset) in BANDAI.items():
        if parent not in (None, "joint_Root"):
            length = np.linalg.norm(now[name] - now[parent], axis=-1)
            np.testing.assert_allclose(length, np.linalg.norm(offset) / 100, atol=1e-5)
    apart = (now["Hips"] - now["joint_Root"]) - (rest["Hips"] - rest["joint_Root"])
    assert np.abs(apart[:, [0, 2]]).max() < 1e-5
    assert np.linalg.norm(np.ptp(now["joint_Root"], axis=0)[[0, 2]]) > 2


@pytest.mark.parametrize("soles", [0.0, 5.0], ids=["barefoot", "thick soles"])
def test_feet_stay_on_the_floor_and_in_their_places(tmp_path, soles):
    motion = Motion(make_motion("squat", seed=2, num_frames=60), 20.0)
    path = write_character(tmp_path / "hero.glb", BANDAI | {"joint_Root": (None, (0.0, soles, 0.0))}, seed=1)
    now, rest = places(on(path, motion, tmp_path)), places(path, None)
    for side in SIDES:
        foot, ankle = now[bone_of("foot", side)], now[bone_of("ankle", side)]
        own = motion.positions[:, INDEX[f"{side}_foot"]]
        assert np.linalg.norm(np.ptp(foot, axis=0)) < np.linalg.norm(np.ptp(own, axis=0)) + 0.01
        assert np.abs(ankle[:, 1] - rest[bone_of("ankle", side)][1]).max() < 0.01
    assert np.ptp(now["Hips"][:, 1]) > 0.15


def on_tiptoe(num_frames=40):
    """Someone who stands, rises on the balls of both feet, and lifts these a little."""
    positions = np.repeat(make_motion("squat", seed=2, num_frames=2)[:1], num_frames, axis=0)
    angle = np.deg2rad(35) * np.sin(np.linspace(0, np.pi, num_frames))
    balls = [INDEX[f"{side}_foot"] for side in SIDES]
    x, y, z = np.moveaxis(positions[:, INDEX["left_ankle"]] - positions[:, balls[0]], -1, 0)
    moved = np.stack([x, y * np.cos(angle) - z * np.sin(angle), z * np.cos(angle) + y * np.sin(angle)], axis=-1)
    positions += (moved - moved[:1])[:, None]
    positions[:, balls] = positions[:1, balls]
    positions[..., 1] += 0.05 * np.sin(angle)[:, None]
    return Motion(positions, 20.0)


def with_feet(joints, share):
    """The same figure with feet of another length."""
    return joints | {
        name: (joints[name][0], tuple(share * part for part in joints[name][1])) for name in ("Toes_L", "Toes_R")
    }


@pytest.mark.parametrize("share", [0.0, 0.6, 1.0, 2.0])
def test_feet_of_any_length_roll_over_the_ball_without_sliding(tmp_path, share):
    motion = on_tiptoe()
    now = places(on(write_character(tmp_path / "hero.glb", with_feet(BANDAI, share)), motion, tmp_path))
    for side in SIDES:
        ball, ankle = now[bone_of("foot", side)], now[bone_of("ankle", side)]
        assert np.linalg.norm(np.ptp(ball[:, [0, 2]], axis=0)) < 0.002
        own = np.ptp(motion.positions[:, INDEX[f"{side}_ankle"]], axis=0)
        assert min(share, 0.5) * own[1] < np.ptp(ankle[:, 1]) < own[1] + 0.01  # long feet do not raise the body
        assert np.ptp(ankle[:, 2]) < own[2] + 0.02


def test_a_foot_with_a_high_ankle_keeps_its_direction(tmp_path):
    """Its sole points down from the ankle by 60 degrees at rest, and beyond the vertical when the heel rises by 35."""
    toes = {f"Toes_{side}": (f"Foot_{side}", (0.0, -26.0, 15.0)) for side in "LR"}
    now = places(on(write_character(tmp_path / "hero.glb", BANDAI | toes), on_tiptoe(), tmp_path))
    for side in SIDES:
        ahead = now[bone_of("foot", side)] - now[bone_of("ankle", side)]
        yaw = np.rad2deg(np.arctan2(ahead[:, 0], ahead[:, 2]))
        assert np.ptp(yaw) < 10


def test_a_written_character_is_read_as_the_motion(tmp_path):
    motion = Motion(make_motion("walk", seed=2, num_frames=40), 20.0, caption="a person walks")
    motion.save(tmp_path / "figure.glb")  # its proportions are those of the motion
    output = on(tmp_path / "figure.glb", motion, tmp_path)
    again = load_motion(output, animation="a person walks 2")
    assert again.fps == 20 and again.num_frames == 40 and again.caption == "a person walks"
    assert np.linalg.norm(again.positions - motion.positions, axis=-1).max() < 0.01


def test_a_motion_writes_itself_on_a_character(tmp_path):
    path = edited(write_character(tmp_path / "hero.glb", BANDAI), without_legs)
    with pytest.raises(UserError, match=r"hero\.glb: .*left_hip, right_hip"):
        walk(8).on_character(path, tmp_path / "moved.glb")
    table = tmp_path / "hero.yaml"
    table.write_text(table_text(lambda bone: bone.replace("Leg", "Tentacle").replace("Foot", "Sucker")))
    walk(8, caption="stroll").on_character(f"{path}", f"{tmp_path / 'moved.glb'}", rig=f"{table}")
    assert [animation["name"] for animation in read_parts(tmp_path / "moved.glb").tree["animations"]] == [
        "nod",
        "stroll",
    ]


def test_several_motions_are_several_animations(tmp_path):
    character = load_character(write_character(tmp_path / "hero.glb", BANDAI))
    character.save(tmp_path / "moved.glb", [walk(8, caption="a"), walk(12)])
    assert len(places(tmp_path / "moved.glb", -2)["Hips"]) == 8
    assert len(places(tmp_path / "moved.glb", -1)["Hips"]) == 12


def uneven(tree):
    tree["nodes"][3]["scale"] = [1, 1, 1.5]


def mirrored(tree):
    tree["nodes"][0]["scale"] = [-0.01] * 3


def short_arm(tree):
    next(node for node in tree["nodes"] if node.get("name") == "LowerArm_L")["translation"] = [0, 0, 0]


def on_its_belly(tree):
    tree["nodes"][0]["rotation"] = [0.5**0.5, 0, 0, 0.5**0.5]


def without_figure(tree):
    del tree["skins"], tree["meshes"]


def without_legs(tree):
    for node in tree["nodes"]:
        node["name"] = node.get("name", "").replace("Leg", "Tentacle").replace("Foot", "Sucker")


def without_person(tree):
    for number, node in enumerate(tree["nodes"]):
        node |= {"name": f"wheel{number}"}


def with_other_file(tree):
    tree["buffers"][0]["uri"] = "hero.bin"


def in_two_trees(tree):
    hips = next(node for node in tree["nodes"] if node.get("name") == "Hips")
    number = next(number for number in hips["children"] if tree["nodes"][number]["name"] == "Spine")
    hips["children"].remove(number)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (without_figure, "has no skin and no mesh, so it is not a character"),
        (without_person, r"no known rig has its joints \(.*\), and pelvis, left_hip, .* were not recognized"),
        (without_legs, "left_hip, right_hip, left_knee, .* were not recognized; `t2m data rig FILE`"),
        (with_other_file, "its data are in another file; export everything into one .glb"),
        (uneven, "the scale of 'Spine' is zero, mirrored or uneven"),
        (mirrored, "is zero, mirrored or uneven"),
        (short_arm, "its left shoulder and elbow are at the same place"),
        (on_its_belly, "its trunk is level in the rest pose"),
        (in_two_trees, "no bone is above all of its limbs"),
    ],
)
def test_a_file_that_is_no_character_is_refused_in_one_line(tmp_path, monkeypatch, change, message):
    monkeypatch.chdir(tmp_path)  # a long path would shorten the message
    path = edited(write_character(Path("hero.glb"), BANDAI), change)
    with pytest.raises(UserError, match=rf"hero\.glb: .*{message}") as refusal:
        load_character(path)
    assert "\n" not in str(refusal.value)


def test_what_is_not_a_glb_file_is_refused(tmp_path):
    (tmp_path / "hero.glb").write_text("solid cube")
    with pytest.raises(UserError, match=r"hero\.glb: is not a GLB file; export as glTF binary"):
        load_character(tmp_path / "hero.glb")
    with pytest.raises(UserError, match="there is no such file"):
        load_character(tmp_path / "other.glb")


def test_a_table_names_the_bones_of_a_character(tmp_path):
    path = edited(write_character(tmp_path / "hero.glb", BANDAI), without_legs)
    table = tmp_path / "hero.yaml"
    table.write_text(table_text(lambda bone: bone.replace("Leg", "Tentacle").replace("Foot", "Sucker")))
    moved = places(on(path, walk(), tmp_path, rig=f"{table}"))
    expected = places(on(write_character(tmp_path / "b.glb", BANDAI), walk(), tmp_path))
    np.testing.assert_allclose(moved["Toes_L"], expected["Toes_L"], atol=1e-5)


def test_the_file_of_the_character_is_kept(tmp_path):
    path = write_character(tmp_path / "hero.glb", BANDAI)
    before = path.read_bytes()
    with pytest.raises(UserError, match=r"hero\.glb: is the character's own file"):
        load_character(path).save(path, [walk()])
    with pytest.raises(UserError, match=r"a\.vrm: a character is written as \.glb file, not \.vrm"):
        load_character(path).save(tmp_path / "a.vrm", [walk()])
    with pytest.raises(UserError, match="there is no motion to write"):
        load_character(path).save(tmp_path / "a.glb", [])
    assert path.read_bytes() == before and list(tmp_path.iterdir()) == [path]


REAL = {
    "KayKit": ("cc0-glb", "kaykit_General.glb"),
    "Quaternius": ("cc0-glb", "quaternius_human-base.glb"),
    "Mesh2Motion": ("foreign-files", "foreign-files/m2m_rig_human.glb"),
}


def faces_away(joints):
    """The same figure turned by half a turn, as figures of VRM 0 are."""
    return {name: (parent, (-x, y, -z)) for name, (parent, (x, y, z)) in joints.items()}


MADE = {
    "VRM 0": lambda path: edited(write_character(path, faces_away(BANDAI)), lambda tree: name_bones(tree, "VRM")),
    "VRM 1": lambda path: edited(write_character(path, BANDAI, seed=2), lambda tree: name_bones(tree, "VRMC_vrm")),
    # Its armature is scaled by 0.01, and turned by -90 degrees about X.
    "scaled and turned": lambda path: write_character(path, ICLONE, seed=4, armature=UPRIGHT, z_up=True),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", [*REAL, *MADE])
def test_characters_of_other_programs_follow_a_motion(tmp_path, shared_data, name):
    if name in MADE:
        path = MADE[name](tmp_path / "hero.glb")
    else:
        archive, file = REAL[name]
        path = shared_data(archive) / file
    character = load_character(path)
    nodes = read_parts(path).tree["nodes"]
    motions = [Motion(make_motion(kind, seed=3, num_frames=60), 20.0) for kind in ("walk", "squat", "wave-left-hand")]
    recorded = load_motion(shared_data("foreign-files") / "foreign-files" / "mobu_8walk.bvh")
    for motion in [*motions, on_tiptoe(), recorded]:
        output = tmp_path / "moved.glb"
        character.save(output, [motion])
        moved = places(output)
        joints = {role: moved[nodes[character.numbers[place]]["name"]] for role, place in character.index.items()}
        scale = character_scale(joints, motion)
        for side in SIDES:
            for first, last in LIMBS[2:]:
                there = motion.positions[:, INDEX[f"{side}_{last}"]] - motion.positions[:, INDEX[f"{side}_{first}"]]
                assert degrees(joints[f"{side}_{last}"] - joints[f"{side}_{first}"], there).max() < 2
            foot = joints[f"{side}_foot"] / scale
            ball, heel = (motion.positions[:, INDEX[f"{side}_{joint}"]] for joint in ("foot", "ankle"))
            assert excess_slide(foot, ball) < 0.01
            # The heel of a foot of 2.5 times the length moves further while the foot turns on its ball.
            ankle = joints[f"{side}_ankle"] / scale
            assert excess_slide(ankle, heel, ball) < (0.04 if name == "KayKit" else 0.01)
        own = motion.positions[:, INDEX["left_hip"]] - motion.positions[:, INDEX["right_hip"]]
        assert degrees(joints["left_hip"] - joints["right_hip"], own).max() < 10


def character_scale(joints, motion):
    """Returns the size of a character per size of the person in a motion, by a leg."""
    legs = [INDEX[f"left_{joint}"] for joint in ("hip", "knee", "ankle")]
    own = np.linalg.norm(np.diff(motion.positions[0, legs], axis=0), axis=-1).sum()
    bones = [joints[f"left_{last}"][0] - joints[f"left_{first}"][0] for first, last in LIMBS[:2]]
    return np.linalg.norm(bones, axis=-1).sum() / own


def excess_slide(foot, own, ball=None):
    """Returns by how much more a foot moves over the floor while its ball stands, at most, than in the motion."""
    ball = own if ball is None else ball
    stands = np.linalg.norm(np.diff(ball, axis=0), axis=-1) < 0.005
    stands = np.flatnonzero(stands & (ball[1:, 1] < ball[:, 1].min() + 0.02))
    runs = np.split(stands, np.flatnonzero(np.diff(stands) > 1) + 1)
    slides = [np.ptp(foot[run][:, [0, 2]], axis=0) - np.ptp(own[run][:, [0, 2]], axis=0) for run in runs if len(run)]
    return max((np.linalg.norm(slide.clip(0)) for slide in slides), default=0.0)


@pytest.mark.slow
def test_the_validator_of_khronos_finds_no_error(tmp_path, tmp_path_factory):
    for make in (*MADE.values(), lambda path: write_character(path, BANDAI, seed=0)):
        path = make(tmp_path / "hero.glb")
        old, new = (validator_issues(one, tmp_path_factory) for one in (path, on(path, walk(), tmp_path)))
        assert new == old and new["numErrors"] == 0
