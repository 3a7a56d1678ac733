"""Learning rates and the optimiser against the original's recorded steps."""

import json

import jax.numpy as jnp
import numpy as np
import optax
import pytest

from t2m_jax.train.optimizer import OptimizerConfig, learning_rate_at, make_optimizer


@pytest.mark.parametrize("stage", ["vq", "gpt"])
def test_golden_optimiser_steps(golden_dir, stage):
    arrays = np.load(golden_dir / "t2m_gpt" / "optim.npz")
    sizes = json.loads(str(arrays["config_json"]))
    config = OptimizerConfig(
        learning_rate=sizes["lr"],
        warmup_steps=sizes["warm_up_iter"] if stage == "vq" else 0,
        milestones=tuple(sizes["milestones"]),
        gamma=sizes["gamma"],
        betas=tuple(sizes[f"{stage}_betas"]),
        weight_decay=sizes[f"{stage}_weight_decay"],
    )
    optimizer = make_optimizer(config)
    params = jnp.asarray(arrays[f"{stage}/param_initial"])
    state = optimizer.init(params)
    for step, gradient in enumerate(arrays[f"{stage}/grads"]):
        np.testing.assert_allclose(learning_rate_at(step, config), arrays[f"{stage}/lr_used"][step], rtol=1e-5)
        updates, state = optimizer.update(jnp.asarray(gradient), state, params)
        params = optax.apply_updates(params, updates)
        np.testing.assert_allclose(params, arrays[f"{stage}/params"][step], atol=1e-5, rtol=1e-5)


def test_published_rates():
    """The numbers of the published command: 999 warm-up updates, then 1000/1001 of the nominal rate."""
    config = OptimizerConfig(learning_rate=2e-4, warmup_steps=1000, milestones=(200_000,), gamma=0.05)
    for step, rate in ((0, 2e-4 * 2 / 1001), (998, 1.998002e-4), (999 + 199_999, 1.998002e-4), (200_999, 9.990e-6)):
        np.testing.assert_allclose(learning_rate_at(step, config), rate, rtol=1e-4)


def test_gradients_are_clipped_on_demand():
    gradient = jnp.full(4, 100.0)
    config = OptimizerConfig(clip_norm=1.0)
    optimizer = make_optimizer(config)
    clipped, state = optimizer.update(gradient, optimizer.init(gradient), gradient)
    first_average = np.asarray(state[1][0].mu)
    np.testing.assert_allclose(np.linalg.norm(first_average), 1.0 - config.betas[0], rtol=1e-5)
    assert np.all(np.isfinite(clipped))
