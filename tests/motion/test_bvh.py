import itertools
import re
from pathlib import Path

import numpy as np
import pytest

from t2m_jax.data.importers.synthetic import make_motion
from t2m_jax.errors import UserError
from t2m_jax.motion.bvh import load_bvh, save_bvh
from t2m_jax.motion.bvh.writer import continuous_euler
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.rotations import matrix_from_euler
from t2m_jax.motion.skeleton import HUMANML3D, KIT_ML

from .figures import ARM_BVH, INDEX, bvh_text, walking_positions


def write(tmp_path: Path, text: str | bytes) -> Path:
    path = tmp_path / "clip.bvh"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def axis_rotation(axis: str, degrees: float) -> np.ndarray:
    cos, sin = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    return {
        "X": np.array([[1, 0, 0], [0, cos, -sin], [0, sin, cos]]),
        "Y": np.array([[cos, 0, sin], [0, 1, 0], [-sin, 0, cos]]),
        "Z": np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]]),
    }[axis]


def read_bvh_independently(path: Path) -> tuple[list[str], np.ndarray, np.ndarray, np.ndarray]:
    """Returns names, OFFSETs, world positions in the rest pose and in all frames, adding positions to OFFSETs."""
    head, motion = path.read_text(encoding="utf-8").split("MOTION\n")
    names, offsets, parents, channels, stack = [], [], [], [], []
    words = iter(head.split())
    for word in words:
        if word in ("ROOT", "JOINT"):
            parents.append(stack[-1] if stack else None)
            stack.append(len(names))
            names.append(next(words))
        elif word == "End":
            stack.append(None)
        elif word == "OFFSET":
            vector = [float(next(words)) for _ in range(3)]
            if stack[-1] is not None:
                offsets.append(np.array(vector))
        elif word == "CHANNELS":
            channels.append([next(words) for _ in range(int(next(words)))])
        elif word == "}":
            stack.pop()
    rows = [[float(value) for value in line.split()] for line in motion.splitlines()[2:]]

    def pose(row: list[float]) -> np.ndarray:
        values, world, places = iter(row), [], []
        for joint, parent in enumerate(parents):
            turn, place = np.eye(3), offsets[joint].copy()
            for channel in channels[joint]:
                value = next(values)
                if channel.endswith("position"):
                    place["XYZ".index(channel[0])] += value
                else:
                    turn = turn @ axis_rotation(channel[0], value)
            world.append(turn if parent is None else world[parent] @ turn)
            places.append(place if parent is None else places[parent] + world[parent] @ place)
        return np.array(places)

    rest = pose([0.0] * len(rows[0]))
    return names, np.array(offsets), rest, np.array([pose(row) for row in rows])


def test_names_offsets_and_positions_are_read(tmp_path):
    clip = load_bvh(write(tmp_path, ARM_BVH))
    assert clip.joint_names == ("Hips", "Arm", "Hand")
    assert clip.parents == (-1, 0, 1)
    assert (clip.fps, clip.metres_per_unit, clip.num_frames) == (30.0, 0.01, 2)
    np.testing.assert_allclose(clip.offsets, [[0, 0.9, 0], [0.3, 0, 0], [0.4, 0, 0]], atol=1e-7)
    np.testing.assert_allclose(clip.positions[0], [[0, 0.9, 0], [0.3, 0.9, 0], [0.7, 0.9, 0]], atol=1e-6)
    # Facing +X after the turn about Y, the arm points to -Z, and its own turn about Z raises the hand.
    np.testing.assert_allclose(
        clip.positions[1], [[0.01, 0.92, 0.03], [0.01, 0.92, -0.27], [0.01, 1.32, -0.27]], atol=1e-6
    )


@pytest.mark.parametrize("order", ["".join(letters) for letters in itertools.permutations("XYZ")])
def test_rotation_channels_multiply_in_the_order_of_the_file(tmp_path, order):
    angles = np.array([25.0, -70.0, 140.0])
    joints = {"Hips": (None, (0, 0, 0)), "Tip": ("Hips", (50, 20, 10))}
    channels = " ".join(f"{axis}rotation" for axis in order)
    frames = np.concatenate((angles, np.zeros(6), np.zeros(3)))[None]
    text = bvh_text(
        joints,
        frames,
        root_channels=f"{channels} Zposition Xposition Yposition",
        channels=f"{channels} Xposition Yposition Zposition",
    )
    clip = load_bvh(write(tmp_path, text), root_positions="add")
    first, second, third = (axis_rotation(axis, angle) for axis, angle in zip(order, angles, strict=True))
    np.testing.assert_allclose(clip.rotations[0, 0], first @ second @ third, atol=1e-6)
    np.testing.assert_allclose(clip.positions[0, 1], first @ second @ third @ (0.5, 0.2, 0.1), atol=1e-6)


def test_axes_without_a_channel_do_not_turn(tmp_path):
    joints = {"Hips": (None, (0, 0, 0)), "Tip": ("Hips", (0, 50, 0))}
    text = bvh_text(joints, np.array([[30.0]]), root_channels="Xrotation", channels="")
    clip = load_bvh(write(tmp_path, text))
    np.testing.assert_allclose(clip.rotations[0, 0], axis_rotation("X", 30), atol=1e-6)
    np.testing.assert_array_equal(clip.rotations[0, 1], np.eye(3))


MOVING_JOINTS = {"Root": (None, (0.0, 0.0, 0.0)), "Hips": ("Root", (30.0, 95.0, -4.0))} | {
    name: (parent, (0.0, 20.0, 5.0)) for name, parent in (("Spine", "Hips"), ("Neck", "Spine"), ("Head", "Neck"))
}
SIX = "Xposition Yposition Zposition Zrotation Xrotation Yrotation"


def moving_frames(bone: tuple[float, float, float]) -> np.ndarray:
    row = [100, 0, 0, 0, 0, 90] + [0, 90, 10, 0, 0, 0] + [*bone, 0, 0, 0] * 3
    return np.array([row, row], dtype=float)


def test_position_channels_that_repeat_offset_replace_it(tmp_path):
    text = bvh_text(MOVING_JOINTS, moving_frames((0, 20, 5)), root_channels=SIX, channels=SIX)
    clip = load_bvh(write(tmp_path, text), metres_per_unit=1.0)
    # The upper root travels and turns by 90 degrees, which takes the hips' +Z to +X.
    np.testing.assert_allclose(clip.positions[0, :3], [[100, 0, 0], [110, 90, 0], [115, 110, 0]], atol=1e-4)


def test_position_channels_of_zero_add_to_offset(tmp_path):
    text = bvh_text(MOVING_JOINTS, moving_frames((0, 0, 0)), root_channels=SIX, channels=SIX)
    clip = load_bvh(write(tmp_path, text), metres_per_unit=1.0)
    np.testing.assert_allclose(clip.positions[0, 2] - clip.positions[0, 1], [5, 20, 0], atol=1e-4)
    np.testing.assert_allclose(clip.translations[0, 1], [30, 185, 6], atol=1e-4)


def test_root_positions_can_be_ruled_absolute(tmp_path):
    clip = load_bvh(write(tmp_path, ARM_BVH), root_positions="absolute")
    np.testing.assert_allclose(clip.positions[1, 0], [0.01, 0.02, 0.03], atol=1e-6)


@pytest.mark.parametrize(("scale", "metres_per_unit"), [(0.01, 1.0), (1.0, 0.01), (10.0, 0.001)])
def test_the_unit_is_told_from_the_size_of_the_figure(tmp_path, scale, metres_per_unit):
    joints = {
        "Reference": (None, (0.0, 0.0, 0.0)),
        "Hips": ("Reference", (0.0, 95 * scale, 0.0)),
        "Leg": ("Hips", (0.0, -45 * scale, 0.0)),
        "Foot": ("Leg", (0.0, -40 * scale, 0.0)),
        "Spine": ("Hips", (0.0, 60 * scale, 0.0)),
    }
    far_away = np.concatenate((np.array([800, 0, 900]) * scale, np.zeros(15)))[None]
    clip = load_bvh(write(tmp_path, bvh_text(joints, far_away)))
    assert clip.metres_per_unit == metres_per_unit
    np.testing.assert_allclose(clip.positions[0, 3], [8, 0.1, 9], atol=1e-5)


@pytest.mark.parametrize(
    ("written", "fps"),
    [
        *(("0.0333333", 30), ("0.033", 30), ("0.016667", 60), ("0.008333", 120), ("0.05", 20), ("1", 1), ("5e-2", 20)),
        *(("0.017", 60), ("0.011", 90), ("0.014", 72), ("0.008", 125), ("0." + "3" * 40, 1 / 0.33333333333333331)),
        *(("0.016666", 60), ("0.0083", 120), ("3.33333e-02", 30), ("0.04", 25)),
        *(("0.04170", 1 / 0.0417), ("0.0333667", 1 / 0.0333667), ("0.08", 12.5)),
    ],
)
def test_rounded_frame_times_mean_whole_rates(tmp_path, written, fps):
    clip = load_bvh(write(tmp_path, ARM_BVH.replace("0.0333333", written)))
    assert clip.fps == pytest.approx(fps, rel=1e-12)


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text.replace("\n", "\r\n"),
        lambda text: text.replace("\n", "\r"),
        lambda text: text.replace("  ", "\t").replace("Frames: ", "Frames:\t"),
        lambda text: "\ufeff" + text,
        lambda text: text + "\n  \n",
        lambda text: text.rstrip("\n"),
        lambda text: text.replace("1 2 3 0 0 90", "1e0 +2.0 3.000E+00 -0 0. .9e2"),
        lambda text: text.replace("HIERARCHY", "hierarchy").replace("Xrotation", "XROTATION").replace("JOINT", "Joint"),
        lambda text: text.replace("Hips\n{", "Hips {").replace("MOTION\nFrames", "MOTION\n\nFrames"),
        lambda text: text.replace("\nEnd", "\n    End").replace("CHANNELS 6 Xposition", "CHANNELS 6\nXposition"),
    ],
)
def test_harmless_differences_of_spelling_are_accepted(tmp_path, change):
    expected = load_bvh(write(tmp_path, ARM_BVH))
    clip = load_bvh(write(tmp_path, change(ARM_BVH)))
    np.testing.assert_array_equal(clip.positions, expected.positions)
    assert clip.joint_names == expected.joint_names


@pytest.mark.parametrize(
    ("encoding", "names"),
    [
        ("utf-8", ("\u5de6\u8155", "\u53f3\u8155")),
        ("cp932", ("\u5de6\u8155", "\u30bd\u3067")),  # the second byte of \u30bd is a backslash
        ("gb18030", ("\u5de6\u81c2", "\u5de6\u624b")),
        ("latin-1", ("H\xfcfte", "Fu\xdf")),
        ("cp1251", ("\u0422\u0430\u0437", "\u041d\u043e\u0433")),
    ],
)
def test_names_of_old_encodings_stay_different(tmp_path, encoding, names):
    text = ARM_BVH.replace("Arm", names[0]).replace("Hand", names[1])
    found = load_bvh(write(tmp_path, text.encode(encoding))).joint_names[1:]
    assert len(set(found)) == 2 and (found == names or encoding == "cp1251")


def test_frames_on_several_lines_and_comments_before_the_first_are_read(tmp_path):
    expected = load_bvh(write(tmp_path, ARM_BVH))
    head, _, rows = ARM_BVH.partition("Frame Time: 0.0333333\n")
    wrapped = "\n".join(" ".join(row.split()[first : first + 5]) for row in rows.splitlines() for first in (0, 5, 10))
    text = f"# by hand\n\n// twice\n{head}Frame Time: 0.0333333\n{wrapped}\n"
    np.testing.assert_array_equal(load_bvh(write(tmp_path, text)).positions, expected.positions)
    for bad, line in ((text.replace("OFFSET 30", "OFFSET x"), 11), (text.removesuffix("0\n"), 27)):
        with pytest.raises(UserError, match=rf":{line}: "):
            load_bvh(write(tmp_path, bad))


def test_angles_that_seem_to_be_radians_are_said(tmp_path):
    save_bvh(tmp_path / "walk.bvh", Motion(positions=walking_positions(), fps=20.0))
    head, rows = re.split(r"(?<=Frame Time: 0\.05)0*\n", (tmp_path / "walk.bvh").read_text())
    frames = np.array([row.split() for row in rows.splitlines()], float)
    assert not load_bvh(tmp_path / "walk.bvh").notes
    frames[:, 3:] = np.deg2rad(frames[:, 3:])
    for factor, is_said in ((1.0, True), (0.01, False)):  # who only slides is not in radians
        table = np.concatenate([frames[:, :3], frames[:, 3:] * factor], axis=1)
        text = "\n".join(" ".join(map(repr, row)) for row in table.tolist())
        notes = load_bvh(write(tmp_path, f"{head}\n{text}\n")).notes
        assert any("may be radians" in note for note in notes) == is_said


def test_joint_names_may_hold_spaces_and_namespaces(tmp_path):
    clip = load_bvh(write(tmp_path, ARM_BVH.replace("JOINT Arm", "JOINT mixamorig:Left Arm")))
    assert clip.joint_names[1] == "mixamorig:Left Arm"


LAST_ROW = "1 2 3 0 0 90 90 0 0 0 0 0\n"
BAD_FILES = {
    "empty": (lambda text: "", 1, "the file is empty"),
    "binary": (lambda text: b"\x89PNG\0\0" + text.encode(), 1, "not a BVH file"),
    "other text": (lambda text: "hello\n" + text, 1, "instead of HIERARCHY"),
    "cut in the hierarchy": (lambda text: text[: text.index("CHANNELS 3")], 9, "is the file truncated"),
    "cut before MOTION": (lambda text: text[: text.index("MOTION")], 21, "no MOTION section"),
    "cut after MOTION": (lambda text: text[: text.index("Frames")], 22, '"Frames:" should follow'),
    "cut after Frames": (lambda text: text[: text.index("Frame Time")], 23, '"Frame Time:" should follow'),
    "no frames": (lambda text: text[: text.index("0 0 0 0 0 0 0")], 24, "after 0 of 2 frames"),
    "cut after a row": (lambda text: text.replace(LAST_ROW, ""), 24, "after 1 of 2 frames"),
    "cut in a row": (lambda text: text[:-8], 25, "frame 1 has 8 columns, but the hierarchy has 12 channels; is"),
    "row too short": (lambda text: text.replace("0.0333333\n0 ", "0.0333333\n"), 24, "frame 0 has 11 columns"),
    "row too long": (lambda text: text.replace("90 90", "90 90 90"), 25, "frame 1 has 13 columns"),
    "borrowed value": (lambda text: text.replace("\n1 2 3", " 1\n2 3"), 24, "frame 0 has 13 columns"),
    "too many rows": (lambda text: text + LAST_ROW, 26, "says 2 frames, but there are 3"),
    "NaN": (lambda text: text.replace("1 2 3", "1 nan 3"), 25, "nan is not a finite number"),
    "infinity": (lambda text: text.replace("1 2 3", "1 -inf 3"), 25, "-inf is not a finite number"),
    "large": (lambda text: text.replace("1 2 3", "1 -1e9 3"), 25, "below 1e+09"),
    "overflow": (lambda text: text.replace("1 2 3", "1 2e999 3"), 25, "finite number"),
    "word": (lambda text: text.replace("1 2 3", "1 x 3"), 25, '"x" is not a number'),
    "glued numbers": (lambda text: text.replace("1 2 3", "1 2-2 3"), 25, '"2-2" is not a number'),
    "underscore": (lambda text: text.replace("1 2 3", "1 1_0 3"), 25, '"1_0" is not a number'),
    "comma": (lambda text: text.replace("1 2 3", "1 2,5 3"), 25, '"2,5" is not a number'),
    "unknown channel": (lambda text: text.replace("6 Xposition", "6 Xscale"), 5, 'unknown channel "Xscale"'),
    "channel twice": (lambda text: text.replace("6 Xposition", "6 Yposition"), 5, "Yposition appears twice"),
    "channel count": (lambda text: text.replace("CHANNELS 6", "CHANNELS 7"), 5, "the count is 7"),
    "channel count too small": (lambda text: text.replace("CHANNELS 6", "CHANNELS 5"), 5, 'found "Yrotation"'),
    "channel count too large": (lambda text: text.replace("CHANNELS 3", "CHANNELS 4", 1), 10, 'channel "JOINT"'),
    "offset": (lambda text: text.replace("OFFSET 30 0 0", "OFFSET 30 0"), 9, '"CHANNELS" is not a number'),
    "offset word": (lambda text: text.replace("OFFSET 30", "OFFSET a"), 8, 'OFFSET of "Arm": "a" is not a number'),
    "offset NaN": (lambda text: text.replace("OFFSET 30", "OFFSET nan"), 8, "nan is not a finite number below"),
    "no OFFSET": (lambda text: text.replace("OFFSET 30 0 0", ""), 9, 'expected "OFFSET", found "CHANNELS"'),
    "no ROOT": (lambda text: text.replace("ROOT", "JOINT"), 2, 'expected "ROOT", found "JOINT"'),
    "two roots": (lambda text: text.replace("MOTION", "ROOT B"), 21, "a second ROOT"),
    "no name": (lambda text: text.replace("JOINT Arm", "JOINT"), 6, "JOINT is not followed by a joint name"),
    "twice the same name": (lambda text: text.replace("JOINT Hand", "JOINT Arm"), 10, '"Arm" appears twice'),
    "missing brace": (lambda text: text.replace("}\nMOTION", "\nMOTION"), 21, '"End Site" or "}" should'),
    "surplus brace": (lambda text: text.replace("MOTION", "}\nMOTION"), 21, 'brace of the root follows "}"'),
    "stray word": (lambda text: text.replace("JOINT Hand", "JOINTS Hand"), 10, 'found "JOINTS"'),
    "no channels": (lambda text: re.sub("CHANNELS.*", "", text), 23, "no channels"),
    "frame count word": (lambda text: text.replace("Frames: 2", "Frames: two"), 22, 'bad frame count "two"'),
    "frame count zero": (lambda text: text.replace("Frames: 2", "Frames: 0"), 22, 'bad frame count "0"'),
    "frame count negative": (lambda text: text.replace("Frames: 2", "Frames: -2"), 22, 'bad frame count "-2"'),
    "frame count missing": (lambda text: text.replace("Frames: 2\n", ""), 22, 'expected "Frames: <count>"'),
    "frame time zero": (lambda text: text.replace("0.0333333", "0"), 23, 'bad frame time "0"'),
    "frame time word": (lambda text: text.replace("0.0333333", "fast"), 23, 'bad frame time "fast"'),
    "frame time NaN": (lambda text: text.replace("0.0333333", "nan"), 23, 'bad frame time "nan"'),
    "frame time missing": (lambda text: text.replace("Frame Time: 0.0333333\n", ""), 23, 'expected "Frame Time'),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD_FILES)
def test_a_bad_file_gets_one_line_with_file_and_line(tmp_path, name):
    change, line, message = BAD_FILES[name]
    path = write(tmp_path, change(ARM_BVH))
    with pytest.raises(UserError) as caught:
        load_bvh(path)
    text = str(caught.value)
    assert text.startswith(f"{path}:{line}: ")
    assert message in text
    assert "\n" not in text


@pytest.mark.parametrize(("place", "said"), [("missing.bvh", "there is no such file"), (".", "cannot be read")])
def test_what_cannot_be_read_is_named(tmp_path, place, said):
    with pytest.raises(UserError, match=said):
        load_bvh(tmp_path / place)


def test_a_written_file_gives_the_positions_back(tmp_path):
    positions = walking_positions()
    path = tmp_path / "walk.bvh"
    save_bvh(path, Motion(positions=positions, fps=20.0))
    clip = load_bvh(path)
    assert (clip.fps, clip.metres_per_unit, clip.num_frames) == (20.0, 1.0, len(positions))
    names, offsets, _, independent = read_bvh_independently(path)
    np.testing.assert_array_equal(offsets[0], 0)
    assert names[:5] == ["Hips", "LeftUpLeg", "LeftLeg", "LeftFoot", "LeftToe"]
    np.testing.assert_allclose(clip.positions, independent, atol=2e-5)
    # Depth first, as spec/motion-representation.md lists HumanML3D's joints in BVH order.
    order = [0, 1, 4, 7, 10, 2, 5, 8, 11, 3, 6, 9, 12, 15, 13, 16, 18, 20, 14, 17, 19, 21]
    assert np.linalg.norm(clip.positions - positions[:, order], axis=-1).mean() < 1e-3


@pytest.mark.parametrize("kind", ["wave-left-hand", "walk", "squat"])
@pytest.mark.parametrize("rise", [0.0, 0.03])
def test_the_tip_of_a_foot_that_stands_is_as_high_as_its_toe(tmp_path, kind, rise):
    positions = make_motion(kind, seed=4, num_frames=60)
    toes = [HUMANML3D.left_foot[1], HUMANML3D.right_foot[1]]
    # Also a figure whose ankles are higher over the floor.
    positions[:, [joint for joint in range(HUMANML3D.num_joints) if joint not in toes], 1] += rise
    save_bvh(tmp_path / "a.bvh", Motion(positions, 20.0))
    clip = load_bvh(tmp_path / "a.bvh").with_end_sites()
    for name, toe in zip(("LeftToe", "RightToe"), toes, strict=True):
        tip, joint = (clip.joint_names.index(found) for found in (f"{name} End Site", name))
        heights = clip.positions[:, tip, 1] - clip.positions[:, joint, 1]
        low = positions[:, toe, 1] < positions[:, toes, 1].min() + 0.01
        np.testing.assert_allclose(np.median(heights[low]), 0, atol=0.01)
    np.testing.assert_allclose(Motion.load(tmp_path / "a.bvh").positions[:, 1:], positions[:, 1:], atol=0.02)


def test_joints_that_a_file_cannot_have_where_they_are_are_said(tmp_path, caplog):
    caplog.set_level("INFO")
    positions = walking_positions()
    save_bvh(tmp_path / "rigid.bvh", Motion(positions, 20.0))
    assert not caplog.messages
    # The spine begins up to 5 cm higher in some frames, as in CMU's files.
    positions[:, INDEX["spine1"], 1] += 0.05 * np.sin(np.arange(len(positions)) / 5) ** 2
    save_bvh(tmp_path / "moved.bvh", Motion(positions, 20.0))
    (said,) = caplog.messages
    clip = load_bvh(tmp_path / "moved.bvh")
    far = np.linalg.norm(clip.positions[:, clip.joint_names.index("Spine")] - positions[:, INDEX["spine1"]], axis=-1)
    assert said.startswith(
        f"{tmp_path / 'moved.bvh'}: joints are up to {1000 * far.max():.0f} mm away from the motion (spine1)"
    )


def test_positions_mean_the_same_to_readers_that_add_and_that_replace(tmp_path):
    path = tmp_path / "walk.bvh"
    save_bvh(path, Motion(positions=walking_positions(10), fps=20.0))
    added, replaced = (load_bvh(path, root_positions=rule).positions for rule in ("add", "absolute"))
    np.testing.assert_array_equal(added, replaced)


def test_the_rest_pose_is_a_t_pose(tmp_path):
    path = tmp_path / "walk.bvh"
    save_bvh(path, Motion(positions=walking_positions(), fps=20.0))
    names, _, rest, _ = read_bvh_independently(path)
    at = dict(zip(names, rest, strict=True))
    for side, sign in (("Left", 1), ("Right", -1)):
        arm = [at[f"{side}{part}"] for part in ("Arm", "ForeArm", "Hand")]
        leg = [at[f"{side}{part}"] for part in ("UpLeg", "Leg", "Foot", "Toe")]
        np.testing.assert_allclose(np.diff(arm, axis=0)[:, 1:], 0, atol=1e-6)
        assert np.all(np.diff(arm, axis=0)[:, 0] * sign > 0.2)
        np.testing.assert_allclose(np.diff(leg[:3], axis=0)[:, [0, 2]], 0, atol=1e-6)
        assert np.all(np.diff(leg[:3], axis=0)[:, 1] < -0.3)
        np.testing.assert_allclose((leg[3] - leg[2])[:2], 0, atol=1e-6)
        assert leg[3][2] > leg[2][2] + 0.1
    spine = np.array([at[name] for name in ("Hips", "Spine", "Spine1", "Spine2", "Neck", "Head")])
    assert np.all(np.diff(spine[:, 1]) > 0.04)
    np.testing.assert_allclose(spine[:, [0, 2]], 0, atol=0.02)


def test_angles_in_the_file_do_not_jump(tmp_path):
    # Two full turns on the spot, with a thigh that passes through the gimbal lock at 90 degrees.
    turning = np.zeros((120, 2, 3))
    turning[:, 0, 0] = np.linspace(0, 4 * np.pi, 120)
    turning[:, 1, 1] = np.linspace(0, -2.2, 120)
    matrices = matrix_from_euler(turning, "YXZ")
    angles = continuous_euler(matrices)
    assert np.abs(np.diff(angles, axis=0)).max() < 0.2
    assert angles[-1, 0, 2] == pytest.approx(4 * np.pi, abs=1e-3)
    np.testing.assert_allclose(matrix_from_euler(angles, "ZXY"), matrices, atol=2e-4)


def test_angles_at_exact_gimbal_lock_stay_near_the_frame_before():
    swing = np.array(
        [[0.0, np.pi / 2 - 0.2, 0.4], [0.0, np.pi / 2, 0.4], [0.0, np.pi / 2, 0.5], [0.0, np.pi / 2 + 0.2, 0.5]]
    )
    matrices = matrix_from_euler(swing[:, None], "ZXY")
    angles = continuous_euler(matrices)
    assert np.abs(np.diff(angles, axis=0)).max() < 0.25
    np.testing.assert_allclose(matrix_from_euler(angles, "ZXY"), matrices, atol=2e-4)


def test_one_frame_and_other_rates_are_written(tmp_path):
    path = tmp_path / "pose.bvh"
    save_bvh(path, Motion(positions=walking_positions(1), fps=29.97))
    clip = load_bvh(path)
    assert clip.num_frames == 1
    assert clip.fps == pytest.approx(29.97, abs=1e-4)


def test_other_skeletons_and_bad_places_are_refused(tmp_path):
    motion = Motion(positions=walking_positions(3), fps=20.0)
    with pytest.raises(UserError, match="does not exist"):
        save_bvh(tmp_path / "no" / "walk.bvh", motion)
    with pytest.raises(UserError, match=r"walk\.bvh: 0\.5 frames a second are too few for a BVH file"):
        save_bvh(tmp_path / "walk.bvh", Motion(positions=walking_positions(3), fps=0.5))
    kit = Motion(positions=np.ones((3, KIT_ML.num_joints, 3), np.float32), fps=12.5, skeleton=KIT_ML)
    with pytest.raises(UserError, match="skeleton humanml3d, not kit_ml"):
        save_bvh(tmp_path / "kit.bvh", kit)


def test_a_published_clip_comes_closer_than_the_published_export(tmp_path, shared_dir):
    arrays = np.load(shared_dir / "golden" / "motion" / "bvh_012314.npz")
    positions, baseline = arrays["joints"], arrays["ik_noflock"]
    path = tmp_path / "012314.bvh"
    save_bvh(path, Motion(positions=positions, fps=HUMANML3D.fps))
    names, _, _, read = read_bvh_independently(path)
    assert names[0] == "Hips"
    order = [0, 1, 4, 7, 10, 2, 5, 8, 11, 3, 6, 9, 12, 15, 13, 16, 18, 20, 14, 17, 19, 21]
    error = np.linalg.norm(read - positions[:, order], axis=-1).mean()
    assert error < 1e-3 < np.linalg.norm(baseline - positions, axis=-1).mean()
    assert INDEX["pelvis"] == 0


ROOT = "HIERARCHY\nROOT j0\n{\nOFFSET 0 0 0\nCHANNELS 3 Xposition Yposition Zposition\n"
FRAME = "}\nMOTION\nFrames: 1\nFrame Time: 0.05\n0 0 0\n"


def nested(count):
    """A chain of joints."""
    joints = "".join(f"JOINT j{n}\n{{\nOFFSET 0 1 0\nCHANNELS 0\n" for n in range(1, count))
    return f"{ROOT}{joints}{'}' * (count - 1)}{FRAME}"


def flat(count, *, prefix="j"):
    """A root whose children are all other joints."""
    joints = "".join(f"JOINT {prefix}{n}\n{{\nOFFSET 0 1 0\nCHANNELS 0\n}}\n" for n in range(1, count))
    return f"{ROOT}{joints}{FRAME}"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (nested(20_000), "more than 2,000 joints"),
        (flat(50_000), "more than 2,000 joints"),
        (
            nested(3).replace("MOTION\n", "MOTION\n" + "\n" * 20_000_000).replace("Frames", "Frame"),
            ':20000016: expected "Frames: <count>"',
        ),
        ("HIERARCHY\n" + "{" * 20_000_000, "its hierarchy has 20,000,010 bytes, more than 4,000,000"),
        ("HIERARCHY\n" + "JOINT a\n" * 1_000_000, "its hierarchy has 8,000,010 bytes"),
        (nested(3).replace("0.05", "10"), 'bad frame time "10"'),
        ("\n" * 50_000_000, "the file is empty"),
    ],
    ids=["joints", "flat joints", "lines", "braces", "words", "frame time", "empty"],
)
def test_files_that_would_take_long_are_refused(tmp_path, text, says):
    path = tmp_path / "a.bvh"
    path.write_text(text)
    with pytest.raises(UserError, match=re.escape(says)):
        load_bvh(path)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "num_joints"),
    [
        (flat(2000, prefix="j" * 1000), 2000),
        (f"{ROOT}{'End Site { OFFSET 0 1 0 }' * 20_000}{FRAME}", 1),
        (f"{ROOT}JOINT {'j ' * 1_000_000}{{ OFFSET 0 1 0 }}{FRAME}", 2),
    ],
    ids=["flat joints", "end sites", "name of many words"],
)
def test_wide_figures_are_read(tmp_path, text, num_joints):
    # A reader whose work grows with the square of the size needs hours for these.
    clip = load_bvh(write(tmp_path, text))
    assert len(clip.joint_names) == num_joints
