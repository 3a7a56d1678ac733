"""Files for download, and files that users bring."""

import base64
import io
import json

import numpy as np
import pytest

from t2m_jax.errors import UserError
from t2m_jax.export.npz import write_npz
from t2m_jax.motion.bvh import load_bvh
from t2m_jax.motion.changes import Changes
from t2m_jax.motion.features import features_from_positions
from t2m_jax.motion.formats import format_options, load_motion, motion_formats
from t2m_jax.motion.targets import targets_from_text
from t2m_jax.serving.files import Names, make_file, motion_file, motion_record, move_character, open_file
from t2m_jax.serving.schema import SEVERAL, FileOptions, decode_base64
from tests.export.conftest import nasty, walk  # noqa: F401 - fixtures
from tests.motion.character_files import read_parts, table_text, write_character
from tests.motion.rig.foreign import nameless, nameless_table  # noqa: F401 - fixtures
from tests.motion.rig.test_retarget import BANDAI

SIGNATURES = {
    "npz": b"PK",
    "bvh": b"HIERARCHY",
    "glb": b"glTF",
    "vrma": b"glTF",
    "gif": b"GIF8",
    "png": b"\x89PNG",
    "html": b"<!doctype",
}


def data_of(motion) -> bytes:
    file = io.BytesIO()
    write_npz(file, motion, compress=False)
    return file.getvalue()


def read_back(data: bytes, suffix: str):
    with motion_file(data, suffix) as path:
        return load_motion(path)


@pytest.mark.parametrize("name", sorted(SIGNATURES))
def test_every_format_is_made(walk, name):  # noqa: F811
    data = make_file([data_of(walk[:8])], FileOptions(format=name))
    assert data[:9].lower().startswith(SIGNATURES[name].lower())


def test_a_video_is_made(walk):  # noqa: F811
    pytest.importorskip("imageio_ffmpeg")
    assert make_file([data_of(walk[:4])], FileOptions(format="mp4"))[4:8] == b"ftyp"


@pytest.mark.parametrize("name", ["npz", "bvh", "glb"])
def test_motions_can_be_read_back(walk, name):  # noqa: F811
    found = read_back(make_file([data_of(walk)], FileOptions(format=name)), name)
    np.testing.assert_allclose(found.positions, walk.positions, atol=5e-3 if name != "npz" else 0)


def test_a_part_at_another_rate_in_place(walk):  # noqa: F811
    options = FileOptions(changes=Changes(begin=1.0, end=3.0, fps=60.0, in_place=True))
    found = read_back(make_file([data_of(walk)], options), "npz")
    assert found.fps == 60 and found.num_frames == 39 * 3 + 1
    assert np.abs(found.positions[:, 0, [0, 2]]).max() < 0.1 < np.ptp(walk.positions[:, 0, 2])


@pytest.mark.parametrize(("asked", "expected"), [(None, 60), (24.0, 24)])
def test_a_loop_has_60_frames_a_second_without_a_rate(walk, asked, expected):  # noqa: F811
    found = read_back(
        make_file([data_of(walk)], FileOptions(changes=Changes(loop=True, in_place=True, fps=asked))), "npz"
    )
    assert found.fps == expected
    np.testing.assert_allclose(found.positions[-1], found.positions[0], atol=1e-3)


def test_names_and_units_are_those_of_the_format(walk):  # noqa: F811
    options = FileOptions(format="bvh", names="mixamo", units="cm")
    with motion_file(make_file([data_of(walk)], options), "bvh") as path:
        assert load_bvh(path).joint_names[0] == "mixamorig:Hips"


@pytest.mark.parametrize("name", motion_formats())
def test_options_of_other_formats_are_refused(walk, name):  # noqa: F811
    choices = {"names": ("lafan1", "unreal", "smpl"), "units": ("m", "cm"), "camera": ("follow",), "root_bone": (True,)}
    known = format_options(f"motion.{name}")
    for option, value in ((option, value) for option, values in choices.items() for value in values):
        if value not in known.get(option, ()):
            with pytest.raises(UserError, match=rf"^{option}: {value!r} is unknown; known is "):
                make_file([data_of(walk[:2])], FileOptions(format=name, **{option: value}))
    make_file([data_of(walk[:2])], FileOptions(format=name, root_bone=False))  # is the same as without it


def test_arrays_have_the_layout_that_is_asked_for(walk):  # noqa: F811
    for names, entry in (("smpl", "poses"), ("humanml3d", "positions"), (None, "positions")):
        assert entry in np.load(io.BytesIO(make_file([data_of(walk)], FileOptions(names=names))))
    assert b'"Root"' in make_file([data_of(walk)], FileOptions(format="glb", root_bone=True))


def test_several_motions_need_a_format_for_several(walk):  # noqa: F811
    data = data_of(walk[:2])
    for name in motion_formats():
        if name not in SEVERAL:
            with pytest.raises(UserError, match="cannot contain 2 motions"):
                make_file([data, data], FileOptions(format=name))
    assert make_file([data, data], FileOptions(format="glb"))
    for count in (0, 33):
        with pytest.raises(UserError, match=f"cannot contain {count} motions"):
            make_file([data] * count, FileOptions(format="glb"))


def test_a_long_video_is_refused(walk):  # noqa: F811
    long = walk[:1].resampled(20)
    positions = np.repeat(long.positions, 20 * 241, axis=0)
    data = data_of(type(walk)(positions, 20.0))
    with pytest.raises(UserError, match="takes too long"):
        make_file([data], FileOptions(format="gif"))


def test_a_motion_that_lasts_for_days_is_refused(walk):  # noqa: F811
    slow = data_of(type(walk)(walk.positions, 1e-6))
    changes = Changes(fps=60.0)
    for action in (lambda: make_file([slow], FileOptions(changes=changes)), lambda: open_file(slow, "npz", changes)):
        with pytest.raises(UserError, match=r"^motion\.npz: has 8e\+07 seconds; at most 14400 are read"):
            action()


def test_a_table_of_joints_comes_with_its_file(nameless, nameless_table):  # noqa: F811
    data, expected = nameless.read_bytes(), load_motion(nameless, rig=str(nameless_table))
    with pytest.raises(UserError, match=r"^motion\.bvh: no known rig has its joints"):
        open_file(data, "bvh", Changes())
    found = json.loads(open_file(data, "bvh", Changes(), nameless_table.read_text()))
    assert found["motion"]["frames"] == expected.num_frames
    with pytest.raises(UserError, match=r"^motion\.bvh: rig mixamo: the file has no joint"):
        open_file(data, "bvh", Changes(), "mixamo")
    # A path is the text of a table, not a file of the server.
    with pytest.raises(UserError, match=r"^rig:"):
        open_file(data, "bvh", Changes(), str(nameless_table))


@pytest.mark.parametrize("data", [b"", b"PK\x03\x04", b"HIERARCHY", b"x" * 100])
def test_a_damaged_file_is_named_without_its_place(data):
    with pytest.raises(UserError, match=r"^motion\.npz: ") as caught:
        make_file([data], FileOptions())
    assert "/" not in str(caught.value).partition(":")[0]


@pytest.mark.parametrize(("begin", "end"), [(2.0, 1.0), (-1.0, 2.0), (3.0, 3.0), (90.0, 91.0), (1e308, 1.7e308)])
def test_a_part_without_frames_is_refused(walk, begin, end):  # noqa: F811
    with pytest.raises(UserError):
        make_file([data_of(walk)], FileOptions(changes=Changes(begin=begin, end=end)))


def test_the_scene_of_a_file(nasty):  # noqa: F811
    found = json.loads(open_file(data_of(nasty), "npz", Changes(begin=0.0, end=1.0)))
    assert found["motion"]["frames"] == 20 and found["motion"]["caption"] == nasty.caption
    (figure,) = found["scene"]["figures"]
    assert figure["frames"] == 20 and found["scene"]["seconds"] == 1.0


@pytest.mark.parametrize("kind", ["positions", "features"])
def test_arrays_of_a_data_set_are_opened(walk, kind):  # noqa: F811
    file = io.BytesIO()
    np.save(file, walk.positions if kind == "positions" else features_from_positions(walk.positions, walk.skeleton))
    opened = json.loads(open_file(file.getvalue(), "npy", Changes(mirror=True), names=Names("012314.npy")))
    assert opened["motion"]["fps"] == 20
    found = read_back(base64.b64decode(opened["motion"]["npz"]), "npz")
    expected = read_back(file.getvalue(), "npy").mirrored()
    np.testing.assert_allclose(found.positions, expected.positions, atol=1e-5)


def test_another_array_is_refused_by_its_name():
    file = io.BytesIO()
    np.save(file, np.zeros((30, 24, 3), np.float32))
    with pytest.raises(UserError, match=r"^smpl\.npy: an array of shape \[30, 24, 3\] is not a motion; it needs"):
        open_file(file.getvalue(), "npy", Changes(), names=Names("smpl.npy"))


def test_a_sentence_is_split(walk):  # noqa: F811
    def split(data, seconds):
        return json.loads(open_file(data, "npz", Changes(), split=seconds))["motion"]

    once = split(data_of(walk), 1.0)
    assert once["part_starts"] == [0, 20] and once["part_captions"] == [walk.caption] * 2
    twice = split(decode_base64(once["npz"]), 0.5)
    assert twice["part_starts"] == [0, 10, 20]
    for seconds in (0.0, 0.5, -1.0, 1e300):
        with pytest.raises(UserError, match="is not in a sentence"):
            split(decode_base64(twice["npz"]), seconds)


@pytest.mark.slow
def test_a_motion_is_changed_in_every_way(walk):  # noqa: F811
    changes = Changes(begin=0.5, mirror=True, speed=2.0, turn=90.0)
    expected = changes.apply(walk)
    assert expected.num_frames < walk.num_frames / 2
    shown = decode_base64(json.loads(open_file(data_of(walk), "npz", changes))["motion"]["npz"])
    written = make_file([data_of(walk)], FileOptions(changes=changes))
    for data in (shown, written):
        np.testing.assert_allclose(read_back(data, "npz").positions, expected.positions, atol=1e-5)


@pytest.mark.slow
def test_a_character_moves_as_the_changed_motions(walk, tmp_path):  # noqa: F811
    hero = write_character(tmp_path / "hero.glb", BANDAI)
    table = table_text(lambda bone: bone)
    for rig in (None, table):
        data = move_character(hero.read_bytes(), [data_of(walk[:8]), data_of(walk)], Changes(speed=2.0), rig)
        (tmp_path / "moved.glb").write_bytes(data)
        animations = read_parts(tmp_path / "moved.glb").tree["animations"]
        assert [one["name"] for one in animations][:2] == ["nod", walk.caption or "motion"]
        assert [one["extras"]["frames"] for one in animations[1:]] == [4, (walk.num_frames + 1) // 2]
        assert 0.8 < animations[1]["extras"]["scale"] < 1.2


@pytest.mark.parametrize(
    ("character", "rig", "message"),
    [
        (b"solid cube", None, "hero.vrm: is not a GLB file; export as glTF binary (.glb)"),
        (None, "bandai", "my table.yaml:1: "),
        (None, "pelvis: Nose", "my table.yaml: "),
    ],
)
def test_a_bad_character_is_refused_by_its_name(walk, tmp_path, character, rig, message):  # noqa: F811
    hero = write_character(tmp_path / "hero.glb", BANDAI).read_bytes()
    with pytest.raises(UserError) as refusal:
        move_character(character or hero, [data_of(walk[:8])], Changes(), rig, Names("hero.vrm", "my table.yaml"))
    assert message in str(refusal.value) and "/tmp" not in str(refusal.value) and "\n" not in str(refusal.value)


def test_a_motion_without_a_person_is_not_put_on_a_character(walk, tmp_path):  # noqa: F811
    hero = write_character(tmp_path / "hero.glb", BANDAI).read_bytes()
    with pytest.raises(UserError, match=r"^motion\.npz: "):
        move_character(hero, [b"nonsense"], Changes())


def test_a_motion_says_how_far_it_is_from_its_targets(walk):  # noqa: F811
    x, _, z = walk.positions[0, 0]
    met, missed = motion_record(walk, targets_from_text(f"0 root={x},{z}; 0 facing=100"))["targets"]
    assert (met["name"], met["unit"], met["met"]) == ("root at 0 s", "m", True) and met["distance"] < 1e-5
    assert (missed["unit"], missed["met"]) == ("degrees", False) and 90 < missed["distance"] < 110
    assert motion_record(walk)["targets"] == []
