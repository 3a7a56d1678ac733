"""A trained evaluator in a folder: sizes, weights, statistics, words. A run of its training is such a folder."""

import dataclasses
import hashlib
import os
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from flax import traverse_util

from t2m_jax.config import load_config, save_config
from t2m_jax.errors import UserError
from t2m_jax.files import load_arrays, save_arrays
from t2m_jax.models.evaluator import EvaluatorConfig, evaluator_shapes
from t2m_jax.motion.normalizer import Normalizer, load_normalizer, save_normalizer
from t2m_jax.text.word_vectors import Vocabulary, load_vocabulary, save_vocabulary

EVALUATOR_CONFIG, WEIGHTS_FILE, WORDS_FILE = "evaluator.yaml", "weights.safetensors", "words.txt"


@dataclasses.dataclass(frozen=True, kw_only=True)
class EvaluatorBundleConfig:
    """What an evaluator's folder says of itself."""

    format_version: int = 1
    """Layout of the folder."""
    model: EvaluatorConfig = EvaluatorConfig()
    """Sizes."""


class TrainedEvaluator(NamedTuple):
    """An evaluator and all that its numbers depend on."""

    config: EvaluatorConfig
    variables: dict[str, Any]
    normalizer: Normalizer
    """Statistics of the motion it reads; not those of a generator."""
    vocabulary: Vocabulary
    fingerprint: str
    """Tells one evaluator from another: results of two fingerprints cannot be compared."""


def make_trained_evaluator(
    config: EvaluatorConfig, variables: dict[str, Any], normalizer: Normalizer, vocabulary: Vocabulary
) -> TrainedEvaluator:
    """Returns an evaluator with its fingerprint: a digest of sizes, weights, statistics and words."""
    digest = hashlib.sha256(repr(config).encode())
    digest.update("\n".join(vocabulary.words).encode())
    flat = traverse_util.flatten_dict(jax.device_get(variables), sep="/")
    for name, array in (*sorted(flat.items()), *normalizer._asdict().items()):
        digest.update(name.encode() + np.ascontiguousarray(array, np.float32).tobytes())
    return TrainedEvaluator(config, variables, normalizer, vocabulary, digest.hexdigest()[:16])


def save_evaluator(folder: Path, trained: TrainedEvaluator) -> None:
    """Writes an evaluator into a new folder.

    Raises:
        UserError: if the folder exists already.
    """
    if folder.exists():
        raise UserError(f"{folder}: exists already; choose another folder or remove it")
    folder.mkdir(parents=True)
    save_evaluator_parts(folder, trained.config, trained.normalizer, trained.vocabulary)
    save_evaluator_weights(folder, trained.variables)


def save_evaluator_parts(folder: Path, config: EvaluatorConfig, normalizer: Normalizer, vocabulary: Vocabulary) -> None:
    """Writes all of an evaluator but its weights."""
    save_normalizer(folder, normalizer)
    save_vocabulary(folder / WORDS_FILE, vocabulary)
    save_config(folder / EVALUATOR_CONFIG, EvaluatorBundleConfig(model=config))


def save_evaluator_weights(folder: Path, variables: dict[str, Any]) -> None:
    """Writes an evaluator's weights over those of before; the file is never half there."""
    partial = folder / f"{WEIGHTS_FILE}.partial"
    save_arrays(partial, variables)
    partial.chmod(0o644)  # safetensors makes them private
    os.replace(partial, folder / WEIGHTS_FILE)


def load_evaluator_bundle(folder: str | Path) -> TrainedEvaluator:
    """Returns the evaluator of a folder or of a run, there the best on the validation split so far.

    Raises:
        UserError: if there is none, a file is damaged, or the parts do not fit each other.
    """
    folder = Path(folder)
    if not (folder / EVALUATOR_CONFIG).is_file():
        raise UserError(f"{folder}: no evaluator (it has no {EVALUATOR_CONFIG}); train one with `t2m train evaluator`")
    bundle = load_config(folder / EVALUATOR_CONFIG, EvaluatorBundleConfig)
    if bundle.format_version != EvaluatorBundleConfig().format_version:
        path = folder / EVALUATOR_CONFIG
        raise UserError(f"{path}: format_version {bundle.format_version} is not known to this version of t2m_jax")
    if not (folder / WEIGHTS_FILE).is_file():
        raise UserError(f"{folder / WEIGHTS_FILE}: missing; the training has not come to its first validation yet")
    config, normalizer = bundle.model, load_normalizer(folder)
    vocabulary = load_vocabulary(folder / WORDS_FILE)
    if len(vocabulary) != config.num_words:
        raise UserError(
            f"{folder / WORDS_FILE}: {len(vocabulary)} words, but {EVALUATOR_CONFIG} says {config.num_words}"
        )
    if normalizer.mean.shape != (config.feature_dim,):
        raise UserError(f"{folder}: statistics of {len(normalizer.mean)} features, {config.feature_dim} wanted")
    variables = load_arrays(folder / WEIGHTS_FILE, evaluator_shapes(config))
    return make_trained_evaluator(config, variables, normalizer, vocabulary)
