"""The record of the data that a model was trained on."""

import dataclasses

import numpy as np
import pytest

from t2m_jax.data.folder import Clip, Dataset, DatasetInfo, open_dataset
from t2m_jax.data.importers.synthetic import KINDS
from t2m_jax.data.index import IndexEntry, save_index
from t2m_jax.data.summary import NUM_CAPTIONS, save_training_data, summarize_training_data
from t2m_jax.data.texts import Caption
from t2m_jax.files.reading import load_json
from t2m_jax.motion.skeleton import HUMANML3D

FEATURES = np.zeros((3, 263), np.float32)


def clip(name, *captions):
    return Clip(name, FEATURES, captions)


def dataset_in(folder):
    return Dataset(folder=folder, info=DatasetInfo(name="mine"), skeleton=HUMANML3D)


def test_clips_are_counted_by_label_and_words_by_use(tmp_path):
    save_index(
        tmp_path, [IndexEntry("a", "a.bvh", "turn left"), IndexEntry("b", "b.bvh", "walk"), IndexEntry("c", "", "")]
    )
    clips = [
        clip("a", Caption("He TURNS left.", ("he/PRON", "turn/VERB", "left/ADV")), Caption("He turns LEFT")),
        clip("Ma", Caption("x", ("He/PRON", "turn/VERB", "right/ADV"))),
        clip("b"),
        clip("c"),
        clip("unknown"),
    ]
    found = summarize_training_data(dataset_in(tmp_path), clips)
    assert (found.data, found.num_clips) == ("mine", 5)
    assert found.clips_per_action == {"turn left": 1, "turn right": 1, "walk": 1}
    assert found.words == {"he": 3, "turn": 2, "left": 2, "turns": 1, "right": 1}


def test_composed_clips_are_counted_by_their_number_of_actions(tmp_path):
    labels = ("walk + wave", "wave + walk", "walk + wave + run", "walk")
    save_index(tmp_path, [IndexEntry(f"{number}", "", label) for number, label in enumerate(labels)])
    found = summarize_training_data(dataset_in(tmp_path), [clip(f"{number}") for number in range(4)])
    assert found.clips_per_action == {"2 actions in turn": 2, "3 actions in turn": 1, "walk": 1}


def test_all_but_the_shortest_clips_say_how_long_motions_are(tmp_path):
    lengths = [5, *(30 for _ in range(200))]
    clips = [Clip(f"{number}", np.zeros((length, 263), np.float32), ()) for number, length in enumerate(lengths)]
    assert summarize_training_data(dataset_in(tmp_path), clips).shortest_frames == 30
    assert summarize_training_data(dataset_in(tmp_path), clips[:50]).shortest_frames == 17


def test_without_labels_no_action_is_counted(tmp_path):
    found = summarize_training_data(dataset_in(tmp_path), [clip("a", Caption("walk"))])
    assert found.clips_per_action == {} and found.words == {"walk": 1}


def test_actions_are_counted_by_the_text_of_captions(tmp_path):
    clips = [clip("a", Caption("He waves."), Caption("he is waving")), clip("b", Caption("he walks", ("he/PRON",)))]
    assert summarize_training_data(dataset_in(tmp_path), clips).actions == {"wave": 1, "walk": 1}


@pytest.mark.slow
def test_a_data_set_on_disk(synthetic_folder, tmp_path):
    dataset = open_dataset(synthetic_folder)
    clips = dataset.clips("train")
    found = summarize_training_data(dataset, clips)
    assert found.data == "synthetic" and found.num_clips == len(clips) == sum(found.clips_per_action.values())
    assert found.clips_per_action.keys() <= KINDS.keys()
    assert found.words["walk"] > 0 and 0 < found.actions["walk"] < found.num_clips
    assert len(found.captions) == len(clips) and set(found.captions) <= {
        caption.text for clip in clips for caption in clip.captions
    }
    save_training_data(tmp_path / "training_data.json", found)
    assert load_json(tmp_path / "training_data.json") == dataclasses.asdict(found) | {"captions": [*found.captions]}


def test_some_captions_are_kept_and_always_the_same(tmp_path):
    clips = [
        clip(f"{number}", Caption(f"go {number}"), Caption(f"part {number}", (), 1.0, 2.0)) for number in range(400)
    ]
    found, again = (summarize_training_data(dataset_in(tmp_path), clips).captions for _ in range(2))
    assert len(set(found)) == NUM_CAPTIONS and all(text.startswith("go ") for text in found) and found == again
