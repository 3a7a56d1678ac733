"""Further groups of prompt tests: paces, measured against real clips, and sentences that ask for two actions."""

import functools
from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from t2m_jax.data.composing.turns import held_out_compositions
from t2m_jax.data.folder import Dataset
from t2m_jax.data.index import load_index
from t2m_jax.errors import UserError
from t2m_jax.evaluation.prompts.following import RULES, PromptTest, check_skeleton, goes_straight, measure_motion
from t2m_jax.evaluation.prompts.sentences import Pace, held_out_paces, held_out_sentences
from t2m_jax.motion.facts import Facts, measure
from t2m_jax.motion.features import positions_from_features
from t2m_jax.motion.motion import Motion

PACED = ("walk", "run", "walk-turn-left", "walk-turn-right", "wave-left-hand", "wave-right-hand", "wave-both-hands")
"""Contents that are asked for at each pace."""
PACE_WORDS = ("pace", "steady", "relaxed", "step by step", "a few", "several")
"""Sentences with these say how fast already, or ask for little movement."""
# One second: less of an action could be a part of the other one.
SHORTEST_PART = 20
"""Frames of the shortest part of a composed motion."""
CUT_STEP = 4
"""Frames between the places where a composed motion is cut on trial."""


def pace_tests(dataset: Dataset) -> list[PromptTest]:
    """Returns a test for each paced content and pace. The limits are shares of the training clips by speed.

    Raises:
        UserError: The data set has another skeleton than HumanML3D's, or does not show one of the contents.
    """
    check_skeleton(dataset.skeleton, owner="data set")
    speeds = clip_speeds(dataset, PACED)
    return [_pace_test(content, pace, speeds[content]) for content in PACED for pace in held_out_paces()]


def clip_speeds(dataset: Dataset, contents: Sequence[str]) -> Mapping[str, Float[np.ndarray, " N"]]:
    """Returns the speeds of the training clips of each content, in m/s.

    Raises:
        UserError: The data set does not show one of the contents.
    """
    index = load_index(dataset.folder)
    found = defaultdict(list)
    for clip in dataset.clips("train", min_frames=2):
        # Labels are `content, style`.
        content = ((index.label(clip.name) if index else None) or "").partition(",")[0]
        if content in contents:
            positions = np.asarray(positions_from_features(clip.features, dataset.skeleton))
            found[content].append(measure(positions, fps=dataset.skeleton.fps).speed)
    for content in contents:
        if not found[content]:
            raise UserError(f"{dataset.folder}: no training clip has the label {content!r}, whose speed is compared")
    return {content: np.array(values) for content, values in found.items()}


def _pace_test(content: str, pace: Pace, speeds: Float[np.ndarray, " N"]) -> PromptTest:
    share: Any = pace.faster_than if pace.slower_than is None else pace.slower_than
    limit = float(np.quantile(speeds, share))
    words = f"speed {'above' if pace.slower_than is None else 'below'} {limit:.2f} m/s"
    # "walks at a steady pace very slowly" would contradict itself.
    plain = [text for text in held_out_sentences()[content] if not any(word in text for word in PACE_WORDS)]
    sentences = tuple(f"{text} {pace.phrases[number % len(pace.phrases)]}" for number, text in enumerate(plain))

    def holds(motion: Motion) -> bool:
        facts = measure_motion(motion)
        if facts is None or not shows(content, facts):
            return False
        return facts.speed > limit if pace.slower_than is None else facts.speed < limit

    return PromptTest(f"{content} {pace.name}", f"as for {content}; {words}", sentences, holds)


def shows(content: str, facts: Facts) -> bool:
    """Returns whether a motion shows a content at any speed."""
    # The rules of walking and running have limits of speed, which a pace may break.
    return goes_straight(facts) if content in ("walk", "run") else RULES[content].holds(facts)


def composed_tests() -> list[PromptTest]:
    """Returns a test for each pair of contents: both are shown, one after the other."""
    return [
        PromptTest(
            " + ".join(contents),
            "can be cut so that each part keeps its rule",
            sentences,
            functools.partial(_shows_in_order, *contents),
        )
        for contents, sentences in held_out_compositions().items()
    ]


def _shows_in_order(first: str, second: str, motion: Motion) -> bool:
    """Returns whether a motion can be cut into parts that satisfy the rules of two contents."""
    check_skeleton(motion.skeleton)
    # Nothing says where the first action ends, so all cuts are tried.
    return any(
        RULES[first].holds(measure(motion.positions[:cut], fps=motion.fps))
        and RULES[second].holds(measure(motion.positions[cut:], fps=motion.fps))
        for cut in range(SHORTEST_PART, motion.num_frames - SHORTEST_PART + 1, CUT_STEP)
    )
