"""Which actions that a model knows mean about the same as another one, by the embeddings of a sentence encoder."""

import functools
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float

from t2m_jax.text.activities import ACTIVITIES
from t2m_jax.text.verbs import CLAUSE_STARTS, PREPOSITIONS, Word, inflected

SAME_MEANING = 0.62
"""Cosine of two actions that mean the same for a model: "strolls" and "walks" have 0.85, "jogs" and "runs" 0.74. Of 36
actions that no model here knows, such as "plays the piano", one had more with any of 34 known ones (MiniLM)."""
NEAR_MEANING = 0.4
"""Cosine from which on an action is worth naming: "applause" has 0.55 with "claps", and "happy" 0.32 with any."""
NUM_NAMED = 2
"""Actions that are named as the nearest ones."""
NUM_COMPARED = 3
"""Sentences nearest to a prompt whose mean cosine tells whether it asks for something that was not learned."""
NUM_ACTIVITIES = 2
"""The same for activities, each of which is said in one way only."""
ACTIVITY_MARGIN = 0.05
"""How much nearer than what was learned the activities must be."""
MAX_OBJECT = 3
"""Words after a verb that say what is done: "plays the piano"."""
LONG_OBJECT = 5
"""The same in a long sentence."""

Embed = Callable[[Sequence[str]], Float[Array | np.ndarray, "B E"]]


class Nearest(NamedTuple):
    """The known actions that mean most nearly the same as another one."""

    actions: tuple[str, ...]
    """In the third person, the nearest first."""
    is_same: bool
    """Whether the first means the same."""
    is_near: bool
    """Whether the first means something like it."""


class Meanings:
    """Finds the nearest of some known actions. Nothing is embedded before it is asked."""

    def __init__(
        self, actions: Sequence[str], embed: Embed, *, learned: Sequence[str] = (), missing: Sequence[str] = ()
    ):
        """Keeps what a model knows.

        Args:
            actions: Verbs in their basic form.
            embed: Embeds sentences.
            learned: Plain sentences for what it learned, such as "a person punches forward".
            missing: The same for what its data lack, such as "a person throws something".
        """
        self._actions = actions
        self._embed = embed
        self._learned = learned
        self._missing = missing

    @property
    def are_labeled(self) -> bool:
        """Whether captions were written for labels of the captions' own grammar, so that it is known what they lack."""
        return bool(self._learned)

    @functools.cached_property
    def _known(self) -> tuple[list[str], Float[np.ndarray, "A E"]]:
        names = [inflected(action, "VBZ") for action in self._actions]
        return names, self._unit([f"a person {name}" for name in names])

    @functools.cached_property
    def _learned_vectors(self) -> Float[np.ndarray, "L E"]:
        return self._unit(self._learned)

    @functools.cached_property
    def _missing_vectors(self) -> Float[np.ndarray, "M E"]:
        return self._unit(self._missing)

    @functools.cached_property
    def _activity_vectors(self) -> Float[np.ndarray, "A E"]:
        return self._unit(ACTIVITIES)

    def _unit(self, sentences: Sequence[str]) -> Float[np.ndarray, "B E"]:
        embeddings = np.asarray(self._embed(sentences), np.float32)
        return embeddings / np.maximum(np.linalg.norm(embeddings, axis=1, keepdims=True), 1e-9)

    def nearest(self, sentence: str) -> Nearest:
        """Returns the known actions that are nearest to what a sentence says, such as "a person plays the piano"."""
        if not self._actions:
            return Nearest((), is_same=False, is_near=False)
        names, known = self._known
        query = self._unit([sentence])[0]
        cosines = known @ query
        order = np.argsort(-cosines)
        is_same = cosines.max() >= SAME_MEANING
        if self._learned and not is_same:
            is_same = (self._learned_vectors @ query).max() >= SAME_MEANING
        named = tuple(names[place] for place in order[:NUM_NAMED])
        return Nearest(named, bool(is_same), bool(cosines.max() >= NEAR_MEANING))

    def missing(self, sentence: str) -> str:
        """Returns which of the missing sentences one is nearest to; "" if it is nearer to those that were learned."""
        if not self._learned or not self._missing:
            return ""
        query = self._unit([sentence])[0]
        learned, missing = self._learned_vectors @ query, self._missing_vectors @ query
        is_missing = _mean_of_best(missing, NUM_COMPARED) > _mean_of_best(learned, NUM_COMPARED)
        return self._missing[int(missing.argmax())] if is_missing else ""

    def activity(self, sentence: str) -> str:
        """Returns which of `ACTIVITIES` a sentence is nearest to; "" if it is nearer to what was learned."""
        if not self._learned:
            return ""
        query = self._unit([sentence])[0]
        learned, others = self._learned_vectors @ query, self._activity_vectors @ query
        lead = _mean_of_best(others, NUM_ACTIVITIES) - _mean_of_best(learned, NUM_ACTIVITIES)
        return ACTIVITIES[int(others.argmax())] if lead > ACTIVITY_MARGIN else ""


def _mean_of_best(cosines: Float[np.ndarray, " S"], count: int) -> float:
    return float(np.sort(cosines)[-count:].mean())


def sentence_of(words: Sequence[Word], place: int, *, is_long: bool = False) -> str:
    """Returns a plain sentence about the action at a place in a caption: "a person plays the piano".

    A long one goes on after prepositions: "a person gives them a round of applause".
    """
    longest = LONG_OBJECT if is_long else MAX_OBJECT
    ends = CLAUSE_STARTS if is_long else CLAUSE_STARTS | PREPOSITIONS
    rest = []
    for word in words[place + 1 : place + 1 + longest]:
        # A second verb is not the object of the first one.
        if word.text in ends or (word.action and word.text.endswith("s")):
            break
        rest.append(word.text)
    return " ".join(["a person", inflected(words[place].action, "VBZ"), *rest])
