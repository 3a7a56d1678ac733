"""Whether generated motion does what the sentence asked, by simple kinematic rules.

The contents are those of Bandai-Namco dataset-2, and standing still. The limits were chosen so that nearly all of the
training clips satisfy them. The sentences are held out from training.
"""

import functools
from collections import Counter
from collections.abc import Callable, Sequence
from typing import NamedTuple

from t2m_jax.errors import UserError
from t2m_jax.evaluation.prompts.results import PromptResult
from t2m_jax.evaluation.prompts.sentences import held_out_sentences
from t2m_jax.motion.facts import Facts, measure
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.skeleton import HUMANML3D, Skeleton

HAND_UP = -0.05
"""A wrist is raised if it is higher than this above its own shoulder, in meters."""
HAND_DOWN = -0.15
"""A wrist is not raised if it is lower than this above its own shoulder, in meters."""
STANDS_TRAVEL = 0.5
"""Largest distance covered by somebody in place, in meters."""
MOVES_TRAVEL = 1.0
"""Smallest distance covered by somebody who goes ahead, in meters."""
STRAIGHT_TURN = 40.0
"""Largest change of heading of a person who does not turn, in degrees."""
CORNER_TURN = (45.0, 160.0)
"""Smallest and largest change of heading of a person who turns a corner, in degrees."""
FASTEST_WALK = 1.8
"""Mean speed over the ground in meters per second."""
SLOWEST_RUN = 1.35
"""The ranges overlap, because tired and old people run slowly."""
STILL_HANDS = 0.5
"""Largest speed of a wrist of a person who stands still (95 % of the time), in meters per second."""
WAVES = 2
"""A raised hand waves if it sweeps to and fro at least this often."""
SEEDS = 4
"""Motions of each sentence, if their number is not given."""
NOTHING = "nothing of these"
"""What a motion does that passes no test."""


class Rule(NamedTuple):
    """What a motion must do, in words and as a test of its measurements."""

    words: str
    holds: Callable[[Facts], bool]


def goes_straight(facts: Facts) -> bool:
    """Returns whether the person goes ahead without a turn, at any speed."""
    return facts.forward >= MOVES_TRAVEL and abs(facts.turn) <= STRAIGHT_TURN


def hand_is_up(hands: str, facts: Facts) -> bool:
    """Returns whether `both` hands, or the `left` or the `right` one alone, were raised."""
    if hands == "both":
        return min(facts.above_shoulder) > HAND_UP
    named, other = facts.above_shoulder if hands == "left" else facts.above_shoulder[::-1]
    # Otherwise a model that always raises both hands would pass the tests of each.
    return named > HAND_UP and other < HAND_DOWN


def _hand_rule(hands: str, *, waves: bool) -> Rule:
    """Returns the rule of raising or waving `both`, `left` or `right`, in place."""

    def holds(facts: Facts) -> bool:
        in_place = facts.travel <= STANDS_TRAVEL and abs(facts.turn) <= STRAIGHT_TURN
        return hand_is_up(hands, facts) and in_place and (facts.waves >= WAVES) == waves

    if hands == "both":
        words = "both wrists come above their shoulders (less 5 cm)"
    else:
        words = "the named wrist comes above its shoulder (less 5 cm), the other stays 15 cm below"
    return Rule(f"{words}; no travel; {'2 waves or more' if waves else 'fewer than 2 waves'}", holds)


def _stands(facts: Facts) -> bool:
    """Returns whether the person stands still with low hands."""
    in_place = facts.travel <= STANDS_TRAVEL and abs(facts.turn) <= STRAIGHT_TURN
    return in_place and facts.speed <= STILL_HANDS and max(facts.above_shoulder) < HAND_DOWN


def _corner_rule(sign: int) -> Rule:
    def holds(facts: Facts) -> bool:
        # Turns to the left are positive.
        return facts.forward >= MOVES_TRAVEL and CORNER_TURN[0] <= sign * facts.turn <= CORNER_TURN[1]

    return Rule("goes at least 1 m ahead; heading changes by 45 to 160 degrees to the named side", holds)


RULES: dict[str, Rule] = {
    "raise-up-both-hands": _hand_rule("both", waves=False),
    "raise-up-left-hand": _hand_rule("left", waves=False),
    "raise-up-right-hand": _hand_rule("right", waves=False),
    "run": Rule(
        "goes at least 1 m ahead without a turn (40 degrees), at 1.35 m/s or faster",
        lambda facts: goes_straight(facts) and facts.speed >= SLOWEST_RUN,
    ),
    "stand": Rule("no travel; both wrists stay 15 cm below their shoulders, slower than 0.5 m/s", _stands),
    "walk": Rule(
        "goes at least 1 m ahead without a turn (40 degrees), at 1.8 m/s or slower",
        lambda facts: goes_straight(facts) and facts.speed <= FASTEST_WALK,
    ),
    "walk-turn-left": _corner_rule(1),
    "walk-turn-right": _corner_rule(-1),
    "wave-both-hands": _hand_rule("both", waves=True),
    "wave-left-hand": _hand_rule("left", waves=True),
    "wave-right-hand": _hand_rule("right", waves=True),
}
"""The rule of each content of dataset-2, and of standing still, which is cut out of its clips."""


class PromptTest(NamedTuple):
    """What some sentences ask for, and how it is recognized."""

    name: str
    rule: str
    """In words."""
    sentences: tuple[str, ...]
    """Held out from training."""
    holds: Callable[[Motion], bool]


def check_skeleton(skeleton: Skeleton, *, owner: str = "motion") -> None:
    """Checks that rules can be applied to a motion or to a data set.

    Raises:
        UserError: The skeleton is another one than HumanML3D's, whose joints the rules name.
    """
    if skeleton != HUMANML3D:
        raise UserError(f"skeleton: the rules are for {HUMANML3D.name!r}, and the {owner} has {skeleton.name!r}")


def measure_motion(motion: Motion) -> Facts | None:
    """Returns the measurements that rules are about; None for motion of one frame.

    Raises:
        UserError: The motion has another skeleton than HumanML3D's.
    """
    check_skeleton(motion.skeleton)
    return measure(motion.positions, fps=motion.fps) if motion.num_frames >= 2 else None


def follows(content: str, motion: Motion) -> bool:
    """Returns whether a motion satisfies the rule of a content.

    Raises:
        UserError: The motion has another skeleton than HumanML3D's.
    """
    facts = measure_motion(motion)
    return facts is not None and RULES[content].holds(facts)


def action_tests() -> list[PromptTest]:
    """Returns a test for each content that has a rule."""
    return [
        PromptTest(content, rule.words, held_out_sentences()[content], functools.partial(follows, content))
        for content, rule in RULES.items()
    ]


def requests(test: PromptTest, *, num_seeds: int | None) -> list[tuple[int, str]]:
    """Returns seeds 0 to `num_seeds` - 1, with the test's sentences in rotation; None asks each of them four times."""
    if num_seeds is None:
        num_seeds = SEEDS * len(test.sentences)
    # In turn and not drawn, so that each sentence is asked equally often.
    return [(seed, test.sentences[seed % len(test.sentences)]) for seed in range(num_seeds)]


def evaluate_prompt_following(
    tests: Sequence[PromptTest], generate: Callable[[str, int], Motion], *, num_seeds: int | None
) -> list[PromptResult]:
    """Returns one result per test.

    Args:
        tests: A group of tests.
        generate: Returns the motion of a sentence and a seed.
        num_seeds: Samples per test; None for four of each sentence.
    """
    results = []
    for place, test in enumerate(tests):
        asked = requests(test, num_seeds=num_seeds)
        failed = [(sentence, motion) for seed, sentence in asked if not test.holds(motion := generate(sentence, seed))]
        instead = Counter(_passes(tests, place, motion) for _, motion in failed)
        results.append(
            PromptResult(
                name=test.name,
                rule=test.rule,
                right=len(asked) - len(failed),
                samples=len(asked),
                failures=tuple(sentence for sentence, _ in failed),
                instead=tuple(instead.items()),
            )
        )
    return results


def _passes(tests: Sequence[PromptTest], place: int, motion: Motion) -> str:
    """Returns the test that a motion passes. Of several, it is the nearest one to a place in the list."""
    # Neighbors in the list are alike: the sides of an action, the paces of a content.
    near = sorted(range(len(tests)), key=lambda other: abs(other - place))
    return next((tests[other].name for other in near if tests[other].holds(motion)), NOTHING)
