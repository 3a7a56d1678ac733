"""The GPT against arrays of the original PyTorch classes."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax.checkpoints.official.load import gpt_variables
from t2m_jax.losses import token_accuracy, token_loss, token_weights
from t2m_jax.models.motion_gpt import MotionGpt, MotionGptConfig
from tests.golden_files import state_dict
from tests.jit import compiled_apply


@pytest.fixture(scope="module", params=("gpt_l2", pytest.param("gpt_l3", marks=pytest.mark.slow)))
def case(request, golden_dir):
    arrays = np.load(golden_dir / "t2m_gpt" / f"{request.param}.npz")
    sizes = json.loads(str(arrays["config_json"]))
    config = MotionGptConfig(
        num_codes=sizes["nb_code"],
        embed_dim=sizes["embed_dim"],
        text_dim=sizes["clip_dim"],
        num_layers=2 * sizes["num_layers"],
        num_heads=sizes["n_head"],
        mlp_ratio=sizes["fc_rate"],
        block_size=sizes["block_size"],
        dropout=sizes["drop_out_rate"],
    )
    return arrays, MotionGpt(config), gpt_variables(state_dict(arrays), config)


@pytest.mark.slow
def test_logits(case):
    arrays, model, variables = case
    text = jnp.asarray(arrays["clip_feat"])
    tokens = jnp.asarray(arrays["input_tokens"])
    for length, expected in ((tokens.shape[1], "logits"), (0, "logits_empty"), (4, "logits_prefix4")):
        logits = compiled_apply(model, variables, tokens[:, :length], text, train=False)
        np.testing.assert_allclose(logits, arrays[expected], atol=1e-4, rtol=1e-4)


def test_loss_and_gradient(case):
    arrays, model, variables = case
    text, tokens = jnp.asarray(arrays["clip_feat"]), jnp.asarray(arrays["input_tokens"])

    def loss_function(params):
        logits = model.apply({"params": params}, tokens, text, train=False)
        targets, lengths = jnp.asarray(arrays["target"]), jnp.asarray(arrays["n_tokens"])
        weights = [token_weights(lengths, targets.shape[1], mean_over=kind) for kind in ("motions", "tokens")]
        return token_loss(logits, targets, weights[0]), token_accuracy(logits, targets, weights[1])

    (loss, right), gradient = jax.jit(jax.value_and_grad(loss_function, has_aux=True))(variables["params"])
    np.testing.assert_allclose(loss, arrays["loss"], rtol=1e-5)
    counted = np.sum(arrays["n_tokens"] + 1)
    np.testing.assert_allclose(right * counted, arrays["argmax_right"], rtol=1e-5)
    for ours, theirs in (
        (gradient["token_embedding"]["embedding"], "trans_base.tok_emb.weight"),
        (gradient["block_0"]["attn"]["query"]["kernel"], "trans_base.blocks.0.attn.query.weight"),
        (gradient["head"]["kernel"], "trans_head.head.weight"),
    ):
        np.testing.assert_allclose(jnp.linalg.norm(ours), arrays[f"gradnorm/{theirs}"], rtol=1e-4)


@pytest.mark.slow
def test_cached_steps_equal_the_whole_sequence(case):
    arrays, model, variables = case
    text, tokens = jnp.asarray(arrays["clip_feat"]), jnp.asarray(arrays["input_tokens"])
    whole = compiled_apply(model, variables, tokens, text, train=False)
    logits, cache = compiled_apply(model, variables, text, method="begin")
    np.testing.assert_allclose(logits, whole[:, 0], atol=1e-5)
    for position in range(1, tokens.shape[1] + 1):
        logits, stops, cache = compiled_apply(model, variables, cache, tokens[:, position - 1, None], method="step")
        np.testing.assert_array_equal(stops, tokens[:, position - 1] == model.config.end_token)
        np.testing.assert_allclose(logits, whole[:, position], atol=1e-5)
