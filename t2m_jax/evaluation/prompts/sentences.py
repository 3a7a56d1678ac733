"""Sentences that no training caption equals, and the paces that they are combined with.

The grammar of training captions cannot write them; a test shows it. Sentences that ask for two actions are like some
captions of composed motions. They are in `t2m_jax.data.importers.bandai_namco`, which leaves them out of its captions.
"""

import functools
from collections.abc import Mapping
from typing import NamedTuple

from t2m_jax.data.captioning.lexicon import read_words


class Pace(NamedTuple):
    """How fast a person is asked to move."""

    name: str
    phrases: tuple[str, ...]
    """What is added to a sentence."""
    share: float
    """Share of an action's clips by speed, the slowest ones; the fastest of them is the limit."""
    is_slow: bool
    """Whether the person is asked to stay below the limit, or to be above it."""


@functools.cache
def held_out_sentences() -> Mapping[str, tuple[str, ...]]:
    """Returns content of dataset-2 -> sentences that no training caption equals."""
    return {
        content: tuple(sentence.format(side=side) for sentence in group["sentences"])
        for group in read_words(__package__, "held_out")
        for content, side in group["contents"].items()
    }


@functools.cache
def held_out_paces() -> tuple[Pace, ...]:
    """Returns the paces that held-out sentences are combined with."""
    paces = []
    for entry in read_words(__package__, "held_out_paces"):
        is_slow = "slower_than" in entry
        share = entry["slower_than" if is_slow else "faster_than"]
        paces.append(Pace(entry["name"], tuple(entry["phrases"]), share, is_slow))
    return tuple(paces)
