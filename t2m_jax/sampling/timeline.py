"""Motion from several sentences, or after a given motion: known codes are read, and sampling continues from them."""

import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Key

from t2m_jax.motion.cleanup import clean_long
from t2m_jax.motion.joining import ease_seams
from t2m_jax.motion.motion import Motion
from t2m_jax.sampling.decode import Codes, decode_sentences
from t2m_jax.sampling.loop import Given, Sampling
from t2m_jax.sampling.model import ModelParts
from t2m_jax.sampling.prompts import KeyBatch, Prompt, batches_of_keys
from t2m_jax.sampling.request import MotionRequest

CONTEXT_SECONDS = 0.4
"""Motion before the continuation, which the generator reads as its beginning. With more, a sentence is followed less
often."""
SAMPLING_SHARE = 0.7
"""Share of the time for a motion of several sentences that sampling takes; the rest is decoding and the clean-up."""
_SEGMENT_STREAM = 2**30
"""In place of a sample's number, in keys for the segments of a chain."""


Tell = Callable[[float], None]
"""Called with the number of motions of a batch that are done, in which parts count, too."""


class Segment(NamedTuple):
    """What is sampled at once: a sentence, and how long its motion is."""

    prompt: Prompt
    num_rows: int
    """0 leaves the end to the stop rule."""
    begins: bool
    """Whether the sentence begins here, and does not only continue."""
    draft: Codes | None = None
    """The codes that stand where `kept` is True."""
    kept: Bool[np.ndarray, "B N"] | None = None
    """For each motion; the others are sampled."""


class Start(NamedTuple):
    """What a motion continues."""

    codes: Codes
    parts: Sequence[tuple[int, str]]
    """The row in which each of its sentences begins, and the sentence."""


def split_segments(prompts: Sequence[Prompt], num_rows: int, *, limit: int) -> list[Segment]:
    """Returns the segments of sentences. A motion that is longer than `limit` rows has several, which continue it."""
    if not num_rows:
        return [Segment(prompt, 0, True) for prompt in prompts]
    lengths = [min(limit, num_rows - done) for done in range(0, num_rows, limit)]
    return [Segment(prompt, rows, not number) for prompt in prompts for number, rows in enumerate(lengths)]


def rows_of_seconds(model: ModelParts, seconds: float) -> int:
    """Returns the rows of codes that a motion of this length has, at least 1."""
    return max(1, round(seconds * model.skeleton.fps / model.config.tokenizer.downsample))


def context_rows(model: ModelParts) -> int:
    """Returns how many rows of codes a sentence reads of the motion before it."""
    # At least one row, or nothing would go on, and at least one less than the generator reads, to sample one.
    rows = round(CONTEXT_SECONDS * model.skeleton.fps / model.config.tokenizer.downsample)
    return min(max(1, rows), model.config.generator.max_codes - 1)


def most_rows(model: ModelParts) -> int:
    """Returns how many rows of codes are sampled at once, after those that are read of the motion before."""
    return model.config.generator.max_codes - context_rows(model)


def part_rows(model: ModelParts, motion: Motion, num_rows: int) -> list[int]:
    """Returns the row of codes in which each sentence of a motion begins."""
    rows_per_frame = model.skeleton.fps / motion.fps / model.config.tokenizer.downsample
    return [min(round(first * rows_per_frame), num_rows - 1) for first in motion.part_starts]


def _read_start(model: ModelParts, motion: Motion) -> Start:
    codes = model.encode(motion)
    # A motion of one sentence may say it as its caption alone.
    parts = dict(zip(part_rows(model, motion, len(codes)), motion.part_captions, strict=True)) or {0: motion.caption}
    return Start(codes, [(row, text) for row, text in parts.items() if text])


def make_chain(
    model: ModelParts, request: MotionRequest, prompts: Sequence[Prompt], sampling: Sampling, tell: Tell
) -> Iterator[list[Motion]]:
    """Yields the motions that show sentences one after the other, in batches. For `tell`, see `make_batch`."""
    segments, start = _read_chain(model, request, prompts)
    for batch in batches_of_keys(request.seed, prompts[0], request.num_samples):
        yield make_batch(model, request, segments, batch, start=start, sampling=sampling, tell=tell)


def make_chain_pieces(
    model: ModelParts, request: MotionRequest, prompts: Sequence[Prompt], key: Key[jax.Array, ""], sampling: Sampling
) -> Iterator[Motion]:
    """Returns an iterator over the motion of `make_chain` with a key, as decoded, while its codes are sampled."""
    segments, start = _read_chain(model, request, prompts)
    scale = request.options.guidance_scale
    codes = None if start is None else start.codes
    found = sample_segments(model, segments, key[None], start=codes, sampling=sampling, guidance_scale=scale)
    return stream_segments(model, segments, (own for own, *_ in found), start=start, seed=request.seed)


def _read_chain(
    model: ModelParts, request: MotionRequest, prompts: Sequence[Prompt]
) -> tuple[list[Segment], Start | None]:
    """Returns the segments of a request for a sequence of sentences, and what the first one continues."""
    rows = 0 if request.seconds is None else rows_of_seconds(model, request.seconds)
    start = None if request.start is None else _read_start(model, request.start)
    return split_segments(prompts, rows, limit=most_rows(model)), start


def make_batch(
    model: ModelParts,
    request: MotionRequest,
    segments: Sequence[Segment],
    batch: KeyBatch,
    *,
    start: Start | None,
    sampling: Sampling,
    tell: Tell,
) -> list[Motion]:
    """Returns the motions of segments for a batch of keys; `tell` learns how many of them are done."""
    scale = request.options.guidance_scale
    codes = None if start is None else start.codes
    sampled = []
    for own in sample_segments(model, segments, batch.keys, start=codes, sampling=sampling, guidance_scale=scale):
        sampled.append(own)
        tell(batch.num_samples * SAMPLING_SHARE * len(sampled) / len(segments))
    motions = []
    for codes_of_one in itertools.islice(zip(*sampled, strict=True), batch.num_samples):
        raw = request.options.raw
        motions.append(join_segments(model, segments, codes_of_one, start=start, seed=request.seed, raw=raw))
        tell(batch.num_samples * SAMPLING_SHARE + len(motions) * (1 - SAMPLING_SHARE))
    return motions


def sample_segments(
    model: ModelParts,
    segments: Sequence[Segment],
    keys: Key[jax.Array, " B"],
    *,
    start: Codes | None,
    sampling: Sampling,
    guidance_scale: float | None,
) -> Iterator[list[Codes]]:
    """Yields the new codes of each segment: those of each motion.

    A sentence after another one is sampled as if it were alone.

    Args:
        model: The model.
        segments: Sentences in turn.
        keys: One for each motion (consumed).
        start: Codes that the first segments go on from.
        sampling: How to choose codes, and when to stop.
        guidance_scale: Strength of the guidance by the text.
    """
    batch = len(keys)
    depth = model.config.tokenizer.num_quantizers
    nothing = np.zeros((0, depth), np.int32) if start is None else np.asarray(start, np.int32)
    before: list[Codes] = [nothing] * batch
    for segment, own_keys in zip(segments, segment_keys(keys, len(segments)), strict=True):
        # A sentence does not read the motion before it (see `FADE_SECONDS`), a segment that goes on does.
        if segment.begins and segment is not segments[0]:
            before = [codes[:0] for codes in before]
        # Teacher forcing for the context: its rows are given, and the generator continues after them.
        context = [codes[-context_rows(model) :] for codes in before]
        lengths = np.array([len(codes) for codes in context], np.int32)
        # A given length may need all rows that the generator can sample, whatever the longest free length is.
        longest = model.config.generator.max_codes
        limit = longest if segment.num_rows else min(longest, sampling.max_codes + int(lengths.max()))
        given = _given(segment, context, max_codes=limit)
        texts = model.text_encoder([segment.prompt.read] * batch)
        sampled = model.sample_codes(
            texts, own_keys, sampling._replace(max_codes=limit), guidance_scale=guidance_scale, given=given
        )
        rows = np.asarray(sampled.codes)
        ends = np.asarray(sampled.code_lengths)
        new = [own[first:last] for own, first, last in zip(rows, lengths, ends, strict=True)]
        # A short segment alone may have fewer rows than a context, so the old context stays in front of it.
        before = [np.concatenate(codes) for codes in zip(context, new, strict=True)]
        yield new


def _given(segment: Segment, context: Sequence[Codes], *, max_codes: int) -> Given:
    """Returns what is fixed of a segment: the codes before it, the kept ones of its draft, and its length."""
    codes = np.zeros((len(context), max_codes, context[0].shape[1]), np.int32)
    known = np.zeros(codes.shape[:2], bool)
    wanted = np.zeros(len(context), np.int32)
    for row, before in enumerate(context):
        first = len(before)
        last = len(before) + segment.num_rows
        codes[row, :first] = before
        known[row, :first] = True
        if segment.num_rows:
            wanted[row] = last
        if segment.draft is not None and segment.kept is not None:
            codes[row, first:last] = segment.draft
            known[row, first:last] = segment.kept[row]
    return Given(*map(jnp.asarray, (codes, known, wanted)))


def segment_keys(keys: Key[jax.Array, " B"], count: int) -> list[Key[jax.Array, " B"]]:
    """Returns keys for each segment of each motion. Those of the first are those of a motion that stands alone."""
    # The stream is above every step, so that no row of a segment has the key of a row before it.
    others = jax.vmap(
        lambda key, number: jax.random.fold_in(jax.random.fold_in(key, _SEGMENT_STREAM), number), (0, None)
    )
    return [keys] + [others(keys, number) for number in range(1, count)]


def join_segments(
    model: ModelParts, segments: Sequence[Segment], codes: Sequence[Codes], *, start: Start | None, seed: int, raw: bool
) -> Motion:
    """Returns the motion of the segments of one sample, in which a cross-fade joins each sentence to the next."""
    downsample = model.config.tokenizer.downsample
    placed = list(place_codes(segments, codes, start=start))
    numbered = [(piece.number, piece.codes) for piece in placed]
    decoded = list(decode_sentences(model.tokenizer, numbered, skeleton=model.skeleton))
    rows, features, positions = map(np.concatenate, zip(*decoded, strict=True))
    cleaned = None
    if not raw:
        size = model.config.generator.max_codes * downsample
        known = 0 if start is None else len(start.codes)
        seams = [piece.first * downsample for piece in placed if piece.first and piece.first >= known]
        eased = ease_seams(positions, seams, fps=model.skeleton.fps)
        # Windows as long as the longest motion of one sentence share a program.
        cleaned = clean_long(eased, skeleton=model.skeleton, size=size)
    return Motion(
        positions if cleaned is None else cleaned,
        model.skeleton.fps,
        positions_raw=None if cleaned is None else positions,
        skeleton=model.skeleton,
        features=features,
        codes=rows,
        caption=chain_caption(segments, start),
        seed=seed,
        part_starts=tuple(piece.first * downsample for piece in placed if piece.sentence is not None),
        part_captions=tuple(piece.sentence for piece in placed if piece.sentence is not None),
        warning=" ".join(dict.fromkeys(segment.prompt.warning for segment in segments if segment.prompt.warning)),
        unknown_words=tuple(dict.fromkeys(word for segment in segments for word in segment.prompt.unknown_words)),
    )


class PlacedCodes(NamedTuple):
    """Codes of one segment of a motion, and their position in it."""

    number: int
    """Of the sentence that they belong to."""
    first: int
    """Rows before them."""
    sentence: str | None
    """The sentence, if it begins here."""
    codes: Codes


def place_codes(segments: Sequence[Segment], codes: Iterable[Codes], *, start: Start | None) -> Iterator[PlacedCodes]:
    """Yields the codes of the segments of one sample; those of `start` come first and belong to the first sentence."""
    number = count = 0
    if start is not None:
        parts = {0: None} | dict(start.parts)
        for row, after in itertools.pairwise([*parts, len(start.codes)]):
            yield PlacedCodes(1, row, parts[row], np.asarray(start.codes[row:after], np.int32))
        count = len(start.codes)
    for segment, new in zip(segments, codes, strict=True):
        # Pieces of one number are decoded together, without a fade between them.
        number += segment.begins
        yield PlacedCodes(number, count, segment.prompt.text if segment.begins else None, new)
        count += len(new)


def chain_caption(segments: Sequence[Segment], start: Start | None) -> str:
    """Returns all sentences as one."""
    before = [] if start is None else [text for _, text in start.parts]
    return ", then ".join([*before, *(segment.prompt.text for segment in segments if segment.begins)])


def stream_segments(
    model: ModelParts, segments: Sequence[Segment], codes: Iterator[Codes], *, start: Start | None, seed: int
) -> Iterator[Motion]:
    """Yields the motion of the segments of one sample, as decoded, while their codes are sampled."""
    begun: list[tuple[int, str]] = []
    downsample = model.config.tokenizer.downsample
    caption = chain_caption(segments, start)
    frames = 0

    def numbered() -> Iterator[tuple[int, Codes]]:
        for piece in place_codes(segments, codes, start=start):
            if piece.sentence is not None:
                begun.append((piece.first * downsample, piece.sentence))
            yield piece.number, piece.codes

    for piece in decode_sentences(model.tokenizer, numbered(), skeleton=model.skeleton):
        last = frames + len(piece.positions)
        own = [(first - frames, text) for first, text in begun if frames <= first < last]
        yield Motion(
            piece.positions,
            model.skeleton.fps,
            skeleton=model.skeleton,
            features=piece.features,
            codes=piece.codes,
            caption=caption,
            seed=seed,
            part_starts=tuple(first for first, _ in own),
            part_captions=tuple(text for _, text in own),
        )
        frames = last
        # Sentences begin when their codes are sampled, which is some windows before they are decoded.
        begun[:] = [(first, text) for first, text in begun if first >= frames]
