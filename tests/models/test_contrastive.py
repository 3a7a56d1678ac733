"""The common space of texts and motions: what its vectors depend on."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax.losses import infonce_loss
from t2m_jax.models.contrastive import ContrastiveHead
from tests.tiny import random_variables

KEY = jax.random.key(0)
LENGTHS = jnp.array([6, 3, 1])
MASK = jnp.arange(6)[None] < LENGTHS[:, None]
TEXT, ROWS = jax.random.normal(KEY, (3, 4)), jax.random.normal(KEY, (3, 6, 5))
HEAD = ContrastiveHead()
VARIABLES = random_variables(jax.eval_shape(HEAD.init, KEY, TEXT, ROWS, MASK), gain=1.0)
APPLY = jax.jit(HEAD.apply)


def test_vectors_have_length_one():
    for found in APPLY(VARIABLES, TEXT, ROWS, MASK):
        np.testing.assert_allclose(jnp.linalg.norm(found, axis=-1), 1, atol=1e-4)


def test_rows_after_the_end_have_no_influence():
    other = jnp.where(MASK[..., None], ROWS, 1e3)
    for one, another in zip(APPLY(VARIABLES, TEXT, ROWS, MASK), APPLY(VARIABLES, TEXT, other, MASK), strict=True):
        np.testing.assert_array_equal(one, another)


def test_the_order_of_the_halves_counts():
    _, motion = APPLY(VARIABLES, TEXT, ROWS, MASK)
    _, reverse = APPLY(VARIABLES, TEXT, ROWS.at[0].set(ROWS[0, ::-1]), MASK)
    assert np.abs(motion[0] - reverse[0]).max() > 0.1
    _, within = APPLY(VARIABLES, TEXT, ROWS.at[0, :2].set(ROWS[0, 1::-1]), MASK)  # the first half, in another order
    np.testing.assert_allclose(motion, within, atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("rows", [ROWS, jnp.zeros_like(ROWS)])
def test_gradients_are_finite(rows):
    def loss(variables, text):
        return infonce_loss(*HEAD.apply(variables, text, rows, MASK), jnp.eye(3, dtype=bool), temperature=0.1)

    of_head, of_text = jax.grad(loss, argnums=(0, 1))(VARIABLES, TEXT)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves((of_head, of_text)))
    assert np.abs(of_text).max() > 1e-3 or not np.any(rows)
