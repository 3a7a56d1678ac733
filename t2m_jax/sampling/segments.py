"""Codes of sentences in turn: what is sampled at once, after which rows, and how often."""

import functools
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Key

from t2m_jax.sampling.choosing import Wanted, candidate_keys, candidate_texts, choose
from t2m_jax.sampling.decode import Codes
from t2m_jax.sampling.loop import Given, Sampling
from t2m_jax.sampling.model import ModelParts
from t2m_jax.sampling.prompts import Prompt
from t2m_jax.text.counts import Times

CONTEXT_SECONDS = 0.4
"""Motion before the continuation, which the generator reads as its beginning. With more, a sentence is followed less
often."""
_SEGMENT_STREAM = 2**30
"""In place of a sample's number, in keys for the segments of a chain."""


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
    wanted: Wanted | None = None
    """How often something is done, how fast, or with which side. Of several samples, the one that does so is taken."""


def split_segments(prompt: Prompt, num_rows: int, *, limit: int, wanted: Wanted | None = None) -> list[Segment]:
    """Returns the segments of a sentence. A motion that is longer than `limit` rows has several, which continue it.

    Only a motion of one segment can be chosen by how often something is done; the warning of a longer one says so.
    """
    if num_rows <= limit:
        return [Segment(prompt, num_rows, True, wanted=wanted)]
    if isinstance(wanted, Times):
        said = f"{prompt.text!r}: too long to choose a sample by its count ({wanted.action} {wanted.number} times)"
        prompt = prompt._replace(warning=" ".join(filter(None, (prompt.warning, said))))
        wanted = None
    lengths = [min(limit, num_rows - done) for done in range(0, num_rows, limit)]
    return [Segment(prompt, rows, not number, wanted=wanted) for number, rows in enumerate(lengths)]


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
    depth = model.config.tokenizer.num_quantizers
    nothing = np.zeros((0, depth), np.int32) if start is None else np.asarray(start, np.int32)
    before: list[Codes] = [nothing] * len(keys)
    sample = functools.partial(_sample_segment, model, sampling=sampling, guidance_scale=guidance_scale)
    for segment, own_keys in zip(segments, segment_keys(keys, len(segments)), strict=True):
        # A sentence does not read the motion before it (see `FADE_SECONDS`), a segment that goes on does.
        if segment.begins and segment is not segments[0]:
            before = [codes[:0] for codes in before]
        # Teacher forcing for the context: its rows are given, and the generator continues after them.
        context = [codes[-context_rows(model) :] for codes in before]
        if segment.wanted is None:
            new = sample(segment, [segment.prompt.read] * len(keys), context, own_keys)
        else:
            tried = [candidate_keys(key, segment.wanted) for key in own_keys]
            texts = candidate_texts(segment.prompt.read, segment.wanted, len(tried[0]))
            found = [
                sample(segment, texts, [own] * len(texts), tries) for own, tries in zip(context, tried, strict=True)
            ]
            # A length that was asked for stays.
            most_rows = 0 if segment.num_rows else sampling.max_codes
            new = [choose(model, candidates, segment.wanted, most_rows=most_rows) for candidates in found]
        # A short segment alone may have fewer rows than a context, so the old context stays in front of it.
        before = [np.concatenate(codes) for codes in zip(context, new, strict=True)]
        yield new


def _sample_segment(
    model: ModelParts,
    segment: Segment,
    texts: Sequence[str],
    context: Sequence[Codes],
    keys: Key[jax.Array, " B"],
    *,
    sampling: Sampling,
    guidance_scale: float | None,
) -> list[Codes]:
    """Returns the new codes of a segment of each motion, after those of its context; `texts` are what is read."""
    lengths = np.array([len(codes) for codes in context], np.int32)
    # A given length may need all rows that the generator can sample, whatever the longest free length is.
    longest = model.config.generator.max_codes
    limit = longest if segment.num_rows else min(longest, sampling.max_codes + int(lengths.max()))
    sampled = model.sample_codes(
        model.text_encoder(texts),
        keys,
        sampling._replace(max_codes=limit),
        guidance_scale=guidance_scale,
        given=_given(segment, context, max_codes=limit),
    )
    rows = np.asarray(sampled.codes)
    ends = np.asarray(sampled.code_lengths)
    return [own[first:last] for own, first, last in zip(rows, lengths, ends, strict=True)]


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
