"""Normalization inside the residual units: over what it is taken, and that padding has no part in it."""

import chex
import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax.models.convolution import GROUPS, normalized
from t2m_jax.models.vqvae import VqVae, VqVaeConfig

pytestmark = pytest.mark.slow

NORMS = ["LN", "GN", "BN"]
LENGTHS = np.array([7, 12, 4])


class Norm(nn.Module):
    """One layer by itself."""

    kind: str

    @nn.compact
    def __call__(self, hidden, mask, *, train):
        return normalized(hidden, mask, kind=self.kind, name="norm", train=train)


@pytest.fixture(scope="module")
def batch():
    hidden = 3.0 + 2.0 * jax.random.normal(jax.random.key(0), (3, 12, 64))
    return hidden, jnp.arange(12)[None] < jnp.asarray(LENGTHS)[:, None]


def normal(seed, *shape):
    return jax.random.normal(jax.random.key(seed), shape)


def oracle(hidden, kind):
    """Normalizes clips of their own lengths with plain sums."""
    hidden = [np.asarray(clip[:length], np.float64) for clip, length in zip(hidden, LENGTHS, strict=True)]
    if kind == "LN":
        return [(c - c.mean(1, keepdims=True)) / np.sqrt(c.var(1, keepdims=True) + 1e-5) for c in hidden]
    if kind == "GN":
        groups = [clip.reshape(len(clip), GROUPS, -1) for clip in hidden]
        groups = [(g - g.mean((0, 2), keepdims=True)) / np.sqrt(g.var((0, 2), keepdims=True) + 1e-6) for g in groups]
        return [group.reshape(len(group), -1) for group in groups]
    frames = np.concatenate(hidden)
    return [(clip - frames.mean(0)) / np.sqrt(frames.var(0) + 1e-6) for clip in hidden]


@pytest.mark.parametrize("kind", NORMS)
def test_against_plain_sums(batch, kind):
    hidden, mask = batch
    spoiled = jnp.where(mask[:, :, None], hidden, 1e3)
    found, _ = Norm(kind).init_with_output(jax.random.key(0), spoiled, mask, train=True)
    for clip, expected in zip(found, oracle(hidden, kind), strict=True):
        np.testing.assert_allclose(clip[: len(expected)], expected, atol=1e-4)


def test_running_statistics_are_those_of_the_data(batch):
    """They move by a tenth in training, stay in evaluation, and are what evaluation uses."""
    hidden, mask = batch
    variables = Norm("BN").init(jax.random.key(0), hidden, mask, train=False)
    np.testing.assert_array_equal(variables["batch_stats"]["norm"]["mean"], 0.0)
    _, updates = Norm("BN").apply(variables, hidden, mask, train=True, mutable=["batch_stats"])
    frames = np.asarray(hidden)[np.asarray(mask)]
    moved = updates["batch_stats"]["norm"]
    np.testing.assert_allclose(moved["mean"], 0.1 * frames.mean(0), rtol=1e-4)
    np.testing.assert_allclose(moved["var"], 0.9 + 0.1 * frames.var(0), rtol=1e-4)
    output, kept = Norm("BN").apply(variables | updates, hidden, mask, train=False, mutable=["batch_stats"])
    np.testing.assert_array_equal(kept["batch_stats"]["norm"]["mean"], moved["mean"])
    mean, std = np.asarray(moved["mean"]), np.sqrt(np.asarray(moved["var"]) + 1e-6)
    np.testing.assert_allclose(output, (np.asarray(hidden) - mean) / std, rtol=1e-4, atol=1e-5)


def test_batch_norm_is_that_of_flax_on_one_device(batch):
    """With the names and the running statistics of trained models."""
    hidden, mask = batch
    ours, theirs = Norm("BN"), nn.BatchNorm(momentum=0.9, epsilon=1e-6, use_fast_variance=False)
    params = {"scale": normal(1, 64), "bias": normal(2, 64)}
    stats = {"mean": normal(3, 64), "var": 1.0 + normal(4, 64) ** 2}

    weights = normal(5, *hidden.shape) * mask[:, :, None]

    def found(hidden, params, train):
        variables = {"params": {"norm": params}, "batch_stats": {"norm": stats}}
        output, updates = ours.apply(variables, hidden, mask, train=train, mutable=["batch_stats"])
        return jnp.sum(weights * output), (output, updates["batch_stats"]["norm"])

    def expected(hidden, params, train):
        variables = {"params": params, "batch_stats": stats}
        options = {"use_running_average": not train, "mask": mask[:, :, None], "mutable": ["batch_stats"]}
        output, updates = theirs.apply(variables, hidden, **options)
        return jnp.sum(weights * output), (output, updates["batch_stats"])

    for train in (True, False):
        one, other = (
            jax.grad(apply, argnums=(0, 1), has_aux=True)(hidden, params, train) for apply in (found, expected)
        )
        chex.assert_trees_all_close(one, other, rtol=1e-4, atol=1e-4)


def test_statistics_of_batch_norm_are_in_float32(batch):
    hidden, mask = batch
    variables = Norm("BN").init(jax.random.key(0), hidden, mask, train=False)
    rounded = hidden.astype(jnp.bfloat16)
    output, updates = Norm("BN").apply(variables, rounded, mask, train=True, mutable=["batch_stats"])
    assert output.dtype == jnp.bfloat16
    exact = Norm("BN").apply(variables, rounded.astype(jnp.float32), mask, train=True, mutable=["batch_stats"])[1]
    chex.assert_trees_all_equal(updates, exact)


@pytest.mark.parametrize("norm", NORMS)
def test_padding_changes_nothing_in_a_whole_vqvae(norm):
    model = VqVae(VqVaeConfig(feature_dim=7, num_codes=8, code_dim=4, width=32, num_stages=1, depth=1, norm=norm))
    motion = jax.random.normal(jax.random.key(1), (1, 10, 7))
    variables = model.init(jax.random.key(0), motion, train=False)
    variables["codebook"]["quantizer"]["codebook"] = jax.random.normal(jax.random.key(2), (8, 4))
    padded = jnp.concatenate([motion, 100.0 * jnp.ones((1, 6, 7))], axis=1)
    apply = jax.jit(lambda motion, mask: model.apply(variables, motion, mask, train=False))
    alone, beside = apply(motion, jnp.ones((1, 10), bool)), apply(padded, jnp.arange(16)[None] < 10)
    np.testing.assert_array_equal(beside.codes[:, :5], alone.codes)
    np.testing.assert_allclose(beside.reconstruction[:, :10], alone.reconstruction, atol=1e-4)


def test_a_width_that_makes_no_groups_is_refused():
    with pytest.raises(ValueError, match="width: 48 is not a multiple of 32"):
        VqVaeConfig(width=48, norm="GN")
