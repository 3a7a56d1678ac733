"""Counts how often a model does what sentences ask for that were written without regard to its captions.

    python docs/measure/wordings.py [--model demo]

Many of them have words that the packaged models have not learned.
"""

import argparse
import functools
import warnings

from t2m_jax.evaluation.prompts.following import (
    RULES,
    PromptTest,
    evaluate_prompt_following,
    follows,
)
from t2m_jax.evaluation.prompts.results import following_table
from t2m_jax.sampling import TextToMotion
from t2m_jax.text.coverage import PromptWarning

SENTENCES = {
    "walk": """a lady is walking down the street
my neighbour strolls along the path
walk from here to there
an old gentleman goes for a short walk in the park
the robot walks in a straight line across the room
a soldier marches forward""",
    "run": """a kid runs down the street
the athlete sprints forward
run as straight as you can
a woman is jogging through the park
someone hurries ahead at a run
a runner runs past""",
    "walk-turn": """a woman walks up to the corner and takes a {side} turn
walk ahead for a while and turn {side} at the end
the man strolls forward, then curves off to the {side}
a boy walks, then bends around to his {side}
please walk on and go around the {side} corner
the guard walks straight on and turns {side} at the wall""",
    "wave": """a tourist waves with their {side} hand
the kid is waving its {side} hand at us
wave to the crowd using the {side} hand
he waves cheerfully with his {side} arm
a lady waves her {side} hand to say hi
the sailor swings his {side} arm in greeting""",
    "wave-both-hands": """a fan waves both hands
the lady waves her arms to get attention
wave to the crowd with both your hands
a lost man waves both arms at a plane
she is waving hello with both of her arms
a child happily waves two hands""",
    "raise-up": """a pupil puts up the {side} hand
the referee raises his {side} arm
lift your {side} arm up
a woman stretches the {side} arm high above her
the {side} hand goes up and comes back down
he reaches up to a shelf with his {side} hand""",
    "raise-up-both-hands": """a goalkeeper stretches both arms up
put your hands up
the winner throws both arms into the air
a man lifts both arms over his head
she raises her two hands toward the roof
both hands go up and come down""",
    "stand": """a man just stands there
stay where you are
a guard stands still
she is waiting
the person does not move
a statue of a man""",
}
"""Sentences of each content, a line each, or of a content of both sides."""


def tests() -> list[PromptTest]:
    """Returns a test for each content."""
    found = []
    for content, rule in RULES.items():
        side = "left" if "left" in content else "right"
        shared = content.replace("-left", "").replace("-right", "").removesuffix("-hand")
        sentences = SENTENCES.get(content) or SENTENCES[shared]
        lines = tuple(sentences.format(side=side).splitlines())
        found.append(PromptTest(content, rule.words, lines, functools.partial(follows, content)))
    return found


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--model", default="demo")
    parser.add_argument("--count", type=int, default=30, help="motions of each content")
    options = parser.parse_args()
    warnings.simplefilter("ignore", PromptWarning)
    model = TextToMotion.load(options.model)
    results = evaluate_prompt_following(
        tests(), lambda sentence, seed: model.generate(sentence, seed=seed)[0], num_seeds=options.count
    )
    print(following_table(results))  # noqa: T201


if __name__ == "__main__":
    main()
