"""Whether generated motion has the manner that a sentence asked for, as a classifier of real clips sees it."""

import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float, Int

from t2m_jax.data.captioning.lexicon import read_words
from t2m_jax.data.folder import Dataset
from t2m_jax.data.index import load_index
from t2m_jax.errors import UserError
from t2m_jax.evaluation.prompts.following import RULES, PromptTest, check_skeleton
from t2m_jax.evaluation.prompts.sentences import held_out_sentences
from t2m_jax.motion.features import features_from_positions
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.skeleton import HUMANML3D

MANNERS = ("normal", "active", "elderly", "exhausted", "feminine", "masculine", "youthful")
"""Styles of dataset-2. `normal` is recognized, but not asked for."""
CONTENTS = ("walk", "run", "walk-turn-left", "wave-right-hand", "wave-both-hands", "raise-up-left-hand")
"""Contents that are asked for in each manner, one after the other."""
NUM_STEPS = 400
"""Of the classifier's training with AdamW on all clips at once."""
LEARNING_RATE = 0.01
WEIGHT_DECAY = 0.01


class Classifier(NamedTuple):
    """A linear classifier of the statistics of a clip."""

    classes: tuple[str, ...]
    mean: Float[np.ndarray, " S"]
    std: Float[np.ndarray, " S"]
    weights: Float[np.ndarray, "S K"]
    bias: Float[np.ndarray, " K"]

    def recognize(self, features: Float[np.ndarray, "T D"]) -> str:
        """Returns the class of raw features."""
        scores = (_statistics(features) - self.mean) / self.std @ self.weights + self.bias
        return self.classes[int(scores.argmax())]


def manner_tests(dataset: Dataset) -> list[PromptTest]:
    """Returns a test for each manner; its rule says how well the classifier recognizes real clips of the test split.

    Raises:
        UserError: As for `manner_judge`.
    """
    holds, rule = manner_judge(dataset)
    return [PromptTest(manner, rule, _sentences(manner), functools.partial(holds, manner)) for manner in MANNERS[1:]]


def manner_judge(dataset: Dataset) -> tuple[Callable[[str, Motion], bool], str]:
    """Returns a function that tells whether a motion has a manner, and how far it can be trusted.

    Raises:
        UserError: The data set has another skeleton than HumanML3D's, or does not show all manners.
    """
    check_skeleton(dataset.skeleton, owner="data set")
    # Trained on one split and judged on another: the rule tells how far the classifier can be trusted.
    classifier = train_classifier(*_labeled_clips(dataset, "train"), classes=MANNERS)
    clips, manners = _labeled_clips(dataset, "test")
    right = [classifier.recognize(clip) == MANNERS[manner] for clip, manner in zip(clips, manners, strict=True)]
    rule = f"a classifier recognizes it; of real test clips, it recognizes {np.mean(right):.0%}"
    return functools.partial(_has_manner, classifier), rule


def train_classifier(
    clips: list[Float[np.ndarray, "_ D"]], numbers: Int[np.ndarray, " N"], *, classes: Sequence[str]
) -> Classifier:
    """Returns a classifier of raw features by the numbers of their classes (softmax regression)."""
    statistics = np.stack([_statistics(clip) for clip in clips])
    mean = statistics.mean(axis=0)
    std = statistics.std(axis=0) + 1e-6  # a feature that never changes
    inputs = jnp.asarray((statistics - mean) / std)
    weights, bias = fit_softmax(inputs, jnp.asarray(numbers), num_classes=len(classes))
    return Classifier(tuple(classes), mean, std, np.asarray(weights), np.asarray(bias))


@functools.partial(jax.jit, static_argnames=("num_classes", "num_steps"))
def fit_softmax(
    inputs: Float[Array, "N S"], classes: Int[Array, " N"], *, num_classes: int, num_steps: int = NUM_STEPS
) -> tuple[Float[Array, "S K"], Float[Array, " K"]]:
    """Returns weights and bias of a softmax regression on classes, with decayed weights."""
    optimizer = optax.adamw(LEARNING_RATE, weight_decay=WEIGHT_DECAY)
    # The loss is convex, so no start is better than another.
    start = jnp.zeros((inputs.shape[1], num_classes)), jnp.zeros(num_classes)

    def loss(parameters: tuple[Array, Array]) -> Float[Array, ""]:
        logits = inputs @ parameters[0] + parameters[1][None]
        return optax.softmax_cross_entropy_with_integer_labels(logits, classes).mean()

    def step(state: tuple[Any, Any], _: None) -> tuple[tuple[Any, Any], None]:
        parameters, moments = state
        updates, moments = optimizer.update(jax.grad(loss)(parameters), moments, parameters)
        return (optax.apply_updates(parameters, updates), moments), None

    (parameters, _), _ = jax.lax.scan(step, (start, optimizer.init(start)), length=num_steps)
    return parameters


def _labeled_clips(dataset: Dataset, split: str) -> tuple[list[Float[np.ndarray, "_ D"]], Int[np.ndarray, " N"]]:
    """Returns raw features and the numbers of their manners."""
    index = load_index(dataset.folder)
    clips = []
    manners = []
    for clip in dataset.clips(split, min_frames=2):
        content, _, style = ((index.label(clip.name) if index else None) or "").partition(", ")
        # Labels of composed clips have another form, and the data have styles that nobody is asked for here.
        if content in RULES and style in MANNERS:
            clips.append(clip.features)
            manners.append(MANNERS.index(style))
    for number, manner in enumerate(MANNERS):
        if number not in manners:
            raise UserError(f"{dataset.folder}: no clip of the split {split} has a label in the style {manner!r}")
    return clips, np.array(manners)


def _statistics(features: Float[np.ndarray, "T D"]) -> Float[np.ndarray, " S"]:
    """Returns mean and standard deviation of each feature over time."""
    # Clips of any length have as many of these, and they do not depend on when something happens.
    return np.concatenate([features.mean(axis=0), features.std(axis=0)]).astype(np.float32)


def _sentences(manner: str) -> tuple[str, ...]:
    """Returns held-out sentences with the manner at the end."""
    phrases = read_words(__package__, "manner_phrases")[manner]
    sentences = held_out_sentences()
    return tuple(
        # The phrases go on from turn to turn, so that all of them are asked for.
        f"{sentences[content][turn]} {phrases[(turn * len(CONTENTS) + place) % len(phrases)]}"
        for turn in range(10)
        for place, content in enumerate(CONTENTS)
    )


def _has_manner(classifier: Classifier, manner: str, motion: Motion) -> bool:
    """Returns whether the classifier recognizes a manner in a motion, which may have one frame."""
    check_skeleton(motion.skeleton)
    if motion.num_frames < 2:
        return False
    return classifier.recognize(features_from_positions(motion.positions, HUMANML3D)) == manner
