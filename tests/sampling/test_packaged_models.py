"""The models that come with the package: they have names, fit into 45 MB, and do what simple sentences ask."""

import importlib.resources
from pathlib import Path

import numpy as np
import pytest

from t2m_jax.checkpoints.bundle import BUNDLED
from t2m_jax.evaluation.prompts.following import follows
from t2m_jax.motion.motion import Motion
from t2m_jax.sampling import TextToMotion
from t2m_jax.text import PromptWarning

FOLDER = Path(str(importlib.resources.files("t2m_jax"))) / "bundles"
FIRST_CODES = {
    "demo": [204, 204, 424, 211, 95, 27, 465, 117],
    "demo-free": [322, 495, 177, 271, 402, 177, 37, 213],
    "demo-t2m-gpt": [404, 89, 404, 338, 98, 389, 98, 98],
}
"""The first codes of the first rows of one motion, so that a change of what a seed gives is noticed."""
ASKED = {"a person waves with the right hand": "wave-right-hand", "someone runs forward": "run"}
ASKED_FREE = {"a person walks forward": "walk", "someone runs forward": "run"}
"""`demo-free` has never seen a wave."""


def test_all_of_them_are_known_by_name_and_small():
    assert {path.name for path in FOLDER.iterdir()} == set(BUNDLED)
    assert sum(path.stat().st_size for path in FOLDER.rglob("*")) < 45e6


@pytest.mark.parametrize(
    "name", [name if name == "demo" else pytest.param(name, marks=pytest.mark.slow) for name in BUNDLED]
)
def test_they_do_what_is_asked_and_the_same_as_before(name):
    model = TextToMotion.load(name)
    asked = ASKED_FREE if name == "demo-free" else ASKED
    motions = model.generate(list(asked), seed=5, num_samples=4)
    for number, content in enumerate(asked.values()):
        assert sum(follows(content, motion) for motion in motions[4 * number : 4 * number + 4]) >= 3, content
    assert len({motion.num_frames for motion in motions}) > 1
    assert all(np.isfinite(motion.positions).all() for motion in motions)
    assert motions[0].codes[:8, 0].tolist() == FIRST_CODES[name]


@pytest.mark.slow
@pytest.mark.parametrize("name", BUNDLED)
def test_their_examples_need_no_warning_and_are_no_fragments(name):
    model = TextToMotion.load(name)
    motions = model.generate(model.examples, seed=1)
    assert [motion.warning for motion in motions] == [""] * len(model.examples)
    assert min(motion.num_frames for motion in motions) >= 24


@pytest.fixture(scope="module")
def dance():
    (motion,) = TextToMotion.load("demo").generate("someone dances", seed=3)
    return motion


@pytest.mark.slow
@pytest.mark.parametrize(
    ("suffix", "options"),
    [(".bvh", {}), (".glb", {}), (".vrma", {}), (".bvh", {"root_bone": True}), (".glb", {"root_bone": True})],
)
def test_files_give_a_motion_back_within_a_millimeter(dance, tmp_path, suffix, options):
    dance.save(tmp_path / f"dance{suffix}", **options)
    back = Motion.load(tmp_path / f"dance{suffix}")
    assert back.positions.shape == dance.positions.shape
    assert np.linalg.norm(back.positions - dance.positions, axis=-1).max() < 0.001


@pytest.mark.slow
def test_the_free_model_warns_of_what_it_has_never_seen():
    model = TextToMotion.load("demo-free")
    sentences = ["a person waves with the left hand", "he throws a ball", "clap your hands", "she raises both arms"]
    with pytest.warns(PromptWarning, match="the training data have no motion like"):
        motions = model.generate([*sentences, "a person walks forward"], seed=1)
    assert [bool(motion.warning) for motion in motions] == [True] * len(sentences) + [False]


@pytest.mark.parametrize("name", BUNDLED)
def test_their_cards_say_what_the_license_is(name):
    card = (FOLDER / name / "README.md").read_text()
    is_free = name == "demo-free"
    assert "@@" not in card and ("CC BY 4.0" in card) == is_free
    # Neither is in the data of the free one.
    for text in ("CC BY-NC 4.0", "Bandai Namco Research"):
        assert (text in card) != is_free
    assert not is_free or "Berkeley" not in card
    # What the licenses of its data demand.
    wanted = ("https://accad.osu.edu", "CC BY 3.0", "mocap.cs.cmu.edu", "EIA-0196217", "Meta Platforms")
    assert not is_free or all(text in card for text in wanted)
