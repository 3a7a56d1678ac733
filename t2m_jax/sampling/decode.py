"""From codes to motion, whole or piece by piece. Padding, cutting and which frames are final are decided here."""

import dataclasses
import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from t2m_jax.checkpoints.tokenizer import TrainedTokenizer
from t2m_jax.devices import put_everywhere, put_rows
from t2m_jax.motion.cleanup import clean_positions
from t2m_jax.motion.features import positions_from_features, root_from_features
from t2m_jax.motion.joining import FADE_SECONDS, fade_features
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.rotations import rotate_vectors
from t2m_jax.motion.skeleton import Skeleton
from t2m_jax.sampling.batches import round_up
from t2m_jax.sampling.programs import decode_batch, decode_positions

WINDOW_ROWS = 16
"""Rows of codes that are decoded together, without those for context. With fewer, these are decoded more
often; with more, a stream of several sentences waits longer."""
MAX_CONTEXT = 1000
"""Rows that frames may depend on, for windows. Decoders that read more (GroupNorm) get the whole motion."""
ROW_BUCKET = 32
"""Codes of changing lengths are padded to a multiple of this many rows, so that few programs are compiled."""

Codes = Int[np.ndarray, "_ R"]


def pad_codes(
    codes: Sequence[Codes], *, size: int | None = None, batch: int | None = None
) -> tuple[Int[np.ndarray, "B N R"], Int[np.ndarray, " B"]]:
    """Returns codes of different lengths in one array, 0 after their ends, and the lengths.

    Args:
        codes: Of each motion.
        size: Rows of the array; by default those of the longest motion.
        batch: Motions of the array; by default as many as there are. Others fill it up, with one row each.
    """
    code_lengths = np.ones(batch or len(codes), np.int32)
    code_lengths[: len(codes)] = [len(rows) for rows in codes]
    padded = np.zeros((len(code_lengths), size or int(code_lengths.max()), codes[0].shape[1]), np.int32)
    for motion, rows in zip(padded, codes, strict=False):
        motion[: len(rows)] = rows
    return padded, code_lengths


def decode_motions(
    tokenizer: TrainedTokenizer,
    codes: Sequence[Codes],
    *,
    skeleton: Skeleton,
    size: int | None = None,
    batch: int | None = None,
    clean: bool = False,
) -> list[Motion]:
    """Returns the motions of codes, decoded together, with features and codes.

    With the same `size` and `batch`, a motion does not depend on the others to the last bit.

    Args:
        tokenizer: The tokenizer of the codes.
        codes: Of each motion.
        skeleton: The skeleton of the motions.
        size: As in `pad_codes`.
        batch: As in `pad_codes`.
        clean: Whether positions are cleaned. Then `positions_raw` are as decoded.
    """
    # Shapes decide which program runs, and two programs may round differently.
    padded, code_lengths = pad_codes(codes, size=size, batch=batch)
    decoded = decode_positions(
        put_everywhere(tokenizer.variables),
        tokenizer.normalizer,
        *put_rows((padded, code_lengths)),
        tokenizer=tokenizer.module,
        skeleton=skeleton,
    )
    features, positions = map(np.asarray, decoded)
    # Before the clean-up, whose limits are in meters; the features of KIT-ML are in millimeters.
    positions = positions * np.float32(skeleton.metres_per_unit)
    frames = code_lengths * tokenizer.config.downsample
    cleaned = np.asarray(clean_positions(*put_rows((positions, frames)), skeleton=skeleton)) if clean else None
    return [
        Motion(
            positions=(positions if cleaned is None else cleaned)[number, : frames[number]],
            fps=skeleton.fps,
            skeleton=skeleton,
            positions_raw=None if cleaned is None else positions[number, : frames[number]],
            features=features[number, : frames[number]],
            codes=padded[number, : code_lengths[number]],
        )
        for number in range(len(codes))
    ]


class Piece(NamedTuple):
    """Some rows of codes, and their raw features."""

    codes: Codes
    features: Float[np.ndarray, "T D"]


class Place(NamedTuple):
    """Where a piece of a motion begins, and where it faces."""

    half_turn: float
    """Half of the angle from the piece's heading to +Z, in radians."""
    x: float
    z: float
    """The root's place on the ground, in the skeleton's unit."""


ORIGIN = Place(0.0, 0.0, 0.0)


class DecodedPiece(NamedTuple):
    """A piece of a motion as decoded."""

    codes: Codes
    features: Float[np.ndarray, "T D"]
    positions: Float[np.ndarray, "T J 3"]
    """In meters."""


class FeatureWindows:
    """The features of codes that come in turn, each frame once, as soon as it is final.

    A frame depends on its row, and on `TokenizerConfig.decoder_context` rows on either side. A window has these and the
    rows whose frames are taken from it. All windows have one size, so they are decoded by one program.
    """

    def __init__(self, tokenizer: TrainedTokenizer, *, least: int, most: int, last: int, size: int):
        """Begins without codes.

        Args:
            tokenizer: The tokenizer of the codes.
            least: Rows of the shortest piece while further rows follow.
            most: Rows of the longest piece while further rows follow.
            last: Rows of the longest piece after the end.
            size: Rows of a window.
        """
        self.tokenizer = tokenizer
        self.context = tokenizer.config.decoder_context
        self.least = least
        self.most = most
        self.last = last
        self.size = size
        self.rows = np.zeros((0, tokenizer.config.num_quantizers), np.int32)
        """Those that are still needed."""
        self.done = 0
        """How many of them are only there because later frames depend on them."""

    def add(self, rows: Codes, *, ended: bool = False) -> Iterator[Piece]:
        """Yields the pieces that are final with some more rows; `ended` says that these are the last."""
        self.rows = np.concatenate([self.rows, rows])
        # The last `context` rows wait, because their frames depend on rows that come later.
        while (final := min(self.most, len(self.rows) - self.done - self.context)) >= self.least:
            yield self._decode(final)
        while ended and len(self.rows) > self.done:
            left = len(self.rows) - self.done
            # The last piece is not short, because it may fade into another sentence.
            count = left // 2 if self.last < left < 2 * self.last else min(self.last, left)
            # Without a bound of the context, no frame is final before the end.
            yield self._decode(left if self.context > MAX_CONTEXT else count)

    def _decode(self, count: int) -> Piece:
        """Returns the next `count` rows and their features, and forgets what no later frame depends on."""
        first = self.done
        last = self.done + count
        window = self.rows[: last + self.context]
        size = round_up(len(window), ROW_BUCKET) if self.context > MAX_CONTEXT else self.size
        arrays = put_rows(pad_codes([window], size=size))
        variables = put_everywhere(self.tokenizer.variables)
        decoded = decode_batch(variables, self.tokenizer.normalizer, *arrays, tokenizer=self.tokenizer.module)
        downsample = self.tokenizer.config.downsample
        piece = Piece(self.rows[first:last], np.asarray(decoded)[0, first * downsample : last * downsample])
        # Later frames depend on these rows, so they stay, but their frames are not taken again.
        self.done = min(last, self.context)
        self.rows = self.rows[last - self.done :]
        return piece


class GrowingMotion:
    """A motion of one sentence while it is sampled: each frame is decoded once, as soon as it is final."""

    def __init__(self, tokenizer: TrainedTokenizer, *, skeleton: Skeleton, step: int, max_codes: int):
        """Begins without codes.

        Args:
            tokenizer: The tokenizer of the codes.
            skeleton: The skeleton of the motion.
            step: Rows that are added at a time.
            max_codes: Rows of the longest motion.
        """
        context = tokenizer.config.decoder_context
        # A window need not have more rows than the longest motion.
        size = min(step + 2 * context, max_codes)
        # After the end nothing waits any more, so all rows that have waited are one piece.
        self.windows = FeatureWindows(tokenizer, least=1, most=step, last=step + context, size=size)
        self.num_rows = 0
        """Rows that were added."""
        self.skeleton = skeleton
        self.place = ORIGIN

    def add(self, rows: Codes, *, ended: bool = False) -> Motion | None:
        """Returns the frames that are final with some more rows, as decoded; None if there are none."""
        self.num_rows += len(rows)
        pieces = list(self.windows.add(rows, ended=ended))
        if not pieces:
            return None
        codes, features = map(np.concatenate, zip(*pieces, strict=True))
        positions, self.place = place_features(features, self.place, skeleton=self.skeleton)
        positions *= np.float32(self.skeleton.metres_per_unit)
        return Motion(positions, self.skeleton.fps, skeleton=self.skeleton, features=features, codes=codes)


def split_rows(motion: Motion) -> Iterator[Motion]:
    """Yields the motion of each row of codes of a motion as decoded."""
    assert motion.features is not None and motion.codes is not None
    size = motion.num_frames // len(motion.codes)
    for number, row in enumerate(motion.codes):
        frames = slice(number * size, (number + 1) * size)
        yield dataclasses.replace(
            motion, positions=motion.positions[frames], features=motion.features[frames], codes=row[None]
        )


def decode_sentences(
    tokenizer: TrainedTokenizer, codes: Iterable[tuple[int, Codes]], *, skeleton: Skeleton
) -> Iterator[DecodedPiece]:
    """Yields the motion of a sequence of sentences, in pieces of at most `WINDOW_ROWS` rows, as soon as they are final.

    Each sentence is decoded alone. Features fade from one sentence to the next. The pieces do not depend on how the
    codes of a sentence are divided.

    Args:
        tokenizer: The tokenizer of the codes.
        codes: Number of a sentence, and some of its codes, in order; at least one row for each sentence.
        skeleton: The skeleton of the motion.
    """
    # Lazy, so that the first pieces are ready before the last codes are sampled.
    groups = itertools.groupby(codes, key=lambda part: part[0])
    sentences = (_decode_sentence(tokenizer, (rows for _, rows in group)) for _, group in groups)
    place = ORIGIN
    for piece in _faded(sentences, overlap=round(FADE_SECONDS * skeleton.fps)):
        positions, place = place_features(piece.features, place, skeleton=skeleton)
        yield DecodedPiece(piece.codes, piece.features, positions * np.float32(skeleton.metres_per_unit))


def _decode_sentence(tokenizer: TrainedTokenizer, parts: Iterable[Codes]) -> Iterator[Piece]:
    """Yields the features of a sentence, whose codes come in parts."""
    # All windows of chains have this size, however many rows they have.
    size = round_up(WINDOW_ROWS + 2 * tokenizer.config.decoder_context, ROW_BUCKET)
    windows = FeatureWindows(tokenizer, least=WINDOW_ROWS, most=WINDOW_ROWS, last=WINDOW_ROWS, size=size)
    for rows in parts:
        yield from windows.add(rows)
    yield from windows.add(rows[:0], ended=True)


def _faded(sentences: Iterable[Iterable[Piece]], *, overlap: int) -> Iterator[Piece]:
    """Yields the pieces of all sentences, in which the end of each sentence fades into the beginning of the next."""
    last: Piece | None = None
    for sentence in sentences:
        for number, piece in enumerate(sentence):
            if last is not None:
                # A piece waits for the next one, because its end fades if that is of another sentence.
                ends = (last.features, piece.features)
                before, after = ends if number else fade_features(*ends, overlap=overlap)
                yield last._replace(features=before)
                piece = piece._replace(features=after)
            last = piece
    if last is not None:
        yield last


def place_features(
    features: Float[np.ndarray, "T D"], place: Place, *, skeleton: Skeleton
) -> tuple[Float[np.ndarray, "T J 3"], Place]:
    """Returns the joints of features that begin at a place, and the place of the frame after them."""
    # Features are velocities: one more frame says where the next piece begins.
    headings, root = root_from_features(np.concatenate([features, features[-1:]]), skeleton)
    turn = np.array([math.cos(place.half_turn), 0.0, -math.sin(place.half_turn), 0.0])[None]
    positions = rotate_vectors(turn[None], positions_from_features(features, skeleton))
    positions = (positions + np.array([place.x, 0.0, place.z])).astype(np.float32)
    (step,) = rotate_vectors(turn, root[-1:])
    # A heading is a quaternion about Y, (cos, 0, sin, 0) of half its angle, and half angles can be added, too.
    half_turn = place.half_turn + math.atan2(headings[-1, 2], headings[-1, 0])
    return positions, Place(half_turn, place.x + float(step[0]), place.z + float(step[2]))
