import random

import numpy as np
import pytest

from t2m_jax.data.importers.motion_files import open_motion_file
from t2m_jax.errors import UserError
from t2m_jax.export.formats import load_glb_file
from t2m_jax.motion import gltf
from t2m_jax.motion.character import load_character
from t2m_jax.motion.formats import load_motion
from t2m_jax.motion.gltf import load_gltf, load_gltf_animation
from t2m_jax.motion.rig import retarget
from t2m_jax.motion.rig.rigs import RIGS, find_table
from t2m_jax.motion.skeleton import HUMANML3D

from .glb_files import GlbWriter, about_y, edited, name_bones, write_person
from .rig.test_retarget import BANDAI

ARM = {"Root": (None, (0.0, 100.0, 0.0)), "Arm": ("Root", (50.0, 0.0, 0.0)), "Hand": ("Arm", (0.0, 0.0, 20.0))}


def arm(writer=None, **properties):
    """A joint at height 1 with a hand 0.5 to its left."""
    writer = writer or GlbWriter()
    root = writer.joint("Root", translation=[0, 1, 0], **properties)
    return writer, root, writer.joint("Hand", root, translation=[0.5, 0, 0])


def hand_of(writer, tmp_path, **options):
    clip = load_gltf(writer.save(tmp_path / "arm.glb"), **options)["move"]
    return clip.positions[:, clip.joint_names.index("Hand")]


def test_a_turn_is_a_turn_at_constant_speed_and_scales_count(tmp_path):
    path = write_person(tmp_path / "arm.glb", ARM, {"quarter": 90.0, "none": 0.0})
    clips = load_gltf(path, fps=10.0)
    assert list(clips) == ["quarter", "none"] and clips["quarter"].joint_names[0] == "Armature"
    clip = clips["quarter"]
    assert clip.fps == 10 and clip.num_frames == 11
    hand = clip.positions[:, clip.joint_names.index("Hand")]
    angle = np.deg2rad(np.linspace(0, 90, 11))
    expected = np.stack([np.cos(angle) * 0.5 + np.sin(angle) * 0.2, np.ones(11)], axis=1)
    np.testing.assert_allclose(hand[:, :2], expected, atol=1e-6)
    np.testing.assert_allclose(hand[:, 2], np.cos(angle) * 0.2 - np.sin(angle) * 0.5, atol=1e-6)


def test_places_between_keys(tmp_path):
    keys = [[0, 1, 0], [0, 2, 0], [0, 4, 0]]
    for interpolation, expected in (("LINEAR", [1, 1.5, 2, 3, 4]), ("STEP", [1, 1, 2, 2, 4])):
        writer, root, _ = arm()
        writer.animation("move", [(root, "translation", [0, 1, 2], keys, interpolation, "f4")])
        np.testing.assert_allclose(hand_of(writer, tmp_path, fps=2.0)[:, 1], expected, atol=1e-6)


def test_an_animation_begins_with_its_first_key(tmp_path):
    """Scenes begin at frame 1 or 1001, and tracks that never change have one key, at 0."""
    keys = [[0, 1, 0], [0, 2, 0], [0, 4, 0]]
    writer, root, hand = arm()
    tracks = [
        (root, "translation", [5, 6, 7], keys, "LINEAR", "f4"),
        (hand, "translation", [0], [[1, 0, 0]], "STEP", "f4"),
    ]
    writer.animation("move", tracks)
    np.testing.assert_allclose(hand_of(writer, tmp_path, fps=2.0)[:, 1], [1, 1.5, 2, 3, 4], atol=1e-6)


@pytest.mark.parametrize(
    ("frames", "rate", "fps"),
    [
        (np.arange(91), 60, 60),
        (np.arange(1, 3000), 30000 / 1001, 29.97),
        (np.round(np.arange(91) / 30, 3) * 30, 30, 30),
        (np.arange(9), 12, 20),
        (np.array([0, 1, 3, 4, 9]), 30, 20),
    ],
)
def test_the_rate_is_that_of_even_keys(tmp_path, frames, rate, fps):
    """Also if times have three decimals, or each track has other keys; few or uneven ones are no frames of a motion."""
    writer, root, hand = arm()
    times = frames / rate
    places = np.stack([np.sin(40 * times), 0 * times, 0 * times], axis=1)
    kept = [(np.arange(len(times)) % 3 != left_out) | (times == times[-1]) for left_out in (1, 2)]
    writer.animation(
        "move",
        [
            (node, "translation", times[own], places[own], "LINEAR", "f4")
            for node, own in zip((root, hand), kept, strict=True)
        ],
    )
    path = writer.save(tmp_path / "arm.glb")
    clip = load_gltf(path)["move"]
    assert clip.fps == pytest.approx(fps, rel=1e-5) and clip.num_frames == int((times[-1] - times[0]) * fps + 0.05) + 1
    (imported,) = open_motion_file(path).values()
    assert imported.fps == 20, "data stay as they are, whatever the rate of the keys"
    if clip.num_frames == len(frames):
        np.testing.assert_allclose(clip.translations[::3, 1], places[::3], atol=0.02)


def test_steps_are_at_their_frames(tmp_path):
    """The time of a key is a float32, which may be just after its frame."""
    writer, root, _ = arm()
    times = np.arange(60) / 29.0
    writer.animation("move", [(root, "translation", times, np.outer(np.arange(60), [0, 1, 0]), "STEP", "f4")])
    np.testing.assert_array_equal(hand_of(writer, tmp_path)[:, 1], np.arange(60))


def test_cubic_splines_keep_a_parabola(tmp_path):
    """A cubic with the right tangents is exact; their unit is per second, whatever the keys' distance."""
    times = np.array([0.0, 0.5, 2.0])
    values, slopes = times**2, 2 * times
    keys = np.stack([slopes, values, slopes], axis=1).reshape(-1, 1) * [[0, 1, 0]]
    writer, root, _ = arm()
    writer.animation("move", [(root, "translation", times, keys, "CUBICSPLINE", "f4")])
    np.testing.assert_allclose(hand_of(writer, tmp_path, fps=10.0)[:, 1], (np.arange(21) / 10) ** 2, atol=1e-5)


def test_rotations_may_be_integers_and_nodes_may_be_matrices(tmp_path):
    writer = GlbWriter()
    matrix = np.diag([2.0, 2.0, 2.0, 1.0])
    matrix[:3, 3] = 1.0
    above = writer.joint("Above", is_joint=False, matrix=matrix.T.ravel().tolist())
    root = writer.joint("Root", above)
    writer.joint("Hand", root, translation=[0.5, 0, 0])
    turns = np.round(about_y([0, 180]) * 32767)
    writer.animation("move", [(root, "rotation", [0, 1], turns, "STEP", "i2")])
    np.testing.assert_allclose(hand_of(writer, tmp_path, fps=1.0), [[2, 1, 1], [0, 1, 1]], atol=1e-3)


@pytest.mark.parametrize("is_matrix", [True, False])
@pytest.mark.parametrize("scale", [(-1, 1, 1), (1, 1, 1.6), (-1, -1, 2), (-2, -2, -2)])
def test_uneven_scales_move_points_as_gltf_says(tmp_path, scale, is_matrix):
    writer = GlbWriter()
    tilt = [np.sin(0.2), 0, 0, np.cos(0.2)]
    turn = np.array([[1, 0, 0], [0, np.cos(0.4), -np.sin(0.4)], [0, np.sin(0.4), np.cos(0.4)]])
    matrix = np.eye(4)
    matrix[:3, :3] = turn * scale
    placed = {"matrix": matrix.T.ravel().tolist()} if is_matrix else {"rotation": tilt, "scale": scale}
    above = writer.joint("Armature", is_joint=False, **placed)
    root = writer.joint("Root", above, translation=[0, 1, 0])
    writer.joint("Hand", root, translation=[0.5, 0, 0.2])
    writer.animation("move", [(root, "rotation", [0, 1], about_y([0, 90]), "LINEAR", "f4")])
    angle = np.deg2rad(np.linspace(0, 90, 11))
    ahead = np.cos(angle) * 0.2 - np.sin(angle) * 0.5
    local = np.stack([np.cos(angle) * 0.5 + np.sin(angle) * 0.2, np.ones(11), ahead], axis=1)
    np.testing.assert_allclose(hand_of(writer, tmp_path, fps=10.0), local * scale @ turn.T, atol=1e-6)


@pytest.mark.parametrize("has_base", [True, False])
def test_sparse_values_are_those_that_differ(tmp_path, has_base):
    """Blender and optimizers write few values that differ, and no data at all where all are zero."""
    writer, root, _ = arm()
    keys = np.full((4, 3), [0, 1, 0]) if has_base else np.zeros((4, 3))
    writer.animation("move", [(root, "translation", [0, 1, 2, 3], keys, "LINEAR", "f4")])
    track = writer.tree["accessors"][1]
    views = [
        writer.tree["accessors"][writer.accessor(*data)]["bufferView"]
        for data in (([1, 3], "u1"), ([[0, 5, 0], [0, 7, 0]],))
    ]
    track["sparse"] = {
        "count": 2,
        "indices": {"bufferView": views[0], "componentType": 5121},
        "values": {"bufferView": views[1]},
    }
    if not has_base:
        del track["bufferView"]
    base = float(has_base)
    np.testing.assert_allclose(hand_of(writer, tmp_path, fps=1.0)[:, 1], [base, 5, base, 7], atol=1e-6)


def two_figures(path, *, moved):
    """Two figures of the same rig, each with a skin, of which an animation turns some."""
    writer = GlbWriter()
    roots = []
    for _ in range(2):
        roots.append(add_person(writer)["joint_Root"])
    joints = writer.tree["skins"][0]["joints"]
    writer.tree["skins"] = [{"joints": joints[: len(BANDAI)]}, {"joints": joints[len(BANDAI) :]}]
    writer.animation("a", [(roots[one], "rotation", [0, 1], about_y([0, 90]), "LINEAR", "f4") for one in moved])
    return writer.save(path)


@pytest.mark.parametrize("figure", [0, 1])
def test_of_two_figures_the_one_that_moves_is_read(tmp_path, figure):
    clip = load_gltf(two_figures(tmp_path / "two.glb", moved=[figure]), fps=20.0)["a"]
    assert len(clip.joint_names) == len(BANDAI) and not clip.notes
    positions = retarget(clip).positions
    assert np.linalg.norm(positions[-1] - positions[0], axis=-1).max() > 0.5


def test_of_two_figures_that_move_the_first_is_read_and_it_is_said(tmp_path):
    clip = load_gltf(two_figures(tmp_path / "two.glb", moved=[0, 1]), fps=20.0)["a"]
    assert len(clip.joint_names) == len(BANDAI) and "only one of them is read" in clip.notes[0]


def add_person(writer):
    """Adds a person to a file and returns the numbers of its joints."""
    numbers = {}
    for name, (parent, offset) in BANDAI.items():
        numbers[name] = writer.joint(name, numbers.get(parent), translation=[part / 100 for part in offset])
    return numbers


def is_leg(name):
    return any(part in name for part in ("Leg", "Foot", "Toes"))


@pytest.mark.parametrize("turned", ["joint_Root", "Spine"])
def test_skins_that_hang_together_are_one_figure(tmp_path, turned):
    """Body and trousers are two meshes of one person, each with a skin and a tip of the same name."""
    writer = GlbWriter()
    numbers = add_person(writer)
    tips = [writer.joint("End", numbers[name]) for name in ("Hand_L", "Toes_L")]
    legs = [number for name, number in numbers.items() if is_leg(name)]
    body = [number for name, number in numbers.items() if not is_leg(name)]
    writer.tree["skins"] = [{"joints": [*body, tips[0]]}, {"joints": [*legs, tips[1]]}]
    writer.animation("a", [(numbers[turned], "rotation", [0, 1], about_y([0, 90]), "LINEAR", "f4")])
    clip = load_gltf(writer.save(tmp_path / "clothes.glb"), fps=20.0)["a"]
    assert len(clip.joint_names) == len(BANDAI) + 2 and not clip.notes
    assert retarget(clip).positions.shape[1] == 22


def test_what_a_figure_carries_is_not_read_in_its_place(tmp_path, caplog):
    caplog.set_level("INFO")
    writer = GlbWriter()
    hat = writer.joint("joint_Root")
    person = add_person(writer)
    joints = writer.tree["skins"][0]["joints"]
    writer.tree["skins"] = [{"joints": joints[:1]}, {"joints": joints[1:]}]
    tracks = [(number, "rotation", [0, 1], about_y([0, 90]), "LINEAR", "f4") for number in (hat, person["joint_Root"])]
    writer.animation("a", tracks)
    path = writer.save(tmp_path / "hat.glb")
    clip = load_gltf(path, fps=20.0)["a"]
    assert len(clip.joint_names) == len(BANDAI) and "only one of them is read" in clip.notes[0]
    assert len(load_character(path).nodes.names) == len(BANDAI) and "only one of them is read" in caplog.text


def test_a_rig_is_found_and_a_person_stands(tmp_path):
    path = write_person(tmp_path / "person.glb", BANDAI, {"a": 10.0, "Armature|a": 20.0})
    clip = load_gltf(path, fps=20.0)["a"]
    assert find_table(clip.joint_names) is RIGS["bandai-namco"]
    positions = retarget(clip).positions
    assert 0.8 < positions[0, 0, 1] < 1.0 and positions[0, 15, 1] > positions[0, 0, 1] > positions[0, 7, 1]


def broken(change):
    writer, root, _ = arm()
    writer.animation("move", [(root, "rotation", [0, 1], about_y([0, 90]), "LINEAR", "f4")])
    change(writer.tree)
    return writer.data()


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "not a GLB file"),
        (b"{}" * 20, "not a GLB file"),
        (
            broken(lambda tree: (tree.pop("skins"), tree["animations"][0]["channels"][0]["target"].pop("node"))),
            "neither a skin nor an animation of a node",
        ),
        (broken(lambda tree: tree.update(extensions={"VRMC_vrm": {}})), "not a correct GLB"),
        (broken(lambda tree: tree.update(extensions={"VRM": {"humanoid": {"humanBones": [3]}}})), "not a correct GLB"),
        (broken(lambda tree: tree.update(animations=[])), "no animation"),
        (broken(lambda tree: tree["nodes"][1].update(children=[0])), "their own parents"),
        (broken(lambda tree: tree["accessors"][0].update(count=10**9)), "not a correct GLB"),
        (broken(lambda tree: tree["accessors"][1].update(sparse={})), "not a correct GLB"),
        (broken(lambda tree: tree["accessors"][1].update(bufferView=None)), "not a correct GLB"),
        (
            broken(lambda tree: (tree["accessors"][1].pop("bufferView"), tree["accessors"][1].update(count=10**9))),
            "no data",
        ),
        (broken(lambda tree: tree["bufferViews"][0].update(buffer=1)), "another file"),
        (
            broken(lambda tree: tree["bufferViews"][0].update(extensions={"EXT_meshopt_compression": {}})),
            "are compressed .EXT_meshopt_compression.",
        ),
        (broken(lambda tree: tree["animations"][0].update(channels=7)), "not a correct GLB"),
        (broken(lambda tree: tree["nodes"][0].update(translation=[1, 2])), "not a correct GLB"),
        (broken(lambda tree: tree["nodes"][0].update(translation=[1, 2, float("nan")])), "not a finite number"),
    ],
)
def test_refusals_name_the_file(tmp_path, data, words):
    path = tmp_path / "broken.glb"
    path.write_bytes(data)
    with pytest.raises(UserError, match=words) as refusal:
        load_gltf(path)
    assert str(path) in str(refusal.value) and len(str(refusal.value)) < 400


def test_a_very_long_animation_is_refused(tmp_path):
    writer, root, _ = arm()
    writer.animation("move", [(root, "rotation", [0, 1e9], about_y([0, 90]), "LINEAR", "f4")])
    with pytest.raises(UserError, match="1e\\+09 seconds"):
        load_gltf(writer.save(tmp_path / "long.glb"))


@pytest.mark.slow
def test_many_joints_are_read_in_time_and_too_many_poses_are_refused(tmp_path, monkeypatch):
    """A chain of 20,000 joints would take hours if each walked up to the root."""
    writer = GlbWriter()
    joint = None
    for number in range(20_000):
        joint = writer.joint(f"Joint{number}", joint, translation=[0, 0.001, 0])
    writer.animation("move", [(joint, "rotation", [0, 0.2], about_y([0, 90]), "LINEAR", "f4")])
    clip = load_gltf(writer.save(tmp_path / "chain.glb"), fps=20.0)["move"]
    assert clip.parents[0] == -1 and clip.positions[0, -1, 1] == pytest.approx(20.0, rel=1e-3)
    monkeypatch.setattr(gltf, "MAX_POSES", 30_000)
    with pytest.raises(UserError, match="more than 30000 poses"):
        load_gltf(tmp_path / "chain.glb")


def test_damaged_files_are_read_or_refused(tmp_path):
    """Flipped bytes and cut files: nothing but a `UserError` comes out."""
    whole, generator = bytearray(broken(lambda tree: None)), random.Random(3)
    path = tmp_path / "damaged.glb"
    for trial in range(300):
        data = bytearray(whole)
        for _ in range(generator.randint(1, 4)):
            data[generator.randrange(len(data))] = generator.randrange(256)
        path.write_bytes(data[: generator.randrange(len(data))] if trial % 3 == 0 else data)
        try:
            clips = load_gltf(path)
        except UserError:
            continue
        assert all(np.isfinite(clip.positions).all() for clip in clips.values())


def test_a_file_with_only_an_animation_is_read_as_one_with_a_skin(tmp_path):
    path = write_person(tmp_path / "person.glb", BANDAI, {"turn": 40.0})
    expected = load_glb_file(path)
    path = edited(path, lambda tree: tree.pop("skins"))
    np.testing.assert_array_equal(load_glb_file(path).positions, expected.positions)


@pytest.mark.parametrize("version", ["VRM", "VRMC_vrm", "VRMC_vrm_animation"])
def test_bones_that_a_vrm_file_names_are_a_person_whatever_its_nodes_are_called(tmp_path, version):
    path = write_person(tmp_path / "person.glb", BANDAI, {"turn": 40.0})
    expected = load_glb_file(path)

    path = edited(path, lambda tree: name_bones(tree, version))
    np.testing.assert_allclose(load_glb_file(path).positions, expected.positions, atol=0.06)


def test_a_vrm_animation_of_another_program(shared_data):
    motion = load_glb_file(shared_data("foreign-files") / "foreign-files/three-vrm_test.vrma")
    pose = dict(zip(HUMANML3D.joint_names, motion.positions[0], strict=True))
    assert motion.num_frames == 61 and pose["pelvis"][1] == pytest.approx(0.85, abs=1e-3)
    assert abs(motion.positions[..., 1].min()) < 0.01 and pose["left_hip"][0] > 0 > pose["right_hip"][0]
    moving = np.ptp(motion.positions, axis=0).max(axis=-1) > 1e-3
    assert [name for name, moves in zip(HUMANML3D.joint_names, moving, strict=True) if moves] == [
        "right_elbow", "right_wrist"
    ]  # fmt: skip


def test_an_animation_that_moves_nothing_is_none(tmp_path):
    path = write_person(tmp_path / "person.glb", BANDAI, {"turn": 40.0, "bow": 20.0})
    path = edited(path, lambda tree: tree["animations"][0].update(channels=[]))
    assert list(load_gltf(path)) == ["bow"]
    path = edited(path, lambda tree: tree["animations"][1].pop("channels"))
    with pytest.raises(UserError, match=r"has no animation$"):
        load_glb_file(path)


@pytest.mark.parametrize("has_skin", [True, False])
def test_animations_of_a_camera_are_not_of_the_figure(tmp_path, has_skin):
    writer = GlbWriter()
    person = add_person(writer)
    camera = writer.joint("Camera", is_joint=False)
    swing = [(camera, "rotation", [0, 1], about_y([0, 90]), "LINEAR", "f4")]
    writer.animation("camera", swing)
    writer.animation("turn", [(person["joint_Root"], "rotation", [0, 1], about_y([0, 90]), "LINEAR", "f4")])
    if not has_skin:  # the nodes that have names of a person are its joints
        writer.tree["extensions"] = {"VRMC_vrm": {"humanoid": {"humanBones": {"hips": {"node": person["Hips"]}}}}}
        del writer.tree["skins"]
    path = writer.save(tmp_path / "scene.glb")
    assert load_gltf_animation(path).caption == "turn" and list(load_gltf(path)) == ["turn"]
    with pytest.raises(UserError, match="no animation 'camera'; choose one of turn"):
        load_gltf_animation(path, "camera")


def test_a_rig_without_an_animation_is_said(shared_data):
    with pytest.raises(UserError, match=r"m2m_rig_human\.glb: has no animation$"):
        load_glb_file(shared_data("foreign-files") / "foreign-files/m2m_rig_human.glb")


def test_z_up_is_said_and_can_be_chosen(tmp_path, caplog):
    caplog.set_level("INFO")
    z_up = {name: (parent, (x, -z, y)) for name, (parent, (x, y, z)) in BANDAI.items()}
    expected = load_glb_file(write_person(tmp_path / "person.glb", BANDAI, {"bow": 0.0})).positions
    path = write_person(tmp_path / "z.glb", z_up, {"bow": 0.0})
    assert np.ptp(load_glb_file(path).positions[0, :, 1]) < 0.6 and "THE FIGURE LIES with Y up" in caplog.text
    caplog.clear()
    np.testing.assert_allclose(load_motion(path, up="z").positions, expected, atol=1e-5)
    # Somebody who lies, with a rest pose that stands.
    lying = GlbWriter()
    root = add_person(lying)["joint_Root"]
    back = [np.sqrt(0.5), 0, 0, np.sqrt(0.5)]
    lying.animation("lie", [(root, "rotation", [0, 1], [back, back], "LINEAR", "f4")])
    assert np.ptp(load_glb_file(lying.save(tmp_path / "lie.glb")).positions[0, :, 1]) < 0.6 and not caplog.text


def test_lengths_of_a_file_in_centimeters_are_meters(tmp_path, caplog):
    caplog.set_level("INFO")
    path = write_person(tmp_path / "person.glb", BANDAI, {"turn": 40.0})
    expected = load_glb_file(path)
    assert not caplog.text
    path = edited(path, lambda tree: tree["nodes"][0].pop("scale"))
    np.testing.assert_allclose(load_glb_file(path).positions, expected.positions, atol=1e-4)
    assert "lengths are taken as centimeters" in caplog.text


def test_only_the_animation_that_is_asked_for_is_read(tmp_path, monkeypatch):
    path = write_person(tmp_path / "person.glb", BANDAI, {"a": 10.0, "Armature|b": 20.0, "c": 30.0})
    read = []
    sample = gltf._sample
    monkeypatch.setattr(
        gltf,
        "_sample",
        lambda glb, nodes, animation, **o: read.append(animation["name"]) or sample(glb, nodes, animation, **o),
    )
    assert load_glb_file(path, animation="b").caption == "b" and read == ["Armature|b"]
    with pytest.raises(UserError, match=r"has several animations; choose one of a, Armature\|b, c"):
        load_glb_file(path)
    assert read == ["Armature|b"]


def test_animations_of_one_name_are_all_read(tmp_path):
    writer, root, _ = arm()
    for name, degrees in (("a", 10), ("a_2", 20), ("a", 30), ("a", 40)):
        writer.animation(name, [(root, "rotation", [0, 1], about_y([0, degrees]), "LINEAR", "f4")])
    clips = load_gltf(writer.save(tmp_path / "arm.glb"))
    assert list(clips) == ["a", "a_2", "a_3", "a_4"]
    ends = [clip.positions[-1, clip.joint_names.index("Hand"), 2] for clip in clips.values()]
    assert np.all(np.diff(ends) < 0), "each is another motion"
