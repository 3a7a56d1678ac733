"""Which known actions are nearest to another one, with the sentence encoder of the package."""

import numpy as np
import pytest

from t2m_jax.checkpoints.text_encoder import SentenceReference
from t2m_jax.models.caption_encoder import StateEncoderConfig
from t2m_jax.sampling.text_encoders import SentenceStates, StatesTextEncoder
from t2m_jax.text.coverage import Knowledge, check_coverage, make_knowledge
from t2m_jax.text.meanings import Meanings, Nearest, sentence_of
from t2m_jax.text.verbs import inflected, words_of

ACTIONS = ("walk", "run", "wave", "jump", "sit", "crawl", "climb", "clap", "punch")
WORDS = frozenset(
    ["a", "person", "the", "man", "somebody", "with", "his", "hand", "and", "then", "forward"]
) | frozenset(ACTIONS)


@pytest.fixture(scope="module")
def encoder():
    return StatesTextEncoder(StateEncoderConfig(), {}, SentenceStates(SentenceReference(name="minilm")))


def test_no_captions_have_no_embeddings(encoder):
    assert encoder([]).shape == (0, StateEncoderConfig().text_dim)


@pytest.fixture(scope="module")
def knowledge(encoder):
    return Knowledge(WORDS, ACTIONS, Meanings(ACTIONS, encoder.sentence_embeddings))


def warning(prompt, knowledge):
    return check_coverage(prompt, knowledge, read_part=prompt).warning


@pytest.mark.parametrize("prompt", ["a person strolls", "a man jogs and then walks", "somebody applauds"])
def test_a_known_action_in_other_words_is_no_reason_to_warn(knowledge, prompt):
    assert warning(prompt, knowledge) == ""


@pytest.mark.parametrize(
    ("prompt", "verb"),
    [("a person swims", "swims"), ("the man sleeps and then walks", "sleeps"), ("a person plays the piano", "plays")],
)
def test_an_unknown_action_is_named_with_the_nearest_ones(knowledge, prompt, verb):
    said = warning(prompt, knowledge)
    assert said.startswith(f"{prompt!r}: {verb}: not known; nearest: ")
    nearest = said.partition("nearest: ")[2].partition(";")[0].split(", ")
    assert len(nearest) == 2 and set(nearest) <= {inflected(action, "VBZ") for action in ACTIONS}


def test_a_word_may_be_an_unknown_verb_and_a_noun(knowledge):
    first, _, second = (word.action for word in words_of("rung by rung"))
    assert not first and second, "read as the same: the test sees nothing"
    assert "rung: not known; nearest: " in warning("the man climbs, rung by rung", knowledge)


def test_a_sentence_without_a_verb_that_tells_it_is_compared_as_a_whole(encoder):
    actions = ("walk", "run", "jump")
    words = frozenset(["a", "person", "makes", "his", "way", "ahead", "on", "foot", "is", "having", "dinner"])
    meanings = Meanings(actions, lambda sentences: np.eye(4)[[_axis(text) for text in sentences]])
    knowledge = Knowledge(words, actions, meanings)
    assert warning("a person makes his way ahead", knowledge) == ""
    said = warning("a person is having dinner", knowledge)
    assert "it has no action that the model knows; the model knows" in said, "nothing is near"


@pytest.mark.parametrize("prompt", ["gets up", "a person gets up off the floor", "trudging along", "a man marches off"])
def test_actions_with_verbs_that_say_nothing_and_rare_gaits_are_known(encoder, prompt):
    actions = (*ACTIONS, "rise", "stand")
    words = WORDS | frozenset(prompt.split())
    assert (
        warning(
            prompt,
            Knowledge(words, actions, Meanings(actions, encoder.sentence_embeddings, learned=["a person gets up"])),
        )
        == ""
    )


@pytest.mark.parametrize(
    ("prompt", "nearest"), [("the hand", ""), ("with his", ""), ("applause", "; nearest: claps, ")]
)
def test_only_what_is_near_is_named(knowledge, prompt, nearest):
    said = warning(prompt, knowledge._replace(words=WORDS | {"applause"}))
    assert f"it has no action that the model knows{nearest or ';'}" in said and ("nearest" in said) == bool(nearest)


def _axis(sentence):
    """Of vectors that mean walking, running, jumping, and something else."""
    words = ("walks", "runs", "jumps")
    return 0 if "way" in sentence else next((place for place, word in enumerate(words) if word in sentence), 3)


LEARNED = (
    *("a person directs traffic", "a person manages traffic at a crossing", "a person helps cars through a crossing"),
    *("a person punches forward", "a person walks forward", "a person performs a kata"),
)
MISSING = ("a person throws something", "a person tosses a ball", "a person waves with the left hand")


@pytest.fixture(scope="module")
def partly(encoder):
    meanings = Meanings(ACTIONS, encoder.sentence_embeddings, learned=LEARNED, missing=MISSING)
    return Knowledge(WORDS | {"throws", "punches", "left", "ball", "one", "cars", "through"}, ACTIONS, meanings)


@pytest.mark.parametrize(
    ("prompt", "like"),
    [("a person waves with his left hand", MISSING[2]), ("the man throws the ball", MISSING[1])],
)
def test_a_known_verb_in_a_sense_that_was_not_learned_warns(partly, prompt, like):
    said = f"{prompt!r}: the training data have no motion like {like!r}; the model knows "
    assert warning(prompt, partly).startswith(said)


@pytest.mark.parametrize("prompt", ["the man throws punches", "a person waves cars through", "a man performs a kata"])
def test_a_sense_that_was_learned_does_not_warn(partly, prompt):
    words = partly.words | {"performs", "kata"}
    assert warning(prompt, partly._replace(words=words)) == ""


def test_without_missing_sentences_none_is_embedded():
    assert Meanings(("walk",), lambda sentences: 1 / 0, learned=LEARNED).missing("a person waves") == ""


@pytest.fixture(scope="module")
def doubtful(encoder):
    meanings = Meanings(ACTIONS, encoder.sentence_embeddings, learned=LEARNED)
    return Knowledge(WORDS | {"performs", "kata", "sits", "makes", "moves"}, ACTIONS, meanings)


@pytest.mark.parametrize(
    ("prompt", "like"),
    [
        ("the man sits and knits a hat", "knits: not known"),
        ("a person makes a chess move", "like 'a person plays chess'"),
    ],
)
def test_an_unknown_activity_warns_also_if_its_verb_is_known(doubtful, prompt, like):
    assert like in warning(prompt, doubtful)


@pytest.mark.parametrize("prompt", ["the man performs a kata in the attic", "a person walks forward over the lawn"])
def test_an_unknown_word_is_no_activity(doubtful, prompt):
    assert warning(prompt, doubtful) == ""


def test_activities_matter_only_beside_unknown_words(doubtful):
    known = doubtful._replace(words=doubtful.words | {"chess", "move"})
    assert "no motion like" not in warning("a person makes a chess move", known)


def test_an_activity_that_captions_taught_is_none(encoder):
    def said(words, **more):
        record = {"words": dict.fromkeys(words, 100), "actions": {"ride": 50, "walk": 50}, "num_clips": 100} | more
        knowledge = make_knowledge(record | {"learned": LEARNED}, encoder.sentence_embeddings)
        return warning("a person rides a bicycle in the attic", knowledge)

    words = ["a", "person", "ride", "rides", "in", "the", "walk"]
    assert "like 'a person rides a bicycle'" in said(words)
    assert said([*words, "bicycle"]) == ""
    # A taught sentence about something else may have the word.
    assert "like 'a person rides a bicycle'" in said(words, taught=["bicycle"])


def test_embeddings_do_not_depend_on_the_batch(encoder):
    texts = [f"a person walks {number} steps" for number in range(40)]
    together = encoder.sentence_embeddings(texts)
    assert together.shape == (40, 384)
    np.testing.assert_allclose(encoder.sentence_embeddings(texts[35:36])[0], together[35], atol=1e-3)  # 16-bit states


def test_without_actions_nothing_is_near():
    meanings = Meanings((), lambda sentences: 1 / 0)
    assert meanings.nearest("a person swims") == Nearest((), is_same=False, is_near=False)
    said = warning("a person swims", Knowledge(WORDS, (), meanings))
    assert said == "'a person swims': not learned, so without effect: swims"


@pytest.mark.parametrize(
    ("caption", "place", "sentence"),
    [
        ("he plays the old piano loudly", 1, "a person plays the old piano"),
        ("she is swimming across the lake", 2, "a person swims"),
        ("climbs and walks", 0, "a person climbs"),
    ],
)
def test_a_sentence_has_the_verb_and_its_object(caption, place, sentence):
    assert sentence_of(words_of(caption), place) == sentence
