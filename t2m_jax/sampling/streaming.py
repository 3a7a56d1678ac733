"""Motion while it is generated: rows of codes are decoded as soon as their frames are final."""

import dataclasses
import functools
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from jaxtyping import Int

from t2m_jax.devices import put_everywhere
from t2m_jax.motion.motion import Motion
from t2m_jax.sampling.loop import LoopState, Sampling
from t2m_jax.sampling.model import ModelParts
from t2m_jax.sampling.prompts import sample_key
from t2m_jax.sampling.together import Sample


def make_pieces(
    model: ModelParts, sample: Sample, sampling: Sampling, *, guidance_scale: float | None
) -> Iterator[Motion]:
    """Returns an iterator over a motion of one sentence, as decoded, while it is generated: a piece for each row."""
    prompt, seed, number = sample
    keys = put_everywhere(sample_key(seed, prompt.text, number)[None])
    next_row, state = model.rows(model.text_encoder([prompt.text]), keys, sampling, guidance_scale=guidance_scale)
    decode = functools.partial(
        model.decode_padded, size=sampling.max_codes, caption=prompt.text, seed=seed, clean=False
    )
    return stream_pieces(next_row, state, sampling, decode, decoder_context=model.config.tokenizer.decoder_context)


def stream_pieces(
    next_row: Callable[[LoopState], tuple[LoopState, Any]],
    state: LoopState,
    sampling: Sampling,
    decode: Callable[[Int[np.ndarray, "N R"]], Motion],
    *,
    decoder_context: int,
) -> Iterator[Motion]:
    """Yields the frames of each row of one motion when they are final.

    Args:
        next_row: From a state to the next state and a row [1, R].
        state: Before the first row.
        sampling: Says when the motion ends.
        decode: From the first rows of a motion to its frames.
        decoder_context: Rows after a row that its frames depend on.
    """
    rows: list[Int[np.ndarray, " R"]] = []
    sent, ended = 0, False
    while not ended:
        state, row = next_row(state)
        ended = bool(state.done[0])
        if not ended or sampling.stop_rule.keeps_last:
            rows.append(np.asarray(row[0]))
        ended = ended or len(rows) == sampling.max_codes
        final = len(rows) if ended else len(rows) - decoder_context
        if final <= sent:
            continue
        motion = decode(np.stack(rows))
        yield from (part_of_rows(motion, row, row + 1) for row in range(sent, final))
        sent = final


def part_of_rows(motion: Motion, first: int, last: int) -> Motion:
    """Returns the part of a motion as decoded that rows of codes stand for, up to before the last."""
    assert motion.features is not None and motion.codes is not None
    size = motion.num_frames // len(motion.codes)
    frames = slice(first * size, last * size)
    features, codes = motion.features[frames], motion.codes[first:last]
    return dataclasses.replace(motion, positions=motion.positions[frames], features=features, codes=codes)
