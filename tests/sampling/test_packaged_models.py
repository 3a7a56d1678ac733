"""The models that come with the package: they have names, fit into 25 MB, and do what simple sentences ask."""

import importlib.resources
from pathlib import Path

import numpy as np
import pytest

from t2m_jax.checkpoints.bundle import BUNDLED
from t2m_jax.evaluation.prompt_following import follows
from t2m_jax.sampling import TextToMotion

FOLDER = Path(str(importlib.resources.files("t2m_jax"))) / "bundles"
ASKED = {"a person waves with the right hand": "wave-right-hand", "someone runs forward": "run"}


def test_all_of_them_are_known_by_name_and_small():
    assert {path.name for path in FOLDER.iterdir()} == set(BUNDLED)
    assert sum(path.stat().st_size for path in FOLDER.rglob("*")) < 25e6


@pytest.mark.parametrize("name", BUNDLED)
def test_they_do_what_is_asked(name):
    model = TextToMotion.load(name)
    motions = model.generate(list(ASKED), seed=5, num_samples=4)
    for number, content in enumerate(ASKED.values()):
        assert sum(follows(content, motion) for motion in motions[4 * number : 4 * number + 4]) >= 3, content
    assert len({motion.num_frames for motion in motions}) > 1
    assert all(np.isfinite(motion.positions).all() for motion in motions)


@pytest.mark.parametrize(
    ("name", "codes"),
    [
        ("demo", [128, 121, 121, 236, 236, 121, 236, 121]),
        ("demo-t2m-gpt", [266, 470, 162, 218, 218, 218, 259, 162]),
    ],
)
def test_a_seed_gives_the_motion_that_it_gave_before(name, codes):
    (motion,) = TextToMotion.load(name).generate("a person waves with the left hand", seed=3)
    assert motion.codes[:8, 0].tolist() == codes


@pytest.mark.parametrize("name", BUNDLED)
def test_their_cards_say_what_the_license_is(name):
    card = (FOLDER / name / "README.md").read_text()
    assert "CC BY-NC 4.0" in card and "Bandai Namco Research" in card and "@@" not in card
