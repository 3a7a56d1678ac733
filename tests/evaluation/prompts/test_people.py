"""Sentences that are read from a file of KIT's captions."""

import json

import pytest

from t2m_jax.errors import UserError
from t2m_jax.evaluation.prompts.people import kit_tests


def write(path, *entries):
    """Writes motions with their captions, numbered from 1; twins have an M."""
    motions = {
        number: {"path": f"KIT/4/{motion}_poses", "annotations": [{"text": text} for text in texts]}
        for number, motion, texts in entries
    }
    path.write_text(json.dumps(motions))
    return path


def sentences(path):
    return {test.name: test.sentences for test in kit_tests(path)}


def test_captions_are_labeled_by_the_motion_and_by_words(tmp_path):
    path = write(
        tmp_path / "captions.json",
        ("1", "walking_medium01", ["A person walks.", "a person walks", "he walks and waves", "a person stumbles on"]),
        ("2", "bend_left03", ["a turn to the left", "walks a quarter circle to the left.", "a circle to the left"]),
        ("3", "bend_right03", ["somebody goes right", "first left, then right"]),
        ("M4", "walking_medium01", ["a twin walks"]),
        ("5", "wave_right02", ["waving with the right arm", "he waves", "waves with the right hand once"]),
        ("6", "run04", ["a man jogs", "a man goes"]),
        ("7", "kick01", ["a man walks"]),
    )
    assert sentences(path) == {
        "walk": ("A person walks.",),
        "walk-turn-left": ("a turn to the left", "walks a quarter circle to the left."),
        "walk-turn-right": ("somebody goes right",),
        "wave-right-hand": ("waving with the right arm",),
        "run": ("a man jogs",),
    }


def test_of_many_captions_some_are_taken_evenly(tmp_path):
    path = write(tmp_path / "captions.json", ("1", "walking_slow1", [f"he walks {number} m" for number in range(300)]))
    drawn = sentences(path)["walk"]
    assert len(drawn) == len(set(drawn)) == 80
    assert (drawn[0], drawn[-1]) == ("he walks 0 m", "he walks 299 m")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[]", "is not a table of motions"),
        ("{}", "has no caption of walking"),
        ('{"7": {"annotations": []}}', "motion '7' has no `path`"),
        ('{"7": [1]}', "motion '7' has no `path`"),
        ('{"7": {"path": "KIT/4/run01"}}', "motion '7' has no list `annotations`"),
        ('{"7": {"path": "KIT/4/run01", "annotations": [{"text": 3}]}}', "motion '7' has no list `annotations`"),
    ],
)
def test_other_files_are_refused_by_name(tmp_path, text, message):
    path = tmp_path / "captions.json"
    path.write_text(text)
    with pytest.raises(UserError, match=message) as caught:
        kit_tests(path)
    assert f"{path}" in f"{caught.value}"
