"""What is intact in the folder of a model: of a run, a bundle, or an evaluator."""

import functools
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

from t2m_jax.checkpoints.best import BEST_FOLDER, find_best
from t2m_jax.checkpoints.bundle import CONFIG_FILE, load_bundle
from t2m_jax.checkpoints.evaluator import EVALUATOR_CONFIG, load_trained_evaluator
from t2m_jax.checkpoints.model import load_generator_run
from t2m_jax.checkpoints.run import Checkpoints, is_run, run_config_text, run_info
from t2m_jax.checkpoints.tokenizer import load_tokenizer
from t2m_jax.errors import UserError
from t2m_jax.files.manifest import check_folder


class AuditedPart(NamedTuple):
    """A part of a model's folder."""

    name: str
    problem: str
    """What is wrong; "" if nothing is."""


def is_model_folder(path: Path) -> bool:
    """Returns whether a folder says that it is a run, a bundle or an evaluator."""
    return is_run(path) or any((path / name).is_file() for name in (CONFIG_FILE, EVALUATOR_CONFIG))


def audit_model(path: Path) -> list[AuditedPart]:
    """Returns the parts of a run, a bundle or an evaluator. SHA-256 of all files with a manifest are compared.

    Raises:
        UserError: The folder is none of these.
    """
    if is_run(path):
        return list(_audit_run(path))
    if (path / CONFIG_FILE).is_file():
        return [_audit_folder(path, "bundle"), AuditedPart("model", _problem(load_bundle, path))]
    if (path / EVALUATOR_CONFIG).is_file():
        return [_audit_folder(path, "evaluator"), AuditedPart("weights", _problem(load_trained_evaluator, path))]
    raise UserError(f"{path}: neither a run, a bundle nor an evaluator")


def _audit_run(path: Path) -> Iterator[AuditedPart]:
    """Yields what a run has: its checkpoints, the best weights, the copy of its tokenizer, and the model they make."""
    problem = _problem(run_info, path)
    yield AuditedPart("run.yaml", problem)
    if problem:
        return  # it says how the rest is to be read
    yield AuditedPart("config.yaml", _problem(run_config_text, path))
    yield _audit_folder(path, "statistics, sizes and words")
    with Checkpoints(path) as checkpoints:
        for step in checkpoints.steps():
            yield AuditedPart(f"checkpoint {step}", checkpoints.damage(step, thorough=True))
    # After a kill there may be older ones, too. All are checked, because the newest may be the damaged one.
    for folder in sorted((path / BEST_FOLDER).glob("[0-9]*")):
        if folder.is_dir():
            yield _audit_folder(folder, f"best weights of step {folder.name}")
    yield AuditedPart("choice of the best weights", _problem(find_best, path))
    if (path / CONFIG_FILE).is_file():
        yield from (_audit_folder(found.parent, "tokenizer") for found in sorted(path.glob("*/*.safetensors")))
        yield AuditedPart("model", _problem(load_generator_run, path))
    elif (path / EVALUATOR_CONFIG).is_file():
        yield AuditedPart("model", _problem(load_trained_evaluator, path))
    else:
        yield AuditedPart("model", _problem(load_tokenizer, path))


def _audit_folder(folder: Path, name: str) -> AuditedPart:
    return AuditedPart(name, _problem(functools.partial(check_folder, thorough=True), folder))


def _problem(check: Callable[[Path], Any], path: Path) -> str:
    """Returns the error of a check, "" if there is none."""
    try:
        check(path)
    except UserError as error:
        return str(error)
    return ""
