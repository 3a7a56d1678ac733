"""GLB files: a figure in T-pose, its animations, and what programs need to read them."""

import json
import struct

import numpy as np
import pytest

from t2m_jax import Motion
from t2m_jax.cli.main import main
from t2m_jax.data.importers.motion_files import open_motion_file
from t2m_jax.data.importers.synthetic import make_motion
from t2m_jax.errors import UserError
from t2m_jax.export.glb import save_glb
from t2m_jax.export.skin import make_skin
from t2m_jax.motion.formats import load_motion
from t2m_jax.motion.gltf import load_gltf
from t2m_jax.motion.kinematics import forward_kinematics
from t2m_jax.motion.rig.rigs import rig_joint_names
from t2m_jax.motion.skeleton import HUMANML3D
from tests.export.validator import validator_issues
from tests.motion.glb_files import write_person
from tests.motion.rig.test_retarget import BANDAI

NAMES = ("lafan1", "humanml3d", "mixamo", "vrm", "unreal")
COMPONENTS = {5126: "<f4", 5123: "<u2", 5125: "<u4", 5121: "u1"}
COLUMNS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}


def make(kind="walk", *, num_frames=50, seed=4, **fields):
    return Motion(make_motion(kind, seed=seed, num_frames=num_frames), 20.0, **fields)


class Glb:
    """A file as its JSON and its arrays."""

    def __init__(self, path):
        data = path.read_bytes()
        magic, number, length = struct.unpack_from("<III", data)
        assert (magic, number, length) == (0x46546C67, 2, len(data))
        size = struct.unpack_from("<I", data, 12)[0]
        self.tree = json.loads(data[20 : 20 + size])
        binary = data[28 + size :]
        assert len(binary) == self.tree["buffers"][0]["byteLength"]
        self.arrays = []
        for accessor in self.tree["accessors"]:
            view = self.tree["bufferViews"][accessor["bufferView"]]
            assert view["byteOffset"] % 4 == 0
            raw = binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
            columns = COLUMNS[accessor["type"]]
            array = np.frombuffer(raw, COMPONENTS[accessor["componentType"]]).reshape(-1, columns)
            assert len(array) == accessor["count"]
            if "min" in accessor:
                np.testing.assert_array_equal(array.min(axis=0), np.float32(accessor["min"]))
                np.testing.assert_array_equal(array.max(axis=0), np.float32(accessor["max"]))
            self.arrays.append(array)


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "a.glb"
    make(caption="a person walks").save(path)
    return Glb(path)


@pytest.mark.parametrize("names", NAMES)
@pytest.mark.parametrize("suffix", ["glb", "bvh"])
def test_joints_have_the_chosen_names_and_are_read_again(tmp_path, names, suffix):
    motion = make(caption="a person walks")
    motion.save(tmp_path / f"a.{suffix}", names=names)
    assert f'"{rig_joint_names(names)[20]}"' in (tmp_path / f"a.{suffix}").read_text("latin-1").replace(
        " ", '"'
    ).replace("\n", '"')
    again = Motion.load(tmp_path / f"a.{suffix}")
    assert again.num_frames == motion.num_frames and again.fps == pytest.approx(20, rel=1e-6)
    assert np.linalg.norm(again.positions - motion.positions, axis=-1).max() < 5e-3


@pytest.mark.parametrize("names", NAMES)
def test_all_names_differ(names):
    assert len(set(rig_joint_names(names))) == 22


@pytest.mark.parametrize("suffix", ["glb", "bvh"])
def test_centimeters(tmp_path, suffix):
    motion = make()
    motion.save(tmp_path / f"a.{suffix}", units="cm")
    assert np.linalg.norm(Motion.load(tmp_path / f"a.{suffix}").positions - motion.positions, axis=-1).max() < 5e-3
    if suffix == "glb":
        hips = Glb(tmp_path / "a.glb").tree["nodes"][0]["translation"]
        assert 80 < hips[1] < 100


def test_joints_are_exactly_where_they_were(tmp_path):
    shaken = make(caption="shaken")
    rough = np.random.default_rng(0).normal(size=shaken.positions.shape) * 0.01
    shaken = Motion(shaken.positions + rough, 20.0)
    shaken.save(tmp_path / "a.glb")
    np.testing.assert_allclose(Motion.load(tmp_path / "a.glb").positions, shaken.positions, atol=2e-5)


@pytest.mark.parametrize("fps", [12.5, 24, 30, 60])
def test_other_frame_rates(tmp_path, fps):
    motion = make().resampled(fps)
    motion.save(tmp_path / "a.glb")
    again = Motion.load(tmp_path / "a.glb")
    assert (again.fps, again.num_frames) == (fps, motion.num_frames)
    np.testing.assert_allclose(again.positions, motion.positions, atol=1e-4)
    file = Glb(tmp_path / "a.glb")
    frames = file.arrays[file.tree["animations"][0]["samplers"][0]["input"]].ravel() * fps
    # Programs whose scene has this frame rate, as Blender's at first with 24, have each key on a whole frame.
    np.testing.assert_allclose(frames, np.arange(motion.num_frames), atol=1e-3)


def test_the_rest_pose_is_a_t_pose_on_the_ground(file):
    nodes = file.tree["nodes"][:22]
    translations = np.array([node["translation"] for node in nodes])
    assert not any("rotation" in node or "scale" in node for node in nodes)
    rest = forward_kinematics(np.tile(np.eye(3), (22, 1, 1)), translations, HUMANML3D.parents).positions
    joint = dict(zip(HUMANML3D.joint_names, rest, strict=True))
    assert rest[:, 1].min() == pytest.approx(0, abs=1e-6)
    for side, sign in (("left", 1), ("right", -1)):
        arm = np.array([joint[f"{side}_{name}"] for name in ("shoulder", "elbow", "wrist")])
        np.testing.assert_allclose(arm[:, 1:], arm[:1, 1:].repeat(3, 0), atol=1e-5)
        assert (np.diff(arm[:, 0]) * sign > 0.1).all()
        assert joint[f"{side}_foot"][2] > joint[f"{side}_ankle"][2] + 0.05  # faces +Z
    inverse = file.arrays[file.tree["skins"][0]["inverseBindMatrices"]].reshape(22, 4, 4)
    np.testing.assert_allclose(inverse[:, 3, :3], -rest, atol=1e-6)
    np.testing.assert_array_equal(inverse[:, :, 3], np.tile([0, 0, 0, 1], (22, 1)))


def test_the_skin_is_closed_and_moves_with_the_joints(file):
    corners = 0
    for primitive in file.tree["meshes"][0]["primitives"]:
        attributes = {name: file.arrays[number] for name, number in primitive["attributes"].items()}
        np.testing.assert_array_equal(attributes["WEIGHTS_0"], np.tile([255, 0, 0, 0], (len(attributes["NORMAL"]), 1)))
        assert attributes["JOINTS_0"].max() < 22 and not attributes["JOINTS_0"][:, 1:].any()
        np.testing.assert_allclose(np.linalg.norm(attributes["NORMAL"], axis=-1), 1, atol=1e-5)
        triangles = file.arrays[primitive["indices"]].reshape(-1, 3)
        assert triangles.max() < len(attributes["NORMAL"])
        places = attributes["POSITION"][triangles].astype(float)
        faces = np.cross(places[:, 1] - places[:, 0], places[:, 2] - places[:, 0])
        outwards = np.sum(faces * attributes["NORMAL"][triangles].mean(axis=1), axis=-1)
        assert (outwards > -1e-9).all()
        corners += len(triangles)
    assert 3_000 < corners < 30_000


def test_hands_feet_and_head_of_the_skin_follow_their_joints():
    rest = make().positions[0].astype(float)
    parts = {part.tint: part for part in make_skin(rest, HUMANML3D)}
    named = {name: number for number, name in enumerate(HUMANML3D.joint_names)}
    assert set(parts) == {"body", "left", "right", "face"}
    assert set(parts["face"].joints) == {named["head"]}
    for side in ("left", "right"):
        limbs = ("hip", "knee", "ankle", "foot", "shoulder", "elbow", "wrist")
        assert set(parts[side].joints) == {named[f"{side}_{name}"] for name in limbs}


def test_rotations_have_unit_length_and_do_not_jump(file):
    (animation,) = file.tree["animations"]
    for channel in animation["channels"]:
        sampler = animation["samplers"][channel["sampler"]]
        times, values = file.arrays[sampler["input"]], file.arrays[sampler["output"]]
        assert len(times) == len(values) and times[0] == 0 and (np.diff(times[:, 0]) > 0).all()
        if channel["target"]["path"] == "rotation":
            np.testing.assert_allclose(np.linalg.norm(values, axis=-1), 1, atol=1e-5)
            assert (np.sum(values[1:] * values[:-1], axis=-1) > 0).all()
    assert animation["extras"] == {"caption": "a person walks", "fps": 20.0, "frames": 50}


def test_several_motions_are_several_animations(tmp_path, capsys):
    tall = make("squat", caption="a person walks")
    motions = [make(caption="a person walks"), Motion(tall.positions * 1.2, 20.0, caption=tall.caption), make("walk")]
    for number, motion in enumerate(motions):
        motion.save(tmp_path / f"{number}.npz")
    files = [f"{tmp_path / str(number)}.npz" for number in range(3)]
    assert main(["view", *files, "-o", f"{tmp_path / 'all.glb'}", "--names", "vrm"]) == 0
    assert list(load_gltf(tmp_path / "all.glb")) == ["a person walks", "a person walks 2", "motion"]
    output = ["-o", f"{tmp_path / 'b.npz'}"]
    assert main(["view", f"{tmp_path / 'all.glb'}", "--animation", "a person walks 2", *output]) == 0
    again = Motion.load(tmp_path / "b.npz")
    np.testing.assert_allclose(again.positions, motions[1].positions, atol=1e-4)
    assert again.caption == "a person walks"
    capsys.readouterr()
    assert main(["view", f"{tmp_path / 'all.glb'}", *output]) == 2
    assert "has several animations; choose one of" in capsys.readouterr().err


def test_a_caption_keeps_what_is_before_a_bar(tmp_path):
    make(caption="left | right | a person walks").save(tmp_path / "a.glb")
    assert Motion.load(tmp_path / "a.glb").caption == "left | right | a person walks"
    path = write_person(tmp_path / "b.glb", BANDAI, {"Armature|walk | fast": 20.0, "fast": 0.0})
    assert load_motion(path, animation="walk | fast").caption == "walk | fast"
    assert {motion.animation for motion in open_motion_file(path)} == {"walk | fast", "fast"}


def test_animations_of_two_armatures_keep_their_names(tmp_path):
    animations = {"Armature|walk": 20.0, "Hips|walk": 0.0, "a|b": 0.0, "b": 0.0}
    found = open_motion_file(write_person(tmp_path / "a.glb", BANDAI, animations))
    assert [motion.animation for motion in found] == ["Armature|walk", "Hips|walk", "a|b", "b"]


def test_motions_with_one_caption_are_all_read_again(tmp_path):
    motions = [make(seed=seed, caption=caption) for seed, caption in enumerate(("a 3", "a", "a", "a"))]
    save_glb(tmp_path / "a.glb", motions)
    found = load_gltf(tmp_path / "a.glb")
    assert list(found) == ["a 3", "a", "a 4", "a 5"] and {clip.caption for clip in found.values()} == {"a 3", "a"}


@pytest.mark.parametrize("caption", ["", 'ein Mann läuft \N{WAVING HAND SIGN} "quoted" \\ </script>', "\u2028" * 50])
def test_one_frame_and_any_caption(tmp_path, caption):
    make(caption=caption)[:1].save(tmp_path / "a.glb")
    assert Glb(tmp_path / "a.glb").tree["animations"][0]["extras"]["caption"] == caption
    assert Motion.load(tmp_path / "a.glb").num_frames == 1


def test_notes_of_other_programs_are_not_taken_for_own(tmp_path):
    path = tmp_path / "a.glb"
    make().resampled(10).save(path, units="cm")
    (own,) = load_gltf(path).values()
    path.write_bytes(path.read_bytes().replace(b'"t2m_jax ', b'"blender '))
    (foreign,) = load_gltf(path).values()
    assert (own.fps, foreign.fps) == (10, 20)
    np.testing.assert_allclose(foreign.offsets, own.offsets, rtol=1e-3)  # by the size of a person
    assert foreign.metres_per_unit == pytest.approx(0.01) and foreign.notes


def test_what_cannot_be_written_is_refused(tmp_path, kit_walk):
    with pytest.raises(UserError, match="GLB files are written for the skeleton humanml3d, not kit_ml"):
        kit_walk.save(tmp_path / "a.glb")
    with pytest.raises(UserError, match="there is no motion to write"):
        save_glb(tmp_path / "a.glb", [])
    with pytest.raises(UserError, match=r"names: 'blender' is unknown; known is lafan1, humanml3d"):
        make().save(tmp_path / "a.glb", names="blender")
    with pytest.raises(UserError, match=r"units: 'cm' is unknown; known is nothing, because .npz files have no such"):
        make().save(tmp_path / "a.npz", units="cm")
    assert list(tmp_path.iterdir()) == []


def test_options_are_for_the_files_that_have_them(tmp_path):
    make().save(tmp_path / "a.npz")
    outputs = ["-o", f"{tmp_path / 'b.glb'}", "-o", f"{tmp_path / 'b.npz'}"]
    assert main(["view", f"{tmp_path / 'a.npz'}", *outputs, "--names", "unreal", "--units", "cm"]) == 0
    assert Glb(tmp_path / "b.glb").tree["nodes"][0]["name"] == "pelvis"
    assert main(["view", f"{tmp_path / 'a.npz'}", "-o", f"{tmp_path / 'b.html'}", "--names", "unreal"]) == 2


@pytest.mark.slow
@pytest.mark.parametrize("names", NAMES)
def test_the_validator_of_khronos_finds_nothing(tmp_path, tmp_path_factory, names):
    motions = [make(kind, caption=kind, seed=seed) for seed, kind in enumerate(("walk", "squat", "wave-left-hand"))]
    root_bone = names in ("unreal", "vrm")
    save_glb(tmp_path / "a.glb", motions, names=names, units="cm" if names == "unreal" else "m", root_bone=root_bone)
    issues = validator_issues(tmp_path / "a.glb", tmp_path_factory)
    assert [issues[f"num{kind}"] for kind in ("Errors", "Warnings", "Infos", "Hints")] == [0, 0, 0, 0], issues
