"""The data set as codes: every clip is encoded once, before a generator is trained."""

import functools
import logging
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Literal, NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float
from tqdm import tqdm

from t2m_jax.checkpoints.tokenizer import TrainedTokenizer
from t2m_jax.data.banks.codes import Captions, CodeBank
from t2m_jax.data.checks import find_difference
from t2m_jax.data.composing.standing import STILL_SPEED
from t2m_jax.data.folder import Clip, Dataset, DatasetInfo, samples_from_clip
from t2m_jax.data.texts import Caption
from t2m_jax.errors import UserError
from t2m_jax.evaluation.reconstruction import evaluate_reconstruction
from t2m_jax.motion.skeleton import Skeleton, skeleton_from_name
from t2m_jax.sampling.programs import encode_motions
from t2m_jax.text.rewording import reword
from t2m_jax.train.code_cache import Codes, cached_codes, code_key

logger = logging.getLogger(__name__)

OffsetKind = Literal["all", "one", "hold"]
TimedCaptionKind = Literal["encode", "slice"]
LongClipKind = Literal["drop", "windows"]
Frames = Float[np.ndarray, "_ D"]
"""Raw features."""
Weights = Float[np.ndarray, " M"]
"""Of motions."""
Begin = Callable[[Frames, int], Frames]
"""From a clip's features and a starting frame to the motion to encode."""
MAX_JOINT_ERROR = 150
"""Largest mean joint error, in millimeters, with which a tokenizer may give other motion back than it learned."""

CHECKED_CLIPS = 1000
"""About how many clips of a data set show this."""
MOTIONS_TOGETHER = 1024
"""Motions that are encoded together. Those of similar lengths are in one batch."""
KEPT_SPEED = 0.6
"""Share of its speed that a hand keeps from frame to frame when it comes to rest beyond the end of a clip."""


class NoMotionError(UserError):
    """No clip of a split can be used."""


class CodedMotion(NamedTuple):
    """A motion as codes, from one or several starting frames, and the captions that describe all of it."""

    variants: tuple[Codes, ...]
    captions: tuple[Caption, ...]
    clip: str = ""
    """Name of the clip that it is, or is a part of."""


class CodingOptions(NamedTuple):
    """What is encoded of a clip."""

    offsets: OffsetKind
    """Frames at which the first code may start: all that leave the same number of codes or one fewer, or one per clip.
    With "hold", as many are added as would be cut, where the feet stand (`fill_rows`)."""
    timed_captions: TimedCaptionKind
    """Codes for a caption with times: of those frames alone, or cut out of the codes of the clip."""
    seed: int
    """Seed of the random choices."""
    long_clips: LongClipKind = "drop"
    """Leave out clips that are too long (the original), or cut them into windows that overlap by half. All captions of
    a clip without times are taken to describe each of its windows."""


def check_tokenizer(tokenizer: TrainedTokenizer, dataset: Dataset, *, may_differ: bool) -> None:
    """Raises `UserError` if a tokenizer learned another kind of motion than that of a data set.

    Args:
        tokenizer: Makes the codes.
        dataset: The motion.
        may_differ: Whether other statistics are expected, as of some clips of a new kind. Then it counts how exactly
            the tokenizer gives the clips back.
    """
    advice = "train the tokenizer on this data set, or choose another"
    difference = find_difference(dataset, tokenizer.normalizer, reader="the tokenizer")
    if difference is None:
        return
    if not may_differ:
        raise UserError(f"{difference}; {advice}")
    fraction = min(1.0, CHECKED_CLIPS / max(len(dataset.names("train")), 1))
    error = evaluate_reconstruction(tokenizer, dataset, split="train", fraction=fraction).mpjpe_mm
    text = f"{dataset.folder}: the tokenizer learned other motion, and gives this one back with joint errors of"
    if error > MAX_JOINT_ERROR:
        raise UserError(f"{text} {error:.0f} mm (allowed are {MAX_JOINT_ERROR}); {advice}")
    logger.warning("%s %.0f mm on average", text, error)


def starting_frames(clip: Clip, *, downsample: int, options: CodingOptions) -> tuple[int, ...]:
    """Returns the frames at which the first code of a clip may start."""
    # Each start gives other codes of the same motion: augmentation at the cost of encoding it `downsample` times.
    if options.offsets != "one":
        return tuple(range(downsample))
    # By the name of the clip, so that other clips in the data set do not change its start.
    generator = np.random.default_rng([options.seed, zlib.crc32(clip.name.encode())])
    return (int(generator.integers(len(clip.features) % downsample + 1)),)


def fill_rows(features: Frames, start: int, *, downsample: int, most: int, skeleton: Skeleton) -> Frames:
    """Returns a motion that fills whole rows of codes, and that begins and ends as it does, if its feet stand there.

    `start` frames come before the first one, in which hands that move come out of rest, and frames follow the last one
    until a row is full, in which they come to rest. Where somebody walks, that would slide or jolt: there, the motion
    begins with its first frame, and the encoder leaves out the frames behind the last full row.

    Args:
        features: The motion.
        start: Frames to add at the beginning.
        downsample: Frames of a row.
        most: Rows; a motion that would have more of them gets no frames.
        skeleton: Says what the features mean.
    """
    is_longer = _stands(features[0], skeleton) and -(-(len(features) + start) // downsample) <= most
    begun = np.concatenate([_come_from_rest(features[0], start, skeleton), features]) if is_longer else features
    left = -len(begun) % downsample
    if not _stands(features[-1], skeleton) or (len(begun) + left) // downsample > most:
        return begun
    return np.concatenate([begun, _come_to_rest(features[-1], left, skeleton)])


def _start_at(info: DatasetInfo, *, downsample: int, offsets: OffsetKind) -> Begin:
    """Returns what makes the motion to encode."""
    if offsets != "hold":
        return lambda features, start: features[start:]
    # No motion has more rows than the longest one without held frames.
    most = -(-(info.max_frames + 3) // downsample)
    skeleton = skeleton_from_name(info.skeleton)
    return functools.partial(fill_rows, downsample=downsample, most=most, skeleton=skeleton)


def _stands(frame: Float[np.ndarray, " D"], skeleton: Skeleton) -> bool:
    steps = frame[skeleton.layout.velocities].reshape(-1, 3)[[0, *skeleton.left_foot, *skeleton.right_foot]]
    return bool(np.linalg.norm(steps, axis=1).max() * skeleton.fps * skeleton.metres_per_unit < STILL_SPEED)


def _come_to_rest(frame: Float[np.ndarray, " D"], count: int, skeleton: Skeleton) -> Frames:
    """Returns the frames after the last one, in which everything slows down."""
    speeds = KEPT_SPEED ** np.arange(1, count + 1)
    return _moved_on(frame, np.cumsum(speeds / KEPT_SPEED), speeds, skeleton)


def _come_from_rest(frame: Float[np.ndarray, " D"], count: int, skeleton: Skeleton) -> Frames:
    """Returns the frames before the first one, in which everything gains its speed."""
    speeds = KEPT_SPEED ** np.arange(1, count + 1)
    return _moved_on(frame, -np.cumsum(speeds), speeds, skeleton)[::-1]


def _moved_on(
    frame: Float[np.ndarray, " D"], steps: Float[np.ndarray, " S"], speeds: Float[np.ndarray, " S"], skeleton: Skeleton
) -> Frames:
    """Returns a frame once for each number of `steps` that its joints go on, and with that share of its speeds."""
    layout = skeleton.layout
    velocities = frame[layout.velocities].reshape(-1, 3)
    relative = velocities[1:] - velocities[0] * (1, 0, 1)  # local positions follow the root on the ground
    frames = np.repeat(frame[None], len(steps), axis=0)
    frames[:, layout.root_height] += np.outer(steps, velocities[0, 1])
    frames[:, layout.positions] += np.outer(steps, relative)
    for moving in (layout.root_yaw, layout.root_velocity, layout.velocities):
        frames[:, moving] *= speeds[:, None]
    return frames


def encode_clips(
    clips: Sequence[Clip],
    info: DatasetInfo,
    tokenizer: TrainedTokenizer,
    options: CodingOptions,
    places: Sequence[Path] = (),
) -> list[CodedMotion]:
    """Returns what a generator learns from: whole clips, and parts of them that have captions with times, as codes.

    Args:
        clips: The motions.
        info: Limits of lengths.
        tokenizer: Encodes the motions.
        options: Which motions, and where their codes start.
        places: Folders that may have the codes (`cached_codes`).

    Raises:
        NoMotionError: No clip that is long enough and has a caption is left.
    """
    downsample = tokenizer.config.downsample
    # One code more than the shortest motion, so that every starting frame leaves at least one.
    shortest = max(2 * downsample, info.min_frames)
    if options.long_clips == "windows":
        clips = [window for clip in clips for window in cut_windows(clip, info)]
    if options.timed_captions == "encode":
        found = [(clip.name, piece) for clip in clips for piece in samples_from_clip(clip, info)]
    else:
        found = [(clip.name, clip) for clip in clips if info.fits(len(clip.features))]
    found = [(name, piece) for name, piece in found if len(piece.features) >= shortest]
    pieces = [piece for _, piece in found]
    left_out = len({clip.name for clip in clips} - {piece.name for piece in pieces})
    if left_out:
        limits = f"shorter than {info.min_frames} or longer than {info.max_frames + 3} frames, or no caption for it all"
        logger.warning("%s: %d of %d clips are not used whole (%s)", info.name, left_out, len(clips), limits)
    starts = [starting_frames(piece, downsample=downsample, options=options) for piece in pieces]
    begin = _start_at(info, downsample=downsample, offsets=options.offsets)
    pairs = [(piece.features, frames) for piece, frames in zip(pieces, starts, strict=True)]
    cuts = f"{options.offsets} {info.max_frames} {info.skeleton} {starts}"
    key = code_key(tokenizer.fingerprint, cuts, (piece.features for piece in pieces))
    codes = cached_codes(places, key, lambda: _encode_shifted(tokenizer, pairs, begin))
    motions = []
    for (name, piece), frames in zip(found, starts, strict=True):
        variants = tuple(next(codes) for _ in frames)
        parts = split_by_captions(variants, piece.captions, codes_per_second=info.fps / downsample)
        motions += [part._replace(clip=name) for part in parts]
    if not motions:
        raise NoMotionError(
            f"{info.name}: no motion with a caption has {info.min_frames} to {info.max_frames + 3} frames; see "
            "`t2m data check`, or cut long clips with `--long_clips windows`"
        )
    return motions


def _encode_shifted(
    tokenizer: TrainedTokenizer, pairs: Sequence[tuple[Frames, Sequence[int]]], begin: Begin
) -> Iterator[Codes]:
    """Yields the codes of each motion from each of its starting frames; most of the time before a first update."""
    with tqdm(total=len(pairs), desc="encoding", unit="motion", disable=None) as progress:
        # Not all at once: held frames are copies, many times the size of the data set.
        for first in range(0, len(pairs), MOTIONS_TOGETHER):
            some = pairs[first : first + MOTIONS_TOGETHER]
            shifted = [begin(motion, start) for motion, frames in some for start in frames]
            yield from encode_motions(tokenizer, shifted, progress=False)
            progress.update(len(some))


def draw_captions(clips: Sequence[Clip], *, count: int, seed: int) -> list[Clip]:
    """Returns clips with at most `count` of their captions each, 0 for all."""
    if not count:
        return list(clips)
    generator = np.random.default_rng([seed, zlib.crc32(b"captions")])

    def drawn(captions: tuple[Caption, ...]) -> tuple[Caption, ...]:
        chosen = generator.permutation(len(captions))[:count]
        return tuple(captions[place] for place in sorted(chosen))

    return [clip._replace(captions=drawn(clip.captions)) for clip in clips]


def add_rewordings(motions: Sequence[CodedMotion], *, count: int, seed: int) -> list[CodedMotion]:
    """Returns motions with `count` further wordings of each of their captions."""
    generator = np.random.default_rng([seed, zlib.crc32(b"rewordings")])

    def added(caption: Caption) -> list[Caption]:
        return [Caption(reword(caption.text, generator)) for _ in range(count)]

    return [
        motion._replace(captions=(*motion.captions, *(new for old in motion.captions for new in added(old))))
        for motion in motions
    ]


def cut_windows(clip: Clip, info: DatasetInfo) -> list[Clip]:
    """Returns the clip or, if it is too long, windows of it that overlap by half or a little more.

    Captions with times are left out of windows.
    """
    frames = len(clip.features)
    length = info.max_frames
    if info.fits(frames) or frames < info.min_frames:
        return [clip]
    captions = tuple(caption for caption in clip.captions if caption.whole_clip)
    # As few as overlap by at least half, at equal distances from the first frame to the last.
    count = -(-(frames - length) // (length // 2)) + 1
    starts = [round(place * (frames - length) / (count - 1)) for place in range(count)]
    return [Clip(clip.name, clip.features[start : start + length], captions) for start in starts]


def split_by_captions(
    variants: tuple[Codes, ...], captions: Sequence[Caption], *, codes_per_second: float
) -> list[CodedMotion]:
    """Returns a clip's codes as motions: the whole, and one part for each caption with times that contain codes."""
    whole = tuple(caption for caption in captions if caption.whole_clip)
    motions = [CodedMotion(variants, whole)] if whole else []
    for caption in captions:
        first = int(caption.start * codes_per_second)
        last = int(caption.end * codes_per_second)
        pieces = tuple(codes[first:last] for codes in variants)
        if not caption.whole_clip and all(len(piece) for piece in pieces):
            motions.append(CodedMotion(pieces, (caption,)))
    return motions


def balanced_weights(actions: Sequence[Sequence[str]], *, power: float, limit: float) -> Weights:
    """Returns how often motions are drawn in training, relative to each other.

    Args:
        actions: Of each motion, at least one.
        power: The weight of an action is the number of motions that have it to the power of minus this. A motion of
            several actions has the mean of their weights.
        limit: Largest weight of a motion, as a multiple of the mean of all weights before they are limited.
    """
    counts = Counter(action for names in actions for action in set(names))
    weights = np.array([np.mean([float(counts[action]) ** -power for action in names]) for names in actions])
    return np.minimum(weights, limit * weights.mean())


def with_share(weights: Weights, chosen: Bool[np.ndarray, " M"], share: float) -> Weights:
    """Returns weights of which those of the chosen motions sum to `share`, and the others to the rest of 1."""
    return weights * np.where(chosen, share / weights[chosen].sum(), (1 - share) / weights[~chosen].sum())


def make_code_bank(
    motions: Sequence[CodedMotion], read: Callable[[Sequence[str]], Captions], *, shares: Weights | None = None
) -> CodeBank:
    """Returns coded motions as NumPy arrays; `read` turns all captions into the input of the text encoder."""
    lengths = np.array([[len(codes) for codes in motion.variants] for motion in motions], np.int32)
    codes = np.zeros((*lengths.shape, int(lengths.max()), motions[0].variants[0].shape[1]), np.int32)
    for index, motion in enumerate(motions):
        for offset, rows in enumerate(motion.variants):
            codes[index, offset, : len(rows)] = rows
    counts = np.array([len(motion.captions) for motion in motions], np.int32)
    captions = read([caption.text for motion in motions for caption in motion.captions])
    # The captions of motion m are those from `first[m]` on, `counts[m]` of them.
    first = np.cumsum(counts, dtype=np.int32) - counts
    return CodeBank(codes, lengths, jax.tree.map(np.asarray, captions), first, counts, shares)
