"""Files of programs that no table knows: joints found by names and anatomy, sizes, floors, sides, and animals."""

import itertools
import json
import logging

import numpy as np
import pytest

from t2m_jax.errors import UserError
from t2m_jax.motion.formats import load_motion
from t2m_jax.motion.rig.anatomy import find_joints, make_bones
from t2m_jax.motion.rig.orientation import left_is_left
from t2m_jax.motion.rig.rigs import OPTIONAL_JOINTS
from t2m_jax.motion.skeleton import HUMANML3D
from tests.motion.rig.foreign import Joint, bvh_of, walk_on

INDEX = HUMANML3D.joint_names.index


def both_sides(**table: str) -> dict[str, str]:
    """Returns joints of HumanML3D -> names, from names with {S}, {s} or {side} for joints of both sides."""
    found = {}
    for role, name in table.items():
        for side in ("Left", "Right") if role not in HUMANML3D.joint_names else ("",):
            full = f"{side.lower()}_{role}" if side else role
            found[full] = name.format(S=side[:1], s=side[:1].lower(), side=side)
    return found


ARMS = {"collar": "{side}Shoulder", "shoulder": "{side}Arm", "elbow": "{side}ForeArm", "wrist": "{side}Hand"}
LEGS = {"hip": "{side}UpLeg", "knee": "{side}Leg", "ankle": "{side}Foot", "pelvis": "Hips"}
HIPS = {"hip": "{side}Hip", "knee": "{side}Knee", "ankle": "{side}Ankle", "pelvis": "Hips"} | {
    "collar": "{side}Collar", "shoulder": "{side}Shoulder", "elbow": "{side}Elbow", "wrist": "{side}Wrist"
}  # fmt: skip
TOP = {"neck": "Neck", "head": "Head"}
MIXAMO = LEGS | ARMS | TOP | {"foot": "{side}ToeBase", "spine1": "Spine", "spine2": "Spine1", "spine3": "Spine2"}
ROLES = {
    "SOMA": ARMS | {
        "pelvis": "Hips", "hip": "{side}Leg", "knee": "{side}Shin", "ankle": "{side}Foot", "foot": "{side}ToeBase",
        "spine1": "Spine1", "spine2": "Spine2", "spine3": "Chest", "neck": "Neck1", "head": "Head",
    },
    "Perception Neuron": LEGS | ARMS | TOP | {"spine1": "Spine", "spine2": "Spine1", "spine3": "Spine3"},
    "3ds Max": HIPS | TOP | {"spine1": "Chest", "spine2": "Chest2", "spine3": "Chest3"},
    "GAMES-105": {
        "pelvis": "RootJoint", "hip": "{s}Hip", "knee": "{s}Knee", "ankle": "{s}Ankle", "foot": "{s}ToeJoint",
        "spine1": "pelvis_lowerback", "spine3": "lowerback_torso", "neck": "torso_head", "collar": "{s}Torso_Clavicle",
        "shoulder": "{s}Shoulder", "elbow": "{s}Elbow", "wrist": "{s}Wrist",
    },
    "Blender CMU": {
        "pelvis": "pelvis", "hip": "thigh_{S}", "knee": "calf_{S}", "ankle": "foot_{S}", "foot": "toes_{S}",
        "spine1": "spine02", "spine3": "spine03", "neck": "neck", "head": "head",
        "collar": "clavicle_{S}", "shoulder": "upperarm_{S}", "elbow": "lowerarm_{S}", "wrist": "hand_{S}",
    },
    "CMU ASF": {
        "pelvis": "root", "hip": "{s}femur", "knee": "{s}tibia", "ankle": "{s}foot", "foot": "{s}toes",
        "spine3": "upperback", "neck": "neck", "head": "head", "collar": "{s}shoulderjoint",
        "shoulder": "{s}humerus", "elbow": "{s}radius", "wrist": "{s}hand",
    },
    "LAFAN1": MIXAMO | {"foot": "{side}Toe"},
    "Mixamo": {role: f"mixamorig7:{name}" for role, name in MIXAMO.items()},
    "Xsens": HIPS | TOP | {"foot": "{side}Toe", "spine1": "Chest", "spine2": "Chest3", "spine3": "Chest4"},
    "optical": MIXAMO | {"spine2": "Spine2", "spine3": "Spine3"},
}  # fmt: skip
ENDS = {
    "Perception Neuron": {f"{side}Foot": (0, -7, 17) for side in ("Left", "Right")},
    "3ds Max": {f"{side}Ankle": (0, -7, 17) for side in ("Left", "Right")},
}
"""End Sites of feet without toes."""


@pytest.fixture(scope="session")
def skeletons(shared_dir):
    """The ten skeletons by the first word of their names."""
    found = {}
    for name, joints in json.loads((shared_dir / "data/foreign-skeletons.json").read_text()).items():
        key = next(key for key in ROLES if name.startswith(key))
        found[key] = [Joint(one["name"], one["parent"], tuple(one["offset"]), len(one["channels"])) for one in joints]
    return found


def write_walk(path, joints, roles, *, ends=None, height=None, roots=None):
    """Writes the walk on a skeleton; its root's channels are places in a room whose floor is at 0."""
    turns = walk_on(joints, roles)
    if roots is None:
        frames = np.arange(len(next(iter(turns.values()))))
        up = 1 if height is None else height
        roots = np.zeros((len(frames), 3))
        roots[:, 2] = 0.06 * frames
        roots[:, 1] = up
    path.write_text(bvh_of(joints, turns, roots, ends=ends or {}))
    return load_motion(path)


def check_person(motion, *, size=(1.5, 2.0)):
    """Checks floor, sides and size, and that the figure walks ahead."""
    positions = motion.positions
    assert abs(np.quantile(positions[..., 1].min(axis=1), 0.05)) <= 0.05
    assert left_is_left(positions).mean() > 0.9
    bones = np.linalg.norm(np.diff(positions[:, [1, 4, 7]], axis=1), axis=-1).mean(axis=0).sum()
    assert size[0] <= 2.07 * bones <= size[1]
    assert np.all(np.diff(positions[:, [7, 4, 1, 12], 1].mean(axis=0)) > 0)
    assert positions[:, INDEX("head"), 1].mean() > positions[:, INDEX("neck"), 1].mean()


@pytest.mark.parametrize("name", ROLES)
def test_joints_are_recognized_without_their_tables(skeletons, name):
    joints = skeletons[name]
    names = [joint.name for joint in joints]
    parents = [-1 if joint.parent is None else names.index(joint.parent) for joint in joints]
    found = find_joints(make_bones(names, parents, np.array([joint.offset for joint in joints])))
    assert {role: names[place] for role, place in found.items()} == both_sides(**ROLES[name])


@pytest.mark.parametrize("name", ROLES)
def test_skeletons_of_other_programs_walk(tmp_path, skeletons, name):
    roles = both_sides(**ROLES[name])
    motion = write_walk(tmp_path / "walk.bvh", skeletons[name], roles, ends=ENDS.get(name))
    check_person(motion)


def renamed(joints, rename):
    return [joint._replace(name=rename(joint.name), parent=joint.parent and rename(joint.parent)) for joint in joints]


def side_and_rest(name):
    """Returns the side and the words of a name with `Left` and `Right`."""
    for side in ("Left", "Right"):
        if name.startswith(side):
            return side, name.removeprefix(side)
    return "", name


BIPED = {
    "Hips": "Pelvis", "UpLeg": "Thigh", "Leg": "Calf", "Foot": "Foot", "ToeBase": "Toe0", "Shoulder": "Clavicle",
    "Arm": "UpperArm", "ForeArm": "Forearm", "Hand": "Hand",
}  # fmt: skip
UNREAL = {
    "Hips": "pelvis", "Spine": "spine_01", "Spine1": "spine_02", "Spine2": "spine_03", "Neck": "neck_01",
    "Head": "head", "UpLeg": "thigh", "Leg": "calf", "Foot": "foot", "ToeBase": "ball", "Shoulder": "clavicle",
    "Arm": "upperarm", "ForeArm": "lowerarm", "Hand": "hand",
}  # fmt: skip
VROID = {
    "Hips": "Hips", "Spine": "Spine", "Spine1": "Chest", "Spine2": "UpperChest", "UpLeg": "UpperLeg", "Leg": "LowerLeg",
    "ToeBase": "ToeBase", "Arm": "UpperArm", "ForeArm": "LowerArm",
}  # fmt: skip
DAZ = {
    "Hips": "hip", "Spine": "abdomen", "Spine1": "chest", "Spine2": "chestUpper", "UpLeg": "ThighBend", "Leg": "Shin",
    "Foot": "Foot", "ToeBase": "Toe", "Shoulder": "Collar", "Arm": "ShldrBend", "ForeArm": "ForearmBend",
}  # fmt: skip
ANATOMY = {
    "Hips": "pelvis", "UpLeg": "femur", "Leg": "tibia", "Foot": "ankle", "ToeBase": "toes", "Shoulder": "clavicula",
    "Arm": "humerus", "ForeArm": "radius", "Hand": "carpus",
}  # fmt: skip
KINECT = {
    "Hips": "SpineBase", "Spine": "SpineMid", "Spine1": "SpineHigh", "Spine2": "SpineShoulder", "UpLeg": "Hip",
    "Leg": "Knee", "Foot": "Ankle", "ToeBase": "Foot", "Shoulder": "Clavicle", "Arm": "Shoulder", "ForeArm": "Elbow",
    "Hand": "Wrist",
}  # fmt: skip


def in_words(words, before, after):
    """Returns a function that gives a name of Mixamo in the words and with the sides of another program."""

    def rename(name):
        side, rest = side_and_rest(name.partition(":")[2])
        word = words.get(rest, rest)
        initial = side[:1] if side else ""
        return (
            (before if side else before.replace("{S}_", "").replace("{S} ", "").replace("{s}", "")).format(
                S=initial, s=initial.lower()
            )
            + word
            + (after.format(S=initial, s=initial.lower(), side=side) if side else "")
        )

    return rename


PROGRAMS = {
    "3ds Max biped": in_words(BIPED, "Bip01 {S} ", ""),
    "biped with signs": in_words(BIPED, "Bip001_{S}_", ""),
    "Unreal": in_words(UNREAL, "", "_{s}"),
    "VRoid": in_words(VROID, "J_Bip_{S}_", ""),
    "DAZ": in_words(DAZ, "{s}", ""),
    "Blender": in_words(UNREAL, "", ".{S}"),
    "Blender with a beginning": in_words(VROID, "DEF-", ".{S}"),
    "anatomy": in_words(ANATOMY, "{s}", ""),
    "Kinect": in_words(KINECT, "", "{side}"),
    "side at the end": in_words({}, "Actor_01_", "_{side}"),
    "small letters": lambda name: name.partition(":")[2].lower(),
    "capitals": lambda name: name.partition(":")[2].upper(),
    "a namespace": lambda name: "Take_001|Reference:" + name.partition(":")[2],
    "Character1": lambda name: "Character1_" + name.partition(":")[2],
    "CC_Base": in_words(BIPED, "CC_Base_{S}_", ""),
}


@pytest.mark.parametrize("program", PROGRAMS)
def test_other_names_give_the_same_motion(tmp_path, skeletons, program):
    joints, roles = skeletons["Mixamo"], both_sides(**ROLES["Mixamo"])
    expected = write_walk(tmp_path / "mixamo.bvh", joints, roles)
    rename = PROGRAMS[program]
    names = {role: rename(name) for role, name in roles.items()}
    motion = write_walk(tmp_path / "other.bvh", renamed(joints, rename), names)
    np.testing.assert_allclose(motion.positions, expected.positions, atol=1e-5)
    check_person(motion)


def scaled(joints, factor):
    return [joint._replace(offset=tuple(factor * value for value in joint.offset)) for joint in joints]


UNITS = {"m": 1, "mm": 0.001, "inch": 0.0254, "foot": 0.3048, "dm": 0.1, "CMU": 0.0254 / 0.45}


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("name", ["LAFAN1", "GAMES-105", "CMU ASF"])
def test_any_unit_gives_the_same_motion(tmp_path, skeletons, name, unit):
    joints, roles = skeletons[name], both_sides(**ROLES[name])
    meters = 1 if name == "GAMES-105" else 0.01
    expected = write_walk(tmp_path / "usual.bvh", scaled(joints, meters), roles)
    factor = meters / UNITS[unit]
    turns = walk_on(joints, roles)
    roots = np.zeros((12, 3))
    roots[:, 1:] = np.stack([np.ones(12), 0.06 * np.arange(12)], axis=1) / UNITS[unit]
    (tmp_path / "unit.bvh").write_text(bvh_of(scaled(joints, factor), turns, roots))
    np.testing.assert_allclose(load_motion(tmp_path / "unit.bvh").positions, expected.positions, atol=2e-4)


@pytest.mark.parametrize("factor", [2.0, 0.3, 0.63, 41.0])
def test_an_unknown_unit_gives_an_adult_and_is_said(tmp_path, skeletons, caplog, factor):
    caplog.set_level(logging.INFO)
    joints, roles = scaled(skeletons["Mixamo"], factor), both_sides(**ROLES["Mixamo"])
    motion = write_walk(tmp_path / "walk.bvh", joints, roles, height=100 * factor)
    check_person(motion, size=(1.69, 1.71))
    assert "its unit is not known; the figure is scaled to a person of 1.7 m" in caplog.text


def without(joints, names):
    """Returns a skeleton without some joints; those below them hang on the joint above."""
    kept = list(joints)
    for name in names:
        gone = next(joint for joint in kept if joint.name == name)
        kept = [
            joint._replace(parent=gone.parent, offset=tuple(np.add(gone.offset, joint.offset)))
            if joint.parent == name
            else joint
            for joint in kept
            if joint.name != name
        ]
    return kept


LACKS = [
    ("neck",), ("head",), ("neck", "head"), ("spine1", "spine2"), ("spine1", "spine2", "spine3"), ("spine3",),
    ("left_foot", "right_foot"), ("left_collar", "right_collar"), OPTIONAL_JOINTS,
]  # fmt: skip


@pytest.mark.parametrize("lacks", LACKS)
def test_joints_that_may_be_missing_are_placed(tmp_path, skeletons, caplog, lacks):
    """Without toes, the tips behind them and the End Sites are gone, too."""
    caplog.set_level(logging.INFO)
    joints, roles = skeletons["Mixamo"], both_sides(**ROLES["Mixamo"])
    expected = write_walk(tmp_path / "whole.bvh", joints, roles).positions
    tips = [f"mixamorig7:{tip}" for tip in ("LeftToe_End", "RightToe_End", "HeadTop_End")]
    fewer = without(joints, [*tips, *(roles[role] for role in lacks)])
    motion = write_walk(tmp_path / "fewer.bvh", fewer, {role: roles[role] for role in roles if role not in lacks})
    check_person(motion)
    assert "recognized by their names and by anatomy" in caplog.text
    assert all(role in caplog.text for role in lacks if "foot" in role or "collar" in role)
    limbs = [INDEX(f"{side}_{name}") for side in ("left", "right") for name in ("hip", "knee", "ankle", "foot")]
    # The trunk turns otherwise without its joints, so legs are compared from the pelvis.
    legs, own = (found[:, limbs] - found[:, :1] for found in (expected, motion.positions))
    assert np.linalg.norm(legs - own, axis=-1).max() < 0.12


OFFSETS = {"none": (0, 0, 0), "hips": (0, 99.8, 0), "room": (193.6, 90.2, 358.2), "negative": (-50, 92, -400)}


@pytest.mark.parametrize("offset", OFFSETS)
@pytest.mark.parametrize("meaning", ["place", "change"])
def test_the_offset_of_the_root_does_not_lift_the_figure(tmp_path, skeletons, offset, meaning):
    joints, roles = skeletons["Mixamo"], both_sides(**ROLES["Mixamo"])
    moved = [joints[0]._replace(offset=OFFSETS[offset]), *joints[1:]]
    roots = np.zeros((12, 3))
    roots[:, 1:] = np.stack([92 + np.sin(np.arange(12)), 6 * np.arange(12)], axis=1)
    if meaning == "change":
        roots -= OFFSETS[offset]
    motion = write_walk(tmp_path / "walk.bvh", moved, roles, roots=roots)
    check_person(motion)
    assert abs(motion.positions[:, 0, 1].mean() - 0.92) < 0.1
    np.testing.assert_allclose(motion.positions[-1, 0, 2] - motion.positions[0, 0, 2], 0.66, atol=1e-3)


@pytest.mark.parametrize("name", ["Xsens", "optical"])
def test_somebody_who_lies_stays_on_the_floor(tmp_path, skeletons, name):
    """The hips are far below OFFSET, but the channels are still their place."""
    joints, roles = skeletons[name], both_sides(**ROLES[name])
    turns = walk_on(joints, roles)
    lying = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    turns[joints[0].name] = lying @ turns[joints[0].name]
    moved = [joints[0]._replace(offset=(190.0, 90.0, 350.0)), *joints[1:]]
    roots = np.tile([150.0, 14.0, -80.0], (12, 1))
    (tmp_path / "lying.bvh").write_text(bvh_of(moved, turns, roots))
    positions = load_motion(tmp_path / "lying.bvh").positions
    assert positions[..., 1].min() > -0.1 and positions[:, 0, 1].max() < 0.5
    assert abs(positions[0, 0, 0] - 1.5) < 0.01


@pytest.mark.parametrize("name", ["Xsens", "SOMA", "Blender CMU", "Mixamo"])
@pytest.mark.parametrize("seed", range(3))
def test_the_order_of_joints_does_not_matter(tmp_path, skeletons, name, seed):
    joints, roles = skeletons[name], both_sides(**ROLES[name])
    expected = write_walk(tmp_path / "walk.bvh", joints, roles)
    waiting, done = list(joints), []
    generator = np.random.default_rng(seed)
    while waiting:
        ready = [joint for joint in waiting if joint.parent is None or joint.parent in {one.name for one in done}]
        done.append(ready[generator.integers(len(ready))])
        waiting.remove(done[-1])
    motion = write_walk(tmp_path / "mixed.bvh", done, roles)
    np.testing.assert_allclose(motion.positions, expected.positions, atol=1e-5)


def test_exchanged_sides_are_said(tmp_path, skeletons, caplog):
    joints, roles = skeletons["Xsens"], both_sides(**ROLES["Xsens"])
    caplog.set_level(logging.INFO)
    write_walk(tmp_path / "walk.bvh", joints, roles)
    assert "exchanged" not in caplog.text
    swap = {"Left": "Right", "Right": "Left", "": ""}

    def exchange(name):
        side, rest = side_and_rest(name)
        return swap[side] + rest

    turns = walk_on(joints, roles)
    others = {exchange(name): turn for name, turn in turns.items()}
    (tmp_path / "exchanged.bvh").write_text(bvh_of(renamed(joints, exchange), others, np.ones((12, 3))))
    load_motion(tmp_path / "exchanged.bvh")
    assert "LEFT AND RIGHT may be exchanged" in caplog.text


def animal(names, *, arm, leg, trunk, foot=0.15, tail=True, slope=0.0, scale=100.0):
    """Returns a skeleton with limbs that hang from a trunk of some slope; `names` are of its joints (see `DOG`)."""
    ahead, up = np.cos(slope), np.sin(slope)
    joints = [Joint(names["pelvis"], None, (0.0, 0.0, 0.0), 6)]

    def add(name, parent, *offset):
        joints.append(Joint(name, parent, tuple(scale * np.array(offset, float))))

    spine = [names["pelvis"], *names["spine"], names["neck"], names["head"]]
    for below, above in itertools.pairwise(spine):
        add(above, below, 0, up * trunk / 3, ahead * trunk / 3)
    chest = names["spine"][-1]
    for side, sign in (("Left", 1), ("Right", -1)):
        at = dict.fromkeys(("side", "S", "s"), side) | {"S": side[0], "s": side[0].lower()}
        limbs = [(names["pelvis"], names["leg"], leg, foot), (chest, names["arm"], arm, 0.0)]
        for parent, limb, length, tip in limbs:
            line = [name.format(**at) for name in limb]
            steps = [(0.08 * sign, -0.02, 0), (0, -length / 2, 0.02), (0, -length / 2, -0.02), (0, -0.3 * tip, tip)]
            steps = steps if len(line) < 5 else [(0.04 * sign, 0, 0), *steps]
            if limb is names["arm"] and len(line) == 4:
                steps = [(0.04 * sign, 0, 0), (0.06 * sign, -0.02, 0), *steps[1:3]]
            for name, above, step in zip(line, [parent, *line[:-1]], steps, strict=False):
                add(name, above, *step)
    if tail:
        for name, above in zip(names["tail"], [names["pelvis"], *names["tail"][:-1]], strict=True):
            add(name, above, 0, 0, -0.15)
    return joints


DOG = {
    "pelvis": "Hips", "spine": ["Spine", "Spine1"], "neck": "Neck", "head": "Head", "tail": ["Tail", "Tail1"],
    "leg": ["{side}UpLeg", "{side}Leg", "{side}Foot", "{side}ToeBase"],
    "arm": ["{side}Shoulder", "{side}Arm", "{side}ForeArm", "{side}Hand"],
}  # fmt: skip
DOG_BIPED = {
    "pelvis": "Bip01 Pelvis", "spine": ["Bip01 Spine", "Bip01 Spine1"], "neck": "Bip01 Neck", "head": "Bip01 Head",
    "tail": ["Bip01 Tail", "Bip01 Tail1"],
    "leg": ["Bip01 {S} Thigh", "Bip01 {S} Calf", "Bip01 {S} Foot", "Bip01 {S} Toe0"],
    "arm": ["Bip01 {S} Clavicle", "Bip01 {S} UpperArm", "Bip01 {S} Forearm", "Bip01 {S} Hand"],
}  # fmt: skip
ANIMALS = {
    "dog": animal(DOG, arm=0.4, leg=0.4, trunk=0.6),
    "dog without a tail": animal(DOG, arm=0.4, leg=0.42, trunk=0.6, tail=False),
    "horse": animal(DOG_BIPED, arm=0.95, leg=1.0, trunk=1.3),
    "monkey that sits": animal(DOG_BIPED, arm=0.5, leg=0.4, trunk=0.45, slope=1.2),
    "ape": animal(DOG_BIPED, arm=0.7, leg=0.5, trunk=0.6, slope=0.7, tail=False),
    "bear": animal(DOG, arm=0.6, leg=0.6, trunk=0.9, foot=0.25, tail=False),
}


@pytest.mark.parametrize("name", ANIMALS)
@pytest.mark.parametrize("unit", [1.0, 0.01])
def test_animals_are_refused_in_one_line(tmp_path, name, unit):
    path = tmp_path / "animal.bvh"
    path.write_text(bvh_of(scaled(ANIMALS[name], unit), {}, np.tile([0, 60 * unit, 0], (5, 1))))
    with pytest.raises(UserError, match=r"animal\.bvh: this seems to be an animal") as refusal:
        load_motion(path)
    assert "\n" not in str(refusal.value) and "--rig" in str(refusal.value)


def test_a_person_with_a_tail_is_a_person(tmp_path, skeletons):
    joints, roles = skeletons["Xsens"], both_sides(**ROLES["Xsens"])
    check_person(write_walk(tmp_path / "cat.bvh", [*joints, Joint("Tail", "Hips", (0, 0, -20.0))], roles))


DWARF = animal(DOG, arm=0.42, leg=0.4, trunk=0.5, foot=0.08, tail=False, slope=np.pi / 2)


def test_drawn_people_may_have_short_legs_and_long_arms(tmp_path):
    path = tmp_path / "dwarf.bvh"
    path.write_text(bvh_of(DWARF, {}, np.ones((5, 3))))
    positions = load_motion(path).positions
    assert positions[0, INDEX("left_wrist"), 1] > positions[0, INDEX("left_knee"), 1]


def test_somebody_who_crawls_is_a_person(tmp_path, skeletons):
    joints, roles = skeletons["optical"], both_sides(**ROLES["optical"])
    turns = walk_on(joints, roles)
    bent = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    turns["Hips"] = bent @ turns["Hips"]
    for side in ("Left", "Right"):
        turns[f"{side}UpLeg"] = np.swapaxes(bent, 0, 1) @ turns[f"{side}UpLeg"]
    (tmp_path / "crawl.bvh").write_text(bvh_of(joints, turns, np.tile([0.0, 60, 0], (12, 1))))
    assert abs(load_motion(tmp_path / "crawl.bvh").positions[..., 1].min()) < 0.06


def test_what_was_not_recognized_is_named(tmp_path, skeletons):
    joints = renamed(skeletons["Xsens"], lambda name: name.replace("RightKnee", "q1").replace("RightHip", "q2"))
    (tmp_path / "walk.bvh").write_text(bvh_of(joints, {}, np.ones((3, 3))))
    with pytest.raises(UserError, match=r"walk\.bvh: no known rig has its joints .* and .*right_knee.* not recognized"):
        load_motion(tmp_path / "walk.bvh")
