"""Reconstruction figures: against a plain NumPy computation, whatever the batch."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax.checkpoints.tokenizer import TrainedTokenizer
from t2m_jax.data.folder import open_dataset
from t2m_jax.data.importers.synthetic import write_synthetic_dataset
from t2m_jax.errors import UserError
from t2m_jax.evaluation import reconstruction
from t2m_jax.evaluation.reconstruction import evaluate_reconstruction, reconstruct_batch
from t2m_jax.metrics.quality import measure_errors, measure_quality
from t2m_jax.models.vqvae import VqVae
from t2m_jax.motion.features import positions_from_features
from tests.tiny import VQVAE, random_bundle

DRIFTS = ("global_mpjpe_mm", "acceleration_error_mm", "path_drift_mm", "heading_drift_degrees")


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    folder = tmp_path_factory.mktemp("reconstruction") / "data"
    write_synthetic_dataset(folder, num_clips=20, seed=6)
    return open_dataset(folder)


@pytest.fixture(scope="module")
def tokenizer():
    bundle = random_bundle()
    return TrainedTokenizer(VQVAE, bundle.variables["tokenizer"], bundle.normalizer)


@pytest.fixture(scope="module")
def report(tokenizer, dataset):
    return evaluate_reconstruction(tokenizer, dataset, split="test")


@functools.partial(jax.jit, static_argnames="skeleton")
def measure(found, wanted, mask, *, skeleton):
    """Returns the errors of clips, then the quality of what was found and of what was wanted."""
    qualities = [measure_quality(clips, mask, skeleton=skeleton) for clips in (found, wanted)]
    return jnp.stack([*measure_errors(found, wanted, mask, skeleton=skeleton), *qualities[0], *qualities[1]])


@pytest.mark.slow
def test_figures_equal_a_plain_computation(tokenizer, dataset, report):
    encode, decode = (jax.jit(functools.partial(VqVae(VQVAE).apply, method=name)) for name in ("encode", "decode"))
    errors, per_clip, counts = [], [], np.zeros(VQVAE.num_codes)
    measured = []
    for clip in dataset.clips("test"):
        features = clip.features[: len(clip.features) // 4 * 4]
        codes = encode(tokenizer.variables, jnp.asarray(tokenizer.normalizer.normalize(features))[None])
        raw = tokenizer.normalizer.denormalize(np.asarray(decode(tokenizer.variables, codes)[0]))
        found, wanted = (positions_from_features(x, dataset.skeleton).astype(np.float64) for x in (raw, features))
        distance = np.linalg.norm((found - found[:, :1]) - (wanted - wanted[:, :1]), axis=-1).mean(axis=-1)
        errors.append(distance)
        per_clip.append(distance.mean())
        counts += np.bincount(np.ravel(codes), minlength=VQVAE.num_codes)
        pair = [jnp.asarray(one[None], jnp.float32) for one in (found, wanted)]
        measured.append(measure(*pair, jnp.ones((1, len(found)), bool), skeleton=dataset.skeleton))
    np.testing.assert_allclose(report.mpjpe_mm, 1000 * np.concatenate(errors).mean(), rtol=1e-3)
    np.testing.assert_allclose(report.mpjpe_median_clip_mm, 1000 * np.median(per_clip), rtol=1e-3)
    assert report.codebook_usage == np.mean(counts > 0)
    shares = counts[counts > 0] / counts.sum()
    np.testing.assert_allclose(report.perplexity, np.exp(-np.sum(shares * np.log(shares))), rtol=1e-4)
    _, *drifts = np.mean(measured, axis=0).ravel()[:5] * [1000, 1000, 1000, 1000, 1]
    found = [getattr(report, name) for name in DRIFTS]
    np.testing.assert_allclose(found, drifts, rtol=1e-2)
    both = (report.quality, report.real_quality)
    qualities = [value for quality in both for value in dataclasses.astuple(quality)]
    np.testing.assert_allclose(qualities, np.mean(measured, axis=0).ravel()[5:], rtol=1e-2, atol=1e-4)
    assert report.num_clips == len(errors)
    assert report.num_frames == sum(map(len, errors))


@pytest.mark.slow
def test_the_batch_does_not_matter(tokenizer, dataset, report, monkeypatch):
    monkeypatch.setattr(reconstruction, "BATCH", 2)
    other = evaluate_reconstruction(tokenizer, dataset, split="test")
    np.testing.assert_allclose(other.mpjpe_mm, report.mpjpe_mm, rtol=1e-4)
    assert other.codebook_usage == report.codebook_usage


@pytest.mark.slow
def test_codes_after_the_end_are_zero(tokenizer, dataset, report, monkeypatch):
    found = []

    def kept(*arguments, **options):
        found.append((arguments[3], reconstruct_batch(*arguments, **options)))
        return found[-1][1]

    monkeypatch.setattr(reconstruction, "reconstruct_batch", kept)
    assert evaluate_reconstruction(tokenizer, dataset, split="test") == report
    ((lengths, result),) = found
    is_past = np.arange(result.codes.shape[1])[None] >= np.asarray(lengths)[:, None] // 4
    assert is_past.any() and not np.asarray(result.codes)[is_past].any()


def test_a_split_without_clips_is_refused(tokenizer, dataset, tmp_path):
    with pytest.raises(UserError, match="nothing"):
        evaluate_reconstruction(tokenizer, dataset, split="nothing")
