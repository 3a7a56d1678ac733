"""How long and how often, in the words of sentences."""

from pathlib import Path

import pytest
import yaml

from t2m_jax.motion.repetitions import COUNTED_ACTIONS, SIDED_ACTIONS
from t2m_jax.text.counts import said_side, said_times, uncounted
from t2m_jax.text.prompts import MAX_PROMPT_LENGTH
from t2m_jax.text.quantities import quantity_words, said_seconds, unread_amounts

SENTENCES = yaml.safe_load(Path(__file__).with_name("quantities.yaml").read_text())


def times_of(caption):
    times = said_times(caption, COUNTED_ACTIONS)
    return None if times is None else (times.action, times.number)


@pytest.mark.parametrize(
    ("words", "seconds"),
    [
        ("for five seconds", 5.0),
        ("for 2.5 seconds", 2.5),
        ("for 2,5 s", 2.5),
        ("(10s)", 10.0),
        ("for two and a half seconds", 2.5),
        ("for a minute and a half", 90.0),
        ("for a couple of seconds", 2.0),
        ("and stops after 8 seconds", 8.0),
        ("after 8 seconds", None),
        ("every two seconds", None),
        ("for 3 seconds or for 4 seconds", None),
        ("for 0 seconds", None),
        ("for 99999 minutes", None),
        ("on all fours", None),
        ("and pauses for two seconds", None),
        ("for twenty five seconds", 25.0),
        ("for Thirty-two seconds", 32.0),
        ("for ninety seconds", 90.0),
        ("for a hundred seconds", 100.0),
        ("for one hundred and twenty seconds", None),
        ("for two hundred seconds", None),
        ("for 1,200 seconds", None),
        ("like a man in his 70s", None),
        ("a man in his 30s walks for 5 seconds", 5.0),
        ("walks for 5s looking around", 5.0),
        ("for two to three seconds", None),
        ("and doesn't move for 5 seconds", None),
        ("for 1 min 30 s", 90.0),
        ("for about a minute", 60.0),
        ("for the next five seconds", 5.0),
        ("with five seconds left", None),
        ("while his friends clap for ten seconds", None),
        ("for 10s showing off", 10.0),
        ("a dance in the 80s style", None),
        ("like a woman in her late 30s", None),
        ("as in the 60s", None),
        ("in 80s clothes", None),
        ("in the 40 seconds that are left", 40.0),
    ],
)
def test_a_sentence_says_how_long_its_motion_is(words, seconds):
    assert said_seconds(f"a person walks {words}") == seconds


@pytest.mark.parametrize(
    ("caption", "times"),
    [
        ("kicks twice", ("kick", 2)),
        ("a man jumps 3 times", ("jump", 3)),
        ("a man jumps 3x", ("jump", 3)),
        ("throws two quick punches", ("punch", 2)),
        ("a single jump", ("jump", 1)),
        ("five reps of jumping jacks", ("jack", 5)),
        ("a double clap", ("clap", 2)),
        ("kicks the box three times", ("kick", 3)),
        ("kicks a box three times", ("kick", 3)),
        ("jumps and spins twice", None),
        ("turns around twice and sits down", None),
        ("jumps twice and claps three times", None),
        ("kicks twice with the left leg and once with the right", ("kick", 3)),
        ("takes two steps forward and two steps back", ("step", 4)),
        ("doesn't jump three times", None),
        ("jumps two or three times", None),
        ("picks up two boxes", None),
        ("rides two waves", None),
        ("falls down ten steps", None),
        ("twice, she bows", ("bow", 2)),
        ("jumps ten times, holding a rope", ("jump", 10)),
        ("raises the arm and lowers it twice", ("raise", 2)),
        ("while his mother claps four times", None),
        ("kicks big boxes three times", ("kick", 3)),
        ("throws a punch three times", ("punch", 3)),
        ("raises a hand to wave three times", ("wave", 3)),
        ("steps forward with a kick three times", ("kick", 3)),
        ("a person bows, then a jump three times", ("jump", 3)),
        ("jumps off the step two times", ("jump", 2)),
        ("claps sixty five times", None),
        ("claps 1,000 times", None),
        ("kicks twice as high", None),
        ("once he sits, he waves", None),
        ("waves with one hand", None),
        ("jumps 2.5 times", None),
        ("kicks 1000 times", None),
        ("walks twice", None),
        # Numbers of something else.
        ("a 7 year old jumps", None),
        ("a 6 foot man jumps", None),
        ("a man with 3 dogs kicks", None),
        ("a group of three claps", None),
        ("on the count of three he jumps", None),
        ("player 2 jumps", None),
        ("in scene 2 he jumps", None),
        ("the person walks two steps per second", None),
        ("stays two steps behind", None),
        ("one hand waves", None),
        ("he jumps once or twice", None),
        ("claps twice or three times", None),
        ("jumps three times, maybe four times", None),
        ("two roundhouse kicks", ("kick", 2)),
        ("a set of three star jumps", ("jump", 3)),
        ("makes three step to the front", ("step", 3)),
        ("takes two steps away from the wall", ("step", 2)),
    ],
)
def test_a_sentence_says_how_often(caption, times):
    assert times_of(caption) == times


def test_the_side_counts():
    assert said_times("waves twice with the left hand", COUNTED_ACTIONS).sides == {"left"}
    assert said_times("waves twice", COUNTED_ACTIONS).sides == {"left", "right"}
    assert said_times("throws two right-hand punches", COUNTED_ACTIONS).sides == {"right"}
    assert said_times("takes two steps to the left", COUNTED_ACTIONS).sides == {"left", "right"}
    assert said_times("kicks left and right three times", COUNTED_ACTIONS).sides == {"left", "right"}


@pytest.mark.parametrize(
    ("caption", "amounts"),
    [
        ("walks three meters", ["three meters"]),
        ("runs a mile", ["a mile"]),
        ("walks 2m, then turns ninety degrees", ["2m", "ninety degrees"]),
        ("walks for an hour", ["an hour"]),
        ("runs for two to three seconds", ["three seconds"]),
        ("runs for 3-5 seconds", ["3-5 seconds"]),
        ("walks for eleven minutes", ["eleven minutes"]),
        ("walks ten feet", ["ten feet"]),
        ("I am walking", []),
        ("jumps with two feet", []),
        ("jumps 50 cm high", []),
        ("walks for five seconds", []),
        ("after three seconds she waves", []),
        ("every two seconds", []),
    ],
)
def test_amounts_that_nothing_follows(caption, amounts):
    assert [amount for amount, _ in unread_amounts(caption)] == amounts


@pytest.mark.parametrize(
    ("caption", "found"),
    [
        ("spins twice", ["twice"]),
        ("sits down and claps, five times", []),
        ("jumps 2 times and claps 3 times", ["2 times", "3 times"]),
        ("kicks 100 times", ["100 times"]),
        ("turns around once", []),
        ("kicks twice", []),
        ("jumps two or three times", ["three times"]),
    ],
)
def test_times_that_are_not_counted(caption, found):
    assert [times for times, _ in uncounted(caption, COUNTED_ACTIONS)] == found


@pytest.mark.parametrize(
    ("caption", "said"),
    [
        ("a person kicks with the right leg", ("kick", "right")),
        ("a Left-footed kick", ("kick", "left")),
        ("kicks high with his left, then rests", ("kick", "left")),
        ("throws the ball with her left hand", ("throw", "left")),
        ("a right high kick", ("kick", "right")),
        ("kicks to the left", None),
        ("kicks with the left leg, then with the right leg", None),
        ("kicks", None),
        ("waves with the left hand", None),
        ("does not kick with the left leg", None),
        ("throws or kicks with the left foot", None),
        ("steps left and kicks", None),
        ("kicks to the right-hand side", None),
        ("kicks while holding a bottle in the left hand", None),
        ("throws the ball at his opponent's left leg", None),
        ("standing on the left leg, she kicks with the right", ("kick", "right")),
        ("kicks with the right leg and raises the left hand", ("kick", "right")),
        ("throws a punch with the right fist, stepping on the left foot", ("throw", "right")),
    ],
)
def test_the_side_of_an_action(caption, said):
    assert said_side(caption, SIDED_ACTIONS) == said


def test_words_of_quantities():
    assert quantity_words("a man jumps 3 times in five seconds") == {"3", "times", "five", "seconds"}
    assert not quantity_words("after three seconds he jumps")
    assert quantity_words("a man walks 4 big steps", COUNTED_ACTIONS) == {"4"}
    assert not quantity_words("a man walks 4 dogs", COUNTED_ACTIONS)
    assert not quantity_words("a man walks 4 steps in a curve", COUNTED_ACTIONS)
    assert times_of("a man sweeps the four steps") is None
    assert times_of("he stands 3 steps behind the line") is None


def test_sentences_of_other_people_say_how_long_and_how_often():
    right = [said_seconds(one["text"]) == one["seconds"] for one in SENTENCES["lengths"]]
    assert sum(right) >= 58 and len(right) == 60
    counted = [one for one in SENTENCES["counts"] if one["verb"] in COUNTED_ACTIONS]
    found = [(one, times_of(one["text"])) for one in counted]
    assert sum(times is not None and times[1] == one["times"] for one, times in found) >= 28 and len(found) == 34
    neither = [said_seconds(one["text"]) is None and times_of(one["text"]) is None for one in SENTENCES["neither"]]
    assert sum(neither) >= 58 and len(neither) == 59


@pytest.mark.parametrize("rest", ["and turns left", "in a curve to the right", "around the corner"])
def test_steps_on_a_path_with_a_turn_are_not_counted(rest):
    assert times_of("a person walks four steps") == ("step", 4)
    assert times_of(f"a person walks four steps {rest}") is None


@pytest.mark.parametrize("words", ["2 ", "a couple of ", "stops after 1", "half a ", "two 1 s 3x ", "one-"])
def test_long_sentences_are_read(words):
    caption = (words * MAX_PROMPT_LENGTH)[:MAX_PROMPT_LENGTH].strip()
    assert said_seconds(caption) is None or said_seconds(caption) > 0
    assert times_of(caption) is None
