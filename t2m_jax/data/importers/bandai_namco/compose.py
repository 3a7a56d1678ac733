"""Training motions that are made of others: standing still, and two or three actions in turn."""

import itertools
import random
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from t2m_jax.data.captioning.captions import (
    CLAUSE_MARKS,
    FAST_WORDS,
    SLOW_WORDS,
    Labels,
    true_wordings,
)
from t2m_jax.data.captioning.grammar import Form, Manner, Wording, clause, opening
from t2m_jax.data.captioning.lexicon import tag_words, words_in
from t2m_jax.data.captioning.wordings import held_out_compositions, load_composition, load_wordings
from t2m_jax.data.files import FEATURES
from t2m_jax.data.texts import Caption
from t2m_jax.errors import UserError
from t2m_jax.motion.facts import WALKING_SPEED, measure
from t2m_jax.motion.features import features_from_positions, positions_from_features
from t2m_jax.motion.joining import OVERLAP, find_cut, join_features
from t2m_jax.motion.skeleton import HUMANML3D

STAND = "stand"
STILL_SPEED, QUIET_SPEED = 0.5, 0.15
"""Meters per second of the fastest joint of somebody who stands nearly still, and to which it is slowed down."""
HANDS_DOWN = -0.3
"""Meters above the shoulder that a wrist stays below while somebody stands still."""
SHORTEST_STAND = 8
"""Frames of the shortest stretch of stillness that is used."""
STAND_FRAMES = (30, 120)
"""Shortest and longest motion of standing still; stretches are played forward and backward until it is full."""
LONGEST = HUMANML3D.max_frames
SHORTEST_PART, LONGEST_TRAVEL = 36, 90
"""Frames of a part that travels; other parts are whole clips."""
THREE_SHARE = 0.25
"""Share of the motions with three parts."""
MANNER_SHARE = 0.25
"""Share of the clauses that name the style."""
FORMS: tuple[Form, ...] = ("present", "progressive", "imperative", "gerund")
FORM_WEIGHTS = (70, 12, 12, 6)
TRIES = 200
"""Draws of parts before a motion of fitting length must have been found."""


class Part(NamedTuple):
    """A piece of a clip and its labels."""

    labels: Labels
    features: Float[np.ndarray, "T D"]

    @property
    def travels(self) -> bool:
        """Whether it goes somewhere."""
        layout = HUMANML3D.layout
        steps = np.linalg.norm(self.features[:, layout.root_velocity], axis=1)
        return bool(steps.mean() * HUMANML3D.fps > WALKING_SPEED)


class Library(NamedTuple):
    """The training clips that parts are taken from."""

    folder: Path
    """Of the data set."""
    clips: Mapping[str, Sequence[tuple[str, str]]]
    """Content -> names and styles."""

    def read(self, name: str) -> Float[np.ndarray, "T D"]:
        """Returns the raw features of a clip."""
        return np.load(self.folder / FEATURES / f"{name}.npy")


def find_stillness(positions: Float[np.ndarray, "T J 3"]) -> slice | None:
    """Returns the longest stretch in which somebody stands still with low hands; None if it is too short."""
    names = HUMANML3D.joint_names
    wrists, shoulders = (
        positions[:, [names.index(f"{side}_{joint}") for side in ("left", "right")], 1]
        for joint in ("wrist", "shoulder")
    )
    speed = np.linalg.norm(np.diff(positions, axis=0, prepend=positions[:1]), axis=-1).max(axis=1) * HUMANML3D.fps
    still = (speed < STILL_SPEED) & np.all(wrists - shoulders < HANDS_DOWN, axis=1)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(int)))
    stretches = sorted((last - first, first) for first, last in zip(edges[::2], edges[1::2], strict=True))
    if not stretches or stretches[-1][0] < SHORTEST_STAND:
        return None
    length, first = stretches[-1]
    return slice(int(first), int(first + length))


def stand_still(positions: Float[np.ndarray, "T J 3"], *, num_frames: int) -> Float[np.ndarray, "U J 3"]:
    """Returns a stretch of stillness, played slowly forward and backward until it has `num_frames` frames."""
    last = len(positions) - 1
    speed = np.linalg.norm(np.diff(positions, axis=0), axis=-1).max() * HUMANML3D.fps
    places = np.arange(num_frames) * min(1.0, QUIET_SPEED / max(speed, QUIET_SPEED))
    places = last - np.abs(places % (2 * last) - last)
    before = np.minimum(places.astype(int), last - 1)
    share = (places - before).astype(np.float32)[:, None, None]
    return positions[before] * (1 - share) + positions[before + 1] * share


def draw_parts(library: Library, generator: random.Random) -> list[Part]:
    """Returns two or three parts that fit into one motion; no content follows itself.

    Raises:
        UserError: There are none.
    """
    composition = load_composition()
    contents = [content for content in composition.weights if library.clips.get(content)]
    weights = [composition.weights[content] for content in contents]
    for _ in range(TRIES if len(contents) > 1 else 0):
        count = 3 if generator.random() < THREE_SHARE else 2
        drawn = generator.choices(contents, weights, k=count)
        if any(one == following for one, following in itertools.pairwise(drawn)):
            continue
        parts = []
        for content in drawn:
            name, style = generator.choice(library.clips[content])
            parts.append(Part(Labels(content, style), library.read(name)))
        room = LONGEST + (count - 1) * OVERLAP
        cut = [part.travels and "turn" not in part.labels.content for part in parts]
        left = room - sum(len(part.features) for part, short in zip(parts, cut, strict=True) if not short)
        if left < SHORTEST_PART * sum(cut):
            continue
        share = min(LONGEST_TRAVEL, left // max(sum(cut), 1))
        return [_shorten(part, share, generator) if short else part for part, short in zip(parts, cut, strict=True)]
    raise UserError(f"{library.folder}: no training clips are short enough to be joined; import without compositions")


def _shorten(part: Part, longest: int, generator: random.Random) -> Part:
    """Returns a piece of a part that travels, at most `longest` frames."""
    length = min(generator.randint(SHORTEST_PART, longest), len(part.features))
    first = generator.randint(0, len(part.features) - length)
    return part._replace(features=part.features[first : first + length])


def join_parts(parts: Sequence[Part]) -> Float[np.ndarray, "T J 3"]:
    """Returns the joint positions of parts in turn, each joined to the one before where their poses are most alike."""
    whole = parts[0].features
    for part in parts[1:]:
        slack = [min(20, len(features) // 4) for features in (whole, part.features)]
        cut = find_cut(
            whole,
            part.features,
            ends=range(max(len(whole) - slack[0], OVERLAP), len(whole) + 1),
            starts=range(min(slack[1], len(part.features) - OVERLAP) + 1),
            skeleton=HUMANML3D,
        )
        joined = join_features(whole, part.features, cut)
        # Bones changed their lengths in the overlap; features of the next overlap must be those of a person.
        whole = features_from_positions(positions_from_features(joined, HUMANML3D), HUMANML3D)
    return np.asarray(positions_from_features(whole, HUMANML3D))


def write_composed_captions(parts: Sequence[Part], *, count: int, generator: random.Random) -> tuple[Caption, ...]:
    """Returns `count` different captions of parts in turn; none is a held-out sentence."""
    forbidden = {tuple(words_in(text)) for request in held_out_compositions() for text in request.sentences}
    texts: dict[str, None] = {}
    while len(texts) < count:
        text = _compose(parts, generator)
        if tuple(words_in(text)) not in forbidden:
            texts[text] = None
    return tuple(Caption(text, tag_words(text, strict=True)) for text in texts)


def _compose(parts: Sequence[Part], generator: random.Random) -> str:
    """Returns one sentence for parts in turn."""
    composition, subject = load_composition(), generator.choice(load_wordings().subjects)
    (form,) = generator.choices(FORMS, FORM_WEIGHTS)
    patterns = composition.three if len(parts) == 3 else composition.two
    if len(parts) == 2 and parts[0].travels and not parts[1].travels:
        patterns = (*patterns, *composition.stops)
    pattern = generator.choice(patterns)
    said = [(_choose_wording(part, generator), _choose_manner(part, generator)) for part in parts]
    limb = generator.choice(("hand", "hand", "arm"))

    def clauses(form: Form) -> list[str]:
        sides = [load_wordings().contents[part.labels.content].side for part in parts]
        return [
            clause(wording.predicate, subject, form=form, side=side, limb=limb, manner=manner)
            for (wording, manner), side in zip(said, sides, strict=True)
        ]

    now, ing = clauses(form), {f"ing{place}": text for place, text in enumerate(clauses("progressive"))}
    stop, still = (clause(text, subject, form=form) for text in ("[stop]", "[stand] still"))
    text = pattern.format(*now, **ing, subject=opening(subject, form), stop=stop, still=still)
    return text + generator.choice(("", "."))


def _choose_wording(part: Part, generator: random.Random) -> Wording:
    """Returns a wording that holds for a part and has no clause of its own; one for low hands, if they stay low."""
    facts = measure(np.asarray(positions_from_features(part.features, HUMANML3D)), fps=HUMANML3D.fps)
    marks, wordings = (*CLAUSE_MARKS, " and then "), true_wordings(part.labels, facts)
    short = [one for one in wordings if not any(mark in one.predicate for mark in marks)]
    return generator.choice([one for one in short if one.needs == "low"] or short)


def _choose_manner(part: Part, generator: random.Random) -> Manner | None:
    manners = [one for one in load_wordings().styles[part.labels.style].manners if one.place == "end"]
    # A part of some style is not always slow or fast.
    manners = [one for one in manners if not any(word in one.text for word in (*SLOW_WORDS, *FAST_WORDS))]
    return generator.choice(manners) if generator.random() < MANNER_SHARE else None
