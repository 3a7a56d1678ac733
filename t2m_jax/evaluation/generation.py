"""Evaluating generated motion by a protocol: repeats, each a row of metrics for real motion and one for generated."""

import json
import logging
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key

from t2m_jax.checkpoints.evaluator import TrainedEvaluator
from t2m_jax.config import UserError
from t2m_jax.data.caption_bank import caption_tokens
from t2m_jax.data.folder import Clip, Dataset, samples_from_clip
from t2m_jax.evaluation.embedding import embed_captions, embed_generated, embed_real, generate_many
from t2m_jax.evaluation.protocols import BATCH, SAMPLES_A_CAPTION, Plan, Protocol, make_plan
from t2m_jax.evaluation.reports import save_json
from t2m_jax.metrics import diversity, fid, matching_score, multimodality, r_precision
from t2m_jax.motion.normalizer import Normalizer
from t2m_jax.sampling.pipeline import TextToMotion
from t2m_jax.sampling.strategies import Strategy

logger = logging.getLogger(__name__)

Figures = dict[str, float]
Row = dict[str, Figures]
"""Row name -> metric -> value."""

STATISTICS_TOLERANCE = 0.5
"""Deviations by which the means of data and evaluator may differ, and natural logarithm of the deviations' ratio."""
SECOND_PASS = 1_000_000
"""Added to a repeat's number for the second look at real motion, against which the first is measured."""


class Subject(NamedTuple):
    """What is evaluated, on what, how."""

    model: TextToMotion
    evaluator: TrainedEvaluator
    samples: Sequence[Clip]
    protocol: Protocol
    strategy: Strategy
    max_frames: int
    seed: int


def load_samples(dataset: Dataset, split: str) -> list[Clip]:
    """Returns the motions of a split, whole or parts, each with captions that describe all of it.

    Raises:
        UserError: if there are none.
    """
    clips = dataset.clips(split)
    samples = [sample for clip in clips for sample in samples_from_clip(clip, dataset.info)]
    if not samples:
        raise UserError(f"{dataset.folder}: split {split} has no motion with a caption to evaluate")
    return samples


def check_fit(model: TextToMotion, evaluator: TrainedEvaluator, dataset: Dataset) -> None:
    """Raises `UserError` where model, evaluator and data are not of one kind of motion.

    An evaluator may have statistics of its own, such as those of an earlier build of the data, but motion must lie
    where it learned to look. Root and contact columns are left out: evaluators weigh them.
    """
    width = dataset.skeleton.feature_dim
    for name, found in (("the model", model.skeleton.feature_dim), ("the evaluator", evaluator.config.feature_dim)):
        if found != width:
            raise UserError(f"{dataset.folder}: has {width} features a frame, {name} reads {found}")
    layout = dataset.skeleton.layout
    kept = np.r_[layout.positions, layout.rotations, layout.velocities]
    ours, theirs = (Normalizer(*(column[kept] for column in n)) for n in (dataset.normalizer, evaluator.normalizer))
    shift = np.max(np.abs(ours.mean - theirs.mean) / theirs.std)
    ratio = np.max(np.abs(np.log(ours.std / theirs.std)))
    if max(shift, ratio) > STATISTICS_TOLERANCE:
        raise UserError(
            f"{dataset.folder}: its statistics (Mean.npy, Std.npy) are not those of the evaluator's data; train one on "
            "this data set with `t2m train evaluator`"
        )


def _rows_of(plan: Plan, protocol: Protocol) -> tuple[Int[np.ndarray, " G"], Int[np.ndarray, " G"]]:
    """Returns which captions to generate for, and the number of each sample among those of its caption.

    Of the 30 samples of a caption only those are made that a metric looks at: one does not depend on another.
    """
    standing = 0 if protocol.first_counts else SAMPLES_A_CAPTION - 1
    looked_at = np.union1d(plan.multimodality_pairs.ravel(), [standing])
    items = [np.arange(len(plan.samples)), *(plan.varied for number in looked_at if number != standing)]
    numbers = [standing, *(number for number in looked_at if number != standing)]
    sizes = [len(rows) for rows in items]
    return np.concatenate(items), np.repeat(numbers, sizes)


def evaluate_repeat(subject: Subject, texts: Float[np.ndarray, "Q E"], index: dict[str, int], *, repeat: int) -> Row:
    """Returns the metrics of one repeat for real and for generated motion.

    Args:
        subject: What is evaluated.
        texts: The model's embeddings of all captions.
        index: Caption -> its row there.
        repeat: Number of the repeat.
    """
    plan = make_plan(subject.samples, subject.protocol, seed=subject.seed, repeat=repeat)
    captions = [subject.samples[owner].captions[caption] for owner, caption in zip(*plan[:2], strict=True)]
    text = embed_captions(subject.evaluator, [caption_tokens(caption) for caption in captions])
    real = _real(subject, plan)
    items, numbers = _rows_of(plan, subject.protocol)
    generated = _generated(subject, plan, texts[[index[caption.text] for caption in captions]], items, numbers, repeat)
    standing, varied = generated[: len(captions)], _varied(plan, generated, items, numbers)
    measured = {"real": _figures(text, real, plan, None), "generated": _figures(text, standing, plan, varied)}
    measured["generated"]["fid"] = float(fid(jnp.asarray(real), jnp.asarray(standing)))
    if subject.protocol.crops:
        again = make_plan(subject.samples, subject.protocol, seed=subject.seed, repeat=repeat + SECOND_PASS)
        measured["real"]["fid"] = float(fid(jnp.asarray(real), jnp.asarray(_real(subject, again))))
    return measured


def _real(subject: Subject, plan: Plan) -> Float[np.ndarray, "N E"]:
    samples = [subject.samples[owner] for owner in plan.samples]
    return embed_real(subject.evaluator, samples, plan.starts, plan.lengths, max_frames=subject.max_frames)


def _generated(
    subject: Subject,
    plan: Plan,
    texts: Float[np.ndarray, "N X"],
    items: Int[np.ndarray, " G"],
    numbers: Int[np.ndarray, " G"],
    repeat: int,
) -> Float[np.ndarray, "G E"]:
    """Returns the embeddings of all generated motions; each depends on seed, repeat, caption and number alone."""
    key = jax.random.fold_in(jax.random.key(subject.seed), repeat)
    forced = subject.protocol.generated_length == "real"
    codes = generate_many(
        subject.model,
        texts[items],
        sample_keys(key, jnp.asarray(items), jnp.asarray(numbers)),
        strategy=subject.strategy,
        lengths=plan.lengths[items] if forced else None,
    )
    return embed_generated(
        subject.model,
        subject.evaluator,
        codes,
        max_frames=subject.max_frames,
        clear=subject.protocol.clears_past_end,
    )


@jax.jit
def sample_keys(key: Key[Array, ""], items: Int[Array, " G"], numbers: Int[Array, " G"]) -> Key[Array, " G"]:
    """Returns a key for each sample of each item."""
    return jax.vmap(lambda item, number: jax.random.fold_in(jax.random.fold_in(key, item), number))(items, numbers)


def _varied(
    plan: Plan, generated: Float[np.ndarray, "G E"], items: Int[np.ndarray, " G"], numbers: Int[np.ndarray, " G"]
) -> Float[np.ndarray, "M S E"]:
    """Returns the samples of each caption whose variety is measured, at their numbers; zeros where none was made."""
    place = np.full(len(plan.samples), -1)
    place[plan.varied] = np.arange(len(plan.varied))
    chosen = place[items] >= 0
    varied = np.zeros((len(plan.varied), SAMPLES_A_CAPTION, generated.shape[1]), np.float32)
    varied[place[items[chosen]], numbers[chosen]] = generated[chosen]
    return varied


def _figures(
    text: Float[np.ndarray, "N E"],
    motion: Float[np.ndarray, "N E"],
    plan: Plan,
    varied: Float[np.ndarray, "M S E"] | None,
) -> Figures:
    """Returns the metrics of one set of motions but its distance to another."""
    filled, counted = _whole_batches(len(text))
    precision, mirrored = (
        r_precision(jnp.asarray(text[filled]), jnp.asarray(motion[filled]), direction=direction, counted=counted)
        for direction in ("motions_per_text", "texts_per_motion")
    )
    figures = {f"r_precision_{k}": float(value) for k, value in enumerate(precision, start=1)}
    figures |= {f"r_precision_{k}_texts_per_motion": float(value) for k, value in enumerate(mirrored, start=1)}
    figures["matching_score"] = float(matching_score(jnp.asarray(text), jnp.asarray(motion)))
    figures["diversity"] = float(diversity(jnp.asarray(motion), jnp.asarray(plan.diversity_pairs)))
    if varied is not None:
        figures["multimodality"] = float(multimodality(jnp.asarray(varied), jnp.asarray(plan.multimodality_pairs)))
    return figures


def _whole_batches(count: int) -> tuple[Int[np.ndarray, " M"], Bool[Array, " M"]]:
    """Returns rows in whole batches, filled up from the front, and which of them count."""
    size = -(-count // BATCH) * BATCH
    return np.resize(np.arange(count), size), jnp.arange(size) < count


def evaluate_generation(
    subject: Subject, *, num_repeats: int, header: dict[str, Any], partial: Path | None = None
) -> dict[str, Any]:
    """Returns the report: header, and for each row and metric mean, interval and the value of every repeat.

    Args:
        subject: What is evaluated.
        num_repeats: How often; the interval is over them.
        header: What the figures depend on. It stands in the report, and a partial result with another one is not used.
        partial: File that keeps the repeats done so far, so that an interrupted evaluation goes on where it was.
    """
    captions = sorted({caption.text for sample in subject.samples for caption in sample.captions})
    texts = np.concatenate(
        [
            np.asarray(subject.model.text_encoder(captions[first : first + 256]))
            for first in range(0, len(captions), 256)
        ]
    )
    index = {caption: row for row, caption in enumerate(captions)}
    repeats = load_partial(partial, header)[:num_repeats]
    start, done_before = time.monotonic(), len(repeats)
    for repeat in range(done_before, num_repeats):
        repeats.append(evaluate_repeat(subject, texts, index, repeat=repeat))
        if partial is not None:
            save_json(partial, {"header": header, "repeats": repeats})
        seconds = (time.monotonic() - start) / (repeat + 1 - done_before)
        left = seconds * (num_repeats - repeat - 1)
        logger.info("repeat %d of %d, %.0f s each, %.0f s left", repeat + 1, num_repeats, seconds, left)
    return {**header, "rows": summarize(repeats)}


def load_partial(path: Path | None, header: dict[str, Any]) -> list[Row]:
    """Returns the repeats that an interrupted evaluation of the same kind has left, none where there was none."""
    if path is None or not path.exists():
        return []
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        return list(found["repeats"]) if found["header"] == header else []
    except (ValueError, KeyError, TypeError):
        logger.warning("%s: damaged; the evaluation starts over", path)
        return []


def summarize(repeats: Sequence[Row]) -> dict[str, dict[str, dict[str, Any]]]:
    """Returns mean, half-width of the 95 % interval (1.96 times the deviation over the root of n) and all values."""
    rows: dict[str, dict[str, dict[str, Any]]] = {}
    for row, figures in repeats[0].items():
        rows[row] = {}
        for metric in figures:
            values = np.array([repeat[row][metric] for repeat in repeats])
            interval = 1.96 * values.std() / np.sqrt(len(values))
            rows[row][metric] = {"mean": float(values.mean()), "interval": float(interval), "repeats": values.tolist()}
    return rows
