"""Further groups of prompt tests: paces, measured against real clips, and sentences that ask for two actions."""

import functools
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from jaxtyping import Float

from t2m_jax.data.composing.turns import held_out_compositions
from t2m_jax.data.folder import Dataset
from t2m_jax.errors import UserError
from t2m_jax.evaluation.prompts.following import (
    RULES,
    PromptTest,
    check_skeleton,
    follows,
    goes_straight,
    measure_motion,
)
from t2m_jax.evaluation.prompts.recognition import labeled_clips
from t2m_jax.evaluation.prompts.sentences import held_out_paces, held_out_sentences
from t2m_jax.motion.facts import measure
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
    speeds = clip_speeds(dataset, PACED)
    tests = []
    for content in PACED:
        # "walks at a steady pace very slowly" would contradict itself.
        plain = [text for text in held_out_sentences()[content] if not any(word in text for word in PACE_WORDS)]
        for pace in held_out_paces():
            phrases = pace.phrases
            sentences = tuple(f"{text} {phrases[number % len(phrases)]}" for number, text in enumerate(plain))
            limit = float(np.quantile(speeds[content], pace.share))
            tests.append(pace_test(f"{content} {pace.name}", content, sentences, limit=limit, is_slow=pace.is_slow))
    return tests


def clip_speeds(dataset: Dataset, contents: Sequence[str]) -> Mapping[str, Float[np.ndarray, " N"]]:
    """Returns the speeds of the training clips of each content, in m/s.

    Raises:
        UserError: The data set has another skeleton than HumanML3D's, or does not show one of the contents.
    """
    check_skeleton(dataset.skeleton, owner="data set")
    found = defaultdict(list)
    for content, _, features in labeled_clips(dataset, "train"):
        if content in contents:
            positions = np.asarray(positions_from_features(features, dataset.skeleton))
            found[content].append(measure(positions, fps=dataset.skeleton.fps).speed)
    for content in contents:
        if not found[content]:
            raise UserError(f"{dataset.folder}: no training clip has the label {content!r}, whose speed is compared")
    return {content: np.array(values) for content, values in found.items()}


def pace_test(name: str, content: str, sentences: tuple[str, ...], *, limit: float, is_slow: bool) -> PromptTest:
    """Returns the test of a content that is shown more slowly than a limit (m/s), or faster."""

    def holds(motion: Motion) -> bool:
        facts = measure_motion(motion)
        if facts is None or (facts.speed >= limit if is_slow else facts.speed <= limit):
            return False
        # The rules of walking and running have limits of speed, which a pace may break.
        return goes_straight(facts) if content in ("walk", "run") else RULES[content].holds(facts)

    rule = f"as for {content}; speed {'below' if is_slow else 'above'} {limit:.2f} m/s"
    return PromptTest(name, rule, sentences, holds)


def composed_tests() -> list[PromptTest]:
    """Returns a test for each pair of contents: both are shown, one after the other."""
    return [
        PromptTest(
            " + ".join(contents),
            "can be cut so that each part keeps its rule",
            sentences,
            functools.partial(shows_in_turn, follows, contents),
        )
        for contents, sentences in held_out_compositions().items()
    ]


def shows_in_turn(shows: Callable[[str, Motion], bool], contents: Sequence[str], motion: Motion) -> bool:
    """Returns whether a motion can be cut into two parts that show one content each."""
    first, second = contents
    # Nothing says where the first action ends, so all cuts are tried.
    cuts = range(SHORTEST_PART, motion.num_frames - SHORTEST_PART + 1, CUT_STEP)
    return any(shows(first, motion[:cut]) and shows(second, motion[cut:]) for cut in cuts)
