"""Where sentences begin, as files say it."""

import numpy as np
import pytest

from t2m_jax.motion.bvh import load_bvh, save_bvh
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.part_captions import (
    MAX_CAPTION,
    MAX_PARTS,
    checked_parts,
    parts_from_note,
    parts_note,
    with_neighbors,
)
from t2m_jax.motion.rig import retarget

from .figures import walking_positions

PARTS = ((0, "a person walks"), (7, 'says "hi" \\ {and} [é]; # frame 3 (0.15 s): "b"'), (30, ""))


def motion(parts=PARTS):
    starts, captions = zip(*parts, strict=True)
    return Motion(walking_positions(40), 20.0, part_starts=starts, part_captions=captions)


def test_a_note_is_one_line_of_printable_ascii_without_braces():
    note = parts_note((*PARTS, (31, "new\nline\x1b[31m\x7f\u2028\ud800")), fps=20.0)
    assert note.startswith('# frame 0 (0.00 s): "a person walks"; frame 7 (0.35 s): ')
    assert note.isascii() and note.isprintable() and not set("{}") & set(note)
    assert parts_from_note(note, num_frames=40) == (*PARTS, (31, "new line [31m"))


def test_bvh_files_say_where_sentences_begin(tmp_path):
    for name, saved in (("plain", motion(((0, "a"),))[:]), ("parts", motion())):
        save_bvh(tmp_path / f"{name}.bvh", saved)
    plain, clip = load_bvh(tmp_path / "plain.bvh"), load_bvh(tmp_path / "parts.bvh")
    assert plain.parts == () and "#" not in (tmp_path / "plain.bvh").read_text()
    assert clip.parts == tuple(PARTS)
    np.testing.assert_array_equal(clip.positions, plain.positions)
    assert clip.joint_names == plain.joint_names and clip.end_sites.keys() == plain.end_sites.keys()
    again = retarget(clip)
    assert (again.part_starts, again.part_captions) == tuple(zip(*clip.parts, strict=True))
    assert retarget(clip.from_frame(5)).part_starts == () == clip.resampled(30.0).parts


def test_parts_move_with_the_frame_rate():
    walk = motion(((0, "left"), (7, "b"), (8, "c"), (39, "d")))
    assert walk.resampled(60.0).part_starts == (0, 21, 24, 117)
    slow = walk.resampled(5.0)
    assert (slow.part_starts, slow.part_captions) == ((0, 2), ("left", "c"))
    assert (walk.mirrored().part_starts, walk.mirrored().part_captions[0]) == (walk.part_starts, "right")
    assert walk.in_place().part_captions == walk.part_captions


@pytest.mark.parametrize(
    ("starts", "captions"),
    [
        (None, None),
        ("01", "ab"),
        (5, ["a"]),
        ([0], ["a", "b"]),
        ([1, 1], ["a", "b"]),
        ([-1], ["a"]),
        ([40], ["a"]),
        ([0.0], ["a"]),
        ([True], ["a"]),
        ([0], [None]),
        ([[0]], ["a"]),
    ],
)
def test_parts_that_a_motion_cannot_have_are_left_out(starts, captions):
    assert checked_parts(starts, captions, num_frames=40) == ()


@pytest.mark.parametrize(
    "note", ["", "Site", "# hello", '# frame 1 (0.05 s): "\\x"', '# frame 1 (0.05 s): "a', "# frame 1 (0.05 s): a"]
)
def test_other_notes_say_nothing(note):
    assert parts_from_note(note, num_frames=40) == ()


@pytest.mark.slow
def test_hostile_notes_are_cut():
    many = parts_note(tuple((number, "a") for number in range(100_000)), fps=20.0)
    assert len(parts_from_note(many, num_frames=100_000)) == MAX_PARTS
    ((_, text),) = parts_from_note(parts_note(((0, "a" * 3_000_000),), fps=20.0), num_frames=1)
    assert text == "a" * MAX_CAPTION
    for unit in ('# frame 1 (0.05 s): "', '; frame 1 (0.05 s): "\\', "\\", '"', "#"):
        note = '# frame 0 (0.00 s): "a"' + unit * 150_000
        assert parts_from_note(note, num_frames=9) in ((), ((0, "a"),))


def test_an_empty_sentence_is_that_of_its_neighbor():
    assert with_neighbors(("", "b", "", "c", "")) == ("b", "b", "b", "c", "c")
    assert with_neighbors(("", "")) == ("", "") and with_neighbors(()) == ()
