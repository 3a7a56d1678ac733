"""Evaluating motion by a protocol: repeats, each a row of metrics for real motion and one for what a model makes."""

import json
import logging
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from t2m_jax.data.banks.captions import caption_tokens
from t2m_jax.evaluation.embedding import embed_captions, embed_decoded, embed_real
from t2m_jax.evaluation.protocols import BATCH, SAMPLES_A_CAPTION, Plan, make_plan
from t2m_jax.evaluation.report.record import save_json
from t2m_jax.evaluation.sources import Made, Maker
from t2m_jax.evaluation.task import Subject
from t2m_jax.metrics import diversity, fid, label_bound, matching_score, multimodality, r_precision

logger = logging.getLogger(__name__)

Figures = dict[str, float]
Rows = dict[str, Figures]
"""Row name -> metric -> value."""

REAL = "real"
SECOND_PASS = 1_000_000
"""Added to a repeat's number for the second look at real motion, against which the first is measured."""


def evaluate_repeat(subject: Subject, maker: Maker, *, repeat: int) -> Rows:
    """Returns the metrics of one repeat for real motion and for what `maker` makes."""
    clips, protocol = subject.samples.clips, subject.protocol
    plan = make_plan(clips, protocol, seed=subject.seed, repeat=repeat)
    text = embed_plan_captions(subject, plan)
    real = embed_plan_motions(subject, plan)
    made = maker.make(clips, protocol, plan, jax.random.fold_in(jax.random.key(subject.seed), repeat))
    embeddings = embed_decoded(
        maker.vqvae,
        subject.evaluator,
        made.codes,
        max_frames=subject.max_frames,
        clear=protocol.clears_past_end,
    )
    standing, varied = embeddings[: len(plan.samples)], _varied(plan, embeddings, made)
    labels = None if subject.samples.labels is None else subject.samples.labels[plan.samples]
    measured = {REAL: _figures(text, real, plan, labels), maker.row: _figures(text, standing, plan, labels)}
    if labels is not None:
        measured[REAL] |= _label_bounds(labels)
    measured[maker.row]["fid"] = float(fid(jnp.asarray(real), jnp.asarray(standing)))
    if varied is not None:
        variety = multimodality(jnp.asarray(varied), jnp.asarray(plan.multimodality_pairs))
        measured[maker.row]["multimodality"] = float(variety)
    if protocol.crops:
        again = make_plan(clips, protocol, seed=subject.seed, repeat=repeat + SECOND_PASS)
        measured[REAL]["fid"] = float(fid(jnp.asarray(real), jnp.asarray(embed_plan_motions(subject, again))))
    return measured


def embed_plan_captions(subject: Subject, plan: Plan) -> Float[np.ndarray, "N E"]:
    """Returns the embeddings of a plan's captions."""
    pairs = zip(plan.samples, plan.captions, strict=True)
    captions = [subject.samples.clips[owner].captions[caption] for owner, caption in pairs]
    return embed_captions(subject.evaluator, [caption_tokens(caption) for caption in captions])


def embed_plan_motions(subject: Subject, plan: Plan) -> Float[np.ndarray, "N E"]:
    """Returns the embeddings of a plan's real motions."""
    samples = [subject.samples.clips[owner] for owner in plan.samples]
    return embed_real(subject.evaluator, samples, plan.starts, plan.lengths, max_frames=subject.max_frames)


def _varied(plan: Plan, embeddings: Float[np.ndarray, "G E"], made: Made) -> Float[np.ndarray, "M S E"] | None:
    """Returns the samples of each caption whose variety is measured, at their numbers; zeros where none was made."""
    if len(made.items) == len(plan.samples) or not len(plan.varied):
        return None
    place = np.full(len(plan.samples), -1)
    place[plan.varied] = np.arange(len(plan.varied))
    chosen = place[made.items] >= 0
    varied = np.zeros((len(plan.varied), SAMPLES_A_CAPTION, embeddings.shape[1]), np.float32)
    varied[place[made.items[chosen]], made.numbers[chosen]] = embeddings[chosen]
    return varied


def _figures(
    text: Float[np.ndarray, "N E"],
    motion: Float[np.ndarray, "N E"],
    plan: Plan,
    labels: Int[np.ndarray, " N"] | None,
) -> Figures:
    """Returns the metrics of one set of motions but its distance to another and the variety within captions."""
    filled, counted = _whole_batches(len(text))
    texts, motions = jnp.asarray(text[filled]), jnp.asarray(motion[filled])
    figures = _ranked("r_precision_{}", r_precision(texts, motions, counted=counted))
    mirrored = r_precision(texts, motions, direction="texts_per_motion", counted=counted)
    figures |= _ranked("r_precision_{}_texts_per_motion", mirrored)
    if labels is not None:
        by_label = r_precision(texts, motions, labels=jnp.asarray(labels[filled]), counted=counted)
        figures |= _ranked("r_precision_{}_by_label", by_label)
    figures["matching_score"] = float(matching_score(jnp.asarray(text), jnp.asarray(motion)))
    figures["diversity"] = float(diversity(jnp.asarray(motion), jnp.asarray(plan.diversity_pairs)))
    return figures


def _label_bounds(labels: Int[np.ndarray, " N"]) -> Figures:
    """Returns what R-precision near-identical captions leave to an evaluator that tells labels apart and no more."""
    filled, counted = _whole_batches(len(labels))
    return _ranked("r_precision_{}_bound_by_label", label_bound(jnp.asarray(labels[filled]), counted=counted))


def _ranked(name: str, precision: Float[Array, " K"]) -> Figures:
    return {name.format(k): float(value) for k, value in enumerate(precision, start=1)}


def _whole_batches(count: int) -> tuple[Int[np.ndarray, " M"], Bool[Array, " M"]]:
    """Returns rows in whole batches, filled up from the front, and which of them count."""
    size = -(-count // BATCH) * BATCH
    return np.resize(np.arange(count), size), jnp.arange(size) < count


def evaluate(
    subject: Subject, maker: Maker, *, num_repeats: int, header: Mapping[str, Any], partial: Path | None = None
) -> dict[str, Any]:
    """Returns the report: header, and for each row and metric mean, interval and the value of every repeat.

    Args:
        subject: What is looked at, how.
        maker: Makes the motions that stand beside the real ones.
        num_repeats: How often; the interval is over them.
        header: What the figures depend on. It stands in the report, and a partial result with another one is not used.
        partial: File that keeps the repeats done so far, so that an interrupted evaluation goes on where it was.
    """
    repeats = load_partial(partial, header)[:num_repeats]
    start, done_before = time.monotonic(), len(repeats)
    for repeat in range(done_before, num_repeats):
        repeats.append(evaluate_repeat(subject, maker, repeat=repeat))
        if partial is not None:
            save_json(partial, {"header": header, "repeats": repeats})
        seconds = (time.monotonic() - start) / (repeat + 1 - done_before)
        left = seconds * (num_repeats - repeat - 1)
        logger.info("repeat %d of %d, %.0f s each, %.0f s left", repeat + 1, num_repeats, seconds, left)
    return {**header, "rows": summarize(repeats)}


def load_partial(path: Path | None, header: Mapping[str, Any]) -> list[Rows]:
    """Returns the repeats that an interrupted evaluation of the same kind has left, none where there was none."""
    if path is None or not path.exists():
        return []
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        return list(found["repeats"]) if found["header"] == header else []
    except (ValueError, KeyError, TypeError):
        logger.warning("%s: damaged; the evaluation starts over", path)
        return []


def summarize(repeats: Sequence[Rows]) -> dict[str, dict[str, dict[str, Any]]]:
    """Returns mean, half-width of the 95 % interval (1.96 times the deviation over the root of n) and all values."""
    rows: dict[str, dict[str, dict[str, Any]]] = {}
    for row, figures in repeats[0].items():
        rows[row] = {}
        for metric in figures:
            values = np.array([repeat[row][metric] for repeat in repeats])
            interval = 1.96 * values.std() / np.sqrt(len(values))
            rows[row][metric] = {"mean": float(values.mean()), "interval": float(interval), "repeats": values.tolist()}
    return rows
