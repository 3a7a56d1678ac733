"""The record of the data that a model was trained on."""

import dataclasses
import json

import numpy as np
import pytest

from t2m_jax.data.captioning.wordings import load_wordings
from t2m_jax.data.folder import Clip, Dataset, DatasetInfo, open_dataset
from t2m_jax.data.importers.synthetic import KINDS
from t2m_jax.data.index import IndexEntry, save_index
from t2m_jax.data.summary import NUM_CAPTIONS, save_training_data, summarize_training_data
from t2m_jax.data.texts import Caption
from t2m_jax.files.reading import load_json
from t2m_jax.motion.skeleton import HUMANML3D
from t2m_jax.text.coverage import MIN_LABELS

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


def test_parts_with_captions_of_their_own_say_how_long_motions_are(tmp_path):
    captions = (Caption("he walks", (), 0.0, 3.0), Caption("he waves", (), 3.0, 8.0))
    clips = [Clip(f"{number}", np.zeros((160, 263), np.float32), captions) for number in range(4)]
    assert summarize_training_data(dataset_in(tmp_path), clips).shortest_frames == 60


def test_without_labels_no_action_is_counted(tmp_path):
    found = summarize_training_data(dataset_in(tmp_path), [clip("a", Caption("walk"))])
    assert found.clips_per_action == {} and found.words == {"walk": 1}


def test_actions_are_counted_by_the_text_of_captions(tmp_path):
    clips = [clip("a", Caption("He waves."), Caption("he is waving")), clip("b", Caption("he walks", ("he/PRON",)))]
    assert summarize_training_data(dataset_in(tmp_path), clips).actions == {"wave": 1, "walk": 1}


def summary_of(tmp_path, labels, caption):
    save_index(tmp_path, [IndexEntry(f"{number}", "", label) for number, label in enumerate(labels)])
    clips = [clip(f"{number}", Caption(caption)) for number in range(len(labels))]
    return summarize_training_data(dataset_in(tmp_path), clips)


def test_plain_sentences_say_which_actions_of_the_grammar_the_clips_have(tmp_path):
    lacking = {"throw", "slash", "dance-short", "wave-left-hand"}
    labels = [f"{content}, normal" for content in load_wordings().contents if content not in lacking]
    found = summary_of(tmp_path, [*labels, "walk + throw"], "a person punches, throws a fist, walks and waves")
    assert len(found.learned) == 3 * len(labels)
    assert {"a person walks forward", "a person fights with a sword"} <= set(found.learned)
    # The other two are like a sword fight and a dance.
    assert len(found.missing) == 6
    assert {"a person throws something", "a person waves with the left hand"} < set(found.missing)
    # Waves of the right hand are there.
    assert found.actions == dict.fromkeys(("punch", "walk", "wave"), len(labels) + 1)


def test_labels_of_others_say_nothing_of_our_grammar(tmp_path):
    labels = [*(f"exercise {number}" for number in range(MIN_LABELS)), "walk", "run"]
    found = summary_of(tmp_path, labels, "a person walks")
    assert (found.learned, found.missing) == ((), ())


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
    assert load_json(tmp_path / "training_data.json") == json.loads(json.dumps(dataclasses.asdict(found)))


def test_some_captions_are_kept_and_always_the_same(tmp_path):
    clips = [
        clip(f"{number}", Caption(f"go {number}"), Caption(f"part {number}", (), 1.0, 2.0)) for number in range(400)
    ]
    found, again = (summarize_training_data(dataset_in(tmp_path), clips).captions for _ in range(2))
    assert len(set(found)) == NUM_CAPTIONS and all(text.startswith("go ") for text in found) and found == again
