"""Training motions of two or three actions in turn."""

import functools
import itertools
import random
from collections.abc import Mapping, Sequence

from t2m_jax.data.captioning.lexicon import read_words
from t2m_jax.data.composing.pieces import LONGEST, LabeledPiece, Library
from t2m_jax.errors import UserError
from t2m_jax.motion.joining import OVERLAP

SHORTEST = 40
"""Frames of the shortest motion. Joins take up to a quarter of both clips."""
SHORTEST_TRAVEL = 36
"""Frames of the shortest piece that travels; other pieces are whole clips."""
LONGEST_TRAVEL = 90
THREE_SHARE = 0.25
"""Share of the motions with three pieces."""
TRIES = 200
"""Draws of pieces before a motion of fitting length must have been found."""


def draw_pieces(library: Library, generator: random.Random) -> list[LabeledPiece]:
    """Returns two or three pieces that fit into one motion; no content follows itself.

    Raises:
        UserError: There are none.
    """
    known = library.weights or read_words(__package__, "composed")["weights"]
    contents = [content for content in known if library.clips.get(content)]
    weights = [known[content] for content in contents]
    for _ in range(TRIES if len(contents) > 1 else 0):
        count = 3 if generator.random() < THREE_SHARE else 2
        drawn = _with_followers(generator.choices(contents, weights, k=count), library, generator)
        # Two walks in turn would look like one.
        if any(one == following for one, following in itertools.pairwise(drawn)):
            continue
        pieces: list[LabeledPiece] = []
        for content in drawn:
            clips = library.following(content, pieces[-1] if pieces else None)
            if clips:
                pieces.append(library.piece(content, *generator.choice(clips)))
        if len(pieces) < count:
            continue
        # Walks that do not turn can be cut anywhere. They share the frames that the other pieces leave.
        cut = [piece.travels and "turn" not in piece.labels.content for piece in pieces]
        # Two pieces share the frames of their overlap.
        shared = (count - 1) * OVERLAP
        room = LONGEST + shared
        room -= sum(len(piece.features) for piece, short in zip(pieces, cut, strict=True) if not short)
        if room < SHORTEST_TRAVEL * sum(cut) or sum(len(piece.features) for piece in pieces) - shared < SHORTEST:
            continue
        share = min(LONGEST_TRAVEL, room // max(sum(cut), 1))
        return [_shorten(piece, share, generator) if short else piece for piece, short in zip(pieces, cut, strict=True)]
    raise UserError(f"turns: no two training clips have {SHORTEST} to {LONGEST} frames together; leave it out")


def _shorten(piece: LabeledPiece, longest: int, generator: random.Random) -> LabeledPiece:
    """Returns at most `longest` frames of a piece that travels."""
    length = min(generator.randint(SHORTEST_TRAVEL, longest), len(piece.features))
    first = generator.randint(0, len(piece.features) - length)
    return piece._replace(features=piece.features[first : first + length])


def _with_followers(drawn: Sequence[str], library: Library, generator: random.Random) -> list[str]:
    """Returns contents, each of which is followed by one that can: who sat down stands up before anything else."""
    followers = read_words(__package__, "composed")["followers"]
    result = [drawn[0]]
    for content in drawn[1:]:
        possible = [one for one in followers.get(result[-1], ()) if library.clips.get(one)]
        result.append(generator.choice(possible) if possible else content)
    return result


@functools.cache
def held_out_compositions() -> Mapping[tuple[str, str], tuple[str, ...]]:
    """Returns two contents -> sentences that ask for one after the other. Models are tested with them."""
    entries = read_words(__package__, "held_out_composed")
    return {tuple(entry["parts"]): tuple(entry["sentences"]) for entry in entries}
