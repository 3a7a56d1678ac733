"""The training steps: what a step may change, and what it must not depend on."""

import dataclasses
import functools
from typing import Any

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax.data.banks.motions import Windows
from t2m_jax.text.bpe import CaptionTokens
from t2m_jax.train import TrainVqVaeConfig
from t2m_jax.train.gpt import GptBatch, TrainGptConfig, gpt_train_step, init_gpt_state, make_gpt_batch, make_targets
from t2m_jax.train.vqvae import init_vqvae_state, vqvae_train_step
from tests.documents import code_blocks
from tests.tiny import CAPTION_ENCODER, GPT, OPTIMIZER, VQVAE, walking_normalizer

# Without jit every operation is compiled for every shape: few layers, and widths that agree.
VQVAE_TRAINING = TrainVqVaeConfig(
    model=dataclasses.replace(VQVAE, num_stages=1, code_dim=16), window=16, optimizer=OPTIMIZER
)
GPT_TRAINING = TrainGptConfig(
    model=dataclasses.replace(GPT, num_layers=1, text_dim=16),
    caption_encoder=dataclasses.replace(CAPTION_ENCODER, text_dim=16),
    optimizer=OPTIMIZER,
)

KEY = jax.random.key(0)


def windows() -> Windows:
    mask = jnp.array([[True] * 16, [True] * 9 + [False] * 7])
    return Windows(jax.random.normal(jax.random.key(1), (2, 16, 263)) * mask[:, :, None], mask)


def gpt_batch() -> GptBatch:
    codes = jax.random.randint(jax.random.key(2), (3, 7), 0, GPT.num_codes)
    targets = make_targets(codes, jnp.array([7, 3, 5]), config=GPT)
    tokens = jax.random.randint(jax.random.key(3), (3, 16), 2, 90)
    captions = CaptionTokens(tokens, jnp.arange(16)[None] < jnp.array([4, 16, 9])[:, None])
    keys = jax.random.split(jax.random.key(4), (3, 2))
    return make_gpt_batch(targets, captions, config=GPT_TRAINING, dropout_keys=keys)


@pytest.mark.slow
def test_what_lies_past_the_end_teaches_nothing():
    state = init_vqvae_state(VQVAE_TRAINING, jax.random.key(0))
    clean = windows()
    spoiled = Windows(jnp.where(clean.mask[:, :, None], clean.motion, 1e3), clean.mask)
    train = functools.partial(vqvae_train_step, config=VQVAE_TRAINING, normalizer=walking_normalizer())
    step = jax.jit(train)
    one, metrics = step(state, clean, jax.random.key(4))
    other, spoiled_metrics = step(state, spoiled, jax.random.key(4))
    for name in metrics:
        np.testing.assert_array_equal(metrics[name], spoiled_metrics[name], err_msg=name)
    for left, right in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        np.testing.assert_array_equal(left, right)


@pytest.mark.slow
def test_the_caption_reaches_the_loss():
    state = init_gpt_state(GPT_TRAINING, jax.random.key(0))
    step = jax.jit(gpt_train_step, static_argnames="config")
    after, _ = step(state, gpt_batch(), config=GPT_TRAINING)
    before = state.params["caption_encoder"]["token_embedding"]["embedding"]
    assert np.any(np.asarray(after.params["caption_encoder"]["token_embedding"]["embedding"] != before))


def test_accuracy_is_over_tokens_whatever_the_loss_is():
    codes = jax.random.randint(jax.random.key(2), (3, 7), 0, GPT.num_codes)
    targets = make_targets(codes, jnp.array([7, 3, 5]), config=GPT)
    configs = [dataclasses.replace(GPT_TRAINING, mean_over=kind) for kind in ("motions", "tokens")]
    batches = [make_gpt_batch(targets, jnp.zeros((3, 16)), config=config) for config in configs]
    np.testing.assert_array_equal(batches[0].accuracy_weights, batches[1].accuracy_weights)
    np.testing.assert_array_equal(batches[1].loss_weights, batches[1].accuracy_weights)
    assert not np.array_equal(batches[0].loss_weights, batches[1].loss_weights)


@pytest.mark.slow
def test_the_loop_of_the_page_learns(data, repository, tmp_path, monkeypatch, capsys):
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "synthetic").symlink_to(data)
    monkeypatch.chdir(tmp_path)
    ((_, code),) = code_blocks(repository / "docs" / "howto" / "training_loop.md", "python")
    assert len(code.splitlines()) <= 45
    names: dict[str, Any] = {}
    exec(code, names)  # noqa: S102 - the page's code is run as it is
    losses = names["losses"]
    assert np.mean(losses[-5:]) < 0.9 * np.mean(losses[:5])
    assert capsys.readouterr().out.endswith(" mm\n")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["vqvae", "gpt"])
def test_a_step_is_compiled_once(name):
    """The state that a step returns must have the types of the state that it takes."""
    chex.clear_trace_counter()

    def vqvae_step(state, number):
        key, normalizer = jax.random.key(number), walking_normalizer()
        return vqvae_train_step(state, windows(), key, config=VQVAE_TRAINING, normalizer=normalizer)

    def gpt_step(state, number):
        keys = jax.random.split(jax.random.key(number), (3, 2))
        return gpt_train_step(state, gpt_batch()._replace(dropout_keys=keys), config=GPT_TRAINING)

    step, state = {
        "vqvae": lambda: (vqvae_step, init_vqvae_state(VQVAE_TRAINING, KEY)),
        "gpt": lambda: (gpt_step, init_gpt_state(GPT_TRAINING, KEY)),
    }[name]()
    compiled = jax.jit(chex.assert_max_traces(step, n=1))
    for number in range(3):
        state, _ = compiled(state, number)
    assert state.step == 3
