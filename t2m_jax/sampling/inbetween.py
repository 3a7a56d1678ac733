"""Other codes for a part of a motion: a new middle between head and tail, and variations of the whole."""

import dataclasses
from collections.abc import Iterator, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Key

from t2m_jax.errors import UserError
from t2m_jax.motion.joining import VELOCITY_SECONDS, place_positions, replace_middle
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.skeleton import Skeleton
from t2m_jax.sampling.batches import round_up
from t2m_jax.sampling.decode import ROW_BUCKET, Codes, decode_motions
from t2m_jax.sampling.directing import report_targets
from t2m_jax.sampling.loop import Sampling
from t2m_jax.sampling.middles import Middle, Span, check_middle_targets, move_middles
from t2m_jax.sampling.model import ModelParts
from t2m_jax.sampling.prompts import Prompt, batches_of_keys, sample_key
from t2m_jax.sampling.request import MotionRequest
from t2m_jax.sampling.segments import Segment, most_rows, rows_of_seconds, sample_segments, split_segments
from t2m_jax.sampling.timeline import Tell, make_batch, part_rows

TAIL_SECONDS = 1.0
"""Motion after a middle whose likelihood says how well the middle leads to it."""
AROUND_SECONDS = 2.0
"""Motion on each side that is decoded with a middle, so that decoding does not take longer for a longer motion."""
_KEPT_STREAM = 2**30 + 1
"""In place of a sample's number, in keys for the rows that a variation keeps."""


def find_span(model: ModelParts, seconds: tuple[float, float], num_rows: int) -> Span:
    """Returns the rows that a span of seconds covers, at least one. A span of no time covers none.

    Raises:
        UserError: The span does not lie in the motion.
    """
    begin, end = seconds
    rate = model.skeleton.fps / model.config.tokenizer.downsample
    # One row more than there are: the last frames of a motion may not fill a row.
    if not 0 <= begin <= end < (num_rows + 1) / rate:
        longest = f"{num_rows / rate:.1f} s, where the motion ends"
        raise UserError(f"span: {begin:g} to {end:g} s is not a part of the time from 0 to {longest}")
    if begin == end:
        row = min(round(begin * rate), num_rows)
        return Span(row, row)
    first = min(round(begin * rate), num_rows - 1)
    return Span(first, max(first + 1, min(round(end * rate), num_rows)))


def redo(model: ModelParts, request: MotionRequest, prompt: Prompt, sampling: Sampling) -> list[Motion]:
    """Returns a motion with another middle: those first that are nearest to targets, else as `rank_middles` says."""
    assert request.start is not None and request.span is not None
    motion = request.start
    motion = motion if motion.fps == model.skeleton.fps else motion.resampled(model.skeleton.fps)
    codes = model.encode(motion)
    span = find_span(model, request.span, len(codes))
    downsample = model.config.tokenizer.downsample
    # Frames at the end that do not fill a code belong to the last one.
    end = motion.num_frames if span.last == len(codes) else downsample * span.last
    frames = Span(min(downsample * span.first, motion.num_frames), end)
    # By default as long as the rows that it replaces, so that the tail keeps its time.
    num_rows = span.last - span.first if request.seconds is None else rows_of_seconds(model, request.seconds)
    if request.targets:
        last = frames.first + downsample * num_rows
        check_middle_targets(model, motion, Span(frames.first, last), request.targets)
    candidates = find_middles(model, request, prompt, codes, span, num_rows=num_rows, sampling=sampling)
    if request.targets:
        chosen = move_middles(model, motion, candidates, frames, request)
    else:
        likelihoods = tail_likelihoods(model, candidates, prompt)
        order = rank_middles(motion.positions[frames.last :], candidates, likelihoods, skeleton=motion.skeleton)
        chosen = [candidates[number] for number in order]
    redone = [_with_middle(motion, middle, frames, prompt) for middle in chosen[: request.num_samples]]
    return [report_targets(dataclasses.replace(one, seed=request.seed), request.targets) for one in redone]


def find_middles(
    model: ModelParts,
    request: MotionRequest,
    prompt: Prompt,
    codes: Codes,
    span: Span,
    *,
    num_rows: int,
    sampling: Sampling,
) -> list[Middle]:
    """Returns candidates for the middle of a motion, each of `num_rows` rows in place of those of a span."""
    # Best of n: the loop reads the head alone, so which middle leads to the tail is only known afterwards.
    keys = jnp.stack([sample_key(request.seed, prompt.text, number) for number in range(request.candidates)])
    segments = split_segments(prompt, num_rows, limit=most_rows(model))
    scale = request.options.guidance_scale
    found = sample_segments(model, segments, keys, start=codes[: span.first], sampling=sampling, guidance_scale=scale)
    middles = [np.concatenate(pieces) for pieces in zip(*found, strict=True)]
    rows = round(AROUND_SECONDS * model.skeleton.fps / model.config.tokenizer.downsample)
    # Only for the decoder: the frames of head and tail are taken from the motion itself.
    around = codes[max(0, span.first - rows) : span.first], codes[span.last : span.last + rows]
    return decode_middles(model, around, middles, raw=request.options.raw)


def decode_middles(
    model: ModelParts, around: tuple[Codes, Codes], middles: Sequence[Codes], *, raw: bool
) -> list[Middle]:
    """Returns the candidates of some middles, which are decoded between the rows around them."""
    head, tail = around
    whole = [np.concatenate([head, middle, tail]) for middle in middles]
    size = round_up(len(whole[0]), ROW_BUCKET)
    motions = decode_motions(model.tokenizer, whole, skeleton=model.skeleton, size=size, clean=not raw)
    downsample = model.config.tokenizer.downsample
    first = downsample * len(head)
    last = downsample * (len(whole[0]) - len(tail))
    found = zip(motions, whole, strict=True)
    return [Middle(motion.positions, first, last, codes) for motion, codes in found]


def tail_likelihoods(model: ModelParts, middles: Sequence[Middle], prompt: Prompt) -> Float[np.ndarray, " B"]:
    """Returns the mean logarithm of the probabilities of the first rows of the tails, 0 without one."""
    downsample = model.config.tokenizer.downsample
    num_tail = len(middles[0].codes) - middles[0].last // downsample
    rows = round(TAIL_SECONDS * model.skeleton.fps / downsample)
    size = model.config.generator.max_codes
    # At least one row is read before the first one that is scored.
    scored = min(num_tail, rows, size - 1)
    if not scored:
        return np.zeros(len(middles), np.float32)
    # The newest rows, if there are more than the generator can read.
    read = np.stack([own.codes[: len(own.codes) - num_tail + scored][-size:] for own in middles])
    # One size for one program. The generator is causal, so zeros at the end change nothing before them.
    padded = np.pad(read, ((0, 0), (0, size - read.shape[1]), (0, 0)))
    texts = model.text_encoder([prompt.read] * len(middles))
    likelihoods = np.asarray(model.log_likelihood(jnp.asarray(padded), texts))
    return likelihoods[:, read.shape[1] - scored : read.shape[1]].mean(axis=1)


def rank_middles(
    tail: Float[np.ndarray, "T J 3"],
    candidates: Sequence[Middle],
    likelihoods: Float[np.ndarray, " B"],
    *,
    skeleton: Skeleton,
) -> list[int]:
    """Returns the numbers of candidates, the best one first: the one with the least sum of two places.

    One place is by the likelihood of the tail. The other is by the jump at the join: how far the candidate's joints
    are from the tail's (root mean square) and, scaled, how different their velocities are.
    """
    if not len(tail):
        return list(range(len(candidates)))
    jumps = [_jump(tail[:2], candidate, skeleton) for candidate in candidates]
    costs = np.array(jumps), -likelihoods
    # A place is the number of candidates that are better: places can be added, costs of two kinds cannot.
    places = [np.argsort(np.argsort(cost, kind="stable")) for cost in costs]
    return np.argsort(places[0] + places[1], kind="stable").tolist()


def _jump(tail: Float[np.ndarray, "T J 3"], candidate: Middle, skeleton: Skeleton) -> float:
    """Returns how much a tail differs from the candidate's own frames there, after it was moved to them."""
    own = candidate.positions[candidate.last :][: len(tail)]
    frames = [place_positions(part, part[0], own[0], skeleton=skeleton) for part in (own, tail)]
    difference = frames[1] - frames[0]
    # Frames next to the join decide what is seen there: one for the pose, two for the velocity.
    jumps = [difference[0], *np.diff(difference, axis=0) * (skeleton.fps * VELOCITY_SECONDS)]
    return float(np.sqrt(np.mean(np.square(np.concatenate(jumps, axis=-1)).sum(axis=-1))))


def _with_middle(motion: Motion, middle: Middle, frames: Span, prompt: Prompt) -> Motion:
    """Returns a motion with another middle in place of some frames, and says where its sentence begins and ends."""
    positions = replace_middle(
        motion.positions[: frames.first],
        middle.positions,
        motion.positions[frames.last :],
        first=middle.first,
        last=middle.last,
        fps=motion.fps,
        skeleton=motion.skeleton,
    )
    old = list(zip(motion.part_starts, motion.part_captions, strict=True))
    if not old or old[0][0] > 0:  # a motion without a sentence may have been continued
        old.insert(0, (0, "" if old else motion.caption))
    parts = {start: caption for start, caption in old if start < frames.first} | {frames.first: prompt.text}
    if frames.last < motion.num_frames:
        end = frames.first + middle.last - middle.first
        # The sentence that the middle interrupts continues after it.
        parts |= {end: [caption for start, caption in old if start <= frames.last][-1]}
        parts |= {start + end - frames.last: caption for start, caption in old if start > frames.last}
    return Motion(
        positions,
        motion.fps,
        skeleton=motion.skeleton,
        caption=", then ".join(filter(None, parts.values())),
        part_starts=tuple(parts),
        part_captions=tuple(parts.values()),
        warning=prompt.warning,
        unknown_words=prompt.unknown_words,
    )


def vary(
    model: ModelParts, request: MotionRequest, prompts: Sequence[Prompt], sampling: Sampling, tell: Tell
) -> Iterator[list[Motion]]:
    """Yields variations of a motion, in batches. For `tell`, see `make_batch`."""
    assert request.start is not None and request.strength is not None
    codes = model.encode(request.start)
    parts = [(0, prompts[0])]
    if len(prompts) > 1:
        firsts = part_rows(model, request.start, len(codes))
        # Sentences that begin in one row of codes are too short to be told apart; the last one stays.
        parts = list(dict(zip([0, *firsts[1:]], prompts, strict=True)).items())
    for batch in batches_of_keys(request.seed, prompts[0], request.num_samples):
        segments = variation_segments(codes, parts, batch.keys, strength=request.strength, limit=most_rows(model))
        yield make_batch(model, request, segments, batch, start=None, sampling=sampling, tell=tell)


def variation_segments(
    codes: Codes, parts: Sequence[tuple[int, Prompt]], keys: Key[jax.Array, " B"], *, strength: float, limit: int
) -> list[Segment]:
    """Returns the segments of variations of a motion: each row is sampled with a probability, and kept otherwise.

    Args:
        codes: Of the motion.
        parts: The row in which each sentence begins, and the sentence.
        keys: One for each variation (consumed).
        strength: The probability.
        limit: Most rows of a segment.
    """
    chosen = jax.vmap(lambda key: jax.random.uniform(jax.random.fold_in(key, _KEPT_STREAM), (len(codes),)))(keys)
    # The same numbers for every strength: a larger one samples the same rows again, and further ones.
    kept = np.asarray(chosen) >= strength
    ends = [*(first for first, _ in parts[1:]), len(codes)]
    pieces = [
        (prompt, slice(row, min(row + limit, end)), row == first)
        for (first, prompt), end in zip(parts, ends, strict=True)
        for row in range(first, end, limit)
    ]
    return [Segment(prompt, len(codes[rows]), begins, codes[rows], kept[:, rows]) for prompt, rows, begins in pieces]
