"""Training motions in which something is done once to five times, counted by the peaks of a height or a distance."""

import itertools
import random
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from t2m_jax.data.captioning.lexicon import read_words
from t2m_jax.data.composing.pieces import LONGEST, LabeledPiece, Library, join_at
from t2m_jax.errors import UserError
from t2m_jax.motion.features import positions_from_features
from t2m_jax.motion.joining import OVERLAP
from t2m_jax.motion.repetitions import SIGNALS, find_peaks
from t2m_jax.motion.skeleton import HUMANML3D

MOST = 5
COUNT_WEIGHTS = (1, 3, 3, 2, 1)
"""How often motions of one to five times are made; most clips show a thing once or many times already."""
TRIES = 100
SLACK = 4
"""Frames around the lowest point between two times at which a join may be."""


class CountedContent(NamedTuple):
    """How a content is counted."""

    signal: str
    """What has a peak each time, of `motion.repetitions.SIGNALS`."""
    least: float
    """Height of the smallest peak, in meters."""
    weight: float
    """How often motions of it are made."""
    side: str = ""
    """Of the hand, for signals that depend on it."""

    def values(self, positions: Float[np.ndarray, "T J 3"]) -> Float[np.ndarray, " T"]:
        """Returns the signal."""
        return SIGNALS[self.signal](positions, self.side)


def counted_contents() -> dict[str, CountedContent]:
    """Returns the contents that can be counted."""
    return {name: CountedContent(**entry) for name, entry in read_words(__package__, "composed")["repeated"].items()}


def count_times(positions: Float[np.ndarray, "T J 3"], content: str) -> int:
    """Returns how often a content that can be counted is done."""
    how = counted_contents()[content]
    return len(find_peaks(how.values(positions), least=how.least))


def borders(positions: Float[np.ndarray, "T J 3"], content: str) -> list[int]:
    """Returns the frames between which something is done once: the first, the lowest between two peaks, the end."""
    how = counted_contents()[content]
    values = how.values(positions)
    peaks = find_peaks(values, least=how.least)
    between = [one + int(values[one:other].argmin()) for one, other in itertools.pairwise(peaks)]
    return [0, *between, len(values)]


def draw_repeated(library: Library, generator: random.Random) -> tuple[LabeledPiece, int]:
    """Returns a motion in which something is done as often as the number says.

    Raises:
        UserError: There are no clips of which one can be made.
    """
    weights = {content: how.weight for content, how in counted_contents().items()}
    for _ in range(TRIES):
        piece = library.draw_clip(weights, generator)
        if piece is None:
            break
        content = piece.labels.content
        times = generator.choices(range(1, MOST + 1), COUNT_WEIGHTS)[0]
        features = repeat(piece.features, content, times)
        if features is None or len(features) > LONGEST:
            continue
        made = piece._replace(features=features)
        # Who counts again must find the same number: joins may have taken or made one.
        if count_times(made.positions, content) == times:
            return made, times
    raise UserError("repeated: no training clips can be repeated; leave it out")


def repeat(features: Float[np.ndarray, "T D"], content: str, times: int) -> Float[np.ndarray, "U D"] | None:
    """Returns a motion that does what a clip shows a number of times; None if the clip does not lend itself to it.

    It begins and ends as the clip. In between, times are left out or done again.
    """
    places = borders(np.asarray(positions_from_features(features, HUMANML3D)), content)
    shown = len(places) - 1
    if shown == times:
        return features
    if shown == 1:
        whole = features
        for _ in range(times - 1):
            whole = join_at(whole, features, slack=SLACK)
        return whole
    # Of the times before and after the join; each side has one at least, as many as the clip shows at most.
    before = (times + 1) // 2
    after = times - before
    if not (after >= 1 and before < shown and after < shown):
        return None
    half = OVERLAP // 2 + SLACK
    first = features[: places[before] + half]
    second = features[max(places[shown - after] - half, 0) :]
    return join_at(first, second, slack=2 * SLACK)
