"""Gaps in real motion, filled by a model and by interpolation."""

import dataclasses

import numpy as np
import pytest

from t2m_jax import Motion
from t2m_jax.data import open_dataset
from t2m_jax.data.importers.synthetic import make_motion, write_synthetic_dataset
from t2m_jax.data.texts import Caption, save_captions
from t2m_jax.errors import UserError
from t2m_jax.evaluation.inbetween import evaluate_inbetween, gap_figures, interpolate_gap
from t2m_jax.motion.features import bone_vectors
from t2m_jax.motion.skeleton import HUMANML3D
from t2m_jax.sampling import TextToMotion
from tests import tiny

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def model():
    return TextToMotion(tiny.random_bundle(tiny.BUNDLE))


@pytest.fixture(scope="module")
def positions():
    return Motion(make_motion("walk", seed=1, num_frames=80), 20.0).positions


def test_straight_motion_has_no_deviation():
    steps = np.arange(50)[:, None, None] * np.array([0.1, 0.0, 0.02])
    straight = (steps + np.random.default_rng(0).normal(size=(1, 22, 3))).astype(np.float32)
    np.testing.assert_allclose(gap_figures(straight, straight, 20, 30, fps=20.0), np.zeros(4), atol=2e-3)


@pytest.mark.parametrize("last", [20, 22])
def test_a_gap_without_an_acceleration_is_refused(positions, last):
    with pytest.raises(UserError, match=f"seconds: the gap would have {last - 20} frames"):
        gap_figures(positions, positions, 20, last, fps=20.0)


def test_a_jump_of_a_centimeter_is_found_at_its_join(positions):
    jumping = np.zeros((50, 22, 3), np.float32)
    jumping[30:] += np.array([0.01, 0, 0], np.float32)
    figures = gap_figures(jumping, np.zeros_like(jumping), 20, 30, fps=20.0)
    np.testing.assert_allclose(figures.deviation_mm, 10 * 2 / 4, rtol=1e-4)  # in two of the four frames
    np.testing.assert_allclose(figures.velocity_change, 0.2 * 2 / 4, rtol=1e-4)
    assert figures.acceleration == figures.acceleration_error == 0


def test_an_interpolation_keeps_bones_and_hardly_accelerates(positions):
    straight = interpolate_gap(positions, 30, 50, skeleton=HUMANML3D)
    np.testing.assert_array_equal(straight[:30], positions[:30])
    np.testing.assert_array_equal(straight[50:], positions[50:])
    lengths = np.linalg.norm(bone_vectors(straight, HUMANML3D), axis=-1)
    np.testing.assert_allclose(lengths, np.broadcast_to(lengths[:1], lengths.shape), atol=1e-4)
    figures = gap_figures(straight, positions, 30, 50, fps=20.0)
    real = gap_figures(positions, positions, 30, 50, fps=20.0)
    assert real.acceleration_error == 0 and figures.acceleration < 0.3 * real.acceleration
    np.testing.assert_allclose(figures.acceleration_error, real.acceleration - figures.acceleration)


def test_what_is_asked_for_is_about_the_whole_clip(model, tmp_path, monkeypatch):
    write_synthetic_dataset(tmp_path, num_clips=20, seed=6)
    for path in (tmp_path / "texts").iterdir():
        save_captions(path, [Caption("sits down at the end", (), 2.0, 2.5), Caption("walks on")])
    said = []

    def redo(motion, span, caption, **_):
        said.append(caption)
        return [dataclasses.replace(motion, part_starts=(0, 20, 28), part_captions=("a", "b", "a"))]

    monkeypatch.setattr(model, "redo", redo)
    evaluate_inbetween(model, open_dataset(tmp_path), split="train", seconds=0.4, num_clips=2)
    assert said == ["walks on"] * 2


@pytest.mark.filterwarnings("ignore::t2m_jax.text.coverage.PromptWarning")
def test_a_model_is_measured_on_the_clips_that_are_long_enough(model, tmp_path, monkeypatch):
    write_synthetic_dataset(tmp_path / "data", num_clips=20, seed=6)
    dataset = open_dataset(tmp_path / "data")
    figures = evaluate_inbetween(model, dataset, split="train", seconds=0.4, num_clips=2)
    assert figures.num_clips == 2 and figures.real.acceleration_error == 0
    assert figures.generated.deviation_mm > 0 and figures.generated != figures.interpolated
    # A model that gives the clip back is as good as the clip.
    parts = {"part_starts": (0, 20, 28), "part_captions": ("a", "b", "a")}
    monkeypatch.setattr(model, "redo", lambda motion, *_, **__: [dataclasses.replace(motion, **parts)])
    figures = evaluate_inbetween(model, dataset, split="train", seconds=0.4, num_clips=2)
    assert figures.generated == figures.real != figures.interpolated
    with pytest.raises(UserError, match="split train has no clip of 10040 frames with a caption"):
        evaluate_inbetween(model, dataset, split="train", seconds=500.0, num_clips=2)
    with pytest.raises(UserError, match="seed: -1 is not between"):
        evaluate_inbetween(model, dataset, split="train", seconds=0.4, num_clips=2, seed=-1)
