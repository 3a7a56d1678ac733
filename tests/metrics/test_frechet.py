"""FID against the reference, against float64, and its laws."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax.metrics.frechet import fid
from tests.jit import assert_jit_equals_eager

jitted = jax.jit(fid)


def exact(real, generated):
    """The textbook form in float64: eigenvalues of S1^(1/2) S2 S1^(1/2)."""
    real, generated = (np.asarray(values, np.float64) for values in (real, generated))
    first, second = np.cov(real, rowvar=False), np.cov(generated, rowvar=False)
    values, vectors = np.linalg.eigh(first)
    root = (vectors * np.sqrt(np.clip(values, 0, None))) @ vectors.T
    cross = np.sqrt(np.clip(np.linalg.eigvalsh(root @ second @ root), 0, None)).sum()
    shift = real.mean(0) - generated.mean(0)
    return shift @ shift + np.trace(first) + np.trace(second) - 2 * cross


def naive(real, generated):
    """The same, computed in float32."""
    first, second = np.cov(real, rowvar=False, dtype=np.float32), np.cov(generated, rowvar=False, dtype=np.float32)
    values, vectors = np.linalg.eigh(first)
    root = (vectors * np.sqrt(np.clip(values, 0, None))) @ vectors.T
    cross = np.sqrt(np.clip(np.linalg.eigvalsh(root @ second @ root), 0, None)).sum()
    shift = real.mean(0) - generated.mean(0)
    return shift @ shift + np.trace(first) + np.trace(second) - 2 * cross


def test_golden_cases(golden_dir):
    arrays = np.load(golden_dir / "evaluation" / "fid.npz")
    names = [str(name) for name in arrays["names"]]
    assert len(names) == 11
    for name in names:
        expected = arrays[f"{name}/fid_reference"]
        found = fid(jnp.asarray(arrays[f"{name}/x"]), jnp.asarray(arrays[f"{name}/y"]))
        assert abs(found - expected) / (1 + abs(expected)) < 5e-5, name


def sets(seed, width=512):
    """Two sets of embeddings: near or far, more samples than dimensions or fewer, flat spectra and steep ones."""
    generator = np.random.default_rng(seed)
    num_real, num_generated = generator.choice([2 * width // 5, 3 * width], 2)
    spectrum = np.exp(-np.arange(width) / width * generator.choice([2.5, 12.5, 100]))
    if seed % 4 == 0:
        spectrum[3 * width // 5 :] = 0
    mixing = np.linalg.qr(generator.normal(size=(width, width)))[0]
    real = generator.normal(size=(num_real, width)) * spectrum @ mixing + generator.normal(size=width)
    change = generator.choice([0.01, 0.1, 0.5])
    generated = generator.normal(size=(num_generated, width)) * spectrum * (1 + change) @ mixing + change
    return real.astype(np.float32), generated.astype(np.float32)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_float32_agrees_with_float64_at_the_evaluators_width(seed):
    real, generated = sets(seed)
    np.testing.assert_allclose(jitted(jnp.asarray(real), jnp.asarray(generated)), exact(real, generated), rtol=1e-3)


@pytest.mark.slow
def test_the_naive_form_does_not():
    """Why the form matters: sets that differ as a good model's do from real motion."""
    generator = np.random.default_rng(0)
    mixing = 3 * np.exp(-np.arange(512) / 40)[:, None] * np.linalg.qr(generator.normal(size=(512, 512)))[0]
    real, generated = ((generator.normal(size=(1500, 512)) @ mixing).astype(np.float32) for _ in range(2))
    expected = exact(real, generated)
    np.testing.assert_allclose(jitted(jnp.asarray(real), jnp.asarray(generated)), expected, rtol=1e-3)
    assert abs(naive(real, generated) - expected) > 0.03 * expected


@pytest.mark.parametrize("seed", range(4))
def test_a_set_is_at_no_distance_from_itself(seed):
    """With more samples than dimensions and with fewer, also where columns hang together."""
    real = jnp.asarray(sets(seed, width=64)[0])
    trace = np.trace(np.cov(real, rowvar=False))
    assert 0 <= fid(real, real) < 1e-6 * trace
    assert 0 <= fid(real, real[::-1]) < 1e-6 * trace


def test_a_shift_adds_its_square_and_order_does_not_matter():
    real, generated = (jnp.asarray(values) for values in sets(5, width=20))
    shift = jnp.arange(20.0)[None] / 10
    np.testing.assert_allclose(fid(real, real + shift), jnp.sum(shift**2), rtol=1e-4)
    np.testing.assert_allclose(fid(real, generated), fid(generated, real), rtol=1e-4)


@pytest.mark.slow
def test_jit_vmap_and_eager_agree():
    generator = np.random.default_rng(0)
    sets_of_two = [jnp.asarray(generator.normal(size=(2, 100, 16)), jnp.float32) for _ in range(2)]
    together = jax.jit(jax.vmap(fid))(sets_of_two[0], sets_of_two[1])
    alone = [assert_jit_equals_eager(jax.jit(fid), *two, rtol=1e-4) for two in zip(*sets_of_two, strict=True)]
    np.testing.assert_allclose(together, alone, rtol=1e-4)


def test_one_sample_has_no_covariance():
    with pytest.raises(ValueError, match="two samples"):
        fid(jnp.zeros((1, 4)), jnp.zeros((5, 4)))
