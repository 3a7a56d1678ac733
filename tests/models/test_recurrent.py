"""The GRU's own gradient against the one that JAX derives from its steps."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax.models.recurrent import last_state, next_state

STEPS, ROWS, WIDTH = 7, 3, 4


def plain(first, gates, mask, kernel, bias):
    """Returns the last state, step after step."""
    state = first
    for gate, is_read in zip(gates, mask, strict=True):
        state = next_state(state, gate, state @ kernel + bias[None], is_read)
    return state


@pytest.fixture
def arguments():
    rng = np.random.default_rng(0)
    shapes = [(ROWS, WIDTH), (STEPS, ROWS, 3 * WIDTH), None, (WIDTH, 3 * WIDTH), (3 * WIDTH,)]
    mask = jnp.arange(STEPS)[:, None] < jnp.array([[STEPS, 3, 0]])
    return [mask if shape is None else jnp.asarray(rng.normal(size=shape), jnp.float32) for shape in shapes]


@pytest.mark.slow
@pytest.mark.parametrize("transform", [lambda function: function, jax.jit], ids=["eager", "jit"])
def test_state_and_gradients_are_those_of_the_plain_steps(arguments, transform):
    weights = jnp.arange(1.0, ROWS * WIDTH + 1).reshape(ROWS, WIDTH) / WIDTH

    def gradients(run):
        total = jax.value_and_grad(lambda *values: (weights * run(*values)).sum(), argnums=(0, 1, 3, 4))
        return transform(total)(*arguments)

    (expected, theirs), (found, ours) = gradients(plain), gradients(last_state)
    np.testing.assert_allclose(found, expected, rtol=1e-5)
    for one, other in zip(ours, theirs, strict=True):
        assert np.abs(other).max() > 0.1
        np.testing.assert_allclose(one, other, atol=1e-5)


def test_weights_get_their_gradient_outside_the_loop(arguments):
    def total(kernel):
        return last_state(*arguments[:3], kernel, arguments[4]).sum()

    backward = jax.make_jaxpr(jax.grad(total))(arguments[3]).eqns
    shapes = [variable.aval.shape for eqn in backward if eqn.primitive.name == "scan" for variable in eqn.outvars]
    assert (ROWS, WIDTH) in shapes and arguments[3].shape not in shapes
