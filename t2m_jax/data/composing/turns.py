"""Training motions that are made of others: standing still, and two or three actions in turn."""

import functools
import itertools
import random
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from t2m_jax.data.captioning.captions import Labels
from t2m_jax.data.captioning.lexicon import read_words
from t2m_jax.data.captioning.sequences import write_then_captions
from t2m_jax.data.files import FEATURES
from t2m_jax.data.texts import Caption
from t2m_jax.errors import UserError
from t2m_jax.motion.facts import WALKING_SPEED, measure
from t2m_jax.motion.features import features_from_positions, positions_from_features
from t2m_jax.motion.joining import OVERLAP, find_cut, join_features
from t2m_jax.motion.skeleton import HUMANML3D

STAND = "stand"
STILL_SPEED = 0.5
"""Meters per second of the fastest joint of a person who stands nearly still."""
QUIET_SPEED = 0.15
"""Speed to which such a stretch is slowed down."""
HANDS_DOWN = -0.3
"""Meters above the shoulder that a wrist stays below while a person stands still."""
SHORTEST_STAND = 8
"""Frames of the shortest stretch of stillness that is used."""
STAND_FRAMES = (30, 120)
"""Shortest and longest motion of standing still; stretches are played forward and backward until it is full."""
LONGEST = HUMANML3D.max_frames
SHORTEST_TRAVEL = 36
"""Frames of the shortest piece that travels; other pieces are whole clips."""
LONGEST_TRAVEL = 90
THREE_SHARE = 0.25
"""Share of the motions with three pieces."""
TRIES = 200
"""Draws of pieces before a motion of fitting length must have been found."""


class LabeledPiece(NamedTuple):
    """A piece of a clip, and the labels of the clip."""

    labels: Labels
    features: Float[np.ndarray, "T D"]

    @property
    def travels(self) -> bool:
        """Whether it goes somewhere."""
        steps = np.linalg.norm(self.features[:, HUMANML3D.layout.root_velocity], axis=1)
        return bool(steps.mean() * HUMANML3D.fps > WALKING_SPEED)


class Library(NamedTuple):
    """The training clips that pieces are taken from."""

    folder: Path
    """Of the data set."""
    clips: Mapping[str, Sequence[tuple[str, str]]]
    """Content -> names and styles."""

    def read(self, name: str) -> Float[np.ndarray, "T D"]:
        """Returns the raw features of a clip."""
        return np.load(self.folder / FEATURES / f"{name}.npy")


def find_stillness(positions: Float[np.ndarray, "T J 3"]) -> slice | None:
    """Returns the longest stretch in which a person stands still with low hands; None if it is too short."""
    names = HUMANML3D.joint_names
    wrists, shoulders = (
        positions[:, [names.index(f"{side}_{joint}") for side in ("left", "right")], 1]
        for joint in ("wrist", "shoulder")
    )
    speed = np.linalg.norm(np.diff(positions, axis=0, prepend=positions[:1]), axis=-1).max(axis=1) * HUMANML3D.fps
    still = (speed < STILL_SPEED) & np.all(wrists - shoulders < HANDS_DOWN, axis=1)
    # Where stillness begins and where it ends, in turn; the added ends close a stretch at an edge of the clip.
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
    # To the last frame and back again, without a jump.
    places = last - np.abs(places % (2 * last) - last)
    before = np.minimum(places.astype(int), last - 1)
    share = (places - before).astype(np.float32)[:, None, None]
    return positions[before] * (1 - share) + positions[before + 1] * share


def draw_pieces(library: Library, generator: random.Random) -> list[LabeledPiece]:
    """Returns two or three pieces that fit into one motion; no content follows itself.

    Raises:
        UserError: There are none.
    """
    known = read_words(__package__, "composed")["weights"]
    contents = [content for content in known if library.clips.get(content)]
    weights = [known[content] for content in contents]
    for _ in range(TRIES if len(contents) > 1 else 0):
        count = 3 if generator.random() < THREE_SHARE else 2
        drawn = generator.choices(contents, weights, k=count)
        # Two walks in turn would look like one.
        if any(one == following for one, following in itertools.pairwise(drawn)):
            continue
        pieces = []
        for content in drawn:
            name, style = generator.choice(library.clips[content])
            pieces.append(LabeledPiece(Labels(content, style), library.read(name)))
        # Walks that do not turn can be cut anywhere. They share the frames that the other pieces leave.
        cut = [piece.travels and "turn" not in piece.labels.content for piece in pieces]
        # Two pieces share the frames of their overlap.
        room = LONGEST + (count - 1) * OVERLAP
        room -= sum(len(piece.features) for piece, short in zip(pieces, cut, strict=True) if not short)
        if room < SHORTEST_TRAVEL * sum(cut):
            continue
        share = min(LONGEST_TRAVEL, room // max(sum(cut), 1))
        return [_shorten(piece, share, generator) if short else piece for piece, short in zip(pieces, cut, strict=True)]
    raise UserError(f"{library.folder}: no training clips are short enough to be joined; import without compositions")


def _shorten(piece: LabeledPiece, longest: int, generator: random.Random) -> LabeledPiece:
    """Returns at most `longest` frames of a piece that travels."""
    length = min(generator.randint(SHORTEST_TRAVEL, longest), len(piece.features))
    first = generator.randint(0, len(piece.features) - length)
    return piece._replace(features=piece.features[first : first + length])


def join_pieces(pieces: Sequence[LabeledPiece]) -> Float[np.ndarray, "T J 3"]:
    """Returns the joint positions of pieces, each joined to the one before where the poses are most alike."""
    whole = pieces[0].features
    for piece in pieces[1:]:
        # A second of each may be given up for a join at which the poses are more alike.
        slack = [min(20, len(features) // 4) for features in (whole, piece.features)]
        cut = find_cut(
            whole,
            piece.features,
            ends=range(max(len(whole) - slack[0], OVERLAP), len(whole) + 1),
            starts=range(min(slack[1], len(piece.features) - OVERLAP) + 1),
            skeleton=HUMANML3D,
        )
        joined = join_features(whole, piece.features, cut)
        # Bones changed their lengths in the overlap; features of the next overlap must be those of a person.
        whole = features_from_positions(positions_from_features(joined, HUMANML3D), HUMANML3D)
    return np.asarray(positions_from_features(whole, HUMANML3D))


@functools.cache
def held_out_compositions() -> Mapping[tuple[str, str], tuple[str, ...]]:
    """Returns two contents -> sentences that ask for one after the other. Models are tested with them."""
    entries = read_words(__package__, "held_out_composed")
    return {tuple(entry["parts"]): tuple(entry["sentences"]) for entry in entries}


def write_composed_captions(
    pieces: Sequence[LabeledPiece], *, count: int, generator: random.Random
) -> tuple[Caption, ...]:
    """Returns `count` different captions of a sequence of pieces."""
    facts = [
        measure(np.asarray(positions_from_features(piece.features, HUMANML3D)), fps=HUMANML3D.fps) for piece in pieces
    ]
    return write_then_captions([piece.labels for piece in pieces], facts=facts, count=count, generator=generator)
