"""Evaluation of models that are still in training: one repeat on the validation split, the same one each time."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from t2m_jax.checkpoints.bundle import Bundle
from t2m_jax.checkpoints.evaluator import load_evaluator_bundle
from t2m_jax.data.folder import Dataset
from t2m_jax.evaluation.protocols import find_protocol, make_plan
from t2m_jax.evaluation.run import Figures, evaluate_repeat
from t2m_jax.evaluation.sources import Maker
from t2m_jax.evaluation.task import Subject, make_subject
from t2m_jax.sampling.pipeline import TextToMotion
from t2m_jax.sampling.text_encoders import make_text_encoder

SPLIT = "val"
"""Nothing is chosen on test."""
PROTOCOL = dataclasses.replace(find_protocol("t2m-gpt"), multimodality_captions=0)
"""As the original evaluates while it trains: one motion a caption, so variety is not measured."""
REPEAT = 0


def open_held_out(dataset: Dataset, evaluator: Path, *, seed: int) -> Subject:
    """Returns the validation split as an evaluator in a folder will look at it.

    Raises:
        UserError: if there is no evaluator, or it was trained on other motion, or the split does not fill a batch.
    """
    subject = make_subject(dataset, load_evaluator_bundle(evaluator), PROTOCOL, split=SPLIT, seed=seed)
    make_plan(subject.samples.clips, PROTOCOL, seed=seed, repeat=REPEAT)
    return subject


def held_out_figures(subject: Subject, maker: Maker) -> Figures:
    """Returns the metrics of what `maker` makes of the validation split."""
    return evaluate_repeat(subject, maker, repeat=REPEAT)[maker.row]


class ModelInTraining(TextToMotion):
    """A model whose weights move on; what else it is made of is read once."""

    def __init__(self, bundle: Bundle):
        """Takes the weights of the beginning."""
        super().__init__(bundle)
        self._bundle = bundle

    def take(self, variables: Mapping[str, Any]) -> None:
        """Puts the weights of now in the place of those of before."""
        self._variables = {**self._variables, **variables}
        if self._bundle.tokenizer is not None:
            self.text_encoder = make_text_encoder(self._bundle._replace(variables=self._variables))
