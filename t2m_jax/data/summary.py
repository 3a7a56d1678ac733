"""A record of the data that a model was trained on: the number of clips per action, and the words of the captions."""

import dataclasses
import itertools
import re
from collections import Counter
from collections.abc import Collection, Sequence
from pathlib import Path

import numpy as np

from t2m_jax.data.banks.captions import all_tokens
from t2m_jax.data.captioning.wordings import load_wordings
from t2m_jax.data.folder import Clip, Dataset, samples_from_clip
from t2m_jax.data.index import action_of, label_actions, load_index
from t2m_jax.files.writing import save_json
from t2m_jax.text.coverage import MIN_LABELS, count_actions

NUM_CAPTIONS = 300
"""Captions that a record has, if there are so many clips."""

SHORTEST_SHARE = 0.01
"""Share of the clips that are shorter than the shortest motion that a model should make."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class TrainingData:
    """The data that a model was trained on."""

    data: str
    """Name of the data set."""
    num_clips: int
    """Number of clips, including mirrored twins."""
    clips_per_action: dict[str, int]
    """Number of clips per label of `index.csv`, of composed clips per number of their actions; empty without labels."""
    words: dict[str, int]
    """Number of uses per lower-case word of the captions, in the basic form if the caption files have tokens."""
    actions: dict[str, int]
    """Number of clips per verb of the captions, in its basic form (`t2m_jax.text.coverage.count_actions`)."""
    learned: tuple[str, ...]
    """Plain sentences for the actions of the clips; empty if few labels are those of `t2m_jax.data.captioning`."""
    missing: tuple[str, ...]
    """The same for other actions that captions can say, of which there is no clip."""
    shortest_frames: int
    """Nearly all clips and parts with own captions are at least so long: all but 1 %. Generated motion is, too."""
    captions: tuple[str, ...]
    """Some of the captions, one each of `NUM_CAPTIONS` clips, which `t2m data replay` generates again."""


def summarize_training_data(dataset: Dataset, clips: Sequence[Clip]) -> TrainingData:
    """Returns the record of some clips of a data set. The most frequent actions and words come first."""
    index = load_index(dataset.folder)
    labels = Counter(_action(label) for clip in clips if index and (label := index.label(clip.name)))
    # Of parts that captions with times are about, too. Without captions, as tokenizers read them, whole clips count.
    samples = [sample for clip in clips for sample in samples_from_clip(clip, dataset.info)]
    lengths = [len(sample.features) for sample in samples or clips]
    actions = [_single_action(index.label(clip.name) or "") for clip in clips] if index else []
    learned, missing = _plain_sentences(set(actions))
    words = Counter(token.partition("/")[0].lower() for tokens in all_tokens(clips) for token in tokens)
    return TrainingData(
        data=dataset.info.name,
        num_clips=len(clips),
        clips_per_action=dict(labels.most_common()),
        words=dict(words.most_common()),
        actions=count_actions(
            ([caption.text for caption in clip.captions] for clip in clips),
            actions,
            learned=[plainest for plainest, *_ in learned],
            missing=[plainest for plainest, *_ in missing],
        ),
        learned=tuple(itertools.chain.from_iterable(learned)),
        missing=tuple(itertools.chain.from_iterable(missing)),
        shortest_frames=int(np.quantile(lengths, SHORTEST_SHARE)) if lengths else 0,
        captions=_some_captions(clips),
    )


def _plain_sentences(labels: Collection[str]) -> tuple[list[tuple[str, ...]], list[tuple[str, ...]]]:
    """Returns sentences for each action of the grammar of captions that labels have, and for each that they lack."""
    contents = load_wordings().contents
    known = contents.keys() & labels
    if len(known) < MIN_LABELS:
        return [], []
    learned = [content for name, content in contents.items() if name in known]
    missing = [content for name, content in contents.items() if name not in known and content.like not in known]
    return [one.plain_sentences() for one in learned], [one.plain_sentences() for one in missing]


def _some_captions(clips: Sequence[Clip]) -> tuple[str, ...]:
    """Returns captions of whole clips, one each of some clips, always the same."""
    whole = [[caption.text for caption in clip.captions if caption.whole_clip] for clip in clips]
    generator = np.random.default_rng(0)
    drawn = [captions[generator.integers(len(captions))] for captions in whole if captions]
    return tuple(drawn[place] for place in generator.permutation(len(drawn))[:NUM_CAPTIONS])


def _single_action(label: str) -> str:
    """Returns the action of a label, empty if there is none, or several."""
    return action_of(label) if len(label_actions(label)) == 1 else ""


def _action(label: str) -> str:
    """Returns a label, or for one such as `walk + wave`, of which there are hundreds, how many actions it has."""
    if len(label_actions(label)) > 1:
        return action_of(label)
    # Numbers of times and of seconds are not of interest here.
    if " x " in label:
        return f"{action_of(label)}, repeated"
    return re.sub(r", \d+ s$", ", for some seconds", label)


def save_training_data(path: Path, data: TrainingData) -> None:
    """Writes a record as JSON."""
    save_json(path, dataclasses.asdict(data))
