"""Whole training steps against the original's: six of the VQ-VAE, four of the GPT."""

import functools
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax.checkpoints.official.load import gpt_variables, vqvae_variables
from t2m_jax.data.banks.motions import Windows
from t2m_jax.models.motion_gpt import MotionGptConfig
from t2m_jax.models.vqvae import VqVaeConfig
from t2m_jax.train import OptimizerConfig, TrainVqVaeConfig
from t2m_jax.train.gpt import Corruption, Targets, TrainGptConfig, gpt_train_step, make_gpt_batch
from t2m_jax.train.optimizer import first_state, make_optimizer
from t2m_jax.train.vqvae import VqVaeState, vqvae_train_step
from tests.golden_files import state_dict
from tests.tiny import walking_normalizer

pytestmark = pytest.mark.slow


def assert_close_parameters(found, expected, *, skip: str = "?"):
    """Adam turns rounding into full-size steps where a gradient is near 0: the worst element is far from the median."""
    errors = []
    for (path, leaf), other in zip(jax.tree_util.tree_leaves_with_path(found), jax.tree.leaves(expected), strict=True):
        if skip not in jax.tree_util.keystr(path):
            errors.append(np.abs(np.asarray(leaf) - np.asarray(other)).ravel())
    errors = np.concatenate(errors)
    assert np.max(errors) < 5e-4
    assert np.median(errors) < 1e-6


def test_vqvae_steps(golden_dir):
    arrays = np.load(golden_dir / "t2m_gpt" / "vqtrain_dim263.npz")
    sizes = json.loads(str(arrays["config_json"]))
    config = TrainVqVaeConfig(
        model=VqVaeConfig(
            num_codes=sizes["nb_code"],
            code_dim=sizes["code_dim"],
            width=sizes["width"],
            num_stages=sizes["down_t"],
            depth=sizes["depth"],
            ema_decay=sizes["mu"],
        ),
        commitment_weight=sizes["commit"],
        velocity_weight=sizes["loss_vel"],
        optimizer=OptimizerConfig(
            learning_rate=sizes["lr"],
            warmup_steps=sizes["warm_up_iter"],
            milestones=tuple(sizes["milestones"]),
            gamma=sizes["gamma"],
            betas=tuple(sizes["betas"]),
        ),
    )
    variables = vqvae_variables(state_dict(arrays), config.model)
    codebook = jax.tree.map(jnp.asarray, variables["codebook"])
    codebook["quantizer"]["initialised"] = jnp.array(False)
    opt_state = make_optimizer(config.optimizer).init(variables["params"])
    state = VqVaeState(jnp.array(0), variables["params"], codebook, {}, opt_state)
    step_function = jax.jit(functools.partial(vqvae_train_step, config=config, normalizer=walking_normalizer()))
    for step, motion in enumerate(arrays["x"]):
        windows = Windows(jnp.asarray(motion), jnp.ones(motion.shape[:2], bool))
        state, metrics = step_function(state, windows, jax.random.key(step))
        for ours, theirs in (
            ("loss", "total"),
            ("reconstruction", "recon"),
            ("velocity", "vel"),
            ("commitment", "commit"),
            ("perplexity", "perplexity"),
        ):
            np.testing.assert_allclose(metrics[ours], arrays[theirs][step], rtol=2e-4, err_msg=f"{ours}, step {step}")
        quantizer = state.codebook["quantizer"]
        np.testing.assert_allclose(quantizer["codebook"], arrays["codebook_after"][step], atol=5e-4)
        np.testing.assert_allclose(quantizer["ema_count"], arrays["code_count_after"][step], atol=1e-5)
    final = vqvae_variables(
        {**state_dict(arrays, "final/"), "vqvae.quantizer.codebook": arrays["codebook_after"][-1]},
        config.model,
    )
    assert_close_parameters(state.params, final["params"])


def test_gpt_steps(golden_dir):
    """The text comes as features and the corruption as arrays; everything else is our own step."""
    arrays = np.load(golden_dir / "t2m_gpt" / "gpttrain_l2.npz")
    sizes = json.loads(str(arrays["config_json"]))
    config = TrainGptConfig(
        text_encoder="clip",
        model=MotionGptConfig(
            num_codes=sizes["nb_code"],
            embed_dim=sizes["embed_dim"],
            text_dim=sizes["clip_dim"],
            num_layers=2 * sizes["num_layers"],
            num_heads=sizes["n_head"],
            block_size=sizes["block_size"],
            dropout=0.0,
        ),
        optimizer=OptimizerConfig(
            learning_rate=sizes["lr"],
            milestones=tuple(sizes["milestones"]),
            gamma=sizes["gamma"],
            betas=tuple(sizes["betas"]),
            weight_decay=sizes["weight_decay"],
        ),
    )
    weights = state_dict(arrays)
    params = {"gpt": gpt_variables(weights, config.model)["params"]}
    state = first_state(params, config.optimizer)
    step_function = jax.jit(gpt_train_step, static_argnames="config")
    for step in range(len(arrays["loss"])):
        targets = Targets(jnp.asarray(arrays["target"][step]), jnp.asarray(arrays["n_tokens"][step]))
        keep = jnp.asarray(arrays["mask_keep"][step]).astype(bool)
        corruption = Corruption(keep, jnp.asarray(arrays["random_indices"][step]))
        batch = make_gpt_batch(
            targets,
            jnp.asarray(arrays["clip_feat"][step]),
            config=config,
            inputs=corruption.apply(targets.tokens[:, :-1]),
            dropout_keys=jax.random.split(jax.random.key(step), (len(keep), 2)),
        )
        state, metrics = step_function(state, batch, config=config)
        np.testing.assert_allclose(metrics["loss"], arrays["loss"][step], rtol=1e-5)
    final = weights | state_dict(arrays, "final/")
    expected = gpt_variables(final, config.model)["params"]
    assert_close_parameters(state.params["gpt"], expected, skip="['key']['bias']")
