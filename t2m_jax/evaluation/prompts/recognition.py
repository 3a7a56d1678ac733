"""Which action or manner a motion shows, as classifiers of real clips see it.

They judge what nobody wrote a rule for. A classifier is trained on training clips, and its own accuracy on clips of the
test split, of other takes and people, says how far it can be trusted.
"""

import functools
from collections import Counter
from collections.abc import Iterator, Sequence
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
LEAST_CLIPS = 8
"""Training clips, mirrored twins included, of an action that the classifier learns."""
NUM_STEPS = 400
"""Of the classifier's training with AdamW on all clips at once."""
LEARNING_RATE = 0.01
WEIGHT_DECAY = 0.01

Labeled = list[tuple[str, Float[np.ndarray, "_ D"]]]
"""Clips: class and raw features."""


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

    def sees(self, name: str, motion: Motion) -> bool:
        """Returns whether a motion, which may have one frame, is of a class.

        Raises:
            UserError: The motion has another skeleton than HumanML3D's.
        """
        check_skeleton(motion.skeleton)
        if motion.num_frames < 2:
            return False
        return self.recognize(features_from_positions(motion.positions, HUMANML3D)) == name

    def accuracy(self, clips: Labeled) -> dict[str, float]:
        """Returns the share of the clips of each class that are recognized; classes without a clip are missing."""
        right: dict[str, list[bool]] = {}
        for name, features in clips:
            if name in self.classes:
                right.setdefault(name, []).append(self.recognize(features) == name)
        return {name: float(np.mean(found)) for name, found in right.items()}


def train_classifier(clips: Labeled, *, classes: Sequence[str]) -> Classifier:
    """Returns a classifier of raw features (softmax regression)."""
    statistics = np.stack([_statistics(features) for _, features in clips])
    mean = statistics.mean(axis=0)
    std = statistics.std(axis=0) + 1e-6  # a feature that never changes
    inputs = jnp.asarray((statistics - mean) / std)
    numbers = jnp.array([classes.index(name) for name, _ in clips])
    weights, bias = fit_softmax(inputs, numbers, num_classes=len(classes))
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


def _statistics(features: Float[np.ndarray, "T D"]) -> Float[np.ndarray, " S"]:
    """Returns mean and standard deviation of each feature over time."""
    # Clips of any length have as many of these, and they do not depend on when something happens.
    return np.concatenate([features.mean(axis=0), features.std(axis=0)]).astype(np.float32)


def labeled_clips(dataset: Dataset, split: str) -> Iterator[tuple[str, str, Float[np.ndarray, "_ D"]]]:
    """Yields content, style (often empty) and raw features of the labeled clips of a split."""
    index = load_index(dataset.folder)
    for clip in dataset.clips(split, min_frames=2):
        content, _, style = ((index.label(clip.name) if index else None) or "").partition(",")
        if content:
            yield content, style.strip(), clip.features


def action_clips(dataset: Dataset, split: str) -> Labeled:
    """Returns the clips of a split that show one labeled action, with the action."""
    # Labels of composed clips, such as "jump x 3", have spaces.
    return [(content, features) for content, _, features in labeled_clips(dataset, split) if " " not in content]


def train_judge(dataset: Dataset) -> tuple[Classifier, dict[str, float]]:
    """Returns a classifier of the actions that have at least `LEAST_CLIPS` training clips, and its accuracy by action.

    Raises:
        UserError: The data set has another skeleton than HumanML3D's, or no action has so many clips.
    """
    check_skeleton(dataset.skeleton, owner="data set")
    train = action_clips(dataset, "train")
    counts = Counter(action for action, _ in train)
    actions = sorted(action for action, count in counts.items() if count >= LEAST_CLIPS and action != "other")
    if not actions:
        raise UserError(f"{dataset.folder}: no action has {LEAST_CLIPS} labeled training clips, to learn it from")
    classifier = train_classifier([clip for clip in train if clip[0] in actions], classes=actions)
    return classifier, classifier.accuracy(action_clips(dataset, "test"))


def _manner_clips(dataset: Dataset, split: str) -> Labeled:
    """Returns the clips of a split that show a manner, with the manner."""
    # Labels of composed clips have another form, and the data have styles that nobody is asked for here.
    found = [
        (style, features)
        for content, style, features in labeled_clips(dataset, split)
        if content in RULES and style in MANNERS
    ]
    for manner in MANNERS:
        if manner not in {style for style, _ in found}:
            raise UserError(f"{dataset.folder}: no clip of the split {split} has a label in the style {manner!r}")
    return found


def manner_judge(dataset: Dataset) -> tuple[Classifier, str]:
    """Returns a classifier of manners, and a rule in words, which says how far it can be trusted.

    Raises:
        UserError: The data set has another skeleton than HumanML3D's, or does not show all manners.
    """
    check_skeleton(dataset.skeleton, owner="data set")
    # Trained on one split and judged on another: the rule tells how far the classifier can be trusted.
    classifier = train_classifier(_manner_clips(dataset, "train"), classes=MANNERS)
    right = [classifier.recognize(features) == manner for manner, features in _manner_clips(dataset, "test")]
    return classifier, f"a classifier recognizes it; of real test clips, it recognizes {np.mean(right):.0%}"


def manner_tests(dataset: Dataset) -> list[PromptTest]:
    """Returns a test for each manner; its rule says how well the classifier recognizes real clips of the test split.

    Raises:
        UserError: As for `manner_judge`.
    """
    classifier, rule = manner_judge(dataset)
    return [
        PromptTest(manner, rule, _manner_sentences(manner), functools.partial(classifier.sees, manner))
        for manner in MANNERS[1:]
    ]


def _manner_sentences(manner: str) -> tuple[str, ...]:
    """Returns held-out sentences with the manner at the end."""
    phrases = read_words(__package__, "manner_phrases")[manner]
    sentences = held_out_sentences()
    return tuple(
        # The phrases go on from turn to turn, so that all of them are asked for.
        f"{sentences[content][turn]} {phrases[(turn * len(CONTENTS) + place) % len(phrases)]}"
        for turn in range(10)
        for place, content in enumerate(CONTENTS)
    )
