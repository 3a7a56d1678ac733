"""The table of recordings and labels of a data set."""

import pytest

from t2m_jax.data.index import IndexEntry, action_of, load_index, save_index
from t2m_jax.errors import UserError


def test_what_is_written_is_read(tmp_path):
    save_index(tmp_path, [IndexEntry("a", "one, two.bvh", "turn-left, happy"), IndexEntry("b", "b.bvh", "")])
    index = load_index(tmp_path)
    assert index.source("a") == "one, two.bvh" and index.label("a") == "turn-left, happy"
    assert index.label("b") is None and index.source("c") is None


def test_a_twin_is_of_the_same_recording_and_shows_the_other_side(tmp_path):
    save_index(tmp_path, [IndexEntry("a", "a.bvh", "turn-left, happy"), IndexEntry("Moth", "moth.bvh", "fly")])
    index = load_index(tmp_path)
    assert index.source("Ma") == "a.bvh" and index.label("Ma") == "turn-right, happy"
    assert index.source("Moth") == "moth.bvh" and index.label("Moth") == "fly"


def test_the_table_of_humanml3d_is_read_as_it_is(tmp_path):
    header = "source_path,start_frame,end_frame,new_name\n"
    (tmp_path / "index.csv").write_text(header + "./pose_data/KIT/3/kick_poses.npy,0,117,000000.npy\n")
    index = load_index(tmp_path)
    assert index.source("M000000") == "./pose_data/KIT/3/kick_poses.npy" and not index.has("label")


def test_a_label_has_one_action_or_a_number_of_them():
    labels = ["walk", "walk, happy", "walk, 5 s", "jump x 3", "walk + wave + bow", "walk + clap, at once"]
    expected = ["walk", "walk", "walk", "jump", "3 actions in turn", "2 actions at once"]
    assert [action_of(label) for label in labels] == expected


def test_no_table_is_no_index(tmp_path):
    assert load_index(tmp_path) is None


@pytest.mark.parametrize("content", [b"name,label\na,b\n", b"\xff\xfe\x00", b'new_name,label\n"a'])
def test_another_table_is_refused(content, tmp_path):
    (tmp_path / "index.csv").write_bytes(content)
    if content.startswith(b"new_name"):
        assert not load_index(tmp_path).has("label")
        return
    with pytest.raises(UserError, match=r"index\.csv"):
        load_index(tmp_path)
