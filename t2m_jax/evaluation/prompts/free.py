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
    check_skeleton,
    follows,
    hand_is_up,
    measure_motion,
)
from t2m_jax.evaluation.prompts.groups import CUT_STEP, PACED, SHORTEST_PART, clip_speeds, shows
from t2m_jax.evaluation.prompts.manners import manner_judge
from t2m_jax.evaluation.prompts.recognition import ActionJudge, train_judge
from t2m_jax.motion.facts import Facts
from t2m_jax.motion.motion import Motion

CONTENTS = {
    "raise-left-hand": "raise-up-left-hand",
    "raise-right-hand": "raise-up-right-hand",
    "raise-both-hands": "raise-up-both-hands",
    "walk-backward": "walk-back",
    "side-step-left": "walk-left",
    "side-step-right": "walk-right",
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


def _sentences() -> Mapping[str, Any]:
    return read_words(__package__, "held_out_groups")


def _content(label: str) -> str:
    return CONTENTS.get(label, label)


def _by_content(group: str) -> list[PromptTest]:
    """Returns tests of the known actions by their rules, with the sentences of a group."""
    return [_rule_test(_content(label), sentences) for label, sentences in _sentences()[group].items()]


def _rule_test(content: str, sentences: Iterable[str]) -> PromptTest:
    return PromptTest(content, RULES[content].words, tuple(sentences), functools.partial(follows, content))


def free_tests() -> list[PromptTest]:
    """Returns tests of the ten known actions in free wordings."""
    return _by_content("free")


def typo_tests() -> list[PromptTest]:
    """Returns tests of the ten known actions with one typing mistake in each sentence."""
    return _by_content("typos")


def subject_tests() -> list[PromptTest]:
    """Returns tests of the ten known actions with subjects and places that say nothing about the motion."""
    groups = _sentences()
    # All of them in turn, so that each action has other ones.
    drawn = zip(itertools.cycle(groups["subjects"]), itertools.cycle(reversed(groups["places"])))
    return [
        _rule_test(
            _content(label), [f"{subject} {text} {place}" for text, (subject, place) in zip(texts, drawn, strict=False)]
        )
        for label, texts in groups["templates"].items()
    ]


def _grouped(group: str, *keys: str) -> dict[tuple, tuple[str, ...]]:
    """Returns the sentences of a group by the values of `keys`."""
    found: dict[tuple, tuple[str, ...]] = {}
    for entry in _sentences()[group]:
        key = tuple(tuple(entry[name]) if isinstance(entry[name], list) else entry[name] for name in keys)
        found[key] = (*found.get(key, ()), entry["text"])
    return found


def free_pace_tests(dataset: Dataset) -> list[PromptTest]:
    """Returns tests of slow and fast motion in free wordings. The limits are shares of training clips by speed.

    Raises:
        UserError: As for `pace_tests`.
    """
    check_skeleton(dataset.skeleton, owner="data set")
    speeds = clip_speeds(dataset, PACED)
    tests = []
    for (label, pace), sentences in _grouped("paces", "label", "pace").items():
        limit = float(np.quantile(speeds[_content(label)], SHARES[pace]))
        rule = f"as for {label}; speed {'below' if pace == 'slow' else 'above'} {limit:.2f} m/s"
        holds = functools.partial(_has_pace, _content(label), pace == "slow", limit)
        tests.append(PromptTest(f"{label} {pace}", rule, sentences, holds))
    return tests


def _has_pace(content: str, is_slow: bool, limit: float, motion: Motion) -> bool:
    facts = measure_motion(motion)
    if facts is None or not shows(content, facts):
        return False
    return facts.speed < limit if is_slow else facts.speed > limit


def free_manner_tests(dataset: Dataset) -> list[PromptTest]:
    """Returns tests of manners in free wordings, by the classifier of `manner_tests`.

    Raises:
        UserError: As for `manner_tests`.
    """
    holds, rule = manner_judge(dataset)
    return [
        PromptTest(manner, rule, sentences, functools.partial(holds, manner))
        for (manner,), sentences in _grouped("manners", "manner").items()
    ]


def then_tests(dataset: Dataset) -> list[PromptTest]:
    """Returns tests of two actions in turn. Actions without a rule are judged by `train_judge`."""
    judge = train_judge(dataset)
    return [
        PromptTest(
            " + ".join(labels),
            "can be cut so that each part shows its action",
            sentences,
            functools.partial(_shows_in_turn, judge, (_content(labels[0]), _content(labels[1]))),
        )
        for (labels,), sentences in _grouped("then", "labels").items()
    ]


def _shows_in_turn(judge: ActionJudge, contents: tuple[str, str], motion: Motion) -> bool:
    first, second = contents
    # Nothing says where the first action ends, so all cuts are tried.
    cuts = range(SHORTEST_PART, motion.num_frames - SHORTEST_PART + 1, CUT_STEP)
    return any(_shows(judge, first, motion[:cut]) and _shows(judge, second, motion[cut:]) for cut in cuts)


def _shows(judge: ActionJudge, content: str, motion: Motion) -> bool:
    return follows(content, motion) if content in RULES else judge.recognize(motion) == content


def while_tests() -> list[PromptTest]:
    """Returns tests of something done with the arms while the legs do something else."""
    return [
        PromptTest(
            f"{legs} while {arms}",
            "the legs keep the rule of one action, the arms that of the other",
            sentences,
            functools.partial(_shows_at_once, _content(legs), _content(arms)),
        )
        for (legs, arms), sentences in _grouped("while", "legs", "arms").items()
    ]


LEGS: dict[str, Callable[[Facts], bool]] = {
    "stand": lambda facts: facts.travel <= STANDS_TRAVEL,
    "walk-back": lambda facts: facts.forward <= BACKWARD,
} | {content: RULES[content].holds for content in ("walk", "run", "walk-turn-left", "walk-turn-right")}
"""What legs do, whatever the arms do."""


def _shows_at_once(legs: str, arms: str, motion: Motion) -> bool:
    facts = measure_motion(motion)
    if facts is None or not LEGS[legs](facts):
        return False
    if arms in ("clap", "punch"):
        return count_action(arms, motion) >= BEATS
    action, _, hands = arms.removesuffix("-hand").removesuffix("-hands").rpartition("-")
    return hand_is_up(hands, facts) and (action != "wave" or facts.waves >= WAVES)


def count_tests() -> list[PromptTest]:
    """Returns tests of actions that are asked for a number of times."""
    return [
        PromptTest(
            f"{label} x {times}",
            "the action is counted so often (peaks of one curve)",
            sentences,
            functools.partial(_is_counted, _content(label), times),
        )
        for (label, times), sentences in _grouped("counts", "label", "count").items()
    ]


def _is_counted(content: str, times: int, motion: Motion) -> bool:
    return count_action(content, motion) == times


def duration_tests() -> list[PromptTest]:
    """Returns tests of actions that are asked for some seconds."""
    return [
        PromptTest(
            f"{label}, {seconds} s",
            f"lasts so long (give or take {SECONDS_OFF} s, or 10 %), and keeps the rule of the action",
            sentences,
            functools.partial(_lasts, _content(label), seconds),
        )
        for (label, seconds), sentences in _grouped("durations", "label", "seconds").items()
    ]


def _lasts(content: str, seconds: float, motion: Motion) -> bool:
    if abs(motion.num_frames / motion.fps - seconds) > max(SECONDS_OFF, 0.1 * seconds):
        return False
    if content in RULES:
        return follows(content, motion)
    return content not in CURVES or count_action(content, motion) >= BEATS


def warning_tests() -> list[PromptTest]:
    """Returns tests of the warnings: for what no model of one person's common actions can show, and only for that."""
    groups = _sentences()
    known = tuple(itertools.chain.from_iterable(groups["free"].values()))
    beyond = {name: [entry if isinstance(entry, str) else entry["text"] for entry in groups[name]] for name in BEYOND}
    asked = [PromptTest(name, "a warning", tuple(sentences), _is_warned) for name, sentences in beyond.items()]
    return [*asked, PromptTest("the ten actions", "no warning", known, lambda motion: not _is_warned(motion))]


def _is_warned(motion: Motion) -> bool:
    return bool(motion.warning)


def all_action_tests(dataset: Dataset) -> list[PromptTest]:
    """Returns a test of each action that the training clips show, by a classifier of real clips."""
    judge = train_judge(dataset)
    tests = []
    for label, sentences in read_words(__package__, "held_out_actions").items():
        content = _content(label)
        if content in judge.classifier.classes:
            known = judge.accuracy.get(content)
            rule = "a classifier recognizes it" + ("" if known is None else f"; of real test clips, {known:.0%}")
            holds = functools.partial(_is_recognized, judge, content)
            tests.append(PromptTest(content, rule, tuple(sentences), holds))
    return tests


def _is_recognized(judge: ActionJudge, content: str, motion: Motion) -> bool:
    check_skeleton(motion.skeleton)
    return judge.recognize(motion) == content
