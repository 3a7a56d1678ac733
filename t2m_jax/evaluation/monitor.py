"""Evaluation during training: one repeat on the validation split, the same one each time."""

import dataclasses
from pathlib import Path

import jax

from t2m_jax.checkpoints.evaluator import load_trained_evaluator
from t2m_jax.data.folder import Dataset
from t2m_jax.evaluation.protocols import find_protocol
from t2m_jax.evaluation.run import evaluate_repeat
from t2m_jax.evaluation.sources import CodeSource
from t2m_jax.evaluation.task import EvaluationTask, make_task
from t2m_jax.keys import new_key
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.skeleton import skeleton_from_feature_dim
from t2m_jax.sampling.decode import decode_motions

SPLIT = "val"
"""The test split must not choose anything."""
PROTOCOL = dataclasses.replace(find_protocol("t2m-gpt"), multimodality_captions=0)
"""As in the original's training: one motion per caption, so variety is not measured."""
# Always the same pieces and captions, so that a curve over training shows the model and not the draws.
REPEAT = 0


def open_held_out(dataset: Dataset, evaluator: Path, *, seed: int, unit: int) -> EvaluationTask:
    """Returns the task of evaluating the validation split with the evaluator in a folder.

    Raises:
        UserError: There is no evaluator, it was trained on other data, or the split does not fill a batch.
    """
    return make_task(dataset, load_trained_evaluator(evaluator), PROTOCOL, split=SPLIT, seed=seed, unit=unit)


def held_out_metrics(task: EvaluationTask, source: CodeSource) -> dict[str, float]:
    """Returns the metrics of a source's motion for the validation split."""
    return evaluate_repeat(task, source, repeat=REPEAT).measured


def sample_motions(task: EvaluationTask, source: CodeSource, *, count: int) -> list[Motion]:
    """Returns the first motions of a source in the repeat that is measured, with their captions."""
    plan = task.plan(REPEAT)
    # A motion depends on key and item only, so these are the first ones of the whole repeat.
    few = plan._replace(
        samples=plan.samples[:count],
        captions=plan.captions[:count],
        starts=plan.starts[:count],
        lengths=plan.lengths[:count],
    )
    key = jax.random.fold_in(new_key(task.seed), REPEAT)
    found = source.make(task.samples.clips, task.protocol, few, key)
    captions = [caption.text for caption in few.chosen_captions(task.samples.clips)]
    skeleton = skeleton_from_feature_dim(source.tokenizer.config.feature_dim)
    motions = decode_motions(source.tokenizer, found.codes.rows, skeleton=skeleton)
    return [dataclasses.replace(motion, caption=caption) for motion, caption in zip(motions, captions, strict=True)]
