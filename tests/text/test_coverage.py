"""What a model can know of a prompt: warnings for what it cannot, none for what it can."""

from pathlib import Path

import pytest
import yaml

from t2m_jax.checkpoints.bundle import bundle_path, load_training_data
from t2m_jax.text.coverage import (
    MIN_CLIPS,
    MIN_LABELS,
    MIN_USES,
    OWN_CLIPS,
    Knowledge,
    check_coverage,
    count_actions,
    make_knowledge,
)

PROMPTS = yaml.safe_load((Path(__file__).parent / "prompts.yaml").read_text())


@pytest.fixture(scope="module")
def demo():
    return make_knowledge(load_training_data(bundle_path("demo")))


def warned(prompts, knowledge, limit=200):
    return [prompt for prompt in prompts if check_coverage(prompt, knowledge, read_part=prompt[:limit]).warning]


def test_the_demo_knows_what_it_can_show(demo):
    assert (len(PROMPTS["knows"]), len(PROMPTS["warn"])) == (37, 23)
    assert len(warned(PROMPTS["knows"], demo)) <= 2
    assert len(warned(PROMPTS["warn"], demo)) >= 19


def test_taught_words_are_known():
    record = {"words": dict.fromkeys(["a", "person", "walks"], MIN_USES), "actions": {"walk": 99}, "num_clips": 99}
    prompt = "boing boing boing boing, a person walks"
    assert warned([prompt], make_knowledge(record)) == [prompt]
    knowledge = make_knowledge(record | {"taught": ["boing", "walks"]})
    assert warned([prompt], knowledge) == [] and knowledge.taught == {"boing"}


def test_numbers_that_are_followed_have_an_effect(demo):
    for prompt in ("a person walks for seventeen seconds", "a person kicks nineteen times"):
        assert not check_coverage(prompt, demo, read_part=prompt).warning


@pytest.mark.parametrize(
    ("prompt", "said"),
    [
        ("a person swims north", "not learned, so without effect: swims, north; it has no action that the model knows"),
        ("a person walks seventeen steps", "not learned, so without effect: seventeen"),
        (
            "a person walks 90 degrees left",
            "90 degrees: without effect; the option `turn` bends the path of a sentence without a turn",
        ),
        (
            "a person walks every seventeen seconds",
            "not learned, so without effect: seventeen",
        ),
        ("a man does a backflip", "it has no action that the model knows"),
        ("asdf qwer", "not learned, so without effect: asdf, qwer; write it in English"),
        ("une personne marche lentement", "not learned, so without effect: une, personne, marche, lentement; write it"),
        (
            "b c d e f g h j k l m n o",
            "not learned, so without effect: b, c, d, e, f, g, h, j, k, l, m, n, ...; write it",
        ),
    ],
)
def test_a_warning_names_what_has_no_effect_and_what_the_model_knows(demo, prompt, said):
    warning = check_coverage(prompt, demo, read_part=prompt).warning
    assert warning.startswith(f"{prompt!r}: {said}")
    assert warning.endswith(f"; the model knows {', '.join(demo.actions[:12])}") and "walk" in demo.actions[:12]
    assert warning.isprintable() and len(warning) < 380


@pytest.mark.parametrize(
    ("prompt", "said"),
    [
        ("a person does not walk", "not walk: words like 'not' have no effect"),
        ("a person doesn't walk, he stands", "not walk: words like 'not' have no effect"),
        ("nobody waves", "not waves: "),
        ("no jumping", "not jumping: words like 'not' have no effect"),
        ("a person with no shoes walks", ""),
        ("he walks without stopping", ""),
        ("a person runs, not too fast", ""),
        ("a person jumps 0 times", "0 times: numbers of times from 1 to 20 are counted"),
        ("a person jumps a hundred times", "hundred times: numbers of times from 1 to 20"),
        ("a person jumps twenty times", ""),
    ],
)
def test_what_is_not_done_and_cannot_be_counted_is_said(demo, prompt, said):
    warning = check_coverage(prompt, demo, read_part=prompt, countable=("jump",)).warning
    assert said in warning if said else not warning


def test_words_that_matter_little_are_only_listed(demo):
    prompt = "My cousin walks forward in the cathedral, the cathedral"
    assert check_coverage(prompt, demo, read_part=prompt) == ("", ("cathedral",))


def test_a_prompt_that_is_cut_says_where(demo):
    warning = check_coverage("a person walks and waves", demo, read_part="a person walks").warning
    assert warning.startswith("'a person walks and waves': too long, so cut after 'a person walks'; the model knows")


def test_what_a_large_data_set_has_rarely_is_not_known():
    many = {"walk": 10**6, "wave": MIN_USES, "jump": MIN_USES - 1}
    actions = {"jump": MIN_CLIPS - 1, "wave": MIN_CLIPS, "walk": 9000}
    knowledge = make_knowledge({"num_clips": 10**5, "words": many, "actions": actions})
    assert knowledge == Knowledge({"walk", "wave"}, ("walk", "wave"))


def test_a_small_data_set_teaches_what_it_has():
    data = {"num_clips": 24, "words": {"he": 24, "walk": 23, "jump": 1}, "actions": {"walk": 23, "jump": 1}}
    knowledge = make_knowledge(data)
    assert knowledge == Knowledge({"he", "walk", "jump"}, ("walk", "jump"))
    assert warned(["he jumps", "he walks left", "he swims"], knowledge) == ["he walks left", "he swims"]


@pytest.mark.parametrize("data", [None, {}, {"num_clips": 3}])
def test_without_a_record_only_a_cut_is_told(data):
    knowledge = make_knowledge(data)
    assert knowledge == Knowledge(frozenset(), ())
    assert check_coverage("asdf", knowledge, read_part="asdf") == ("", ())
    assert (
        check_coverage("asdf qwer", knowledge, read_part="asdf").warning == "'asdf qwer': too long, so cut after 'asdf'"
    )


def test_words_without_actions_still_warn_of_verbs():
    knowledge = make_knowledge({"num_clips": 9, "words": {"a": 5, "person": 5, "walk": 5}})
    assert warned(["a person walks", "a person swims"], knowledge) == ["a person swims"]


def test_actions_are_counted_by_clip():
    captions = [["a person walks", "someone walks and waves"], ["a person makes a jump", "he walks"], []]
    assert count_actions(captions) == {"walk": 2, "jump": 1, "wave": 1}


def test_verbs_that_any_caption_may_have_are_no_actions():
    labels = [f"action {number % MIN_LABELS}" for number in range(OWN_CLIPS * MIN_LABELS)]
    captions = [[f"we saw how a person {'walks' if label == 'action 4' else 'jumps'}"] for label in labels]
    captions[4] = ["a person trots"]
    walks = OWN_CLIPS - 1
    assert count_actions(captions, labels) == {"walk": walks}
    few = [label.replace("7", "6") for label in labels]
    assert count_actions(captions, few) == {"see": len(labels) - 1, "jump": len(labels) - 8, "walk": walks, "trot": 1}
    assert count_actions(captions[1:], labels[1:])["walk"] == walks
    assert count_actions(captions[: 7 * MIN_LABELS], labels[: 7 * MIN_LABELS]) == {}


def test_verbs_of_plain_sentences_are_actions_unless_no_clip_shows_them():
    labels = [f"action {number % MIN_LABELS}" for number in range(OWN_CLIPS * MIN_LABELS)]
    captions = [["a person punches, throws a fist and raises the guard"] for _ in labels]
    learned, missing = ["a person punches", "a person raises the guard"], ["a person throws something"]
    assert count_actions(captions, labels) == {}
    assert count_actions(captions, labels, learned=learned) == dict.fromkeys(("punch", "raise"), len(labels))
    assert count_actions(captions, learned=learned, missing=[*missing, "a person raises a hand"]) == dict.fromkeys(
        ("punch", "raise"), len(labels)
    )
    assert "throw" in count_actions(captions)


def test_corrected_words_are_named(demo):
    corrected = {"wlaks": "walks"}
    assert check_coverage("he walks", demo, read_part="he walks", typed="he wlaks", corrected=corrected).warning == (
        "'he wlaks': wlaks: read as walks"
    )
    warning = check_coverage("he walks north", demo, read_part="he walks north", corrected=corrected).warning
    assert warning.startswith(
        "'he walks north': wlaks: read as walks; not learned, so without effect: north; the model"
    )
