"""Which action a motion shows, as a classifier of real clips sees it.

It judges actions for which nobody wrote a rule. It is trained on training clips, and its own accuracy on clips of the
test split, of other takes and people, says how far it can be trusted.
"""

from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from t2m_jax.data.folder import Dataset
from t2m_jax.data.index import load_index
from t2m_jax.errors import UserError
from t2m_jax.evaluation.prompts.following import check_skeleton
from t2m_jax.evaluation.prompts.manners import Classifier, train_classifier
from t2m_jax.motion.features import features_from_positions
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.skeleton import HUMANML3D

LEAST_CLIPS = 8
"""Training clips, mirrored twins included, of an action that the classifier learns."""


class ActionJudge(NamedTuple):
    """A classifier of actions, and how often it is right about real clips of the test split."""

    classifier: Classifier
    accuracy: dict[str, float]
    """By action; actions without a test clip are missing."""

    def recognize(self, motion: Motion) -> str | None:
        """Returns the action of a motion of the skeleton `HUMANML3D`; None for one frame."""
        if motion.num_frames < 2:
            return None
        return self.classifier.recognize(features_from_positions(motion.positions, HUMANML3D))


def labeled_clips(dataset: Dataset, split: str) -> list[tuple[str, Float[np.ndarray, "_ D"]]]:
    """Returns action and raw features of the clips of a split that show one labeled action."""
    index = load_index(dataset.folder)
    found = []
    for clip in dataset.clips(split, min_frames=2):
        content, _, _ = ((index.label(clip.name) if index else None) or "").partition(", ")
        # Labels of composed clips, such as "jump x 3", have spaces.
        if content and " " not in content:
            found.append((content, clip.features))
    return found


def train_judge(dataset: Dataset) -> ActionJudge:
    """Returns a classifier of the actions that have at least `LEAST_CLIPS` training clips.

    Raises:
        UserError: The data set has another skeleton than HumanML3D's, or no action has so many clips.
    """
    check_skeleton(dataset.skeleton, owner="data set")
    train = labeled_clips(dataset, "train")
    counts = Counter(content for content, _ in train)
    actions = sorted(content for content, count in counts.items() if count >= LEAST_CLIPS and content != "other")
    if not actions:
        raise UserError(f"{dataset.folder}: no action has {LEAST_CLIPS} labeled training clips, to learn it from")
    known = [(content, features) for content, features in train if content in actions]
    numbers = np.array([actions.index(content) for content, _ in known])
    classifier = train_classifier([features for _, features in known], numbers, classes=actions)
    return ActionJudge(classifier, _accuracy(classifier, labeled_clips(dataset, "test")))


def _accuracy(classifier: Classifier, clips: Sequence[tuple[str, Float[np.ndarray, "_ D"]]]) -> dict[str, float]:
    """Returns the share of clips of each known action that are recognized."""
    right: dict[str, list[bool]] = {}
    for content, features in clips:
        if content in classifier.classes:
            right.setdefault(content, []).append(classifier.recognize(features) == content)
    return {content: float(np.mean(found)) for content, found in right.items()}
