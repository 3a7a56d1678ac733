"""The benchmark: frozen data in two tracks, an evaluator for each, one protocol, and groups of prompts.

`configs/benchmark` has the frozen lists and captions, and docs/benchmark.md describes how data and evaluators are made.
"""

import hashlib
import warnings
from collections.abc import Callable, Sequence
from typing import NamedTuple

from t2m_jax.data.files import SPLITS
from t2m_jax.data.folder import Dataset
from t2m_jax.errors import UserError
from t2m_jax.evaluation.prompts.catalog import prompt_tests
from t2m_jax.evaluation.prompts.following import PromptTest, evaluate_prompt_following
from t2m_jax.evaluation.report.record import Following
from t2m_jax.motion.motion import Motion
from t2m_jax.sampling.pipeline import TextToMotion
from t2m_jax.sampling.request import MotionRequest, SamplingOptions
from t2m_jax.text.coverage import PromptWarning

PROTOCOL = "benchmark"
UNIT = 8
"""Lengths of motions are multiples of so many frames, whatever the tokenizer, so that reports of both systems can be
compared."""
GROUPS = ("free", "subjects", "typos", "while", "counts", "durations")
"""Groups of held-out sentences that need no data set."""


class BenchmarkTrack(NamedTuple):
    """A part of the benchmark with its own table."""

    data: str
    """Folder that `configs/benchmark/data.sh` makes by default."""
    evaluator: str
    """Name of the packaged evaluator."""
    lists: str
    """What identifies its lists and captions (see `lists_digest`)."""


TRACKS = {
    "free": BenchmarkTrack("data/benchmark-free", "benchmark-free", "e9873c7174fc22e8"),
    "nc": BenchmarkTrack("data/benchmark-nc", "benchmark-nc", "5bb170e54a5afe9d"),
}
"""`free` has only motion that may be used for everything, `nc` also motion for non-commercial use."""


def lists_digest(dataset: Dataset) -> str:
    """Returns 16 digits that identify the clips of each split and all captions of a data set, but not its motion.

    Features of two machines may differ in their last digits. What each motion is made from, the tables say.

    Raises:
        UserError: A file is missing or cannot be read.
    """
    digest = hashlib.sha256()
    for split in SPLITS:
        for name in sorted(dataset.names(split)):
            texts = [caption.text for caption in dataset.captions(name)]
            digest.update("\n".join([split, name, *texts, ""]).encode())
    return digest.hexdigest()[:16]


def check_track(dataset: Dataset, track: str) -> None:
    """Raises `UserError` if a data set is not that of a track."""
    found = lists_digest(dataset)
    if found != TRACKS[track].lists:
        raise UserError(
            f"{dataset.folder}: its lists and captions ({found}) are not the frozen ones of track {track} "
            f"({TRACKS[track].lists}); make the folder anew with configs/benchmark/data.sh"
        )


def measure_following(model: TextToMotion, options: SamplingOptions) -> dict[str, Following]:
    """Returns how often a model does what held-out sentences ask, by group; each sentence is asked once."""

    def generate(sentence: str, seed: int) -> Motion:
        return next(model.make(MotionRequest(captions=(sentence,), seed=seed, options=options)))

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PromptWarning)  # whether the model can do what is asked is measured here
        return {group: _count_right(prompt_tests(group, None), generate) for group in GROUPS}


def _count_right(tests: Sequence[PromptTest], generate: Callable[[str, int], Motion]) -> Following:
    found = [
        result
        for test in tests
        for result in evaluate_prompt_following([test], generate, num_seeds=len(test.sentences))
    ]
    return Following(right=sum(one.right for one in found), samples=sum(one.samples for one in found))
