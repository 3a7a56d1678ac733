"""Measures a model on the benchmark as `t2m benchmark` does, but keeps the best of several samples.

    python docs/measure/candidates.py runs/claims/hifigpt-rows-0 --track nc --number 4 --json report.json

The best sample is the one whose motion tells its sentence best: with the largest log p(motion | sentence) -
log p(motion), both by the model itself, which learned the latter for guidance. By Bayes' rule, this sample makes the
sentence likeliest.
"""

import argparse
import dataclasses
import math
from collections.abc import Iterator, Sequence
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key

from t2m_jax.checkpoints.evaluator import load_trained_evaluator
from t2m_jax.checkpoints.model import load_model
from t2m_jax.data import open_dataset
from t2m_jax.data.folder import Clip
from t2m_jax.evaluation.benchmark import PROTOCOL, TRACKS, UNIT, check_track, measure_following
from t2m_jax.evaluation.protocols import Plan, Protocol, find_protocol
from t2m_jax.evaluation.report.record import save_report
from t2m_jax.evaluation.run import evaluate
from t2m_jax.evaluation.sources import Generation, MotionCodes, SourceCodes, make_generation
from t2m_jax.evaluation.task import make_task
from t2m_jax.motion.motion import Motion
from t2m_jax.sampling import TextToMotion
from t2m_jax.sampling.decode import Codes, pad_codes
from t2m_jax.sampling.generation import OnProgress
from t2m_jax.sampling.request import MotionRequest, SamplingOptions

BATCH = 128
"""Motions that are read together."""


def fit(
    model: TextToMotion, motions: Sequence[Codes], text_embedding: Float[np.ndarray, "B E"]
) -> Float[np.ndarray, " B"]:
    """Returns how well each motion fits its text: the logarithm of p(motion | text) / p(motion)."""
    found = []
    for first in range(0, len(motions), BATCH):
        codes, lengths = pad_codes(motions[first : first + BATCH], size=model.config.generator.max_codes)
        rows, text = jnp.asarray(codes), jnp.asarray(text_embedding[first : first + BATCH])
        # Zeros are what training gave in place of some texts, for guidance.
        gain = model.parts.log_likelihood(rows, text) - model.parts.log_likelihood(rows, jnp.zeros_like(text))
        is_row = np.arange(codes.shape[1]) < lengths[:, None]
        found.append(np.where(is_row, gain, 0).sum(axis=1))
    return np.concatenate(found)


@dataclasses.dataclass(frozen=True)
class BestOfSeveral(Generation):
    """Motion that a model generates, of which the best sample is kept."""

    number: int
    """Samples of each motion."""

    def make(self, samples: Sequence[Clip], protocol: Protocol, plan: Plan, key: Key[Array, ""]) -> SourceCodes:
        """Returns as many motions as `Generation.make`; the first samples are the same."""
        keys = [key, *(jax.random.fold_in(key, number) for number in range(1, self.number))]
        tries = [super(BestOfSeveral, self).make(samples, protocol, plan, one) for one in keys]
        text = np.stack([self.texts[caption.text] for caption in plan.chosen_captions(samples)])[tries[0].items]
        best = np.argmax([fit(self.model, found.codes.rows, text) for found in tries], axis=0)
        codes = np.stack([found.codes.codes for found in tries])
        lengths = np.stack([found.codes.code_lengths for found in tries])
        motions = np.arange(len(best))
        return tries[0]._replace(codes=MotionCodes(codes[best, motions], lengths[best, motions]))


class ChoosingModel(TextToMotion):
    """A model that makes several samples of a sentence and keeps the best."""

    number: int = 1

    def make(self, *requests: MotionRequest, on_progress: OnProgress | None = None) -> Iterator[Motion]:
        """Yields the best sample of each request. Sentences in turn, which are too long to be read, have one."""
        for request in requests:
            several = dataclasses.replace(request, num_samples=self.number)
            motions = list(super().make(several, on_progress=on_progress))
            codes = [np.asarray(motion.codes) for motion in motions]
            if max(map(len, codes)) > self.config.generator.max_codes:
                yield motions[0]
                continue
            text = np.repeat(np.asarray(self.text_encoder(request.captions[:1])), len(codes), axis=0)
            yield motions[int(np.argmax(fit(self, codes, text)))]


def main() -> None:
    """Writes the report."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("model")
    parser.add_argument("--track", choices=list(TRACKS), default="free")
    parser.add_argument("--number", type=int, default=4, help="samples to choose from")
    parser.add_argument("--num-repeats", type=int, default=5)
    parser.add_argument("--json", type=Path, required=True)
    given = parser.parse_args()

    track = TRACKS[given.track]
    dataset = open_dataset(track.data)
    check_track(dataset, given.track)
    model = ChoosingModel(load_model(given.model))
    unit = math.lcm(UNIT, model.config.tokenizer.downsample)
    evaluator = load_trained_evaluator(track.evaluator)
    task = make_task(dataset, evaluator, find_protocol(PROTOCOL), split="test", seed=0, unit=unit)
    plain = make_generation(model, task.samples.clips)
    source = BestOfSeveral(plain.model, plain.options, plain.texts, given.number)
    report = evaluate(task, source, num_repeats=given.num_repeats, model=given.model)
    model.number = given.number
    save_report(given.json, dataclasses.replace(report, following=measure_following(model, SamplingOptions())))


if __name__ == "__main__":
    main()
