"""Motion from several sentences, or after a given motion: known codes are read, and sampling goes on from them."""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int, Key

from t2m_jax.errors import UserError
from t2m_jax.motion.cleanup import clean_positions
from t2m_jax.motion.features import positions_from_features, smooth_over_time
from t2m_jax.motion.joining import join_clips
from t2m_jax.motion.record import Motion
from t2m_jax.motion.skeleton import Skeleton
from t2m_jax.sampling.batches import padded_batch_size, round_up
from t2m_jax.sampling.codec import motions_from_codes
from t2m_jax.sampling.decoding import Given, Sampling
from t2m_jax.sampling.model import MotionModel
from t2m_jax.sampling.prompts import Prompt

CONTEXT_SECONDS = 0.4
"""Motion before what goes on, which the generator reads as its beginning. With more, a sentence is followed less
often."""
FADE_SECONDS = 0.4
"""Time in which one sentence of a chain fades into the next. Sentences are sampled and decoded as if they were alone:
after rows of another action, a generator obeys less often, and a decoder mixes the two."""
MAX_SECONDS = 3600.0
"""Longest motion for a sentence. A larger number is probably a mistake."""
ROW_BUCKET = 32
"""Codes are padded to a multiple of this many rows, so that few programs are compiled."""
OVERLAP_SECONDS = 2.0
"""Frames that two windows of the clean-up share. In the middle half of them, one fades into the other."""
EASE_SIGMA, EASE_SECONDS = 0.1, 0.5
"""Standard deviation of the filter at the seam of two sentences, and the time on each side in which it fades, in
seconds. Without it, joints accelerate 1.8 times as much there as elsewhere; with it, 1.3 times."""
_PART_STREAM = 2**30
"""In place of a sample's number, in keys for the parts of a chain."""

Codes = Int[np.ndarray, "_ R"]


class Part(NamedTuple):
    """What is sampled at once: a sentence, and how long its motion is."""

    prompt: Prompt
    num_rows: int
    """0 leaves the end to the stop rule."""
    begins: bool
    """Whether the sentence begins here, and does not only go on."""
    draft: Codes | None = None
    """The codes that stand where `kept` is True."""
    kept: Bool[np.ndarray, "B N"] | None = None
    """For each motion; the others are sampled."""


def split_parts(prompts: Sequence[Prompt], num_rows: int, *, limit: int) -> list[Part]:
    """Returns the parts of sentences. A motion that is longer than `limit` rows has several, which go on."""
    if not num_rows:
        return [Part(prompt, 0, True) for prompt in prompts]
    lengths = [min(limit, num_rows - done) for done in range(0, num_rows, limit)]
    return [Part(prompt, rows, not number) for prompt in prompts for number, rows in enumerate(lengths)]


def check_seconds(seconds: float) -> None:
    """Raises `UserError` if a length is not a number of seconds up to `MAX_SECONDS`."""
    if not 0 < seconds <= MAX_SECONDS:
        raise UserError(f"seconds: {seconds:g} is not a number above 0, up to {MAX_SECONDS:g}")


def rows_of_seconds(model: MotionModel, seconds: float) -> int:
    """Returns the rows of codes that a motion of this length has, at least 1.

    Raises:
        UserError: The length is not a number of seconds up to `MAX_SECONDS`.
    """
    check_seconds(seconds)
    return max(1, round(seconds * model.skeleton.fps / model.config.tokenizer.downsample))


def context_rows(model: MotionModel) -> int:
    """Returns how many rows of codes a sentence reads of the motion before it."""
    rows = round(CONTEXT_SECONDS * model.skeleton.fps / model.config.tokenizer.downsample)
    return min(max(1, rows), model.config.generator.max_codes - 1)


def sample_parts(
    model: MotionModel,
    parts: Sequence[Part],
    keys: Sequence[Key[jax.Array, " B"]],
    *,
    start: Codes | None,
    sampling: Sampling,
    guidance_scale: float | None,
) -> list[list[Codes]]:
    """Returns the codes of each part of each motion. A sentence after another one is sampled as if it were alone.

    Args:
        model: The model.
        parts: Sentences in turn.
        keys: Keys of the motions, for each part (consumed).
        start: Codes that the first parts go on from.
        sampling: How to choose codes, and when to stop.
        guidance_scale: Strength of the guidance by the text.
    """
    batch, depth = len(keys[0]), model.config.tokenizer.num_quantizers
    nothing = np.zeros((0, depth), np.int32) if start is None else np.asarray(start, np.int32)
    so_far: list[Codes] = [nothing] * batch
    found: list[list[Codes]] = [[] for _ in range(batch)]
    for part, part_keys in zip(parts, keys, strict=True):
        if part.begins and found[0]:
            so_far = [codes[:0] for codes in so_far]
        context = [codes[-context_rows(model) :] for codes in so_far]
        lengths = np.array([len(codes) for codes in context], np.int32)
        given = _given(part, context, max_codes=sampling.max_codes)
        texts = model.text_encoder([part.prompt.text] * batch)
        sampled = model.sample_codes(texts, part_keys, sampling, guidance_scale=guidance_scale, given=given)
        rows, ends = np.asarray(sampled.codes), np.asarray(sampled.code_lengths)
        for row in range(batch):
            new = rows[row, lengths[row] : ends[row]]
            found[row].append(new)
            so_far[row] = np.concatenate([so_far[row], new])
    return found


def _given(part: Part, context: Sequence[Codes], *, max_codes: int) -> Given:
    """Returns what is fixed of a part: the codes before it, the kept ones of its draft, and its length."""
    codes = np.zeros((len(context), max_codes, context[0].shape[1]), np.int32)
    known = np.zeros(codes.shape[:2], bool)
    wanted = np.zeros(len(context), np.int32)
    for row, before in enumerate(context):
        first, last = len(before), len(before) + part.num_rows
        codes[row, :first], known[row, :first] = before, True
        if part.num_rows:
            wanted[row] = last
        if part.draft is not None and part.kept is not None:
            codes[row, first:last], known[row, first:last] = part.draft, part.kept[row]
    return Given(*map(jnp.asarray, (codes, known, wanted)))


def part_keys(keys: Key[jax.Array, " B"], count: int) -> list[Key[jax.Array, " B"]]:
    """Returns keys for each part of each motion. Those of the first part are those of a motion that stands alone."""
    others = jax.vmap(lambda key, number: jax.random.fold_in(jax.random.fold_in(key, _PART_STREAM), number), (0, None))
    return [keys] + [others(keys, number) for number in range(1, count)]


def join_parts(
    model: MotionModel, parts: Sequence[Part], codes: Sequence[Codes], *, start: Codes | None, seed: int, raw: bool
) -> Motion:
    """Returns the motion of the parts of one sample, in which each sentence fades into the next."""
    pieces = [*([] if start is None else [np.asarray(start, np.int32)]), *codes]
    sentences = [part.prompt.text for part in parts if part.begins]
    ends = model.config.tokenizer.downsample * np.cumsum([len(piece) for piece in pieces])
    starts = [0, *ends[:-1].tolist()][-len(parts) :]
    begins = [0, *[first for first, part in zip(starts[1:], parts[1:], strict=True) if part.begins]]
    whole = np.split(np.concatenate(pieces), np.array(begins[1:], int) // model.config.tokenizer.downsample)
    motion = join_sentences(model, whole, caption=", then ".join(sentences), seed=seed)
    if not raw:
        size = model.config.generator.max_codes * model.config.tokenizer.downsample
        eased = ease_seams(motion.positions, [first for first in starts if first], fps=motion.fps)
        cleaned = clean_long(eased, skeleton=model.skeleton, size=size)
        motion = dataclasses.replace(motion, positions=cleaned, positions_raw=motion.positions)
    return dataclasses.replace(
        motion,
        part_starts=tuple(first for first, part in zip(starts, parts, strict=True) if part.begins),
        part_captions=tuple(sentences),
        warning=" ".join(dict.fromkeys(part.prompt.warning for part in parts if part.prompt.warning)),
        unknown_words=tuple(dict.fromkeys(word for part in parts for word in part.prompt.unknown_words)),
    )


def join_sentences(model: MotionModel, sentences: Sequence[Codes], *, caption: str, seed: int) -> Motion:
    """Returns the motion of the codes of sentences, each decoded alone. Their features fade into each other."""
    motions = []
    for codes in sentences:
        rows = np.pad(codes, ((0, round_up(len(codes), ROW_BUCKET) - len(codes)), (0, 0)))[None]
        lengths = np.array([len(codes)], np.int32)
        motions += motions_from_codes(
            model.tokenizer, rows, lengths, skeleton=model.skeleton, captions=[caption], seed=seed
        )
    if len(motions) == 1:
        return motions[0]
    clips = [motion.features for motion in motions if motion.features is not None]
    features = join_clips(clips, overlap=round(FADE_SECONDS * model.skeleton.fps))
    positions = np.asarray(positions_from_features(features, model.skeleton)) * model.skeleton.metres_per_unit
    codes = np.concatenate(sentences)
    return dataclasses.replace(motions[0], positions=positions, features=features, codes=codes)


def ease_seams(
    positions: Float[np.ndarray, "T J 3"], seams: Sequence[int], *, fps: float
) -> Float[np.ndarray, "T J 3"]:
    """Returns a motion that is smoothed near the given frames, so that one action goes over into the next."""
    if not seams:
        return positions
    count = len(positions)
    smooth = np.asarray(smooth_over_time(positions.reshape(count, -1), sigma=EASE_SIGMA * fps)).reshape(positions.shape)
    distance = np.abs(np.arange(count)[:, None] - (np.array(seams)[None] - 0.5)).min(axis=1)
    near = np.clip(1 - distance / (EASE_SECONDS * fps), 0, 1)
    share = (near**2 * (3 - 2 * near))[:, None, None].astype(np.float32)
    return (1 - share) * positions + share * smooth


def clean_long(positions: Float[np.ndarray, "T J 3"], *, skeleton: Skeleton, size: int) -> Float[np.ndarray, "T J 3"]:
    """Returns a cleaned motion of any length, by windows of `size` frames that fade into each other.

    A motion that fits into one window is cleaned as `generate` does it.
    """
    count, overlap = len(positions), min(round(OVERLAP_SECONDS * skeleton.fps), size // 2)
    firsts = range(0, max(1, count - overlap), size - overlap)
    windows = np.zeros((padded_batch_size(len(firsts)), size, *positions.shape[1:]), np.float32)
    lengths = np.ones(len(windows), np.int32)
    for number, first in enumerate(firsts):
        window = positions[first : first + size]
        windows[number, : len(window)], lengths[number] = window, len(window)
    cleaned = np.asarray(clean_positions(windows, lengths, skeleton=skeleton))
    # The weight of the later window: 0 in the first quarter of the overlap, 1 in the last.
    fade = np.clip(2 * np.arange(overlap) / overlap - 0.5, 0, 1)[:, None, None].astype(np.float32)
    result = cleaned[0][:count]
    for number, first in enumerate(firsts[1:], start=1):
        window = cleaned[number, : lengths[number]]
        both = (1 - fade) * result[first : first + overlap] + fade * window[:overlap]
        result = np.concatenate([result[:first], both, window[overlap:]])
    return result
