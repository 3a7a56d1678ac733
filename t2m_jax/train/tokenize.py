"""The data set as codes: every clip through the trained VQ-VAE, once, before the GPT trains."""

import logging
import zlib
from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Int

from t2m_jax.checkpoints.vqvae import TrainedVqVae
from t2m_jax.data.banks.codes import Captions, CodeBank
from t2m_jax.data.folder import Clip, DatasetInfo, samples_from_clip
from t2m_jax.data.texts import Caption
from t2m_jax.errors import UserError
from t2m_jax.sampling.codec import encode_motions
from t2m_jax.train.config import TrainGptConfig

logger = logging.getLogger(__name__)


class CodedMotion(NamedTuple):
    """A motion as codes, from one or several starting frames on, and captions that describe all of it."""

    variants: tuple[Int[np.ndarray, " _"], ...]
    captions: tuple[Caption, ...]


def starting_frames(clip: Clip, *, downsample: int, config: TrainGptConfig) -> tuple[int, ...]:
    """Returns the frames at which the first code of a clip may start."""
    if config.offsets == "all":
        return tuple(range(downsample))
    generator = np.random.default_rng([config.loop.seed, zlib.crc32(clip.name.encode())])
    return (int(generator.integers(len(clip.features) % downsample + 1)),)


def coded_motions(
    clips: Sequence[Clip], info: DatasetInfo, vqvae: TrainedVqVae, *, config: TrainGptConfig
) -> list[CodedMotion]:
    """Returns what the GPT learns from: whole clips and time-tagged pieces of them, as codes.

    Raises:
        UserError: if nothing is left that is long enough and has a caption.
    """
    downsample = vqvae.config.downsample
    # One more code than the shortest: every starting frame must leave at least one.
    shortest = max(2 * downsample, info.min_frames)
    if config.timed_captions == "encode":
        pieces = [piece for clip in clips for piece in samples_from_clip(clip, info)]
    else:
        pieces = [clip for clip in clips if info.fits(len(clip.features))]
    pieces = [piece for piece in pieces if len(piece.features) >= shortest]
    _tell_left_out(clips, pieces, info)
    starts = [starting_frames(piece, downsample=downsample, config=config) for piece in pieces]
    codes = iter(
        encode_motions(
            vqvae, [piece.features[start:] for piece, frames in zip(pieces, starts, strict=True) for start in frames]
        )
    )
    motions = []
    for piece, frames in zip(pieces, starts, strict=True):
        variants = tuple(next(codes) for _ in frames)
        motions += sliced(variants, piece.captions, codes_per_second=info.fps / downsample)
    if not motions:
        raise UserError("no motion with a caption to train on: the split is empty or every clip was left out")
    return motions


def _tell_left_out(clips: Sequence[Clip], pieces: Sequence[Clip], info: DatasetInfo) -> None:
    """Logs how many clips are not used whole: too short, too long, or without a caption for all of it."""
    left_out = len({clip.name for clip in clips} - {piece.name for piece in pieces})
    if left_out:
        limits = f"shorter than {info.min_frames} or longer than {info.max_frames + 3} frames, or no caption for it all"
        logger.warning("%s: %d of %d clips are not used whole (%s)", info.name, left_out, len(clips), limits)


def sliced(
    variants: tuple[Int[np.ndarray, " _"], ...], captions: Sequence[Caption], *, codes_per_second: float
) -> list[CodedMotion]:
    """Returns a clip's codes as motions: whole, and once for each caption with times that some codes fall into."""
    whole = tuple(caption for caption in captions if caption.whole_clip)
    motions = [CodedMotion(variants, whole)] if whole else []
    for caption in captions:
        first, last = int(caption.start * codes_per_second), int(caption.end * codes_per_second)
        pieces = tuple(codes[first:last] for codes in variants)
        if not caption.whole_clip and all(len(piece) for piece in pieces):
            motions.append(CodedMotion(pieces, (caption,)))
    return motions


def make_code_bank(motions: Sequence[CodedMotion], read: Callable[[Sequence[str]], Captions]) -> CodeBank:
    """Returns coded motions as arrays on the device; `read` makes of all captions what the text encoder takes."""
    lengths = np.array([[len(codes) for codes in motion.variants] for motion in motions], np.int32)
    codes = np.zeros((*lengths.shape, int(lengths.max())), np.int32)
    for index, motion in enumerate(motions):
        for offset, row in enumerate(motion.variants):
            codes[index, offset, : len(row)] = row
    counts = np.array([len(motion.captions) for motion in motions], np.int32)
    captions = read([caption.text for motion in motions for caption in motion.captions])
    first = np.cumsum(counts, dtype=np.int32) - counts
    return CodeBank(*jax.tree.map(jnp.asarray, (codes, lengths, captions, first, counts)))
