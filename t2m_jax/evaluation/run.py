"""Evaluating motion by a protocol: repeats, each with the metrics of real motion and of the motion of a source."""

import dataclasses
import logging
import time
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from t2m_jax.checkpoints.evaluator import load_trained_evaluator
from t2m_jax.data.folder import Dataset
from t2m_jax.errors import UserError
from t2m_jax.evaluation.embedding import embed_decoded, embed_plan_captions, embed_plan_motions, measure_plan_motions
from t2m_jax.evaluation.protocols import Plan, find_protocol
from t2m_jax.evaluation.report.record import CLEANED, MAX_REPORT, Header, Metric, Report
from t2m_jax.evaluation.sources import CodeSource
from t2m_jax.evaluation.task import EvaluationTask, make_task
from t2m_jax.files.manifest import load_sealed_json, save_sealed_json
from t2m_jax.keys import new_key
from t2m_jax.metrics.frechet import fid
from t2m_jax.metrics.quality import MotionQuality
from t2m_jax.metrics.retrieval import label_bound, matching_score, r_precision
from t2m_jax.metrics.variety import diversity, multimodality
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.rotations import unit_vectors
from t2m_jax.motion.skeleton import skeleton_from_feature_dim
from t2m_jax.sampling.batches import round_up
from t2m_jax.sampling.decode import decode_motions

logger = logging.getLogger(__name__)

# Above the number of any repeat, so that no two passes are the same.
SECOND_PASS = 1_000_000
"""Added to a repeat's number for the second set of real motions, against which FID of the first is measured."""
HELD_OUT = "val"
"""The split of evaluations during training: the test split must not choose anything."""
HELD_OUT_PROTOCOL = dataclasses.replace(find_protocol("t2m-gpt"), multimodality_captions=0)
"""As in the original's training: one motion per caption, so variety is not measured."""
# Always the same pieces and captions, so that a curve over training shows the model and not the draws.
HELD_OUT_REPEAT = 0


class RepeatMetrics(NamedTuple):
    """The metrics of one repeat by name."""

    real: dict[str, float]
    measured: dict[str, float]


def make_header(task: EvaluationTask, source: CodeSource, *, model: str) -> Header:
    """Returns what the figures of a report depend on; `model` is what the user called the model."""
    return Header(
        protocol=task.protocol.name,
        model=model,
        data=task.data,
        split=task.split,
        num_samples=len(task.samples.clips),
        left_out_for_shared_source=task.samples.shared,
        evaluator=task.evaluator.fingerprint,
        weights=source.fingerprint,
        contents=task.contents,
        seed=task.seed,
        unit=task.unit,
        batch=task.protocol.batch,
        fid_motions=len(np.unique(task.plan(0).samples)),
        embedding_dim=task.evaluator.config.embedding_dim,
        **source.sampling,
    )


def evaluate(
    task: EvaluationTask, source: CodeSource, *, num_repeats: int, model: str = "", partial: str | Path | None = None
) -> Report:
    """Returns the metrics over some repeats.

    Args:
        task: What is evaluated.
        source: Gives the motions that are compared with the real ones.
        num_repeats: How often; the intervals are over the repeats.
        model: What the user calls the model, for the report's header.
        partial: File that keeps the finished repeats, so that an interrupted evaluation continues. It is only used by
            an evaluation with the same header.

    Raises:
        UserError: There are to be no repeats.
    """
    if num_repeats < 1:
        raise UserError(f"num-repeats: {num_repeats} is not a whole number above 0")
    header = make_header(task, source, model=model)
    if header.fid_warning:
        logger.warning(header.fid_warning)  # now, because an evaluation may take hours; tables say it, too
    # A repeat does not depend on how many follow, so those of a longer evaluation serve a shorter one.
    repeats = load_partial(partial, header)[:num_repeats]
    start = time.monotonic()
    done_before = len(repeats)
    for repeat in range(done_before, num_repeats):
        repeats.append(evaluate_repeat(task, source, repeat=repeat))
        if partial is not None:
            # After each repeat, so that an interruption costs no more than one.
            save_sealed_json(partial, {"header": dataclasses.asdict(header), "repeats": repeats})
        seconds = (time.monotonic() - start) / (repeat + 1 - done_before)
        left = seconds * (num_repeats - repeat - 1)
        logger.info("repeat %d of %d, %.0f s each, %.0f s left", repeat + 1, num_repeats, seconds, left)
    real, measured = (
        {name: Metric.from_repeats([metrics[name] for metrics in column]) for name in column[0]}
        for column in zip(*repeats, strict=True)
    )
    return Report(header=header, kind=source.kind, real=real, measured=measured)


def load_partial(path: str | Path | None, header: Header) -> list[RepeatMetrics]:
    """Returns the finished repeats of an interrupted evaluation with the same header; none if there was none.

    Raises:
        UserError: The file belongs to another evaluation.
    """
    if path is None or not Path(path).exists():
        return []
    try:
        found = load_sealed_json(path, max_bytes=MAX_REPORT, entries=("header", "repeats"))
        started = found["header"]
        # What the user called model and data may change; the fingerprints tell what they are.
        current = dataclasses.asdict(header) | {name: started[name] for name in ("model", "data")}
        differs = [name for name in current if started.get(name) != current[name]]
        repeats = [RepeatMetrics(real, measured) for real, measured in found["repeats"]]
        for column in zip(*repeats, strict=True):
            same = len({tuple(metrics) for metrics in column}) == 1
            if not same or not np.isfinite([list(metrics.values()) for metrics in column]).all() or not column[0]:
                raise ValueError("metrics that are not finite, or not the same in all repeats")
    except (UserError, LookupError, TypeError, ValueError, AttributeError):
        logger.warning("%s: is damaged; the evaluation starts over", path)
        return []
    if differs:
        name = differs[0]
        raise UserError(
            f"{path}: keeps the repeats of an evaluation with other {name} ({started.get(name)}, not {current[name]}); "
            "finish that one, or delete the file to start over"
        )
    return repeats


def evaluate_repeat(task: EvaluationTask, source: CodeSource, *, repeat: int) -> RepeatMetrics:
    """Returns the metrics of one repeat for real motion and for the motion of a source."""
    plan = task.plan(repeat)
    text = embed_plan_captions(task, plan)
    real = embed_plan_motions(task, plan)
    key = jax.random.fold_in(new_key(task.seed), repeat)
    found = source.make(task.samples.clips, task.protocol, plan, key)
    embeddings, quality = embed_decoded(task, source.tokenizer, found.codes)
    # Only the first sample of each item counts here; the others are for variety.
    motion = embeddings[: len(plan.samples)]
    metrics = RepeatMetrics(*(_paired_metrics(task, plan, text, motions) for motions in (real, motion)))
    metrics.real.update(_mean_quality(measure_plan_motions(task, plan), count=len(motion)))
    metrics.measured.update(_mean_quality(quality.decoded, count=len(motion)))
    metrics.measured.update(_mean_quality(quality.cleaned, count=len(motion), prefix=CLEANED))
    # Against the real pieces of this repeat, as in T2M-GPT and MoMask.
    metrics.measured.update(_distances(real, motion))
    if len(found.items) > len(plan.samples):  # there are further samples of the captions whose variety is measured
        place = np.full(len(plan.samples), -1)
        place[plan.varied] = np.arange(len(plan.varied))
        is_varied = place[found.items] >= 0
        # Samples that no pair uses were not made; they stay zero.
        varied = np.zeros((len(plan.varied), task.protocol.samples_per_caption, embeddings.shape[1]), np.float32)
        varied[place[found.items[is_varied]], found.numbers[is_varied]] = embeddings[is_varied]
        variety = multimodality(jnp.asarray(varied), jnp.asarray(plan.multimodality_pairs))
        metrics.measured["multimodality"] = float(variety)
    if task.samples.labels is not None:
        chosen, counted = _whole_batches(len(text), task.protocol.batch)
        labels = jnp.asarray(task.samples.labels[plan.samples][chosen])
        bound = label_bound(labels, batch=task.protocol.batch, counted=counted)
        metrics.real.update(_by_rank("r_precision_{}_bound_by_label", bound))
    if task.protocol.crops:
        # Whole clips would be compared with themselves; crops are drawn again, which shows the best that FID can be.
        again = embed_plan_motions(task, task.plan(repeat + SECOND_PASS))
        metrics.real.update(_distances(real, again))
    return metrics


def _distances(one: Float[np.ndarray, "N E"], other: Float[np.ndarray, "M E"]) -> dict[str, float]:
    """Returns FID of embeddings, and of their directions alone: their length says little about what a motion shows."""
    pairs = {"fid": (one, other), "fid_normalized": tuple(map(unit_vectors, (one, other)))}
    return {name: float(fid(jnp.asarray(real), jnp.asarray(motion))) for name, (real, motion) in pairs.items()}


def _mean_quality(quality: MotionQuality, *, count: int, prefix: str = "") -> dict[str, float]:
    """Returns the means over the first `count` motions, by name."""
    return {f"{prefix}{name}": float(np.mean(values[:count])) for name, values in quality._asdict().items()}


def _paired_metrics(
    task: EvaluationTask, plan: Plan, text: Float[np.ndarray, "N E"], motion: Float[np.ndarray, "N E"]
) -> dict[str, float]:
    """Returns the metrics of one set of motions and their captions."""
    batch = task.protocol.batch
    chosen, counted = _whole_batches(len(text), batch)
    texts = jnp.asarray(text[chosen])
    motions = jnp.asarray(motion[chosen])
    metrics = _by_rank("r_precision_{}", r_precision(texts, motions, batch=batch, counted=counted))
    # The papers describe this direction, the published codes compute the other.
    mirrored = r_precision(texts, motions, batch=batch, direction="texts_per_motion", counted=counted)
    metrics |= _by_rank("r_precision_{}_texts_per_motion", mirrored)
    if task.samples.labels is not None:
        labels = jnp.asarray(task.samples.labels[plan.samples][chosen])
        by_label = r_precision(texts, motions, batch=batch, labels=labels, counted=counted)
        metrics |= _by_rank("r_precision_{}_by_label", by_label)
    # Of each pair once, without those that fill the last batch again.
    metrics["matching_score"] = float(matching_score(jnp.asarray(text), jnp.asarray(motion)))
    metrics["diversity"] = float(diversity(jnp.asarray(motion), jnp.asarray(plan.diversity_pairs)))
    return metrics


def _by_rank(name: str, precision: Float[Array, " K"]) -> dict[str, float]:
    """Returns R-precision by metric; `{}` in the name is replaced by the rank."""
    return {name.format(k): float(value) for k, value in enumerate(precision, start=1)}


def _whole_batches(count: int, batch: int) -> tuple[Int[np.ndarray, " M"], Bool[Array, " M"]]:
    """Returns indices in whole batches, and which count; the last batch is filled with the first motions."""
    size = round_up(count, batch)
    return np.resize(np.arange(count), size), jnp.arange(size) < count


def open_held_out(dataset: Dataset, evaluator: Path, *, seed: int, unit: int) -> EvaluationTask:
    """Returns the task of evaluating the validation split with the evaluator in a folder.

    Raises:
        UserError: There is no evaluator, it was trained on other data, or the split does not fill a batch.
    """
    return make_task(
        dataset, load_trained_evaluator(evaluator), HELD_OUT_PROTOCOL, split=HELD_OUT, seed=seed, unit=unit
    )


def held_out_metrics(task: EvaluationTask, source: CodeSource) -> dict[str, float]:
    """Returns the metrics of a source's motion for the validation split."""
    return evaluate_repeat(task, source, repeat=HELD_OUT_REPEAT).measured


def sample_motions(task: EvaluationTask, source: CodeSource, *, count: int) -> list[Motion]:
    """Returns the first motions of a source in the repeat that is measured, with their captions."""
    plan = task.plan(HELD_OUT_REPEAT)
    # A motion depends on key and item only, so these are the first ones of the whole repeat.
    few = plan._replace(
        samples=plan.samples[:count],
        captions=plan.captions[:count],
        starts=plan.starts[:count],
        lengths=plan.lengths[:count],
    )
    key = jax.random.fold_in(new_key(task.seed), HELD_OUT_REPEAT)
    found = source.make(task.samples.clips, task.protocol, few, key)
    captions = [caption.text for caption in few.chosen_captions(task.samples.clips)]
    skeleton = skeleton_from_feature_dim(source.tokenizer.config.feature_dim)
    motions = decode_motions(source.tokenizer, found.codes.rows, skeleton=skeleton)
    return [dataclasses.replace(motion, caption=caption) for motion, caption in zip(motions, captions, strict=True)]
