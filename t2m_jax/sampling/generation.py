"""Motions of requests whose sentences were read. Here the kinds of requests are told apart."""

import dataclasses
import itertools
from collections.abc import Callable, Iterator, Sequence

from t2m_jax.errors import UserError
from t2m_jax.motion.motion import Motion
from t2m_jax.sampling.decode import GrowingMotion, split_rows
from t2m_jax.sampling.directing import direct
from t2m_jax.sampling.inbetween import redo, vary
from t2m_jax.sampling.loop import Sampling
from t2m_jax.sampling.model import ModelParts
from t2m_jax.sampling.prompts import MAX_BATCH, Prompt, Sample
from t2m_jax.sampling.request import MotionRequest, SamplingOptions
from t2m_jax.sampling.timeline import Tell, make_chain

OnProgress = Callable[[float, int], None]
"""Called with the number of motions that are ready and the number of all: after each batch and, of motions of several
sentences, after each sentence. What is done of a batch counts as a part of its motions."""

ReadRequest = tuple[MotionRequest, Sequence[Prompt]]
"""A request and the prompts of its sentences."""


def make_motions(
    model: ModelParts, requests: Sequence[ReadRequest], on_progress: OnProgress | None
) -> Iterator[Motion]:
    """Returns an iterator over the motions of requests, request by request.

    Raises:
        UserError: A request does not fit the model.
    """
    # Only requests that follow each other are put together, so that motions come in the order of requests.
    groups = itertools.groupby(requests, key=lambda pair: (pair[0].is_plain, pair[0].options))
    total = sum(request.num_samples for request, _ in requests)
    ready = 0

    def tell(part: float | int = 0) -> None:
        """Tells that a number of motions of the batch that is being made is ready, for example 1.5."""
        if on_progress is not None:
            on_progress(ready + part, total)

    # A list, so that options are checked now, and not when the first motion is taken.
    batches = [_make_group(model, list(group), model.sampling(options), tell) for (_, options), group in groups]

    def unpacked() -> Iterator[Motion]:
        nonlocal ready
        for motions in itertools.chain.from_iterable(batches):
            ready += len(motions)
            tell()
            yield from motions

    return unpacked()


def _make_group(
    model: ModelParts, group: Sequence[ReadRequest], sampling: Sampling, tell: Tell
) -> Iterator[list[Motion]]:
    """Yields the motions of requests with the same options in batches."""
    if group[0][0].is_plain:
        yield from _make_together(model, group, sampling)
        return
    for request, prompts in group:
        if request.span is not None:
            yield redo(model, request, prompts[0], sampling)
        elif request.targets:
            yield direct(model, request, prompts[0])
        elif request.strength is not None:
            yield from vary(model, request, prompts, sampling, tell)
        else:
            yield from make_chain(model, request, prompts, sampling, tell)


def _make_together(model: ModelParts, group: Sequence[ReadRequest], sampling: Sampling) -> Iterator[list[Motion]]:
    """Yields the motions of plain requests in batches."""
    options = group[0][0].options
    samples = (
        Sample(prompt, request.seed, number) for request, (prompt,) in group for number in range(request.num_samples)
    )
    while batch := list(itertools.islice(samples, MAX_BATCH)):
        yield model.make_samples(batch, sampling, options)


def make_rows(model: ModelParts, sample: Sample, options: SamplingOptions) -> Iterator[Motion]:
    """Returns an iterator over the motion of each row of codes of a sample, as decoded, when it is final.

    Raises:
        UserError: An option does not fit the model, or the stop rule needs all rows first.
    """
    sampling = model.sampling(options)
    # The rule of the highest score cuts a motion when all rows are known, and then nothing is left to stream.
    if not sampling.stop_rule.ends_early:
        if options.stop_rule is not None:
            raise UserError(f"stop-rule: {options.stop_rule!r} needs all rows first; use threshold for a stream")
        sampling = model.sampling(dataclasses.replace(options, stop_rule="threshold"))
    return _make_rows(model, sample, sampling, options.guidance_scale)


def _make_rows(model: ModelParts, sample: Sample, sampling: Sampling, guidance_scale: float | None) -> Iterator[Motion]:
    """Yields the motions of `make_rows`. A function of its own, so that options are checked before the first one."""
    prompt = sample.prompt
    growing = GrowingMotion(model.tokenizer, skeleton=model.skeleton, step=1, max_codes=sampling.max_codes)
    for row, ended in model.sample_rows(model.text_encoder([prompt.read]), sample.key, sampling, guidance_scale):
        motion = growing.add(row, ended=ended)
        if motion is not None:
            said = dataclasses.replace(
                motion,
                caption=prompt.text,
                seed=sample.seed,
                warning=prompt.warning,
                unknown_words=prompt.unknown_words,
            )
            yield from split_rows(said)
