"""Teaching a model other words for what it knows."""

import dataclasses
import random

import jax
import numpy as np
import pytest

from t2m_jax.checkpoints.bundle import BundleConfig, load_bundle, save_bundle
from t2m_jax.checkpoints.text_encoder import SentenceReference, SentenceStatesConfig
from t2m_jax.cli.main import main
from t2m_jax.data.captioning.held_out import fingerprint, held_out_fingerprints
from t2m_jax.data.folder import open_dataset
from t2m_jax.data.importers.synthetic import write_synthetic_dataset
from t2m_jax.errors import UserError
from t2m_jax.models.caption_encoder import StateEncoderConfig
from t2m_jax.sampling.text_encoders import make_text_encoder
from t2m_jax.text.coverage import MIN_USES, make_knowledge
from t2m_jax.text.encoder import TextEncoder
from t2m_jax.train.lessons import (
    HELD_OUT_EVERY,
    NUM_REWORDED,
    Lesson,
    kept_captions,
    known_meanings,
    load_lessons,
    vary_lessons,
    with_taught_words,
)
from t2m_jax.train.teaching import teach
from tests.sentence_golden import BERT
from tests.tiny import BUNDLE, CAPTIONS, random_bundle

WALK, WAVE = CAPTIONS[:2]
LESSONS = tuple(
    Lesson(sentence, meaning, meaning)
    for meaning, sentences in {WALK: ("off she goes", "on foot ahead"), WAVE: ("left-handed hello", "hi there")}.items()
    for sentence in sentences
)
FILE = """
a person waves with the left hand:
  - left-handed hello
  - wave L
a person walks forward:
  - off she goes
  - left foot, right foot
"""


def write(folder, text):
    path = folder / "sentences.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_side_is_a_lesson_for_both_sides(tmp_path):
    lessons, held_out = load_lessons(write(tmp_path, FILE))
    assert held_out == ()
    right = "a person waves with the right hand"
    assert lessons == (
        Lesson("left-handed hello", WAVE, WAVE),
        Lesson("right-handed hello", right, right),
        Lesson("wave L", WAVE, WAVE),
        Lesson("off she goes", WALK, WALK),
        Lesson("left foot, right foot", WALK, WALK),
    )


def test_every_tenth_sentence_of_a_meaning_is_held_out(tmp_path):
    lines = "".join(f"  - number {number} with the left hand\n" for number in range(1, 2 * HELD_OUT_EVERY + 3))
    lessons, held_out = load_lessons(write(tmp_path, f"a person waves with the left hand:\n{lines}"))
    assert [lesson.sentence.split()[1] for lesson in held_out] == ["10", "10", "20", "20"]
    assert {side for lesson in held_out for side in ("left", "right") if side in lesson.sentence} == {"left", "right"}
    assert not {lesson.sentence for lesson in lessons} & {lesson.sentence for lesson in held_out}


def test_what_is_held_out_is_not_taught_for_the_other_side(tmp_path):
    """Both lists have the same sentences in another order, and each is also a lesson for the other side."""
    sides = {"left": range(HELD_OUT_EVERY), "right": reversed(range(HELD_OUT_EVERY))}
    lists = [
        f"a person waves with the {side} hand:\n" + "".join(f"  - number {number}, {side}\n" for number in numbers)
        for side, numbers in sides.items()
    ]
    lessons, held_out = load_lessons(write(tmp_path, "".join(lists)))
    assert {lesson.sentence for lesson in held_out} == {
        f"number {number}, {side}" for number in (0, HELD_OUT_EVERY - 1) for side in sides
    }
    assert not {lesson.sentence for lesson in lessons} & {lesson.sentence for lesson in held_out}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "has no sentences"),
        ("a person waves: hello", "expected a sentence with a list"),
        ("3: [hello]", "expected a sentence with a list"),
        ("a person waves: [3]", "3 is not a sentence"),
        ("a person waves: ['?!']", "has no words"),
        ("a person waves: [hello]\na person bows: [Hello]", "under 'a person waves' and under 'a person bows'"),
        ("a person waves: []", "has no sentences"),
    ],
)
def test_a_file_with_something_else_is_refused(tmp_path, text, message):
    with pytest.raises(UserError, match=f"sentences.yaml: .*{message}"):
        load_lessons(write(tmp_path, text))


def test_variations_ask_for_what_their_meaning_asks_for():
    varied = list(vary_lessons(LESSONS, random.Random(0)))
    assert len(varied) == 4 * len(LESSONS)
    for number, lesson in enumerate(LESSONS):
        plain, typed, manner, at_once = varied[4 * number : 4 * number + 4]
        assert plain == lesson and typed.like == lesson.like and typed.sentence.lower() != lesson.sentence
        for one in (manner, at_once):
            ending = one.sentence.removeprefix(lesson.sentence)
            assert ending.strip() and one == Lesson(lesson.sentence + ending, lesson.like + ending, lesson.meaning)
        assert "ing" in at_once.sentence
    assert any("while" in lesson.sentence for lesson in varied)


def test_a_question_gets_no_ending():
    question = Lesson("can you make him wave?", WAVE, WAVE)
    assert len(list(vary_lessons([question], random.Random(0)))) == 2


def test_kept_captions_of_a_model_come_in_many_wordings():
    data = {"captions": CAPTIONS}
    kept = kept_captions(None, data, seed=0)
    assert set(CAPTIONS) <= set(kept) and 3 * len(CAPTIONS) < len(kept) <= (1 + NUM_REWORDED) * len(CAPTIONS)
    assert kept == kept_captions(None, data, seed=0) != kept_captions(None, data, seed=1)


def test_actions_in_turn_are_kept_one_by_one_too():
    data = {"captions": ["a man walks, then he waves"], "actions": {"walk": 9, "wave": 9}, "num_clips": 9}
    kept = kept_captions(None, data, seed=0)
    assert {"a man walks, then he waves", "a man walks"} <= set(kept)


def test_kept_captions_of_a_data_set_are_those_of_its_training_clips(tmp_path):
    write_synthetic_dataset(tmp_path / "data", num_clips=20, seed=0)
    dataset = open_dataset(tmp_path / "data")
    kept = kept_captions(dataset, None, seed=0)
    training = {caption.text for name in dataset.names("train") for caption in dataset.captions(name)}
    assert kept and set(kept) <= training
    # Published lists name clips that have no files.
    with (tmp_path / "data" / "train.txt").open("a") as names:
        names.write("missing\n")
    assert set(kept_captions(open_dataset(tmp_path / "data"), None, seed=0)) == set(kept)


def test_words_that_lessons_teach():
    record = {"words": dict.fromkeys(["a", "person", "walks"], MIN_USES), "taught": ["boing"]}
    sentences = ("a rambler walks", "a rambler hikes", "hikes L twice north", "a person vaults")
    lessons = [Lesson(sentence, WALK, WALK) for sentence in sentences] + [Lesson("a person vaults", WAVE, WAVE)]
    # Not "vaults", a verb that no meaning has twice.
    assert with_taught_words(record, lessons)["taught"] == ["boing", "hikes", "rambler"]
    assert with_taught_words(None, lessons) is None


def test_what_a_model_does_not_know_is_not_taught(caplog):
    record = {"words": dict.fromkeys(["a", "person", "walks", "forward"], MIN_USES), "actions": {"walk": 9}}
    knowledge = make_knowledge(record | {"num_clips": 9})
    assert known_meanings(LESSONS, knowledge) == {WALK}
    (said,) = caplog.messages
    assert WAVE in said and said.endswith("the sentences under it are not taught")
    with pytest.raises(UserError, match="knows none of the meanings"):
        known_meanings(LESSONS[2:], knowledge)


def distances(encoder: TextEncoder, sentences, targets):
    """Returns how far embeddings are from their targets, relative to these."""
    found = np.asarray(encoder(sentences))
    return np.linalg.norm(found - targets, axis=1) / np.linalg.norm(targets, axis=1)


def check_taught(bundle, *, num_steps):
    before = make_text_encoder(bundle)
    taught = teach(bundle, LESSONS, CAPTIONS, held_out=LESSONS, num_steps=num_steps, seed=0)
    after = make_text_encoder(taught.bundle)
    sentences = [lesson.sentence for lesson in LESSONS]
    meant = np.asarray(before([lesson.like for lesson in LESSONS]))
    assert distances(after, sentences, meant).mean() < 0.5 * distances(before, sentences, meant).mean()
    assert distances(after, list(CAPTIONS), np.asarray(before(list(CAPTIONS)))).max() < 0.3
    # They were taught, so all are understood.
    assert taught.right_before < taught.right_after == len(LESSONS)
    for role in ("tokenizer", "generator"):
        assert taught.bundle.variables[role] is bundle.variables[role]
    return taught


def test_a_taught_sentence_means_what_another_does_and_captions_keep_their_meaning():
    taught = check_taught(random_bundle(), num_steps=150)
    again = teach(random_bundle(), LESSONS, CAPTIONS, held_out=LESSONS, num_steps=150, seed=0)
    jax.tree.map(np.testing.assert_array_equal, taught.bundle.variables, again.bundle.variables)


@pytest.mark.slow
def test_a_network_over_token_states_is_taught():
    network = StateEncoderConfig(state_dim=24, max_length=20, embed_dim=16, num_layers=1, num_heads=2, text_dim=12)
    reads = SentenceStatesConfig(encoder=SentenceReference(name=f"{BERT}"), network=network)
    bundle = random_bundle(dataclasses.replace(BUNDLE, text_encoder=reads))._replace(bpe=None)
    check_taught(bundle, num_steps=600)


def test_weights_that_do_not_stay_finite_are_refused():
    bundle = random_bundle()
    # All text embeddings are zero, and nothing is near to that, relative to it.
    params = jax.tree.map(np.zeros_like, bundle.variables["text_encoder"])
    with pytest.raises(UserError, match="did not stay finite"):
        teach(
            bundle._replace(variables=bundle.variables | {"text_encoder": params}),
            LESSONS,
            CAPTIONS,
            num_steps=2,
            seed=0,
        )


def test_an_encoder_of_others_is_neither_taught_nor_loaded(tmp_path, capsys):
    """No encoder has this name, so loading it would fail with another message."""
    reference = SentenceReference(name="nowhere")
    config = BundleConfig(tokenizer=BUNDLE.tokenizer, generator=BUNDLE.generator, text_encoder=reference)
    variables = {role: tree for role, tree in random_bundle().variables.items() if role != "text_encoder"}
    bundle = random_bundle()._replace(config=config, bpe=None, variables=variables)
    with pytest.raises(UserError, match="cannot be taught"):
        teach(bundle, LESSONS, CAPTIONS, num_steps=1, seed=0)
    save_bundle(tmp_path / "model", bundle, card="")
    assert main(["teach", f"{tmp_path / 'model'}", f"{write(tmp_path, FILE)}", f"{tmp_path / 'new'}"]) == 2
    assert "model: its text encoder was trained by others" in capsys.readouterr().err


def test_the_command_writes_a_model_that_generates(tmp_path, capsys):
    bundle = random_bundle()._replace(training_data={"captions": list(CAPTIONS)})
    save_bundle(tmp_path / "model", bundle, card="---\nlicense: mit\n---\n# Mine\n")
    path = write(
        tmp_path,
        f"{WAVE}:\n"
        + "".join(f"  - hello number {number}\n" for number in range(HELD_OUT_EVERY - 1))
        + "  - held out\n",
    )
    command = ["teach", f"{tmp_path / 'model'}", f"{path}", f"{tmp_path / 'taught'}", "--num-steps", "2"]
    assert main(command) == 0
    printed = capsys.readouterr()
    assert "of 1 sentences that were not taught, " in printed.out and "t2m generate" in printed.err
    taught = load_bundle(tmp_path / "taught")
    assert taught.license == "mit" and taught.training_data["captions"] == list(CAPTIONS)
    # The words of sentences that are held out are not taught.
    known = make_knowledge(taught.training_data).words
    assert {"hello", "number"} <= known and not {"held", "3"} & known
    assert main(command) == 2, "the folder is there already"
    generate = ["generate", "hello number 3", "--model", f"{tmp_path / 'taught'}", "-o", f"{tmp_path / 'a.npz'}"]
    assert main(generate) == 0


def test_the_command_refuses_what_it_cannot_teach(tmp_path, capsys):
    path = write(tmp_path, FILE)
    for arguments, message in (
        ([f"{tmp_path / 'nowhere'}", f"{path}", f"{tmp_path / 'new'}"], "nowhere: no such model"),
        (["demo", f"{tmp_path / 'nowhere.yaml'}", f"{tmp_path / 'new'}"], "nowhere.yaml: no such config file"),
        (["demo", f"{path}", f"{tmp_path / 'new'}", "--seed", "-1"], "seed: -1"),
        (["demo", f"{path}", f"{tmp_path / 'new'}", "--num-steps", "0"], "is not a whole number above 0"),
    ):
        assert main(["teach", *arguments]) == 2
        assert message in capsys.readouterr().err
    assert not (tmp_path / "new").exists()


def test_no_lesson_of_the_packaged_models_is_a_test_sentence(repository):
    lessons, held_out = load_lessons(repository / "configs/data/sentences.yaml")
    assert not held_out_fingerprints() & {fingerprint(lesson.sentence) for lesson in (*lessons, *held_out)}
