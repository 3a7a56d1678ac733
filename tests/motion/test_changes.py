"""`Changes`: each value is checked once, and the order is that of the fields."""

import dataclasses

import numpy as np
import pytest

from t2m_jax.data.importers.synthetic import make_motion
from t2m_jax.errors import UserError
from t2m_jax.motion.changes import Changes
from t2m_jax.motion.motion import Motion

NAN = float("nan")


@pytest.fixture(scope="module")
def walk():
    return Motion(make_motion("walk", seed=1, num_frames=120), 20.0, caption="a person turns left")


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"begin": -1.0}, "begin: -1 is not a number of seconds from 0"),
        ({"begin": NAN}, "begin: nan"),
        ({"begin": 2.0, "end": 1.0}, "end: 1 s is not after 2 s, where the motion begins"),
        ({"end": 0.0}, "end: 0 s is not after 0 s"),
        ({"end": -1.0}, "end: -1 is not a number of seconds from 0"),
        ({"end": NAN}, "end: nan"),
        ({"speed": 0.0}, "speed: 0.0 is not a number from 0.1 to 10"),
        ({"speed": NAN}, "speed: nan"),
        ({"turn": 1000.0}, "turn: 1000.0 is not a number from -720 to 720 degrees"),
        ({"turn": NAN}, "turn: nan"),
        ({"path": ((0.0, 0.0),)}, "path: 1 point; give two or more"),
        ({"path": ((0.0, 0.0), (0.0, 0.0))}, "path: points 1 and 2 are at the same place"),
        ({"path": ((0.0, 0.0), (1.0, 2.0)), "turn": 30.0}, "turn: excludes path"),
        ({"fps": 0.0}, "fps: 0.0 is not a number above 0, up to 1000"),
        ({"fps": NAN}, "fps: nan"),
    ],
)
def test_changes_that_no_motion_can_have_are_one_line(fields, said):
    with pytest.raises(UserError, match=said) as refused:
        Changes(**fields)
    assert "\n" not in str(refused.value)


WRONG = {
    "begin: 'a' is not a number": (lambda motion: motion.trimmed("a"), {"begin": "a"}),
    "begin: True is not a number": (lambda motion: motion.trimmed(True), {"begin": True}),
    "end: '2' is not a number": (lambda motion: motion.trimmed(0, "2"), {"end": "2"}),
    "speed: None is not a number": (lambda motion: motion.at_speed(None), {"speed": None}),
    "speed: 'a' is not a number": (lambda motion: motion.at_speed("a"), {"speed": "a"}),
    "turn: True is not a number": (lambda motion: motion.turned(True), {"turn": True}),
    "turn: 'x' is not a number": (lambda motion: motion.turned("x"), {"turn": "x"}),
    "fps: 'x' is not a number": (lambda motion: motion.resampled("x"), {"fps": "x"}),
    r"path: 5 is not points of two numbers": (lambda motion: motion.along(5), {"path": 5}),
    r"path: \[1, 2\] is not points of two numbers": (lambda motion: motion.along([1, 2]), {"path": [1, 2]}),
    "path: '1' is not a number": (lambda motion: motion.along([(0, 0), (0, "1")]), {"path": ((0, 0), (0, "1"))}),
}


@pytest.mark.slow  # the fast tests check types by themselves
@pytest.mark.parametrize("said", WRONG)
def test_arguments_of_another_type_are_named(walk, said):
    change, fields = WRONG[said]
    for act in (lambda: change(walk), lambda: Changes(**fields)):
        with pytest.raises(UserError, match=f"^{said}"):
            act()


@pytest.mark.slow  # the fast tests check types by themselves
def test_numbers_of_numpy_are_numbers(walk):
    for number in (np.float32(2), np.int64(2), np.float64(2)):
        Changes(begin=number, speed=number, turn=number, fps=number, path=())
        assert walk.trimmed(number).num_frames == walk.num_frames - 40
        np.testing.assert_array_equal(walk.at_speed(number).positions, walk.at_speed(2).positions)
    path = np.array([[0, 0], [0, 5]])
    np.testing.assert_array_equal(walk.along(path).positions, walk.along(path.tolist()).positions)


def test_no_change_is_the_same_motion(walk):
    assert Changes().apply(walk) is walk


STEPS = {
    "end": (5.0, lambda motion: motion.trimmed(None, 5.0)),
    "clean": (True, lambda motion: motion.cleaned()),
    "mirror": (True, lambda motion: motion.mirrored()),
    "speed": (1.25, lambda motion: motion.at_speed(1.25)),
    "turn": (40.0, lambda motion: motion.turned(40.0)),
    "fps": (30.0, lambda motion: motion.resampled(30.0)),
    "loop": (True, lambda motion: motion.looped()),
    "in_place": (True, lambda motion: motion.in_place()),
}


def test_changes_are_applied_in_the_order_of_the_fields(walk):
    names = [field.name for field in dataclasses.fields(Changes)]
    assert [name for name in names if name in STEPS] == list(STEPS)
    expected = walk
    for _, change in STEPS.values():
        expected = change(expected)
    found = Changes(**{name: value for name, (value, _) in STEPS.items()}).apply(walk)
    np.testing.assert_array_equal(found.positions, expected.positions)
    assert (found.fps, found.caption) == (30.0, "a person turns right")


@pytest.mark.parametrize("name", STEPS)
def test_each_change_alone_is_the_method_of_motion(walk, name):
    value, change = STEPS[name]
    # A loop has at least 60 frames a second if no other rate is asked for.
    given = {"fps": 20.0} if name == "loop" else {}
    found = Changes(**{name: value} | given).apply(walk)
    np.testing.assert_array_equal(found.positions, change(walk).positions)


def test_a_path_replaces_the_turn(walk):
    points = ((0.0, 0.0), (0.5, 2.0), (2.0, 3.0))
    np.testing.assert_array_equal(Changes(path=points).apply(walk).positions, walk.along(points).positions)


def test_a_loop_is_found_in_the_frames_that_are_written(walk):
    found = Changes(loop=True).apply(walk)
    assert found.fps == 60
    np.testing.assert_array_equal(found.positions, walk.resampled(60.0).looped().positions)
