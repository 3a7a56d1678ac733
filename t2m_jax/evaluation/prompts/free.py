"""Tests with sentences of somebody who saw neither the code nor any caption, and wrote them before any training.

The sentences are in `held_out_actions.yaml` and `held_out_groups.yaml`.
"""

import functools
import itertools
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np

from t2m_jax.data.captioning.lexicon import read_words
from t2m_jax.data.folder import Dataset
from t2m_jax.evaluation.prompts.counting import CURVES, count_action
from t2m_jax.evaluation.prompts.following import (
    RULES,
    STANDS_TRAVEL,
    WAVES,
    PromptTest,
    follows,
    hand_is_up,
    measure_motion,
)
from t2m_jax.evaluation.prompts.groups import PACED, clip_speeds, pace_test, shows_in_turn
from t2m_jax.evaluation.prompts.recognition import Classifier, manner_judge, train_judge
from t2m_jax.motion.facts import Facts
from t2m_jax.motion.motion import Motion

CONTENTS = {
    "raise-left-hand": "raise-up-left-hand",
    "raise-right-hand": "raise-up-right-hand",
    "raise-both-hands": "raise-up-both-hands",
    "walk-backward": "walk-back",
    "side-step-left": "sidestep-left",
    "side-step-right": "sidestep-right",
    "show-the-way": "guide",
}
"""Labels of the sentences -> those of data sets, where they differ."""
SHARES = {"slow": 0.2, "fast": 0.8}
"""Quantiles of the speeds of training clips that a slow motion stays below and a fast one is above."""
SECONDS_OFF = 0.5
"""How far a motion may be from the seconds that were asked for; 10 % if that is more."""
BACKWARD = -0.5
"""Meters ahead of somebody who walks backward, at most."""
BEYOND = ("unknown", "other_language", "animals", "two_people")
"""Groups of sentences for which a model should warn."""
BEATS = 2
"""Claps or punches of somebody who claps or punches."""


def _groups() -> Mapping[str, Any]:
    return read_words(__package__, "held_out_groups")


def _content(label: str) -> str:
    return CONTENTS.get(label, label)


def _rule_tests(sentences: Mapping[str, Iterable[str]]) -> list[PromptTest]:
    """Returns tests of known actions by their rules, for sentences by label."""
    tests = []
    for label, texts in sentences.items():
        content = _content(label)
        tests.append(PromptTest(content, RULES[content].words, tuple(texts), functools.partial(follows, content)))
    return tests


def free_tests() -> list[PromptTest]:
    """Returns tests of the ten known actions in free wordings."""
    return _rule_tests(_groups()["free"])


def typo_tests() -> list[PromptTest]:
    """Returns tests of the ten known actions with one typing mistake in each sentence."""
    return _rule_tests(_groups()["typos"])


def subject_tests() -> list[PromptTest]:
    """Returns tests of the ten known actions with subjects and places that say nothing about the motion."""
    groups = _groups()
    # All of them in turn, so that each action has other ones.
    drawn = zip(itertools.cycle(groups["subjects"]), itertools.cycle(reversed(groups["places"])))
    return _rule_tests(
        {
            label: [f"{subject} {text} {place}" for text, (subject, place) in zip(texts, drawn, strict=False)]
            for label, texts in groups["templates"].items()
        }
    )


def _grouped(group: str, *keys: str) -> dict[tuple, tuple[str, ...]]:
    """Returns the sentences of a group by the values of `keys`."""
    found: dict[tuple, tuple[str, ...]] = {}
    for entry in _groups()[group]:
        key = tuple(tuple(entry[name]) if isinstance(entry[name], list) else entry[name] for name in keys)
        found[key] = (*found.get(key, ()), entry["text"])
    return found


def _tests(group: str, *keys: str, name: str, rule: str, holds: Callable[..., bool]) -> list[PromptTest]:
    """Returns a test for each combination of the values of `keys`.

    Args:
        group: Name of the group.
        *keys: Entries of a sentence.
        name: Of a test; `{}` is replaced by a value.
        rule: What a motion must do.
        holds: From the values and a motion to whether it does.
    """
    return [
        PromptTest(name.format(*values), rule, sentences, functools.partial(holds, *values))
        for values, sentences in _grouped(group, *keys).items()
    ]


def free_pace_tests(dataset: Dataset) -> list[PromptTest]:
    """Returns tests of slow and fast motion in free wordings. The limits are shares of training clips by speed.

    Raises:
        UserError: As for `pace_tests`.
    """
    speeds = clip_speeds(dataset, PACED)
    tests = []
    for (label, pace), sentences in _grouped("paces", "label", "pace").items():
        limit = float(np.quantile(speeds[_content(label)], SHARES[pace]))
        tests.append(pace_test(f"{label} {pace}", _content(label), sentences, limit=limit, is_slow=pace == "slow"))
    return tests


def free_manner_tests(dataset: Dataset) -> list[PromptTest]:
    """Returns tests of manners in free wordings, by the classifier of `manner_tests`.

    Raises:
        UserError: As for `manner_tests`.
    """
    classifier, rule = manner_judge(dataset)
    return _tests("manners", "manner", name="{}", rule=rule, holds=classifier.sees)


def then_tests(dataset: Dataset) -> list[PromptTest]:
    """Returns tests of two actions in turn. Actions without a rule are judged by `train_judge`."""
    classifier, _ = train_judge(dataset)
    holds = functools.partial(shows_in_turn, functools.partial(_shows, classifier))
    rule = "can be cut so that each part shows its action"
    return _tests("then", "labels", name="{0[0]} + {0[1]}", rule=rule, holds=holds)


def _shows(classifier: Classifier, label: str, motion: Motion) -> bool:
    content = _content(label)
    return follows(content, motion) if content in RULES else classifier.sees(content, motion)


def while_tests() -> list[PromptTest]:
    """Returns tests of something done with the arms while the legs do something else."""
    rule = "the legs keep the rule of one action, the arms that of the other"
    return _tests("while", "legs", "arms", name="{} while {}", rule=rule, holds=_shows_at_once)


LEGS: dict[str, Callable[[Facts], bool]] = {
    "stand": lambda facts: facts.travel <= STANDS_TRAVEL,
    "walk-back": lambda facts: facts.forward <= BACKWARD,
} | {content: RULES[content].holds for content in ("walk", "run", "walk-turn-left", "walk-turn-right")}
"""What legs do, whatever the arms do."""


def _shows_at_once(legs: str, arms: str, motion: Motion) -> bool:
    facts = measure_motion(motion)
    if facts is None or not LEGS[_content(legs)](facts):
        return False
    if arms in ("clap", "punch"):
        return count_action(arms, motion) >= BEATS
    action, _, hands = arms.removesuffix("-hand").removesuffix("-hands").rpartition("-")
    return hand_is_up(hands, facts) and (action != "wave" or facts.waves >= WAVES)


def count_tests() -> list[PromptTest]:
    """Returns tests of actions that are asked for a number of times."""
    rule = "the action is counted so often (peaks of one curve)"
    return _tests("counts", "label", "count", name="{} x {}", rule=rule, holds=_is_counted)


def _is_counted(label: str, times: int, motion: Motion) -> bool:
    return count_action(_content(label), motion) == times


def duration_tests() -> list[PromptTest]:
    """Returns tests of actions that are asked for some seconds."""
    rule = f"lasts so long (give or take {SECONDS_OFF} s, or 10 %), and keeps the rule of the action"
    return _tests("durations", "label", "seconds", name="{}, {} s", rule=rule, holds=_lasts)


def _lasts(label: str, seconds: float, motion: Motion) -> bool:
    content = _content(label)
    if abs(motion.num_frames / motion.fps - seconds) > max(SECONDS_OFF, 0.1 * seconds):
        return False
    if content in RULES:
        return follows(content, motion)
    return content not in CURVES or count_action(content, motion) >= BEATS


def warning_tests() -> list[PromptTest]:
    """Returns tests of the warnings: for what no model of one person's common actions can show, and only for that."""
    groups = _groups()
    known = tuple(itertools.chain.from_iterable(groups["free"].values()))
    beyond = {name: [entry if isinstance(entry, str) else entry["text"] for entry in groups[name]] for name in BEYOND}
    asked = [PromptTest(name, "a warning", tuple(sentences), _is_warned) for name, sentences in beyond.items()]
    return [*asked, PromptTest("the ten actions", "no warning", known, lambda motion: not _is_warned(motion))]


def _is_warned(motion: Motion) -> bool:
    return bool(motion.warning)


def all_action_tests(dataset: Dataset) -> list[PromptTest]:
    """Returns a test of each action that the training clips show, by a classifier of real clips."""
    classifier, accuracy = train_judge(dataset)
    tests = []
    for label, sentences in read_words(__package__, "held_out_actions").items():
        content = _content(label)
        if content in classifier.classes:
            known = accuracy.get(content)
            rule = "a classifier recognizes it" + ("" if known is None else f"; of real test clips, {known:.0%}")
            tests.append(PromptTest(content, rule, tuple(sentences), functools.partial(classifier.sees, content)))
    return tests
