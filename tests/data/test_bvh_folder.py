import numpy as np
import pytest

from t2m_jax import Motion
from t2m_jax.data.audit import audit_dataset
from t2m_jax.data.folder import open_dataset
from t2m_jax.data.importers.bvh import import_bvh_folder
from t2m_jax.data.importers.synthetic import make_motion
from t2m_jax.errors import UserError
from tests.data.bvh_files import write_bvh
from tests.motion.glb_files import write_person
from tests.motion.rig.test_retarget import BANDAI


def write_clips(folder, names):
    for seed, name in enumerate(names):
        write_bvh(folder / f"{name}.bvh", seed=seed)
    return folder


def all_captions(folder):
    dataset = open_dataset(folder)
    names = [name for split in ("train", "val", "test") for name in dataset.names(split)]
    return {name: [caption.text for caption in dataset.captions(name)] for name in names}


def test_captions_from_a_table(tmp_path):
    source = write_clips(tmp_path / "source", ["a", "sub/b", "c"])
    (source / "captions.csv").write_text(
        'file,caption,start,end\na.bvh,"a person glides, slowly",,\na,he turns left,0.2,1.0\nsub/b,she waves,,\n'
    )
    report = import_bvh_folder(source, tmp_path / "data")
    assert report.num_clips == 4
    assert list(report.left_out) == ["c"] and "no caption" in report.left_out["c"]
    captions = all_captions(tmp_path / "data")
    assert captions["a"] == ["a person glides, slowly", "he turns left"]
    assert captions["Ma"] == ["a person glides, slowly", "he turns right"]
    assert captions["sub_b"] == ["she waves"]
    assert audit_dataset(tmp_path / "data").problems == []


def test_clips_without_twins(tmp_path):
    """Sides are exchanged in English captions only."""
    source = write_clips(tmp_path / "source", ["a", "b"])
    (source / "captions.csv").write_text("file,caption\na,eine Person hebt die linke Hand\nb,sie winkt links\n")
    report = import_bvh_folder(source, tmp_path / "data", twins=False)
    assert report.num_clips == 2 and set(all_captions(tmp_path / "data")) == {"a", "b"}
    assert report.num_frames == sum(len(np.load(path)) for path in (tmp_path / "data").glob("new_joint_vecs/*.npy"))
    assert audit_dataset(tmp_path / "data").problems == []


def test_captions_beside_the_files(tmp_path):
    source = write_clips(tmp_path / "source", ["a", "b"])
    (source / "a.txt").write_text("a man walks\n\nsomeone is walking\n")
    (source / "b.txt").write_text("he waves#he/PRON wave/VERB#0.0#0.0\n")
    import_bvh_folder(source, tmp_path / "data")
    captions = all_captions(tmp_path / "data")
    assert captions["a"] == ["a man walks", "someone is walking"] and captions["b"] == ["he waves"]


def test_captions_from_a_list_or_from_names(tmp_path):
    source = write_clips(tmp_path / "source", ["Man_jumping_02", "b"])
    (source / "captions.txt").write_text("b.bvh: a person stands\n")
    report = import_bvh_folder(source, tmp_path / "data", caption_from_name=True)
    assert not report.left_out
    captions = all_captions(tmp_path / "data")
    assert captions["man_jumping_02"] == ["man jumping"]  # a leading M would mean a mirrored twin
    assert captions["b"] == ["a person stands"]


def test_a_name_without_words_is_no_caption(tmp_path):
    source = write_clips(tmp_path / "source", ["001_01", "a person waves"])
    report = import_bvh_folder(source, tmp_path / "data", caption_from_name=True)
    assert report.num_clips == 2  # with the mirrored twin
    assert "no caption; its name has no words; add it to captions.csv" in report.left_out["001_01"]


def test_broken_clips_are_named_and_the_rest_is_kept(tmp_path):
    source = write_clips(tmp_path / "source", ["good", "broken"])
    (source / "broken.bvh").write_text("HIERARCHY\n")
    report = import_bvh_folder(source, tmp_path / "data", caption_from_name=True)
    assert list(report.left_out) == ["broken"] and "broken.bvh" in report.left_out["broken"]
    assert report.num_clips == 2


@pytest.mark.parametrize("away", ["300", "20"])
def test_a_rest_pose_in_front_is_dropped(tmp_path, away):
    source = write_clips(tmp_path / "source", ["a"])
    lines = (source / "a.bvh").read_text().split("\n")
    first = lines.index("Frame Time:\t0.0333333") + 1
    far = lines[first].split()
    far[8] = away  # the hips are so many centimeters off
    lines[first] = " ".join(far)
    (source / "a.bvh").write_text("\n".join(lines))
    import_bvh_folder(source, tmp_path / "data", caption_from_name=True)
    joints = np.load(tmp_path / "data/new_joints/a.npy")
    assert np.linalg.norm(np.diff(joints, axis=0), axis=-1).max() < 0.2


def test_times_of_captions_follow_when_a_rest_pose_is_dropped(tmp_path):
    """30 of 75 frames, a second, are a T-pose, out of which the figure jumps with its arms down."""
    source = write_clips(tmp_path / "source", [])
    lines = write_bvh(source / "a.bvh", num_frames=75).read_text().split("\n")
    joints = [line.split()[1] for line in lines if line.strip().startswith(("ROOT", "JOINT"))]
    first = lines.index("Frame Time:\t0.0333333") + 1
    lines[first : first + 30] = [lines[first]] * 30
    for number in range(first + 30, first + 75):
        cells = lines[number].split()
        for joint, angle in (("UpperArm_L", "-70"), ("UpperArm_R", "70")):
            cells[6 * joints.index(joint) + 3] = angle
        lines[number] = " ".join(cells)
    (source / "a.bvh").write_text("\n".join(lines))
    rows = "a,he stands,0.2,0.9\na,he walks,1.5,2\na,he goes on,2,\na,he glides,,\na,he is gone,7,9\n"
    (source / "captions.csv").write_text("file,caption,start,end\n" + rows)
    report = import_bvh_folder(source, tmp_path / "data")
    found = {caption.text: (caption.start, caption.end) for caption in open_dataset(tmp_path / "data").captions("a")}
    assert found == {"he walks": (0.5, 1.0), "he goes on": (1.0, 1.5), "he glides": (0.0, 0.0)}
    assert any("a caption about what the motion does not have was left out" in note for note in report.notes)


def test_a_clip_whose_captions_come_after_its_end_is_left_out(tmp_path):
    """As if somebody had given frames."""
    source = write_clips(tmp_path / "source", ["a", "b"])
    (source / "captions.csv").write_text("file,caption,start,end\na,he walks,30,45\nb,he walks,0.5,1\n")
    report = import_bvh_folder(source, tmp_path / "data")
    assert "a.bvh: its captions are about none of its 1.50 s; give times in seconds" in report.left_out["a"]


@pytest.mark.parametrize("name", ["!", "a" * 200 + "/" + "b" * 30])
def test_a_path_that_gives_no_clip_name_is_named(tmp_path, name):
    source = write_clips(tmp_path / "source", ["good", name])
    with pytest.raises(
        UserError, match=f"{name}: the name of a clip has 1 to 220 bytes of letters and digits; rename it"
    ):
        import_bvh_folder(source, tmp_path / "data", caption_from_name=True)
    assert not (tmp_path / "data").exists()


@pytest.mark.slow
def test_the_seed_decides_the_split(tmp_path):
    source = write_clips(tmp_path / "source", [f"walk{letter}" for letter in "abcdefghijkl"])
    for number, seed in enumerate((0, 0, 1)):
        import_bvh_folder(source, tmp_path / f"{number}", caption_from_name=True, seed=seed)
    trains = [(tmp_path / f"{number}" / "train.txt").read_text() for number in range(3)]
    assert trains[0] == trains[1] != trains[2]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("x,y\nz,b\n", r"captions\.csv:1: .*file,caption"),
        ("file,caption\na,\n", r"captions\.csv:2: .*empty"),
        ("file,caption\na,he # waves\n", r"captions\.csv:2: .*'#'"),
        ("file,caption\na,123\n", r"captions\.csv:2: the caption '123' has no words"),
        ("file,caption\na,sie läuft\n", r"captions\.csv: is not UTF-8 text \(byte 20\)"),
        ("file,caption,start,end\na,he waves,one,2\n", r"captions\.csv:2: .*'one'"),
    ],
)
def test_broken_tables_name_the_line(tmp_path, content, words):
    source = write_clips(tmp_path / "source", ["a"])
    (source / "captions.csv").write_text(content, encoding="latin-1")
    with pytest.raises(UserError, match=words):
        import_bvh_folder(source, tmp_path / "data")
    assert not (tmp_path / "data").exists()


def test_refusals(tmp_path, monkeypatch):
    with pytest.raises(UserError, match=r"no folder with \.bvh, \.glb, \.amc or \.npz files"):
        import_bvh_folder(tmp_path, tmp_path / "data")
    source = write_clips(tmp_path / "source", ["a"])
    with pytest.raises(UserError, match="none of 1 clips"):
        import_bvh_folder(source, tmp_path / "data")
    with pytest.raises(UserError, match="no such file"):
        import_bvh_folder(source, tmp_path / "data", captions=tmp_path / "missing.csv")
    write_clips(source, ["b c", "b_c"])
    monkeypatch.setattr("t2m_jax.data.importers.bvh.open_motion_file", None)  # it is said before a file is read
    with pytest.raises(UserError, match="would be named b_c"):
        import_bvh_folder(source, tmp_path / "data")


def test_a_byte_order_mark_is_not_part_of_a_caption(tmp_path):
    source = write_clips(tmp_path / "source", ["a", "b"])
    (source / "captions.csv").write_text("file,caption\na,he waves\n", encoding="utf-8-sig")
    (source / "b.txt").write_text("she walks\n", encoding="utf-8-sig")
    import_bvh_folder(source, tmp_path / "data")
    assert all_captions(tmp_path / "data")["a"] == ["he waves"]
    assert all_captions(tmp_path / "data")["b"] == ["she walks"]


def test_a_caption_file_in_another_encoding_is_named(tmp_path):
    source = write_clips(tmp_path / "source", ["a"])
    (source / "a.txt").write_bytes("sie läuft".encode("latin-1"))
    with pytest.raises(UserError, match=r"a\.txt: is not UTF-8"):
        import_bvh_folder(source, tmp_path / "data")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("sie läuft".encode("latin-1"), "b.txt: is not UTF-8 text (byte 5)"),
        (b"123\n", "b.txt:1: the caption '123' has no words"),
        (b"123##0.0#0.0\n", "b.txt:1: the caption '123' has no words"),
        (b"a man walks\n?!\n", "b.txt:2: the caption '?!' has no words"),
    ],
)
def test_a_broken_text_beside_a_file_costs_one_clip(tmp_path, text, says):
    source = write_clips(tmp_path / "source", ["a", "b", "c"])
    (source / "b.txt").write_bytes(text)
    report = import_bvh_folder(source, tmp_path / "data", caption_from_name=True)
    assert list(report.left_out) == ["b"] and f"{source / says}" in report.left_out["b"]
    assert set(all_captions(tmp_path / "data")) == {"a", "Ma", "c", "Mc"} and report.num_clips == 4
    assert audit_dataset(tmp_path / "data").problems == []
    assert (source / "b.txt").read_bytes() == text


def test_each_animation_of_a_glb_file_is_a_clip(tmp_path):
    source = write_clips(tmp_path / "source", ["a"])
    animations = {"Armature|Turn_Left": 90.0, "Armature|Wait": 0.0, "Armature|Rest": 0.0}
    write_person(source / "sub" / "figure.glb", BANDAI, animations, seconds=2.0)
    (source / "captions.csv").write_text(
        "file,caption\na,she glides\nsub/figure/Turn_Left,he turns\nfigure/Turn_Left,he spins\nWait,he waits\n"
    )
    (source / "sub" / "figure.txt").write_text("not read for several animations\n")
    report = import_bvh_folder(source, tmp_path / "data")
    captions = all_captions(tmp_path / "data")
    assert captions["sub_figure_Turn_Left"] == ["he turns", "he spins"] and captions["sub_figure_Wait"] == ["he waits"]
    assert report.num_clips == 6 and list(report.left_out) == ["sub_figure_Rest"]
    assert len(open_dataset(tmp_path / "data").features("sub_figure_Turn_Left")) == 40
    assert audit_dataset(tmp_path / "data").problems == [
        f"new_joint_vecs/{name}.npy: nothing moves" for name in ("sub_figure_Wait", "Msub_figure_Wait")
    ]


def test_a_broken_glb_file_is_named(tmp_path):
    source = write_clips(tmp_path / "source", ["a"])
    (source / "b.glb").write_bytes(b"no figure here, but more than 20 bytes")
    report = import_bvh_folder(source, tmp_path / "data", caption_from_name=True)
    assert "b.glb: is not a GLB file" in report.left_out["b"]


def test_what_is_known_of_the_data_may_be_given(tmp_path):
    source, info = write_clips(tmp_path / "source", ["a", "b"]), tmp_path / "info.yaml"
    info.write_text("name: Mine\nlicence: CC0\nmin_frames: 20\n")
    import_bvh_folder(source, tmp_path / "data", caption_from_name=True, info=info)
    found = open_dataset(tmp_path / "data").info
    assert (found.name, found.licence, found.min_frames, found.source) == ("Mine", "CC0", 20, "")
    info.write_text("name: Mine\nfps: 30.0\n")
    with pytest.raises(UserError, match=r"info\.yaml: skeleton and fps are humanml3d and 20 here; leave them out"):
        import_bvh_folder(source, tmp_path / "again", caption_from_name=True, info=info)


def test_files_of_amass(tmp_path):
    walk = Motion(make_motion("walk", seed=4, num_frames=60), 20.0)
    source = tmp_path / "source"
    (source / "subject").mkdir(parents=True)
    walk.resampled(120).save(source / "subject" / "walk_poses.npz", names="smpl")
    np.savez(source / "subject" / "shape.npz", gender="female", betas=np.ones(16))  # AMASS has one for each subject
    walk.save(source / "subject" / "ours.npz")
    (source / "subject" / "broken.npz").write_bytes(b"no archive")
    with np.load(source / "subject" / "walk_poses.npz") as archive:  # at 20 frames per second it would fill the memory
        np.savez(source / "subject" / "years.npz", **{**archive, "mocap_framerate": 1e-6})
    (source / "captions.csv").write_text("file,caption\nsubject/walk_poses.npz,he moves\nsubject/years.npz,he stays\n")
    report = import_bvh_folder(source, tmp_path / "data")
    assert (report.num_clips, list(report.left_out)) == (2, ["subject_broken", "subject_years"])
    assert "seconds; at most 14400 are read" in report.left_out["subject_years"]
    assert "broken.npz: this is not a complete .npz file" in report.left_out["subject_broken"]
    assert audit_dataset(tmp_path / "data").problems == []
    joints = np.load(tmp_path / "data/new_joints/subject_walk_poses.npy")
    read = Motion.load(source / "subject" / "walk_poses.npz").resampled(20).positions[: len(joints)]
    np.testing.assert_allclose(inclinations(joints), inclinations(read), atol=0.1)


def inclinations(positions):
    """Returns the sines of the angles between the limbs' bones and the floor, which no size or heading alters."""
    joints, parents = [4, 5, 7, 8, 18, 19, 20, 21], [1, 2, 4, 5, 16, 17, 18, 19]
    bones = positions[:, joints] - positions[:, parents]
    return bones[..., 1] / np.linalg.norm(bones, axis=-1)
