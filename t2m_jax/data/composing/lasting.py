"""Training motions that last a whole number of seconds."""

import random

import numpy as np
from jaxtyping import Float

from t2m_jax.data.captioning.lexicon import read_words
from t2m_jax.data.composing.pieces import LabeledPiece, Library
from t2m_jax.errors import UserError
from t2m_jax.motion.joining import OVERLAP, find_cut, join_features
from t2m_jax.motion.skeleton import HUMANML3D

SECONDS = range(2, 10)
TRIES = 100
KEPT = 12
"""Frames at both ends of a clip that stay as they are, such as the raising of a hand."""
STEP = 2
"""Frames between two places of the join that are tried."""


def draw_lasting(library: Library, generator: random.Random) -> tuple[LabeledPiece, int]:
    """Returns a motion that lasts as many seconds as the number says.

    Raises:
        UserError: There are no clips of which one can be made.
    """
    weights = read_words(__package__, "composed")["lasting_contents"]
    for _ in range(TRIES):
        piece = library.draw_clip(weights, generator)
        if piece is None:
            break
        seconds = generator.choice(SECONDS)
        # A frame more, because the last one has no step to another, so that it is lost when features are computed.
        features = with_length(piece.features, round(seconds * HUMANML3D.fps) + 1)
        if features is not None:
            return piece._replace(features=features), seconds
    raise UserError("timed: no training clips can be made longer or shorter; leave it out")


def with_length(features: Float[np.ndarray, "T D"], length: int) -> Float[np.ndarray, "U D"] | None:
    """Returns a motion of some frames that begins and ends as a clip does; None if that needs more than one join.

    Frames in the middle are left out or shown again, where the poses are most alike.
    """
    count = len(features)
    if length == count:
        return features
    # The second part begins so many frames before or after the end of the first one, whatever that is.
    ahead = count - length - OVERLAP
    earliest = max(OVERLAP + KEPT, -ahead)
    latest = min(count, count - OVERLAP - KEPT - ahead)
    ends = range(earliest, latest + 1, STEP)
    if not ends:
        return None
    cuts = [
        find_cut(features, features, ends=range(end, end + 1), starts=range(start, start + 1), skeleton=HUMANML3D)
        for end, start in ((end, end + ahead) for end in ends)
    ]
    return join_features(features, features, min(cuts, key=lambda cut: cut.cost))
