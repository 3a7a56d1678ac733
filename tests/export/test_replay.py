"""Data sets of motion that a model generates."""

import numpy as np
import pytest

from t2m_jax.checkpoints.bundle import save_bundle
from t2m_jax.cli.main import main
from t2m_jax.data import open_dataset
from t2m_jax.errors import UserError
from t2m_jax.export.replay import write_replay
from t2m_jax.sampling import TextToMotion
from tests.tiny import random_bundle

pytestmark = pytest.mark.slow

CAPTIONS = ["a person walks", "someone waves", "a man turns left"]


@pytest.fixture(scope="module")
def model():
    return TextToMotion(random_bundle()._replace(training_data={"captions": CAPTIONS}))


def test_a_model_generates_its_captions_again(model, tmp_path):
    report = write_replay(model, tmp_path / "old", num_clips=7, seed=1)
    dataset = open_dataset(tmp_path / "old")
    clips = dataset.clips("train")
    assert len(clips) + len(report.left_out) == 7 and report.num_clips == len(clips) == report.split_sizes["train"]
    assert {caption.text for clip in clips for caption in clip.captions} <= set(CAPTIONS)
    assert dataset.info.licence == model.license and report.num_frames == sum(len(clip.features) for clip in clips)
    write_replay(model, tmp_path / "again", num_clips=7, seed=1)
    for clip, same in zip(clips, open_dataset(tmp_path / "again").clips("train"), strict=True):
        assert clip.name == same.name and clip.captions == same.captions
        np.testing.assert_array_equal(clip.features, same.features)


def test_captions_are_sampled_as_they_are_learned(model, tmp_path, monkeypatch):
    """A caption of several actions is one motion of the model's length, not one for each of them."""
    asked = []
    generate = model.generate
    monkeypatch.setattr(
        model, "generate", lambda *given, **options: asked.append(options) or generate(*given, **options)
    )
    write_replay(model, tmp_path / "old", sentences=["a man walks, then waves, then jumps"], num_clips=3)
    assert [options["whole"] for options in asked] == [True] * 3


def test_sentences_may_be_given(model, tmp_path):
    write_replay(model, tmp_path / "old", sentences=["somebody jumps"], num_clips=3)
    found = {caption.text for clip in open_dataset(tmp_path / "old").clips("train") for caption in clip.captions}
    assert found == {"somebody jumps"}


def test_a_sentence_that_comes_twice_gives_two_motions(model, tmp_path):
    write_replay(model, tmp_path / "old", sentences=["somebody jumps"], num_clips=70)
    found = [clip.features for clip in open_dataset(tmp_path / "old").clips("train")]
    assert len({features.tobytes() for features in found}) > 60  # tiny models often stop after the same few codes


def test_a_model_without_captions_needs_sentences(tmp_path):
    with pytest.raises(UserError, match="no record of its captions; give sentences"):
        write_replay(TextToMotion(random_bundle()), tmp_path / "old", num_clips=4)
    with pytest.raises(UserError, match="the text format cannot store '#'"):
        write_replay(TextToMotion(random_bundle()), tmp_path / "old", num_clips=4, sentences=["he waves", "he # walks"])
    assert not (tmp_path / "old").exists()


@pytest.mark.parametrize(("seed", "wrong"), [(-1, -1), (2**32 - 2, 2**32)])
def test_seeds_of_all_repetitions_are_checked_first(model, tmp_path, monkeypatch, seed, wrong):
    """Seven clips of three sentences have three seeds."""
    monkeypatch.setattr(model, "generate", lambda *_, **__: pytest.fail("sampled before"))
    with pytest.raises(UserError, match=f"seed: {wrong} is not between"):
        write_replay(model, tmp_path / "old", num_clips=7, seed=seed)
    assert not (tmp_path / "old").exists()


def test_the_command(tmp_path, capsys):
    (tmp_path / "sentences.txt").write_text("a person walks forward\n\n  someone waves \n")
    bundle = random_bundle()._replace(training_data={"captions": CAPTIONS})
    save_bundle(tmp_path / "tiny", bundle, card="# tiny\n")
    command = ["data", "replay", f"{tmp_path / 'old'}", "--model", f"{tmp_path / 'tiny'}", "--num-clips", "4"]
    assert main([*command, "--sentences", f"{tmp_path / 'sentences.txt'}"]) == 0
    assert "4 clips" in capsys.readouterr().out
    found = {caption.text for clip in open_dataset(tmp_path / "old").clips("train") for caption in clip.captions}
    assert found == {"a person walks forward", "someone waves"}
    assert main([*command]) == 2
    assert "exists" in capsys.readouterr().err
    (tmp_path / "sentences.txt").write_text("\n")
    assert main(["data", "replay", f"{tmp_path / 'b'}", "--sentences", f"{tmp_path / 'sentences.txt'}"]) == 2
    assert "has no sentence" in capsys.readouterr().err
    assert main(["data", "replay", f"{tmp_path / 'b'}", "--num-clips", "0"]) == 2
    assert "num-clips: 0 is not a whole number from 1 to 100,000" in capsys.readouterr().err
    assert main(["data", "replay", f"{tmp_path / 'b'}", "--num-clips", "300000000"]) == 2
    assert "num-clips: 300000000 is not" in capsys.readouterr().err
