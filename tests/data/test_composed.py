"""Training motions that are made of others."""

import itertools
import random

import numpy as np
import pytest

from t2m_jax.data.audit import audit_dataset
from t2m_jax.data.captioning.captions import CAPTIONS, Labels, says_pace
from t2m_jax.data.captioning.lexicon import read_words
from t2m_jax.data.captioning.sequences import write_then_captions
from t2m_jax.data.captioning.wordings import load_wordings
from t2m_jax.data.composing import extra, turns
from t2m_jax.data.composing.extra import (
    MORE_CAPTIONS,
    VARIANTS,
    write_more_captions,
    write_slow_clips,
    write_stand_clips,
)
from t2m_jax.data.composing.pieces import LONGEST, LabeledPiece, Library, join_pieces
from t2m_jax.data.composing.standing import QUIET_SPEED, find_stillness, stand_still
from t2m_jax.data.composing.turns import draw_pieces
from t2m_jax.data.files import FEATURES, POSITIONS
from t2m_jax.data.folder import open_dataset
from t2m_jax.data.importers.bandai_namco import import_bandai_namco, labels_from_name
from t2m_jax.data.index import load_index
from t2m_jax.data.texts import Caption, load_captions
from t2m_jax.data.writer import new_folder, write_twins
from t2m_jax.motion.facts import measure
from t2m_jax.motion.features import features_from_positions
from t2m_jax.motion.kinematics import forward_kinematics
from t2m_jax.motion.skeleton import HUMANML3D
from tests.data.bvh_files import write_bvh
from tests.motion.figures import INDEX, standing_offsets, walking_positions

pytestmark = pytest.mark.slow


def standing(num_frames, *, raised=()):
    """A figure that stands still; in the frames `raised`, the left hand is up."""
    rotations = np.tile(np.eye(3, dtype=np.float32), (num_frames, 22, 1, 1))
    rotations[list(raised), INDEX["left_shoulder"]] = np.diag([-1.0, -1.0, 1.0])
    translations = np.tile(standing_offsets(), (num_frames, 1, 1))
    translations[:, 0] = [0, 0.92, 0]
    return forward_kinematics(rotations, translations, HUMANML3D.parents).positions


def part(content, positions, style="normal"):
    return LabeledPiece(Labels(content, style), features_from_positions(positions, HUMANML3D))


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    """Two walks and two figures that stand, one of which lasts too long for any composition."""
    folder = tmp_path_factory.mktemp("library")
    (folder / FEATURES).mkdir()
    clips = {"walk": walking_positions(121), "run": walking_positions(60), "wave": standing(70), "bow": standing(190)}
    for name, positions in clips.items():
        np.save(folder / FEATURES / f"{name}.npy", features_from_positions(positions, HUMANML3D))
    contents = {"walk": "walk", "run": "run", "wave-left-hand": "wave", "bow": "bow"}
    return Library(folder, {content: [(name, "normal")] for content, name in contents.items()})


def test_stillness_is_the_longest_stretch_with_low_hands():
    assert find_stillness(standing(60, raised=range(20, 35))) == slice(36, 60)
    assert find_stillness(standing(20, raised=range(6, 14))) is None
    assert find_stillness(walking_positions(60)) is None


def test_standing_still_goes_forward_and_back_at_a_quiet_speed():
    steps = np.arange(5, dtype=np.float32)[:, None, None] * np.ones((22, 3), np.float32)
    quiet = steps * 0.004  # 0.14 m/s
    there_and_back = [0, 1, 2, 3, 4, 3, 2, 1, 0, 1, 2, 3]
    np.testing.assert_allclose(stand_still(quiet, num_frames=12)[:, 0, 0] / 0.004, there_and_back, atol=1e-5)
    slowed = stand_still(steps * 0.01, num_frames=60)
    speeds = np.linalg.norm(np.diff(slowed, axis=0), axis=-1) * 20
    np.testing.assert_allclose(speeds.max(), QUIET_SPEED, rtol=1e-3)
    assert slowed.min() == 0 and slowed.max() == pytest.approx(0.04, abs=0.003)


def test_parts_fit_and_differ_and_only_travel_is_cut(library):
    seen = set()
    for number in range(60):
        parts = draw_pieces(library, random.Random(number))
        contents = [one.labels.content for one in parts]
        seen |= set(contents)
        assert len(parts) in (2, 3) and all(a != b for a, b in itertools.pairwise(contents))
        assert len(join_pieces(parts)) <= LONGEST
        assert all(len(one.features) == 69 for one in parts if one.labels.content == "wave-left-hand")
    assert seen == {"walk", "run", "wave-left-hand"}, "a bow of 189 frames leaves no room"


def test_joined_parts_keep_their_bones_and_come_in_order():
    joints = join_pieces(
        [part("walk", walking_positions(80)), part("wave-left-hand", standing(80, raised=range(30, 60)))]
    )
    lengths = np.linalg.norm(joints[:, 1:] - joints[:, list(HUMANML3D.parents[1:])], axis=-1)
    np.testing.assert_allclose(lengths, np.tile(HUMANML3D.bone_lengths[1:], (len(joints), 1)), atol=1e-5)
    speed = np.linalg.norm(np.diff(joints[:, 0, ::2], axis=0), axis=-1) * 20
    assert speed[:40].min() > 1.0 and speed[-40:].max() < 0.05
    above = joints[:, INDEX["left_wrist"], 1] - joints[:, INDEX["left_shoulder"], 1]
    assert above[:60].max() < 0 < above[60:].max()


def said(caption):
    """What a caption says, in basic forms and without typing mistakes."""
    return " ".join(token.partition("/")[0] for token in caption.tokens)


def test_captions_do_not_name_the_other_side():
    parts = [part("walk", walking_positions(60)), part("wave-left-hand", standing(60))]
    captions = captions_of(parts, count=60, generator=random.Random(0))
    assert len({caption.text for caption in captions}) == 60
    for caption in captions:
        assert "left" in said(caption).split() and "right" not in said(caption).split()


def captions_of(pieces, *, count, generator):
    labels, facts = [piece.labels for piece in pieces], [piece.facts for piece in pieces]
    return write_then_captions(labels, facts=facts, count=count, generator=generator)


def labels_of(names):
    return {name: labels_from_name(name) for name in names}


def test_each_style_stands_still_as_often_as_the_others(tmp_path, monkeypatch):
    monkeypatch.setattr(extra, "MOST_OF_A_STYLE", 2)
    styles = ["elderly"] * 4 + ["normal", "active"]
    names = [f"dataset-2_raise-up-left-hand_{style}_{number:03d}" for number, style in enumerate(styles)]
    with new_folder(tmp_path / "data") as folder:
        for number, name in enumerate(names):
            raised = range(20 + number, 70) if number < 5 else range(70)
            captions = (Caption("raises a hand", ("raise/VERB",)),)
            write_twins(folder, name, standing(70, raised=raised), captions=captions, skeleton=HUMANML3D)
        made = write_stand_clips(folder, labels_of(names))
    assert {clip.name.partition("_")[2] for clip in made} == {names[2], names[3], names[4]}, (
        "the longest; none of `active`"
    )
    assert len({clip.name for clip in made}) == len(made) == 3 * VARIANTS
    assert {clip.label for clip in made} == {"stand, elderly", "stand, normal"}


def test_every_content_of_compositions_has_words():
    for content in read_words(turns.__package__, "composed")["weights"]:
        assert load_wordings().contents[content].wordings


def write_walks(folder):
    """Writes 60 clips, each of which walks faster than the one before, and returns their names."""
    names = [f"dataset-2_walk_elderly_{number:03d}" for number in range(60)]
    captions = (Caption("walks", ("walk/VERB",)), Caption("walks slowly", ("walk/VERB", "slowly/ADV")))
    for number, name in enumerate(names):
        positions = walking_positions(40)
        positions[:, :, 2] += positions[:, :1, 2] * (number - 30) / 40
        write_twins(folder, name, positions, captions=captions, skeleton=HUMANML3D)
    return names


def speed_of(folder, name):
    return measure(np.load(folder / POSITIONS / f"{name}.npy"), fps=20.0).speed


def test_the_slowest_clips_are_called_slow(tmp_path):
    with new_folder(tmp_path / "data") as folder:
        names = write_walks(folder)
        write_more_captions(folder, labels_of(names))
        texts = {name: [said(one) for one in load_captions(folder / "texts" / f"{name}.txt")] for name in names}
        twin = [one.text for one in load_captions(folder / "texts" / f"M{names[0]}.txt")]
        speeds = [speed_of(folder, name) for name in names]
    assert len(twin) == len(texts[names[0]])

    def calls(name, pace):
        return sum(says_pace(text, pace) for text in texts[name])

    assert calls(names[0], "slow") >= 2 * MORE_CAPTIONS and not calls(names[0], "fast")
    assert calls(names[59], "fast") >= 2 * MORE_CAPTIONS and not calls(names[59], "slow")
    assert texts[names[59]][:2] != ["walk", "walk slowly"] == texts[names[0]][:2], "it is the fastest"
    assert texts[names[30]][0] == "walk" and 2 <= len(texts[names[30]]) <= 1 + MORE_CAPTIONS
    assert not calls(names[30], "slow") and not calls(names[30], "fast")
    called_slow = [speed for name, speed in zip(names, speeds, strict=True) if calls(name, "slow")]
    assert 6 <= len(called_slow) < 12 and max(called_slow) < 0.95 * np.quantile(speeds, 0.2)


def test_slow_clips_are_written_again_more_slowly(tmp_path):
    with new_folder(tmp_path / "data") as folder:
        names = [*write_walks(folder), "dataset-2_walk_elderly_060"]
        frozen = np.repeat(walking_positions(40)[:1], 40, axis=0)
        write_twins(folder, names[-1], frozen, captions=(Caption("walks", ("walk/VERB",)),), skeleton=HUMANML3D)
        made = write_slow_clips(folder, labels_of(names))
        limit = np.quantile([speed_of(folder, name) for name in names], 0.1)
        speeds = {clip.name: speed_of(folder, clip.name) / limit for clip in made}
        texts = [said(one) for clip in made for one in load_captions(folder / "texts" / f"{clip.name}.txt")]
        twins = [(folder / FEATURES / f"M{clip.name}.npy").is_file() for clip in made]
    assert 8 <= len(made) < 40 and all(twins) and {clip.label for clip in made} == {"walk, elderly"}
    assert all(0.74 < speed < 0.94 for speed in speeds.values()), speeds
    assert all(says_pace(text, "slow") for text in texts)


def test_nothing_is_called_slow_among_few_clips(tmp_path):
    with new_folder(tmp_path / "data") as folder:
        names = write_walks(folder)[:49]
        assert write_slow_clips(folder, labels_of(names)) == []
        write_more_captions(folder, labels_of(names))
        captions = load_captions(folder / "texts" / f"{names[0]}.txt")
    assert len(captions) == 2 + MORE_CAPTIONS, "only the style is added"
    assert captions[1].text == "walks slowly", "what it had is not judged"


@pytest.mark.release
def test_one_wave_is_not_called_slow(tmp_path):
    names = [f"dataset-2_wave-left-hand_elderly_{number:03d}" for number in range(60)]
    with new_folder(tmp_path / "data") as folder:
        for number, name in enumerate(names):
            positions, waves = standing(80, raised=range(10, 70)), 1 if number == 1 else 3
            sway = np.sin(np.linspace(0, 2 * np.pi * waves, 60)) * (0.12 if number > 1 else 0.08)
            positions[10:70, INDEX["left_wrist"], 0] += sway
            write_twins(folder, name, positions, captions=(Caption("waves", ("wave/VERB",)),), skeleton=HUMANML3D)
        write_more_captions(folder, labels_of(names))
        assert speed_of(folder, names[1]) < speed_of(folder, names[0]) < 0.9 * speed_of(folder, names[2])
        texts = [[said(one) for one in load_captions(folder / "texts" / f"{name}.txt")] for name in names[:2]]
        made = {clip.name for clip in write_slow_clips(folder, labels_of(names))}
    assert made and f"slow1_{names[1]}" not in made
    slow, once = (sum(says_pace(text, "slow") for text in one) for one in texts)
    assert slow >= 2 * MORE_CAPTIONS and not once


def test_parts_with_low_hands_are_called_low_and_no_part_is_called_slow():
    positions = standing(80, raised=range(30, 60))
    positions[:, INDEX["left_wrist"], 1] = np.minimum(
        positions[:, INDEX["left_wrist"], 1], positions[:, INDEX["left_shoulder"], 1]
    )
    low = part("wave-left-hand", positions, "elderly")
    for parts, is_low in (([low], True), ([part("wave-left-hand", standing(80, raised=range(30, 60)))], False)):
        walk = part("walk", walking_positions(60), "elderly")
        texts = [said(one) for one in captions_of([walk, *parts], count=40, generator=random.Random(2))]
        assert all(any(mark in text for mark in LOW) for text in texts) == is_low
        assert not any(word in text for text in texts for word in ("slow", "quick", "fast"))
    assert any("old" in text or "elder" in text for text in texts), "manners are still said"


LOW = ("chest", "shoulder", "front of the body", "small wave", "a little", "low")


def test_an_import_with_compositions(tmp_path):
    archive, lists = tmp_path / "archive", tmp_path / "lists"
    lists.mkdir()
    names = [f"dataset-2_{content}_active_001" for content in ("walk", "run", "wave-left-hand", "raise-up-left-hand")]
    for seed, name in enumerate([*names, "dataset-2_walk_active_002"]):
        write_bvh(archive / f"{name}.bvh", seed=seed, num_frames=90, speed=120.0 * ("walk" in name or "run" in name))
    for split, members in {"train": names, "val": [], "test": ["dataset-2_walk_active_002"]}.items():
        (lists / f"{split}.txt").write_text("".join(f"{name}\n" for name in members))
    report = import_bandai_namco(archive, tmp_path / "data", splits=lists, composed=5, workers=1)
    dataset = open_dataset(tmp_path / "data")
    made = [name for name in dataset.names("train") if "composed" in name]
    assert len(made) == 10 and "composed_00004" in made and "5 composed ones" in report.notes[-1]
    assert len(dataset.captions("dataset-2_walk_active_002")) == CAPTIONS, "clips of other splits keep their captions"
    assert " + " in load_index(dataset.folder).label("composed_00000")
    assert audit_dataset(tmp_path / "data").problems == []
    import_bandai_namco(archive, tmp_path / "again", splits=lists, composed=5, workers=1)
    np.testing.assert_array_equal(open_dataset(tmp_path / "again").features(made[3]), dataset.features(made[3]))
