"""VRM animations: what the specification demands of them, and that they give the motion back."""

import numpy as np
import pytest

from t2m_jax import Motion
from t2m_jax.data.importers.synthetic import make_motion
from t2m_jax.errors import UserError
from t2m_jax.export.vrma import EXTENSION, save_vrma
from t2m_jax.motion.gltf_nodes import find_nodes, rest_clip
from t2m_jax.motion.rig.rigs import rig_joint_names
from t2m_jax.motion.skeleton import HUMANML3D
from tests.export.test_glb import Glb
from tests.export.validator import validator_issues

REQUIRED = (
    "hips",
    "spine",
    "head",
    "leftUpperLeg",
    "rightLowerLeg",
    "leftFoot",
    "rightUpperArm",
    "leftLowerArm",
    "rightHand",
)


@pytest.fixture(scope="module")
def motion():
    """A walk whose joints tremble, so that no rigid bones lead to them."""
    positions = make_motion("walk", seed=4, num_frames=50)
    noise = np.random.default_rng(0).normal(size=positions.shape) * 0.005
    return Motion((positions + noise).astype(np.float32), 20.0, caption="a person walks").turned(90)


def test_a_vrm_animation_gives_the_motion_back(tmp_path, motion):
    motion.save(tmp_path / "a.vrma")
    again = Motion.load(tmp_path / "a.vrma")
    np.testing.assert_allclose(again.positions, motion.positions, atol=1e-4)
    assert (again.caption, again.fps) == ("a person walks", 20.0)


def test_bones_of_a_person_only_turn_and_the_hips_move(tmp_path, motion):
    save_vrma(tmp_path / "a.vrma", [motion])
    tree = Glb(tmp_path / "a.vrma").tree
    assert tree["extensionsUsed"] == [EXTENSION] and tree["extensions"][EXTENSION]["specVersion"] == "1.0"
    bones = {name: bone["node"] for name, bone in tree["extensions"][EXTENSION]["humanoid"]["humanBones"].items()}
    assert set(REQUIRED) <= set(bones) == set(rig_joint_names("vrm")) and "meshes" not in tree
    (animation,) = tree["animations"]
    targets = [(channel["target"]["node"], channel["target"]["path"]) for channel in animation["channels"]]
    moved = {node for node, path in targets if path == "translation"}
    assert moved & set(bones.values()) == {bones["hips"]} and len(moved) > 1
    assert {node for node, path in targets if path == "rotation"} == set(bones.values())


def test_the_rest_pose_is_a_t_pose_on_the_floor(tmp_path, motion):
    save_vrma(tmp_path / "a.vrma", [motion])
    clip = rest_clip(find_nodes(Glb(tmp_path / "a.vrma").tree))
    rest = {name: clip.positions[0, place] for place, name in enumerate(clip.joint_names)}
    joints = np.array([rest[name] for name in rig_joint_names("vrm")])
    arms = joints[[HUMANML3D.joint_names.index(f"left_{name}") for name in ("shoulder", "elbow", "wrist")]]
    np.testing.assert_allclose(arms[:, 1:], arms[:1, 1:].repeat(3, 0), atol=1e-5)
    assert (np.diff(arms[:, 0]) > 0.1).all() and joints[:, 1].min() == pytest.approx(0, abs=1e-6)


def test_what_a_vrm_animation_cannot_hold_is_refused(tmp_path, motion, kit_walk):
    with pytest.raises(UserError, match=r"a\.vrma: a \.vrma file holds exactly one motion, not 2"):
        save_vrma(tmp_path / "a.vrma", [motion, motion])
    with pytest.raises(UserError, match=r"a\.vrma: .*the skeleton humanml3d, not kit_ml"):
        save_vrma(tmp_path / "a.vrma", [kit_walk])
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_the_validator_of_khronos_finds_no_error(tmp_path, tmp_path_factory, motion):
    save_vrma(tmp_path / "a.vrma", [motion])
    issues = validator_issues(tmp_path / "a.vrma", tmp_path_factory)
    # It does not know the extension, and tips of limbs have nothing below them.
    assert {message["code"] for message in issues["messages"]} <= {"UNSUPPORTED_EXTENSION", "NODE_EMPTY"}, issues
