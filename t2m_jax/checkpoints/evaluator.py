"""A trained evaluator in a folder: sizes, weights, statistics and words. A run of its training is such a folder."""

import dataclasses
import importlib.resources
from pathlib import Path
from typing import Any, NamedTuple

import jax

from t2m_jax.checkpoints.best import restore_trained
from t2m_jax.checkpoints.bundle import check_statistics_width
from t2m_jax.checkpoints.run import is_run
from t2m_jax.config import load_versioned, save_config
from t2m_jax.errors import UserError
from t2m_jax.files.arrays import fingerprint, load_arrays, save_arrays
from t2m_jax.files.manifest import check_folder, has_manifest, write_manifest
from t2m_jax.files.writing import atomic_folder
from t2m_jax.models.evaluator import EvaluatorConfig, evaluator_shapes
from t2m_jax.motion.normalizer import Normalizer, load_normalizer, save_normalizer
from t2m_jax.text.word_vectors import Vocabulary, load_vocabulary, save_vocabulary

EVALUATOR_CONFIG = "evaluator.yaml"
WEIGHTS_FILE = "weights.safetensors"
WORDS_FILE = "words.txt"
PACKAGED = ("benchmark-free", "benchmark-nc")
"""Names of the evaluators that are part of the package: those of the benchmark's tracks."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class EvaluatorFolderConfig:
    """The file that makes a folder an evaluator."""

    format_version: int = 2
    """Layout of the folder. It has a manifest."""
    model: EvaluatorConfig = EvaluatorConfig()
    """Sizes."""


class TrainedEvaluator(NamedTuple):
    """An evaluator and everything that its figures depend on."""

    config: EvaluatorConfig
    variables: dict[str, Any]
    normalizer: Normalizer
    """Statistics of the motion that it reads. They are not those of a generator."""
    vocabulary: Vocabulary
    fingerprint: str
    """Identifies the evaluator: figures of two fingerprints cannot be compared."""


def make_trained_evaluator(
    config: EvaluatorConfig, variables: dict[str, Any], normalizer: Normalizer, vocabulary: Vocabulary
) -> TrainedEvaluator:
    """Returns an evaluator with its fingerprint: a digest of sizes, weights, statistics and words."""
    words = "\n".join(vocabulary.words)
    # Everything that a figure depends on. Words count, because their order decides which vector each gets.
    digest = fingerprint(f"{config!r}{words}", jax.device_get(variables), normalizer._asdict())
    return TrainedEvaluator(config, variables, normalizer, vocabulary, digest)


def save_evaluator(path: str | Path, trained: TrainedEvaluator) -> None:
    """Writes an evaluator into a new folder.

    Raises:
        UserError: The folder exists already.
    """
    with atomic_folder(Path(path)) as folder:
        save_evaluator_parts(folder, trained.config, trained.normalizer, trained.vocabulary)
        save_arrays(folder / WEIGHTS_FILE, trained.variables)
        write_manifest(folder)


def save_evaluator_parts(folder: Path, config: EvaluatorConfig, normalizer: Normalizer, vocabulary: Vocabulary) -> None:
    """Writes everything of an evaluator except its weights."""
    save_normalizer(folder, normalizer)
    save_vocabulary(folder / WORDS_FILE, vocabulary)
    save_config(folder / EVALUATOR_CONFIG, EvaluatorFolderConfig(model=config))


def evaluator_path(name_or_path: str | Path) -> Path:
    """Returns the folder of a packaged evaluator, or the path itself."""
    if str(name_or_path) in PACKAGED:
        return Path(str(importlib.resources.files("t2m_jax") / "evaluators" / str(name_or_path)))
    return Path(name_or_path)


def load_trained_evaluator(folder: str | Path) -> TrainedEvaluator:
    """Returns a packaged evaluator, the one of a folder, or that of a run with its best weights so far.

    Raises:
        UserError: There is none, a file is damaged, or the parts do not fit each other.
    """
    folder = evaluator_path(folder)
    path = folder / EVALUATOR_CONFIG
    if not path.is_file():
        raise UserError(f"{folder}: not an evaluator (it has no {path.name}); train one with `t2m train evaluator`")
    if not has_manifest(folder):
        # Says so if it is of an older version, which had no manifest.
        load_versioned(path, EvaluatorFolderConfig, version=2)
    check_folder(folder)
    config = load_versioned(path, EvaluatorFolderConfig, version=2).model
    normalizer = load_normalizer(folder)
    vocabulary = load_vocabulary(folder / WORDS_FILE)
    if len(vocabulary) != config.num_words:
        raise UserError(f"{folder / WORDS_FILE}: has {len(vocabulary)} words, but {path.name} says {config.num_words}")
    check_statistics_width(folder, normalizer, config.feature_dim)
    shapes = evaluator_shapes(config)
    variables = restore_trained(folder, shapes) if is_run(folder) else load_arrays(folder / WEIGHTS_FILE, shapes)
    return make_trained_evaluator(config, jax.device_get(variables), normalizer, vocabulary)
