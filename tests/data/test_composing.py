"""Motions that are made of a labeled data set: in turn, at once, repeated, for some time."""

import csv
import random
import shutil
from collections import Counter

import numpy as np
import pytest

from t2m_jax.data.audit import audit_dataset
from t2m_jax.data.captioning.captions import Labels
from t2m_jax.data.composing import turns
from t2m_jax.data.composing.at_once import LEGS, draw_at_once, put_on_legs
from t2m_jax.data.composing.compose import compose_dataset
from t2m_jax.data.composing.extra import EXTRA_PREFIXES
from t2m_jax.data.composing.lasting import draw_lasting, with_length
from t2m_jax.data.composing.pieces import REACH, drawn_weights, make_library
from t2m_jax.data.composing.repeated import borders, count_times, draw_repeated, repeat
from t2m_jax.data.composing.turns import draw_pieces
from t2m_jax.data.folder import DatasetInfo, open_dataset
from t2m_jax.data.index import IndexEntry, is_single, label_actions, load_index, save_index
from t2m_jax.data.texts import Caption
from t2m_jax.data.writer import finish_folder, new_folder, with_twins, write_twins
from t2m_jax.errors import UserError
from t2m_jax.motion.features import features_from_positions, positions_from_features
from t2m_jax.motion.kinematics import forward_kinematics
from t2m_jax.motion.rotations import matrix_from_quaternion
from t2m_jax.motion.skeleton import HUMANML3D
from tests.conftest import REPOSITORY
from tests.motion.figures import INDEX, standing_offsets, walking_positions


def about(axis, angles):
    """Rotations about an axis by some angles (radians)."""
    half = np.asarray(angles)[:, None] / 2
    return matrix_from_quaternion(np.concatenate([np.cos(half), np.sin(half) * np.array(axis)], axis=-1))


def raising(num_frames, *, times, joint="left_shoulder"):
    """A figure that raises a hand some times, from the hip to above the head."""
    rotations = np.tile(np.eye(3, dtype=np.float32), (num_frames, 22, 1, 1))
    swing = np.pi * (0.5 - 0.5 * np.cos(np.linspace(0, 2 * np.pi * times, num_frames)))
    rotations[:, INDEX[joint]] = about((0, 0, 1.0 if "left" in joint else -1.0), swing)
    translations = np.tile(standing_offsets(), (num_frames, 1, 1))
    translations[:, 0] = [0, 0.92, 0]
    return forward_kinematics(rotations, translations, HUMANML3D.parents).positions


def hopping(num_frames, *, times):
    """A figure that jumps some times, and stands before and after."""
    positions = raising(num_frames, times=0)
    height = np.zeros(num_frames)
    height[10:-10] = 0.3 * np.abs(np.sin(np.linspace(0, np.pi * times, num_frames - 20)))
    return positions + np.stack([0 * height, height, 0 * height], axis=-1)[:, None]


def lying(num_frames):
    """A figure that lies on its back, as no other motion begins or ends."""
    return raising(num_frames, times=0)[..., [0, 2, 1]] * np.array([-1, 1, 1])


def features(positions):
    return np.asarray(features_from_positions(positions, HUMANML3D))


MOTIONS = {
    "walk": walking_positions(121),
    "run": walking_positions(100),
    "raise-up-left-hand": raising(60, times=1),
    "wave-right-hand": raising(90, times=5, joint="right_shoulder"),
    "wave-both-hands": raising(80, times=4),
    "bow": lying(50),
    "stand": raising(70, times=0),
}


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """A data set with a clip of each action and, in its test split, one more walk."""
    folder = tmp_path_factory.mktemp("labeled") / "data"
    captions = (Caption("a person moves", ("a/DET", "person/NOUN", "move/VERB")),)
    with new_folder(folder) as new:
        for name, positions in MOTIONS.items():
            write_twins(new, f"clip_{name}", positions, captions=captions, skeleton=HUMANML3D)
        write_twins(new, "clip_test", walking_positions(90), captions=captions, skeleton=HUMANML3D)
        splits = {"train": with_twins([f"clip_{name}" for name in MOTIONS]), "test": with_twins(["clip_test"])}
        finish_folder(new, splits, info=DatasetInfo(name="Actions", licence="CC0"), skeleton=HUMANML3D)
        rows = [IndexEntry(f"clip_{name}", "", f"{name}, normal", person=name[:3]) for name in MOTIONS]
        save_index(new, [*rows[:-1], rows[-1]._replace(licence="MIT"), IndexEntry("clip_test", "", "walk, normal")])
    return folder


@pytest.fixture(scope="module")
def library(data):
    labels = {f"clip_{name}": Labels(name, "normal") for name in MOTIONS}
    weights = drawn_weights(label.content for label in labels.values())
    return make_library(data, labels, weights=weights, reach=REACH)


def bone_lengths(positions):
    return np.linalg.norm(positions[:, 1:] - positions[:, list(HUMANML3D.parents[1:])], axis=-1)


def test_arms_on_legs_keep_the_legs_and_every_bone():
    legs = np.asarray(positions_from_features(features(walking_positions(61)), HUMANML3D))
    arms = np.asarray(positions_from_features(features(raising(61, times=2)), HUMANML3D))
    both = put_on_legs(arms, legs)
    np.testing.assert_allclose(both[:, [0, *LEGS]], legs[:, [0, *LEGS]], atol=1e-5)
    np.testing.assert_allclose(bone_lengths(both), np.tile(HUMANML3D.bone_lengths[1:], (60, 1)), atol=1e-4)
    above = (both[:, INDEX["left_wrist"]] - both[:, INDEX["left_shoulder"]])[:, 1]
    wanted = (arms[:, INDEX["left_wrist"]] - arms[:, INDEX["left_shoulder"]])[:, 1]
    np.testing.assert_allclose(above, wanted, atol=1e-4)
    assert not np.allclose(both[:, INDEX["left_wrist"]], legs[:, INDEX["left_wrist"]], atol=0.2)


def test_arms_turn_with_the_legs():
    legs = np.asarray(positions_from_features(features(walking_positions(61)), HUMANML3D))
    arms = np.asarray(positions_from_features(features(raising(61, times=2)), HUMANML3D))
    quarter = matrix_from_quaternion(np.array([np.sqrt(0.5), 0, np.sqrt(0.5), 0]))
    seen = put_on_legs(arms @ quarter.T, legs)
    np.testing.assert_allclose(seen[5:-5], put_on_legs(arms, legs)[5:-5], atol=0.02)


def test_two_at_once_are_whole_arms_and_a_part_of_a_walk(library):
    drawn = [draw_at_once(library, random.Random(number)) for number in range(20)]
    pairs = {(legs.labels.content, arms.labels.content) for legs, arms, _ in drawn}
    assert {legs for legs, _ in pairs} == {"walk", "run"} and len({arms for _, arms in pairs}) == 3
    for legs, arms, positions in drawn:
        assert len(legs.features) == len(arms.features) == len(positions)
        if arms.labels.content.startswith("raise"):
            assert len(arms.features) == 59 and count_times(positions, arms.labels.content) == 1


def test_times_are_counted():
    for times in (1, 2, 4):
        assert count_times(raising(40 * times, times=times), "raise-up-left-hand") == times
        assert count_times(hopping(20 + 14 * times, times=times), "jump") == times
    assert count_times(raising(40, times=0), "raise-up-left-hand") == 0
    assert count_times(raising(80, times=2), "raise-up-right-hand") == 0
    places = borders(raising(121, times=3), "raise-up-left-hand")
    assert [round(place / 40) for place in places] == [0, 1, 2, 3]


@pytest.mark.parametrize(("shown", "times"), [(1, 1), (1, 2), (1, 4), (3, 3), (4, 2), (4, 3), (3, 4), (5, 5)])
def test_something_is_repeated_as_often_as_wanted(shown, times):
    clip = features(raising(40 * shown + 1, times=shown))
    made = repeat(clip, "raise-up-left-hand", times)
    positions = np.asarray(positions_from_features(made, HUMANML3D))
    assert count_times(positions, "raise-up-left-hand") == times
    real = np.abs(np.diff(raising(40 * shown + 1, times=shown), n=2, axis=0)).max()
    assert np.abs(np.diff(positions, n=2, axis=0)).max() < 2 * real + 0.02, "no joint jumps where it is joined"


def test_no_clip_shows_less_than_it_does():
    assert repeat(features(raising(161, times=4)), "raise-up-left-hand", 1) is None
    assert repeat(features(raising(81, times=2)), "raise-up-left-hand", 4) is None


def test_repeated_motions_count_right(library):
    for number in range(10):
        piece, times = draw_repeated(library, random.Random(number))
        assert count_times(piece.positions, piece.labels.content) == times
        assert len(piece.features) <= 196


@pytest.mark.parametrize("length", [40, 81, 100, 119])
def test_a_motion_gets_a_length_and_keeps_its_ends(length):
    clip = features(walking_positions(90))
    made = with_length(clip, length)
    assert len(made) == length
    np.testing.assert_array_equal(made[:8], clip[:8])
    np.testing.assert_array_equal(made[-8:], clip[-8:])
    assert with_length(clip, 89) is clip and with_length(clip, 300) is None


def test_timed_motions_last_whole_seconds(library):
    for number in range(10):
        piece, seconds = draw_lasting(library, random.Random(number))
        assert len(piece.features) == 20 * seconds + 1


def test_what_follows_begins_as_the_other_ends(library):
    drawn = [draw_pieces(library, random.Random(number)) for number in range(60)]
    seen = Counter(piece.labels.content for pieces in drawn for piece in pieces)
    assert seen["walk"] and seen["raise-up-left-hand"] and not seen["bow"], "nobody else lies"
    anywhere = [draw_pieces(library._replace(reach=np.inf), random.Random(number)) for number in range(60)]
    assert any(piece.labels.content == "bow" for pieces in anywhere for piece in pieces)


def test_short_clips_are_no_turns(library, monkeypatch):
    monkeypatch.setattr(turns, "SHORTEST", 400)
    with pytest.raises(UserError, match="turns: no two training clips"):
        draw_pieces(library, random.Random(0))


def test_contents_without_a_weight_are_drawn_by_their_number():
    weights = drawn_weights(["walk"] * 3 + ["kick-ball"] * 10 + ["jump"] * 500)
    assert weights == {"walk": 5, "kick-ball": 0.5, "jump": 2.0}


@pytest.mark.slow
def test_a_data_set_is_composed(data, tmp_path):
    options = {"turns": 6, "at_once": 4, "repeated": 3, "timed": 4, "still": True}
    report = compose_dataset(data, tmp_path / "new", **options)
    dataset, index = open_dataset(tmp_path / "new"), load_index(tmp_path / "new")
    kinds = Counter(name.partition("_")[0] for name in dataset.names("train"))
    assert (kinds["composed"], kinds["atonce"], kinds["repeated"], kinds["timed"]) == (6, 4, 3, 4)
    assert kinds["clip"] == kinds["Mclip"] == len(MOTIONS) and any(kind.startswith("stand") for kind in kinds)
    assert dataset.names("test") == ("clip_test", "Mclip_test")
    assert report.num_clips == sum(report.split_sizes.values())
    labels = {kind: index.label(f"{kind}_00000") for kind in ("composed", "atonce", "repeated", "timed")}
    assert " + " in labels["composed"] and labels["atonce"].endswith(", at once") and " x " in labels["repeated"]
    seconds = int(labels["timed"].split()[-2])
    assert len(dataset.features("timed_00000")) == 20 * seconds
    entries = [entry for name, entry in index.entries.items() if name.startswith("composed")]
    assert {entry.licence for entry in entries} <= {"CC0", "MIT", "CC0; MIT"}
    assert all(entry.dataset == "Actions" and entry.person for entry in entries)
    problems = audit_dataset(tmp_path / "new").problems
    assert [problem for problem in problems if not problem.endswith("stand.npy: nothing moves")] == []
    compose_dataset(data, tmp_path / "again", **options)
    for name in ("composed_00005", "atonce_00003", "repeated_00002", "timed_00003"):
        np.testing.assert_array_equal(dataset.features(name), open_dataset(tmp_path / "again").features(name))


@pytest.mark.parametrize(
    ("options", "words"),
    [({}, "nothing to compose"), ({"turns": -1}, "turns: -1 is not a whole number")],
)
def test_wrong_numbers_are_refused(data, tmp_path, options, words):
    with pytest.raises(UserError, match=words):
        compose_dataset(data, tmp_path / "new", **options)


def test_labels_are_needed_and_nothing_is_composed_twice(data, tmp_path):
    compose_dataset(data, tmp_path / "new", timed=1)
    with pytest.raises(UserError, match="timed_00000 is composed already"):
        compose_dataset(tmp_path / "new", tmp_path / "other", turns=1)
    (tmp_path / "new" / "index.csv").unlink()
    with pytest.raises(UserError, match="no training clip has a label"):
        compose_dataset(tmp_path / "new", tmp_path / "other", timed=1)


@pytest.mark.parametrize("kind", sorted(EXTRA_PREFIXES))
def test_what_was_made_of_one_clip_is_not_composed_twice(data, tmp_path, kind):
    copy = shutil.copytree(data, tmp_path / "copy")
    name = (copy / "train.txt").read_text().split("\n")[0]
    with (copy / "train.txt").open("a") as names:
        names.write(f"\n{kind}_unknown\n{kind}_{name}\n")
    with pytest.raises(UserError, match=f"{kind}_{name} is composed already"):
        compose_dataset(copy, tmp_path / "other", turns=1)


def test_actions_of_labels():
    assert label_actions("walk, happy") == label_actions("walk, 5 s") == label_actions("walk x 3") == ("walk",)
    assert label_actions("walk + wave-left-hand, at once") == ("walk", "wave-left-hand")
    assert label_actions("walk + bow + run") == ("walk", "bow", "run")
    composed = ("walk, 5 s", "walk x 3", "walk + bow", "walk + wave-left-hand, at once")
    assert [is_single(label) for label in ("walk", "walk, happy", "walk, slow x 3", *composed)] == [True] * 3 + [
        False
    ] * 4


def test_no_person_of_berkeley_is_in_two_splits():
    table = REPOSITORY / "configs" / "data" / "berkeley-mhad.csv"
    with table.open(encoding="utf-8", newline="") as lines:
        homes = {(row["person"], row["split"]) for row in csv.DictReader(lines)}
    assert len({person for person, _ in homes}) == len(homes) == 11
    assert Counter(split for _, split in homes) == {"train": 8, "test": 2, "val": 1}
