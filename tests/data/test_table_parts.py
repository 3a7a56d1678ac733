"""Tables whose rows are clips with an action."""

import hashlib
import re
import shutil

import numpy as np
import pytest

from t2m_jax.data.audit import audit_dataset
from t2m_jax.data.folder import open_dataset
from t2m_jax.data.importers.bvh import import_bvh_folder
from t2m_jax.data.index import load_index
from t2m_jax.data.merge import merge_datasets
from t2m_jax.errors import UserError
from tests.data.bvh_files import write_bvh
from tests.motion.glb_files import write_person
from tests.motion.rig.test_retarget import BANDAI

HEADER = "file,start,end,action,person,split,caption\n"
PARTS_HEADER = "file,start,end,action,person,part,caption\n"


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    folder = tmp_path_factory.mktemp("source")
    for seed, name in enumerate(["long", "short", "sub/third", "unused"]):
        write_bvh(folder / f"{name}.bvh", seed=seed, num_frames=120 if name == "long" else 45)
    return folder


def imported(source, folder, lines):
    table = folder / "table.csv"
    table.write_text(HEADER + lines)
    return import_bvh_folder(source, folder / "data", captions=table)


def test_rows_become_clips(source, tmp_path):
    report = imported(
        source,
        tmp_path,
        "long.bvh,0.5,2,walk-left,ann,train,\nlong,2,,other,ann,train,a person thinks\n"
        "short,,,walk,bob,test,a person goes home\nshort,,,walk,bob,test,a walk\nthird,,,walk,cem,val,\n",
    )
    dataset, index = open_dataset(tmp_path / "data"), load_index(tmp_path / "data")
    assert dataset.names("train") == ("long_1", "Mlong_1", "long_2", "Mlong_2")
    assert dataset.names("val")[0] == "sub_third" and dataset.names("test")[0] == "short"
    assert index.label("Mlong_1") == "walk-right, normal" and index.label("long_2") == "other, normal"
    assert index.entry("Mshort").person == "bob" and index.source("long_2") == "long"
    # 45 frames at 30 per second are 30 at 20, and features have one less.
    assert len(dataset.features("long_1")) == 29 and len(dataset.features("long_2")) == 39
    texts = {name: [one.text for one in dataset.captions(name)] for name in ("long_1", "long_2", "short")}
    assert len(texts["long_1"]) >= 6 and all("left" in text.lower() for text in texts["long_1"])
    assert texts["long_2"] == ["a person thinks"]
    assert texts["short"][:2] == ["a person goes home", "a walk"] and len(texts["short"]) > 2
    assert all(caption.whole_clip for caption in dataset.captions("short"))
    assert list(report.left_out) == ["unused"] and "not in the table" in report.left_out["unused"]
    assert audit_dataset(tmp_path / "data").problems == []


def test_a_part_is_what_the_file_shows_at_its_time(source, tmp_path):
    imported(source, tmp_path, "long,,,walk,,train,\n")
    (tmp_path / "cut").mkdir()
    imported(source, tmp_path / "cut", "long,1,3,walk,,train,\n")
    whole = open_dataset(tmp_path / "data").features("long")
    part = open_dataset(tmp_path / "cut" / "data").features("long")
    limbs = slice(4, 67)  # they swing; the root glides
    np.testing.assert_allclose(part[2:-2, limbs], whole[22:57, limbs], atol=5e-3)


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        ("long,3,9,walk,,train,\n", r"3 to 9 s is no part of a motion of 4.00 s"),
        ("long,,,swim,,train,\n", "no words for the action 'swim'"),
        ("long,,,walk,,dev,\n", "split 'dev' is not train, val, test"),
        ("long,,,walk,,,\n", "its rows have no split"),
        ("long,,,walk,,train,\nlong,,,run,,train,a run\n", "rows of one clip have the action run and walk"),
    ],
)
def test_a_wrong_row_costs_its_clip(source, tmp_path, lines, words):
    report = imported(source, tmp_path, "short,,,walk,,train,\n" + lines)
    assert report.num_clips == 2
    (reason,) = [why for why in report.left_out.values() if "not in the table" not in why]
    assert re.search(words, reason)


PARTS = "".join(
    f"{name},{start / 4},{start / 4 + 0.5},walk,,,\n" for name in ("long", "short", "third") for start in range(4)
)


def test_parts_of_a_recording_stay_in_one_split(source, tmp_path):
    (tmp_path / "table.csv").write_text(PARTS_HEADER + PARTS)
    report = import_bvh_folder(source, tmp_path / "data", captions=tmp_path / "table.csv")
    assert report.split_sizes == {"train": 8, "val": 8, "test": 8}
    dataset = open_dataset(tmp_path / "data")
    for split in report.split_sizes:
        assert len({name.rpartition("_")[0] for name in dataset.names(split) if name[0] != "M"}) == 1


def test_parts_of_too_few_recordings_are_divided(source, tmp_path):
    (tmp_path / "table.csv").write_text(PARTS_HEADER + PARTS.partition("short")[0])
    report = import_bvh_folder(source, tmp_path / "data", captions=tmp_path / "table.csv", split="50/25/25")
    assert report.split_sizes == {"train": 4, "val": 2, "test": 2}


def test_parts_of_a_recording_stay_in_one_of_two_splits(source, tmp_path):
    (tmp_path / "table.csv").write_text(PARTS_HEADER + PARTS.partition("third")[0])
    import_bvh_folder(source, tmp_path / "data", captions=tmp_path / "table.csv", split="50/0/50")
    dataset = open_dataset(tmp_path / "data")
    for split in ("train", "test"):
        assert len({name.rpartition("_")[0] for name in dataset.names(split) if name[0] != "M"}) == 1


def test_lists_may_name_parts(source, tmp_path):
    (tmp_path / "table.csv").write_text(PARTS_HEADER + PARTS.partition("short")[0])
    for split, names in (("train", "long_1\nlong_2\n"), ("val", "long_3\n"), ("test", "long_4\n")):
        (tmp_path / f"{split}.txt").write_text(names)
    report = import_bvh_folder(source, tmp_path / "data", captions=tmp_path / "table.csv", split=tmp_path)
    assert report.split_sizes == {"train": 4, "val": 2, "test": 2}


def test_origins_are_kept_by_merging(source, tmp_path):
    (tmp_path / "info.yaml").write_text("name: Walks\nlicence: CC0\n")
    (tmp_path / "table.csv").write_text(HEADER + "short,,,walk,bob,train,\n")
    options = {"captions": tmp_path / "table.csv", "info": tmp_path / "info.yaml"}
    import_bvh_folder(source, tmp_path / "one", **options)
    (tmp_path / "table.csv").write_text(HEADER + "third,,,walk,cem,train,\n")
    (tmp_path / "info.yaml").write_text("name: More\nlicence: CC BY 4.0\n")
    import_bvh_folder(source, tmp_path / "two", **options)
    merge_datasets([tmp_path / "one", tmp_path / "two"], tmp_path / "both")
    merge_datasets([tmp_path / "both"], tmp_path / "again")
    entries = load_index(tmp_path / "again").entries
    assert (entries["short"].dataset, entries["short"].licence, entries["short"].person) == ("Walks", "CC0", "bob")
    assert (entries["sub_third"].dataset, entries["sub_third"].licence) == ("More", "CC BY 4.0")


FROZEN = "file,action,person,split,sha256,caption_1,caption_2\n"


def frozen(source, folder, lines):
    (folder / "frozen.csv").write_text(FROZEN + lines)
    return import_bvh_folder(source, folder / "data", captions=folder / "frozen.csv", frozen=True)


def digest(path):
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16]


def test_a_frozen_table_gives_its_captions_alone(source, tmp_path):
    report = frozen(
        source, tmp_path, f'short,"walk, happy",ann,train,{digest(source / "short.bvh")},a walk,a person walks\n'
    )
    assert report.num_clips == 2 and report.left_out == {}
    assert [caption.text for caption in open_dataset(tmp_path / "data").captions("short")] == [
        "a walk",
        "a person walks",
    ]
    assert load_index(tmp_path / "data").label("short") == "walk, happy"


def test_a_frozen_table_of_captions_reads_no_other_texts(source, tmp_path):
    source = shutil.copytree(source, tmp_path / "source")
    (source / "short.txt").write_text("a text beside\n")
    table = tmp_path / "frozen.csv"
    table.write_text(f"file,caption,sha256\nshort,a walk,{digest(source / 'short.bvh')}\n")
    options = {"captions": table, "split": "100/0/0"}
    import_bvh_folder(source, tmp_path / "data", frozen=True, **options)
    assert [caption.text for caption in open_dataset(tmp_path / "data").captions("short")] == ["a walk"]
    table.write_text("file,caption,sha256\nshort,a walk,\nlong,,\n")
    with pytest.raises(UserError, match="1 rows of the frozen table gave no clip"):
        import_bvh_folder(source, tmp_path / "other", frozen=True, caption_from_name=True, **options)
    table.write_text("file,caption,sha256\nshort,a walk,0123456789abcdef\n")
    with pytest.raises(UserError, match="not 0123456789abcdef as in the table"):
        import_bvh_folder(source, tmp_path / "other", frozen=True, **options)
    assert not (tmp_path / "other").exists()


def test_a_frozen_table_may_name_an_animation(tmp_path):
    write_person(tmp_path / "source/figure.glb", BANDAI, {"Turn": 90.0, "Bow": 30.0}, seconds=2.0)
    report = frozen(tmp_path / "source", tmp_path, "figure/Turn,walk,ann,train,,he turns,\n")
    assert report.num_clips == 2 and report.left_out == {}


def test_a_broken_file_stops_a_frozen_import_if_the_table_names_it(source, tmp_path):
    source = shutil.copytree(source, tmp_path / "source")
    (source / "chair.glb").write_bytes(b"no motion")
    good = f"long,walk,ann,train,{digest(source / 'long.bvh')},a walk,\n"
    assert frozen(source, tmp_path, good).left_out == {}
    shutil.rmtree(tmp_path / "data")
    for name in ("chair", "Chair/Turn"):
        with pytest.raises(UserError, match=r"first: .*chair\.glb: is not a GLB file"):
            frozen(source, tmp_path, f"{good}{name},walk,ann,train,,a walk,\n")


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("short,walk,ann,train,0123456789abcdef,a walk,\n", "not 0123456789abcdef as in the table"),
        ("absent,walk,ann,train,,a walk,\n", "there is no motion absent"),
        ("third,walk,ann,train,,,\n", "there is no caption; write a caption"),
        ("third,walk,ann,dev,,a walk,\n", "split 'dev' is not"),
    ],
)
def test_a_row_that_fails_stops_a_frozen_import(source, tmp_path, line, words):
    good = f"long,walk,ann,train,{digest(source / 'long.bvh')},a walk,\n"
    with pytest.raises(UserError, match=words):
        frozen(source, tmp_path, good + line)
    assert not (tmp_path / "data").exists()


def test_a_frozen_table_without_any_file_is_an_error(source, tmp_path):
    with pytest.raises(UserError, match="has no file of the table"):
        frozen(source, tmp_path, "absent,walk,ann,train,,a walk,\n")


def test_a_file_of_one_frame_is_left_out(source, tmp_path):
    folder = shutil.copytree(source, tmp_path / "source")
    text = (folder / "short.bvh").read_text()
    head, _, frames = text.partition("Frame Time:")
    head = re.sub(r"Frames:\s*\d+", "Frames: 1", head)
    (folder / "one.bvh").write_text(f"{head}Frame Time:" + "\n".join(frames.split("\n")[:2]) + "\n")
    (tmp_path / "table.csv").write_text("file,caption,action\none,a man stands,stand\nlong,a man walks,walk\n")
    report = import_bvh_folder(folder, tmp_path / "data", captions=tmp_path / "table.csv", split="100/0/0")
    assert report.num_clips == 2 and "has only one frame" in report.left_out["one"]


def test_a_row_that_names_a_file_with_animations_is_told_their_names(source, tmp_path):
    folder = shutil.copytree(source, tmp_path / "source")
    write_person(folder / "figure.glb", BANDAI, {"Turn": 90.0}, seconds=2.0)
    (tmp_path / "table.csv").write_text("file,caption\nfigure,a man turns\nlong,a man walks\n")
    report = import_bvh_folder(folder, tmp_path / "data", captions=tmp_path / "table.csv", split="100/0/0")
    assert any("write one of them: 'figure/Turn'" in note for note in report.notes)
