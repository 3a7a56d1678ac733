"""Modules applied row by row: dropout that belongs to the row, and the dtype of products."""

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax.models.rows import apply_rows, in_precision


class Dropped(nn.Module):
    """Dropout of what it is given."""

    @nn.compact
    def __call__(self, hidden, *, train):
        return nn.Dropout(0.5)(hidden, deterministic=not train)

    def doubled(self, hidden, shift, *, train):
        """Another method, of two inputs."""
        return 2 * hidden + shift


HIDDEN = 1.0 + jnp.arange(4 * 64.0).reshape(4, 64)
KEYS = jax.random.split(jax.random.key(0), 4)


@pytest.mark.slow
def test_dropout_of_a_row_is_that_of_its_key_alone():
    together = apply_rows(Dropped(), {}, HIDDEN, keys=KEYS)
    for rows in ([0], [2, 3], [3, 1]):
        alone = apply_rows(Dropped(), {}, HIDDEN[jnp.array(rows)], keys=KEYS[jnp.array(rows)])
        np.testing.assert_array_equal(alone, together[jnp.array(rows)])
    other = apply_rows(Dropped(), {}, HIDDEN, keys=KEYS.at[0].set(jax.random.key(9)))
    np.testing.assert_array_equal(other[1:], together[1:])
    assert not np.array_equal(other[0], together[0])


def test_rows_are_dropped_apart_and_kept_values_are_scaled():
    found = np.asarray(apply_rows(Dropped(), {}, HIDDEN, keys=KEYS))
    kept = found != 0
    assert len(np.unique(kept, axis=0)) == 4
    assert 0.35 < kept.mean() < 0.65
    np.testing.assert_array_equal(found[kept], 2 * np.asarray(HIDDEN)[kept])


def test_without_keys_nothing_is_dropped():
    np.testing.assert_array_equal(apply_rows(Dropped(), {}, HIDDEN, keys=None), HIDDEN)


def test_any_method_with_any_inputs_can_be_applied():
    shift = jnp.arange(4.0)[:, None] * jnp.ones((1, 64))
    for keys in (KEYS, None):
        found = apply_rows(Dropped(), {}, HIDDEN, shift, keys=keys, method="doubled")
        np.testing.assert_array_equal(found, 2 * HIDDEN + shift)


def test_parameters_are_those_of_all_rows():
    module, hidden = nn.Dense(3), HIDDEN[:, :5]
    params = module.init(jax.random.key(1), hidden)["params"]

    class Projected(nn.Module):
        """A layer that takes `train`."""

        @nn.compact
        def __call__(self, hidden, *, train):
            return nn.Dense(3, name="dense")(hidden)

    found = apply_rows(Projected(), {"params": {"dense": params}}, hidden, keys=KEYS)
    np.testing.assert_allclose(found, module.apply({"params": params}, hidden), rtol=1e-6)


def test_only_floats_get_the_precision():
    tree = {"weights": jnp.ones(3), "tokens": jnp.arange(3), "mask": jnp.ones(2, bool)}
    found = in_precision(tree, "bfloat16")
    assert {name: leaf.dtype for name, leaf in found.items()} == {
        "weights": jnp.bfloat16,
        "tokens": jnp.int32,
        "mask": jnp.bool_,
    }
    jax.tree.map(np.testing.assert_array_equal, in_precision(tree, "float32"), tree)
    assert in_precision(tree, "float32")["weights"].dtype == jnp.float32
