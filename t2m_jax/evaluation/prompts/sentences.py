"""Sentences that no training caption equals, and the paces that they are combined with.

The grammar of training captions cannot write them; a test shows it. Sentences that ask for two actions are like some
captions of composed motions. They are in `t2m_jax.data.importers.bandai_namco`, which leaves them out of its captions.
"""

import functools
from collections.abc import Mapping
from typing import NamedTuple

from t2m_jax.data.captioning.lexicon import read_words


class Pace(NamedTuple):
    """How fast a person is asked to move. One of the limits is None."""

    name: str
    phrases: tuple[str, ...]
    """What is added to a sentence."""
    slower_than: float | None
    """Share of an action's clips, the slowest ones."""
    faster_than: float | None
    """Share of an action's clips, all but the fastest ones."""


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
    return tuple(
        Pace(entry["name"], tuple(entry["phrases"]), entry.get("slower_than"), entry.get("faster_than"))
        for entry in read_words(__package__, "held_out_paces")
    )
