"""Motion from several sentences, or after a given motion: known codes are read, and sampling continues from them."""

import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Key

from t2m_jax.motion.cleanup import clean_long
from t2m_jax.motion.joining import ease_seams
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.skeleton import HUMANML3D
from t2m_jax.sampling.choosing import missed_count
from t2m_jax.sampling.decode import Codes, decode_sentences
from t2m_jax.sampling.loop import Sampling
from t2m_jax.sampling.model import ModelParts
from t2m_jax.sampling.prompts import KeyBatch, Prompt, batches_of_keys
from t2m_jax.sampling.request import MotionRequest
from t2m_jax.sampling.segments import Segment, most_rows, rows_of_seconds, sample_segments, split_segments
from t2m_jax.text.counts import Times

SAMPLING_SHARE = 0.7
"""Share of the time for a motion of several sentences that sampling takes; the rest is decoding and the clean-up."""

Tell = Callable[[float], None]
"""Called with the number of motions of a batch that are done, in which parts count, too."""


class Start(NamedTuple):
    """What a motion continues."""

    codes: Codes
    parts: Sequence[tuple[int, str]]
    """The row in which each of its sentences begins, and the sentence."""


def part_rows(model: ModelParts, motion: Motion, num_rows: int) -> list[int]:
    """Returns the row of codes in which each sentence of a motion begins."""
    rows_per_frame = model.skeleton.fps / motion.fps / model.config.tokenizer.downsample
    # A part that begins in the last frames would round to the row after the last.
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
    rows = [0 if seconds is None else rows_of_seconds(model, seconds) for seconds in request.lengths]
    start = None if request.start is None else _read_start(model, request.start)
    limit = most_rows(model)
    # Of this skeleton alone, it is known which joints do something.
    nothing = (None,) * len(prompts)
    times, sides, at_once = (
        (request.times, request.sides, request.at_once) if model.skeleton == HUMANML3D else (nothing, nothing, nothing)
    )
    segments = (
        # What is said first here counts most: "slowly kicks three times with the left leg".
        split_segments(prompt, own, limit=limit, wanted=next(filter(None, said), None))
        for prompt, own, *said in zip(prompts, rows, times, sides, at_once, request.paces, strict=True)
    )
    return list(itertools.chain.from_iterable(segments)), start


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
    # The samples after these only fill up the batch.
    for codes_of_one in itertools.islice(zip(*sampled, strict=True), batch.num_samples):
        raw = request.options.raw
        motions.append(join_segments(model, segments, codes_of_one, start=start, seed=request.seed, raw=raw))
        tell(batch.num_samples * SAMPLING_SHARE + len(motions) * (1 - SAMPLING_SHARE))
    return motions


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
        # Between parts of what is continued, motion was eased when it was made.
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
        warning=" ".join(_warnings(model, segments, placed, positions if cleaned is None else cleaned)),
        unknown_words=_unknown_words(segments),
    )


def _unknown_words(segments: Sequence[Segment]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(word for segment in segments for word in segment.prompt.unknown_words))


def _warnings(
    model: ModelParts,
    segments: Sequence[Segment],
    placed: Sequence["PlacedCodes"],
    positions: Float[np.ndarray, "T J 3"],
) -> list[str]:
    """Returns what is to be said of the sentences of a motion, and that they are not shown as often as they say."""
    found = [segment.prompt.warning for segment in segments]
    downsample = model.config.tokenizer.downsample
    # What is continued comes first in `placed`, and has no segments.
    for segment, piece in zip(segments, placed[len(placed) - len(segments) :], strict=True):
        if isinstance(segment.wanted, Times):
            own = positions[downsample * piece.first :][: downsample * len(piece.codes)]
            found.append(missed_count(segment.wanted, own, sentence=segment.prompt.text))
    return list(dict.fromkeys(filter(None, found)))


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
    warning = " ".join(dict.fromkeys(filter(None, (segment.prompt.warning for segment in segments))))
    unknown_words = _unknown_words(segments)
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
            warning=warning,
            unknown_words=unknown_words,
        )
        frames = last
        # Sentences begin when their codes are sampled, which is some windows before they are decoded.
        begun[:] = [(first, text) for first, text in begun if first >= frames]
