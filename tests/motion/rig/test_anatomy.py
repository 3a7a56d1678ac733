"""Rigs of many programs in small: which joint of HumanML3D each of their joints is."""

import numpy as np
import pytest
import yaml

from t2m_jax.cli.main import main
from t2m_jax.errors import UserError
from t2m_jax.motion.formats import load_motion
from t2m_jax.motion.rig.anatomy import find_joints, make_bones
from t2m_jax.motion.skeleton import HUMANML3D
from tests.motion.glb_files import GlbWriter, about_y
from tests.motion.rig.foreign import Joint, bvh_of

PLACES = {
    "pelvis": (0, 0.95, 0), "spine1": (0, 1.08, 0), "spine2": (0, 1.21, 0), "spine3": (0, 1.34, 0),
    "neck": (0, 1.5, 0), "head": (0, 1.6, 0), "hip": (0.08, 0.9, 0), "knee": (0.08, 0.48, 0),
    "ankle": (0.08, 0.08, 0), "foot": (0.08, 0.02, 0.12), "collar": (0.03, 1.45, 0), "shoulder": (0.17, 1.45, 0),
    "elbow": (0.43, 1.45, 0), "wrist": (0.69, 1.45, 0),
    # No joints of HumanML3D.
    "thigh": (0.08, 0.69, 0), "shin": (0.08, 0.28, 0), "arm": (0.3, 1.45, 0), "forearm": (0.56, 1.45, 0),
    "throat": (0, 1.55, 0), "palm": (0.78, 1.45, 0),
    "heel": (0.08, 0.04, 0.02), "tip": (0.08, 0.02, 0.23),
}  # fmt: skip
"""Places in meters for the joints of the middle and of the left."""
TRUNK = "Hips=pelvis Spine=spine1 Spine1=spine2 Spine2=spine3 Neck=neck Head=head"
LEG = "{s}UpLeg=hip {s}Leg=knee {s}Foot=ankle {s}ToeBase=foot"
ARM = "{s}Shoulder=collar {s}Arm=shoulder {s}ForeArm=elbow {s}Hand=wrist"


def figure(trunk=TRUNK, leg=LEG, arm=ARM, *, sides=("Left", "Right"), arms_on="spine3"):
    """Returns the joints of a person and joints of HumanML3D -> their names, from chains of `name=place`."""
    joints, places, roles = [], {}, {}

    def chain(text, parent, side="", sign=1):
        for name, place in (word.rsplit("=", 1) for word in text.split()):
            name = name.replace("{s}", side)
            places[name] = np.array(PLACES[place]) * (sign, 1, 1)
            joints.append(Joint(name, parent, tuple(places[name] - places.get(parent, 0))))
            role = f"{'left' if sign > 0 else 'right'}_{place}" if side else place
            if role in HUMANML3D.joint_names:
                roles[role] = name
            parent = name

    chain(trunk, None)
    for side, sign in zip(sides, (1, -1), strict=True):
        chain(leg, roles["pelvis"], side, sign)
        chain(arm, roles[arms_on], side, sign)
    return joints, roles


def recognized(joints):
    """Returns joints of HumanML3D -> the names that were recognized."""
    names = [joint.name for joint in joints]
    parents = [-1 if joint.parent is None else names.index(joint.parent) for joint in joints]
    found = find_joints(make_bones(names, parents, np.array([joint.offset for joint in joints])))
    return {role: names[place] for role, place in found.items()}


SPINES = "spine=pelvis spine.001=spine1 spine.002=spine2 spine.003=spine3 spine.004=neck"
RIGS = {
    "metarig of Blender": {"trunk": f"{SPINES} spine.005=throat spine.006=head"},
    "CAT of 3ds Max": {"trunk": "Hub001=pelvis Spine1=spine1 Spine2=spine2 Hub002=spine3 Spine3=neck Hub003=head"},
    "numbers that end at the neck": {"trunk": SPINES},
    "OptiTrack": {
        "leg": "{s}Thigh=hip {s}Shin=knee {s}Foot=ankle {s}Toe=foot",
        "arm": "{s}Shoulder=collar {s}UArm=shoulder {s}FArm=elbow {s}Hand=wrist",
        "sides": ("L", "R"),
    },
    "initials": {
        "leg": "{s}ULeg=hip {s}LLeg=knee {s}Foot=ankle",
        "arm": "{s}Shoulder=collar {s}UArm=shoulder {s}LArm=elbow {s}Hand=wrist",
        "sides": ("L", "R"),
    },
    "words without vowels": {"arm": "{s}_shldr=shoulder {s}_elbw=elbow {s}_wrst=wrist", "sides": ("l", "r")},
    "letters from hip to toe": {
        "leg": "{s}_leg_a=hip {s}_leg_b=knee {s}_leg_c=ankle {s}_leg_d=foot",
        "arm": "{s}_clav=collar {s}_arm_a=shoulder {s}_arm_b=elbow {s}_arm_c=wrist",
        "sides": ("l", "r"),
    },
    "legs and arms of four segments": {
        "leg": "{s}_Leg1=hip {s}_Leg2=thigh {s}_Leg3=knee {s}_Leg4=shin {s}_Foot=ankle {s}_Toe=foot",
        "arm": "{s}_Collar=collar {s}_Arm1=shoulder {s}_Arm2=arm {s}_Arm3=elbow {s}_Arm4=forearm {s}_Hand=wrist",
        "sides": ("L", "R"),
    },
    "mGear": {
        "leg": "leg_{s}0_0=hip leg_{s}0_1=thigh leg_{s}0_2=knee leg_{s}0_3=shin leg_{s}0_end=ankle foot_{s}0_0=foot",
        "arm": "arm_{s}0_0=shoulder arm_{s}0_1=arm arm_{s}0_2=elbow arm_{s}0_3=forearm arm_{s}0_end=wrist",
        "sides": ("L", "R"),
    },
    "Kinect": {
        "trunk": "HipCenter=pelvis Spine=spine2 ShoulderCenter=spine3 Head=head",
        "leg": "Hip{s}=hip Knee{s}=knee Ankle{s}=ankle Foot{s}=foot",
        "arm": "Shoulder{s}=shoulder Elbow{s}=elbow Wrist{s}=wrist Hand{s}=palm",
    },
    "a head at the place of the neck": {"trunk": "Hips=pelvis Spine=spine2 Spine1=spine3 Head=neck"},
    "arms on the neck": {"arms_on": "neck"},
    "arms without collars on the neck": {"arm": "{s}Arm=shoulder {s}ForeArm=elbow {s}Hand=wrist", "arms_on": "neck"},
    "OpenPose": {
        "trunk": "MidHip=pelvis Neck=neck",
        "leg": "{s}Hip=hip {s}Knee=knee {s}Ankle=ankle {s}BigToe=foot",
        "arm": "{s}Shoulder=shoulder {s}Elbow=elbow {s}Wrist=wrist",
        "sides": ("L", "R"),
        "arms_on": "neck",
    },
    "Second Life, whose toe is the tip of the foot": {
        "trunk": "mPelvis=pelvis mTorso=spine1 mChest=spine3 mNeck=neck mHead=head",
        "leg": "mHip{s}=hip mKnee{s}=knee mAnkle{s}=ankle mFoot{s}=foot mToe{s}=tip",
        "arm": "mCollar{s}=collar mShoulder{s}=shoulder mElbow{s}=elbow mWrist{s}=wrist",
    },
    "a foot between ankle and toe that is the heel": {
        "leg": "{s}Hip=hip {s}Knee=knee {s}Ankle=ankle {s}Foot=heel {s}Toe=foot",
    },
    "arms in small letters": {
        "arm": "{s}clav=collar {s}arm=shoulder {s}forearm=elbow {s}hand=wrist",
        "sides": ("l", "r"),
    },
}


LANGUAGES = {
    "Chinese": (
        "骨盆=pelvis 脊椎=spine2 胸部=spine3 脖子=neck 头=head", "{s}大腿=hip {s}小腿=knee {s}脚=ankle {s}脚趾=foot",
        "{s}锁骨=collar {s}上臂=shoulder {s}前臂=elbow {s}手=wrist", ("左", "右"),
    ),
    "French": (
        "bassin=pelvis torse=spine3 cou=neck tête=head",
        "cuisse_{s}=hip jambe_{s}=knee pied_{s}=ankle orteils_{s}=foot",
        "clavicule_{s}=collar bras_{s}=shoulder avant_bras_{s}=elbow main_{s}=wrist", ("g", "d"),
    ),
    "German": (
        "Hüfte=pelvis Brust=spine3 Hals=neck Kopf=head",
        "Oberschenkel.{s}=hip Unterschenkel.{s}=knee Fuß.{s}=ankle Zehen.{s}=foot",
        "Schulter.{s}=collar Oberarm.{s}=shoulder Unterarm.{s}=elbow Hand.{s}=wrist", ("links", "rechts"),
    ),
    "Italian": (
        "bacino=pelvis torace=spine3 collo=neck testa=head", "coscia_{s}=hip gamba_{s}=knee piede_{s}=ankle",
        "clavicola_{s}=collar braccio_{s}=shoulder avambraccio_{s}=elbow mano_{s}=wrist", ("sx", "dx"),
    ),
    "Japanese, in MikuMikuDance": (
        "センター=pelvis 上半身=spine1 上半身２=spine3 首=neck 頭=head",
        "{s}足=hip {s}ひざ=knee {s}足首=ankle {s}つま先=foot",
        "{s}肩=collar {s}腕=shoulder {s}ひじ=elbow {s}手首=wrist", ("左", "右"),
    ),
    "Korean": (
        "골반=pelvis 척추=spine2 가슴=spine3 목=neck 머리=head",
        "{s}허벅지=hip {s}종아리=knee {s}발=ankle {s}발가락=foot",
        "{s}쇄골=collar {s}위팔=shoulder {s}아래팔=elbow {s}손=wrist", ("왼쪽", "오른쪽"),
    ),
    "Portuguese": (
        "quadril=pelvis peito=spine3 pescoço=neck cabeça=head",
        "coxa_{s}=hip canela_{s}=knee pé_{s}=ankle ponta_{s}=foot",
        "clavicula_{s}=collar braço_{s}=shoulder antebraço_{s}=elbow mão_{s}=wrist", ("esq", "dir"),
    ),
    "Russian": (
        "Таз=pelvis Грудь=spine3 Шея=neck Голова=head", "Бедро_{s}=hip Голень_{s}=knee Стопа_{s}=ankle Носок_{s}=foot",
        "Ключица_{s}=collar Плечо_{s}=shoulder Предплечье_{s}=elbow Кисть_{s}=wrist", ("Л", "П"),
    ),
    "Spanish": (
        "cadera=pelvis pecho=spine3 cuello=neck cabeza=head", "muslo_{s}=hip pantorrilla_{s}=knee pie_{s}=ankle",
        "clavicula_{s}=collar brazo_{s}=shoulder antebrazo_{s}=elbow mano_{s}=wrist", ("izq", "der"),
    ),
}  # fmt: skip


@pytest.mark.parametrize("language", LANGUAGES)
def test_names_may_be_of_other_languages(language):
    *chains, sides = LANGUAGES[language]
    joints, roles = figure(*chains, sides=sides)
    assert recognized(joints) == roles


@pytest.mark.parametrize("name", RIGS)
def test_joints_are_recognized(name):
    joints, roles = figure(**RIGS[name])
    assert recognized(joints) == roles


@pytest.mark.parametrize("sides", [("lf_", "rt_"), ("Lf_", "Rf_"), ("LT", "RT"), ("le_", "ri_"), ("lft_", "rgt_")])
def test_sides_may_be_short(sides):
    joints, roles = figure(sides=sides)
    assert recognized(joints) == roles


def test_a_joint_in_a_limb_has_its_side():
    joints, roles = figure(arm="{s}Shoulder=collar {s}Up=shoulder {s}ForeArm=elbow {s}Hand=wrist")
    sideless = {roles["left_shoulder"]: "Up1", roles["right_shoulder"]: "Up2"}
    joints = [
        joint._replace(**{key: sideless.get(getattr(joint, key), getattr(joint, key)) for key in ("name", "parent")})
        for joint in joints
    ]
    assert recognized(joints) == roles | {"left_shoulder": "Up1", "right_shoulder": "Up2"}


def test_a_limb_that_ends_early_is_not_guessed():
    joints, _ = figure(
        leg="{s}Thigh=hip {s}Shin=knee {s}Guard=shin", arm="{s}Shoulder=collar {s}Arm=shoulder {s}ForeArm=elbow"
    )
    assert not recognized(joints)


def test_of_joints_at_one_place_those_with_more_below_them_are_taken():
    """Such as the bones of a mesh below those of an animator."""
    joints, roles = figure()
    controls = [Joint(f"ORG-{one.name}", one.parent and f"ORG-{one.parent}", one.offset) for one in joints]
    mesh = [Joint(f"DEF-{one.name}", f"ORG-{one.name}", (0, 1e-6, 0)) for one in joints]
    found = recognized(controls + mesh)
    assert found.keys() == roles.keys()
    assert found["left_ankle"] == "ORG-LeftFoot"


def two_people(*, gap, stretch=0.03):
    """Returns the joints of two figures of slightly different build below one joint."""
    generator = np.random.default_rng(0)
    joints = [Joint("Scene", None, (0.0, 0.0, 0.0))]
    for name, place in (("Alice", (0, 0, 0)), ("Bob", (gap, 0, 0))):
        for joint in figure()[0]:
            offset = np.array(joint.offset) * (1 + stretch * generator.normal())
            top = joint.parent is None
            parent = "Scene" if top else f"{name}_{joint.parent}"
            joints.append(Joint(f"{name}_{joint.name}", parent, tuple(offset + np.array(place) * top)))
    return joints


def test_several_people_are_refused_and_not_mixed(tmp_path, capsys):
    path, table = tmp_path / "pair.bvh", tmp_path / "one.yaml"
    path.write_text(bvh_of(two_people(gap=1.0), {}, np.zeros((3, 3))))
    with pytest.raises(UserError, match=r"pair\.bvh: the file seems to hold several people .*_Hips.*_Hips") as refusal:
        load_motion(path)
    assert "\n" not in str(refusal.value)
    main(["data", "rig", str(path), "-o", str(table)])
    names = yaml.safe_load(table.read_text()).values()
    assert len(names) == 22 and len({name.partition("_")[0] for name in names}) == 1
    assert np.ptp(load_motion(path, rig=str(table)).positions[0, :, 0]) < 2


def test_people_without_a_common_joint_are_refused(tmp_path):
    writer, numbers = GlbWriter(), {}
    for joint in two_people(gap=1.0)[1:]:
        numbers[joint.name] = writer.joint(joint.name, numbers.get(joint.parent), translation=list(joint.offset))
    turns = [
        (numbers[name], "rotation", [0, 1], about_y([0, 9]), "LINEAR", "f4") for name in ("Alice_Hips", "Bob_Hips")
    ]
    writer.animation("turn", turns)
    with pytest.raises(UserError, match="seems to hold several people"):
        load_motion(writer.save(tmp_path / "pair.glb"))


def test_a_copy_at_the_same_place_is_the_same_person(tmp_path):
    path = tmp_path / "controls.bvh"
    path.write_text(bvh_of(two_people(gap=0.0, stretch=0.0), {}, np.zeros((3, 3))))
    load_motion(path)


def test_of_a_rider_and_a_horse_the_rider_is_read(tmp_path):
    people = two_people(gap=1.0)
    horse = [joint for joint in people if joint.name.startswith("Bob")]
    tail = Joint("Bob_Tail", horse[0].name, (0.0, 0.0, -0.3))
    found = recognized([*people, tail])
    assert len(found) == 22 and all(name.startswith("Alice") for name in found.values())
