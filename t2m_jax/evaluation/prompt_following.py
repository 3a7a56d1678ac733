"""Whether generated motion does what the sentence asked, by kinematic rules that anybody can state and measure.

The contents are those of Bandai-Namco dataset-2. The limits were read off its training clips, of which nearly all keep
to them; the sentences are held out from training.
"""

from collections.abc import Callable
from typing import NamedTuple

from t2m_jax.data.importers.bandai_namco.measure import Facts, measure
from t2m_jax.data.importers.bandai_namco.wordings import held_out_sentences
from t2m_jax.motion.record import Motion

LEFT, RIGHT = 0, 1
HAND_UP = -0.05
"""A wrist higher than this against its own shoulder is raised, metres."""
HAND_DOWN = -0.15
"""A wrist lower than this against its own shoulder is not raised, metres."""
STANDS_TRAVEL, MOVES_TRAVEL = 0.5, 1.0
"""Ground covered by one who stands in place (at most) or goes somewhere (at least), metres."""
STRAIGHT_TURN = 40.0
"""Largest change of heading of one who goes or stands straight, degrees."""
CORNER_TURN = (45.0, 160.0)
"""Change of heading of one who turns a corner, degrees."""
FASTEST_WALK, SLOWEST_RUN = 1.8, 1.35
"""Mean speed over the ground, metres a second; exhausted and elderly runners are slow."""
WAVES = 2
"""Sweeps there and back from which on a raised hand waves."""


class Rule(NamedTuple):
    """What a motion has to do, in words and as a test of its measurements."""

    words: str
    holds: Callable[[Facts], bool]


def _stands(facts: Facts) -> bool:
    return facts.travel <= STANDS_TRAVEL and abs(facts.turn) <= STRAIGHT_TURN


def _only_up(facts: Facts, side: int) -> bool:
    return facts.above_shoulder[side] > HAND_UP and facts.above_shoulder[1 - side] < HAND_DOWN


def _both_up(facts: Facts) -> bool:
    return min(facts.above_shoulder) > HAND_UP


def _turns(facts: Facts, sign: int) -> bool:
    return facts.forward >= MOVES_TRAVEL and CORNER_TURN[0] <= sign * facts.turn <= CORNER_TURN[1]


def _goes_straight(facts: Facts) -> bool:
    return facts.forward >= MOVES_TRAVEL and abs(facts.turn) <= STRAIGHT_TURN


_ONE = "the named wrist comes above its shoulder (less 5 cm), the other stays 15 cm below; no travel"
_BOTH = "both wrists come above their shoulders (less 5 cm); no travel"
_CORNER = "goes at least 1 m ahead; heading changes by 45 to 160 degrees to the named side"
RULES: dict[str, Rule] = {
    "raise-up-both-hands": Rule(
        f"{_BOTH}; fewer than 2 waves", lambda facts: _both_up(facts) and _stands(facts) and facts.waves < WAVES
    ),
    "raise-up-left-hand": Rule(
        f"{_ONE}; fewer than 2 waves", lambda facts: _only_up(facts, LEFT) and _stands(facts) and facts.waves < WAVES
    ),
    "raise-up-right-hand": Rule(
        f"{_ONE}; fewer than 2 waves", lambda facts: _only_up(facts, RIGHT) and _stands(facts) and facts.waves < WAVES
    ),
    "run": Rule(
        "goes at least 1 m ahead without a turn (40 degrees), at 1.35 m/s or faster",
        lambda facts: _goes_straight(facts) and facts.speed >= SLOWEST_RUN,
    ),
    "walk": Rule(
        "goes at least 1 m ahead without a turn (40 degrees), at 1.8 m/s or slower",
        lambda facts: _goes_straight(facts) and facts.speed <= FASTEST_WALK,
    ),
    "walk-turn-left": Rule(_CORNER, lambda facts: _turns(facts, 1)),
    "walk-turn-right": Rule(_CORNER, lambda facts: _turns(facts, -1)),
    "wave-both-hands": Rule(
        f"{_BOTH}; 2 waves or more", lambda facts: _both_up(facts) and _stands(facts) and facts.waves >= WAVES
    ),
    "wave-left-hand": Rule(
        f"{_ONE}; 2 waves or more", lambda facts: _only_up(facts, LEFT) and _stands(facts) and facts.waves >= WAVES
    ),
    "wave-right-hand": Rule(
        f"{_ONE}; 2 waves or more", lambda facts: _only_up(facts, RIGHT) and _stands(facts) and facts.waves >= WAVES
    ),
}
"""Content of dataset-2 -> what a motion of it does."""


class ContentResult(NamedTuple):
    """How often one content came out as asked."""

    content: str
    rule: str
    num_samples: int
    num_right: int
    failures: tuple[str, ...]
    """The sentences that failed."""


def follows(content: str, motion: Motion) -> bool:
    """Returns whether a motion keeps the rule of a content."""
    if motion.num_frames < 2:
        return False
    return RULES[content].holds(measure(motion.positions, fps=motion.fps))


def requests(content: str, *, num_seeds: int) -> list[tuple[int, str]]:
    """Returns seeds 0 to `num_seeds` - 1, each with one of the content's held-out sentences in turn."""
    sentences = held_out_sentences()[content]
    return [(seed, sentences[seed % len(sentences)]) for seed in range(num_seeds)]


def evaluate_prompt_following(generate: Callable[[str, int], Motion], *, num_seeds: int) -> list[ContentResult]:
    """Returns one row a content.

    Args:
        generate: Makes the motion of a sentence and a seed.
        num_seeds: Samples a content.
    """
    results = []
    for content, rule in RULES.items():
        asked = requests(content, num_seeds=num_seeds)
        failures = tuple(sentence for seed, sentence in asked if not follows(content, generate(sentence, seed)))
        results.append(ContentResult(content, rule.words, len(asked), len(asked) - len(failures), failures))
    return results


def markdown_table(results: list[ContentResult]) -> str:
    """Returns the rows as a Markdown table with a last row for all."""
    lines = ["| content | rule | did what was asked |", "| --- | --- | ---: |"]
    lines += [f"| {row.content} | {row.rule} | {row.num_right} of {row.num_samples} |" for row in results]
    right, total = sum(row.num_right for row in results), sum(row.num_samples for row in results)
    lines.append(f"| **all** | | **{right} of {total} ({right / total:.0%})** |")
    return "\n".join(lines)
