"""Long motion in windows: what takes memory is done for some seconds at a time, whatever the length of the motion."""

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from t2m_jax.checkpoints.tokenizer import TrainedTokenizer
from t2m_jax.devices import put_everywhere, put_rows
from t2m_jax.motion.cleanup import clean_positions
from t2m_jax.motion.features import (
    gaussian_kernel,
    positions_from_features,
    root_from_features,
    smooth_over_time,
)
from t2m_jax.motion.joining import fade_features
from t2m_jax.motion.rotations import rotate_vectors
from t2m_jax.motion.skeleton import Skeleton
from t2m_jax.sampling.batches import round_up
from t2m_jax.sampling.programs import decode_batch

WINDOW_ROWS = 16
"""Rows of codes that are decoded together, beside those that their frames depend on. With fewer, these are decoded more
often; with more, a stream waits longer."""
FADE_SECONDS = 0.4
"""Time in which one sentence of a chain fades into the next. Sentences are sampled and decoded as if they were alone:
after rows of another action, a generator obeys less often, and a decoder mixes the two."""
MAX_CONTEXT = 1000
"""Rows that frames may depend on, for windows. Decoders that read more get the whole motion."""
ROW_BUCKET = 32
"""Codes are padded to a multiple of this many rows, so that few programs are compiled."""
OVERLAP_SECONDS = 2.0
"""Frames that two windows of the clean-up share. In the middle half of them, one fades into the other."""
CLEANED_WINDOWS = 8
"""Windows that are cleaned together."""
EASE_SIGMA, EASE_SECONDS = 0.1, 0.5
"""Standard deviation of the filter where two parts meet, and the time on each side in which it fades, in seconds.
docs/howto/animator.md says how much joints accelerate there with it."""

Codes = Int[np.ndarray, "_ R"]


class Place(NamedTuple):
    """Where a piece of a motion begins, and where it faces."""

    half_turn: float
    """Half of the angle from the piece's heading to +Z, in radians."""
    x: float
    z: float
    """The root's place on the ground, in the skeleton's unit."""


class Piece(NamedTuple):
    """Some rows of codes, and their raw features."""

    codes: Int[np.ndarray, "N R"]
    features: Float[np.ndarray, "T D"]


class Decoded(NamedTuple):
    """A piece of a motion as decoded."""

    codes: Int[np.ndarray, "N R"]
    features: Float[np.ndarray, "T D"]
    positions: Float[np.ndarray, "T J 3"]
    """In meters."""


def decode_sentences(
    tokenizer: TrainedTokenizer, codes: Iterable[tuple[int, Codes]], *, skeleton: Skeleton
) -> Iterator[Decoded]:
    """Yields the motion of sentences in turn, in pieces of at most `WINDOW_ROWS` rows, as soon as they are final.

    Each sentence is decoded alone. Features fade from one sentence to the next. The pieces do not depend on how the
    codes of a sentence are divided.

    Args:
        tokenizer: The tokenizer of the codes.
        codes: Number of a sentence, and some of its codes, in turn; at least one row for each sentence.
        skeleton: The skeleton of the motion.
    """
    groups = itertools.groupby(codes, key=lambda part: part[0])
    sentences = (_decode_sentence(tokenizer, (rows for _, rows in group)) for _, group in groups)
    place = Place(0.0, 0.0, 0.0)
    for piece in _faded(sentences, overlap=round(FADE_SECONDS * skeleton.fps)):
        positions, place = place_features(piece.features, place, skeleton=skeleton)
        yield Decoded(piece.codes, piece.features, positions * np.float32(skeleton.metres_per_unit))


def _decode_sentence(tokenizer: TrainedTokenizer, rows: Iterable[Codes]) -> Iterator[Piece]:
    """Yields the features of a sentence in pieces, each when the rows that it depends on are known."""
    downsample = tokenizer.config.downsample
    for window, before, count in _windows(rows, tokenizer.config.decoder_context):
        features = _decode(tokenizer, window)[before * downsample : (before + count) * downsample]
        yield Piece(window[before : before + count], features)


def _faded(sentences: Iterable[Iterable[Piece]], *, overlap: int) -> Iterator[Piece]:
    """Yields the pieces of all sentences, in which the end of each sentence fades into the beginning of the next."""
    last: Piece | None = None
    for sentence in sentences:
        for number, piece in enumerate(sentence):
            if last is not None:
                ends = (last.features, piece.features)
                before, after = ends if number else fade_features(*ends, overlap=overlap)
                yield last._replace(features=before)
                piece = piece._replace(features=after)
            last = piece
    if last is not None:
        yield last


def _windows(rows: Iterable[Codes], context: int) -> Iterator[tuple[Codes, int, int]]:
    """Yields rows that are decoded together, how many of them were in pieces before, and how many are in the next."""
    if context > MAX_CONTEXT:
        whole = np.concatenate(list(rows))
        yield whole, 0, len(whole)
        return
    before, pending = 0, None
    for new in rows:
        pending = new if pending is None else np.concatenate([pending, new])
        while len(pending) >= before + WINDOW_ROWS + context:
            yield pending[: before + WINDOW_ROWS + context], before, WINDOW_ROWS
            pending, before = _advance(pending, before + WINDOW_ROWS, context)
    while pending is not None and len(pending) > before:
        left = len(pending) - before
        # The last piece is not short, because it may fade into the next sentence.
        count = left // 2 if WINDOW_ROWS < left < 2 * WINDOW_ROWS else min(WINDOW_ROWS, left)
        yield pending[: before + count + context], before, count
        pending, before = _advance(pending, before + count, context)


def _advance(pending: Codes, done: int, context: int) -> tuple[Codes, int]:
    """Returns the rows from `context` rows before the next piece on, and how many these are."""
    kept = min(done, context)
    return pending[done - kept :], kept


def _decode(tokenizer: TrainedTokenizer, codes: Codes) -> Float[np.ndarray, "T D"]:
    """Returns the raw features of codes, and of what they are padded with."""
    context = tokenizer.config.decoder_context
    size = round_up(len(codes) if context > MAX_CONTEXT else WINDOW_ROWS + 2 * context, ROW_BUCKET)
    padded = np.pad(codes, ((0, size - len(codes)), (0, 0)))[None]
    arguments = put_rows((padded, np.array([len(codes)], np.int32)))
    variables = put_everywhere(tokenizer.variables)
    return np.asarray(decode_batch(variables, tokenizer.normalizer, *arguments, tokenizer=tokenizer.module))[0]


def place_features(
    features: Float[np.ndarray, "T D"], place: Place, *, skeleton: Skeleton
) -> tuple[Float[np.ndarray, "T J 3"], Place]:
    """Returns the joints of features that begin at a place, and the place of the frame after them."""
    headings, root = root_from_features(np.concatenate([features, features[-1:]]), skeleton)
    turn = np.array([math.cos(place.half_turn), 0.0, -math.sin(place.half_turn), 0.0])[None]
    positions = rotate_vectors(turn[None], positions_from_features(features, skeleton))
    positions = (positions + np.array([place.x, 0.0, place.z])).astype(np.float32)
    (step,) = rotate_vectors(turn, root[-1:])
    half_turn = place.half_turn + math.atan2(headings[-1, 2], headings[-1, 0])
    return positions, Place(half_turn, place.x + float(step[0]), place.z + float(step[2]))


def ease_seams(
    positions: Float[np.ndarray, "T J 3"], seams: Sequence[int], *, fps: float
) -> Float[np.ndarray, "T J 3"]:
    """Returns a motion that is smoothed near the given frames, so that one action goes over into the next."""
    if not seams:
        return positions
    result, sigma = positions.copy(), EASE_SIGMA * fps
    radius, reach = len(gaussian_kernel(sigma)) // 2, math.ceil(EASE_SECONDS * fps)
    centers = np.array(seams) - 0.5
    for seam in seams:
        first, last = max(0, seam - reach), min(len(positions), seam + reach)
        around = positions[max(0, first - radius) : last + radius]
        smooth = np.asarray(smooth_over_time(around.reshape(len(around), -1), sigma=sigma)).reshape(around.shape)
        distance = np.abs(np.arange(first, last)[:, None] - centers[None]).min(axis=1)
        near = np.clip(1 - distance / (EASE_SECONDS * fps), 0, 1)
        share = (near**2 * (3 - 2 * near))[:, None, None].astype(np.float32)
        skipped = first - max(0, first - radius)
        result[first:last] = (1 - share) * positions[first:last] + share * smooth[skipped : skipped + last - first]
    return result


def clean_long(positions: Float[np.ndarray, "T J 3"], *, skeleton: Skeleton, size: int) -> Float[np.ndarray, "T J 3"]:
    """Returns a cleaned motion of any length, by windows of `size` frames that fade into each other.

    A motion that fits into one window is cleaned as `generate` does it.
    """
    count, overlap = len(positions), min(round(OVERLAP_SECONDS * skeleton.fps), size // 2)
    firsts = range(0, max(1, count - overlap), size - overlap)
    # The weight of the later window: 0 in the first quarter of the overlap, 1 in the last.
    fade = np.clip(2 * np.arange(overlap) / overlap - 0.5, 0, 1)[:, None, None].astype(np.float32)
    result = np.empty_like(positions)
    for first, window in zip(firsts, _cleaned_windows(positions, firsts, size, skeleton), strict=True):
        if first:
            shared = result[first : first + overlap]
            window[:overlap] = (1 - fade) * shared + fade * window[:overlap]
        result[first : first + size] = window
    return result


def _cleaned_windows(
    positions: Float[np.ndarray, "T J 3"], firsts: Sequence[int], size: int, skeleton: Skeleton
) -> Iterator[Float[np.ndarray, "_ J 3"]]:
    """Yields the windows that begin at some frames, each cleaned by itself."""
    batch = CLEANED_WINDOWS if len(firsts) > 1 else 1
    for number in range(0, len(firsts), batch):
        windows = [positions[first : first + size] for first in firsts[number : number + batch]]
        padded: Any = np.zeros((batch, size, *positions.shape[1:]), np.float32)
        lengths = np.ones(batch, np.int32)
        for row, window in enumerate(windows):
            padded[row, : len(window)], lengths[row] = window, len(window)
        cleaned = np.array(clean_positions(padded, lengths, skeleton=skeleton))
        yield from (cleaned[row, : len(window)] for row, window in enumerate(windows))
