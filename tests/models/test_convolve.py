"""The two forms of the convolution against each other, and the convolution against a loop over its taps."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax.models.convolution import MaskedConv
from t2m_jax.models.convolve import Window, convolve, convolve_repeated, general_convolution, loop_convolution
from t2m_jax.models.vqvae import VqVae
from tests.jit import optimized
from tests.tiny import VQVAE

WINDOWS = [
    pytest.param(size, stride, dilation, padding, id=f"kernel{size}-stride{stride}-dilation{dilation}-pad{padding}")
    for size, stride, dilation, padding in [
        (1, 1, 1, 0),
        (1, 2, 1, 0),
        (3, 1, 1, 1),
        (3, 1, 3, 3),
        (3, 1, 9, 9),
        (3, 2, 1, 1),
        (3, 2, 3, 2),
        (4, 1, 1, 1),
        (4, 2, 1, 1),
        (4, 2, 3, 0),
        (3, 1, 1, 3),
    ]
]


def arrays(length: int, kernel_size: int):
    """Returns random inputs and a random kernel."""
    keys = jax.random.split(jax.random.key(length + kernel_size))
    return jax.random.normal(keys[0], (2, length, 5)), jax.random.normal(keys[1], (kernel_size, 5, 4))


def value_and_gradients(function, *arguments):
    """Returns the output and the gradients of a function of the output that uses every number differently."""
    output, pullback = jax.vjp(function, *arguments)
    return output, *pullback(jnp.cos(jnp.arange(output.size, dtype=output.dtype)).reshape(output.shape))


@pytest.mark.slow
@pytest.mark.parametrize("length", [19, 20])
@pytest.mark.parametrize(("kernel_size", "stride", "dilation", "padding"), WINDOWS)
def test_both_forms_have_the_same_outputs_and_gradients(length, kernel_size, stride, dilation, padding):
    window = Window(stride, dilation, padding)
    forms = (functools.partial(form, window=window) for form in (loop_convolution, general_convolution))
    fast, general = (value_and_gradients(form, *arrays(length, kernel_size)) for form in forms)
    for ours, expected in zip(fast, general, strict=True):
        np.testing.assert_allclose(ours, expected, atol=1e-4)


@pytest.mark.parametrize(("kernel_size", "stride", "dilation", "padding"), WINDOWS)
def test_outputs_are_sums_of_taps(kernel_size, stride, dilation, padding):
    inputs, kernel = (np.asarray(array) for array in arrays(19, kernel_size))
    padded = np.pad(inputs, ((0, 0), (padding, padding), (0, 0)))
    first = range(0, padded.shape[1] - dilation * (kernel_size - 1), stride)
    expected = [sum(padded[:, start + dilation * tap] @ kernel[tap] for tap in range(kernel_size)) for start in first]
    found = convolve(jnp.asarray(inputs), jnp.asarray(kernel), stride=stride, dilation=dilation, padding=padding)
    np.testing.assert_allclose(found, np.stack(expected, axis=1), atol=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("length", [1, 2, 19])
def test_convolution_of_a_repeated_sequence_has_the_same_outputs_and_gradients(length):
    def expected(inputs, kernel):
        return convolve(jnp.repeat(inputs, 2, axis=1), kernel, padding=1)

    forms = (value_and_gradients(form, *arrays(length, 3)) for form in (convolve_repeated, expected))
    for ours, theirs in zip(*forms, strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-4)


def test_the_form_is_that_of_the_backend(monkeypatch):
    def has_own_gradient():
        return "custom_vjp_call" in str(jax.make_jaxpr(lambda *pair: convolve(*pair))(*arrays(8, 3)))

    assert has_own_gradient()
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    assert not has_own_gradient()


@pytest.mark.slow
def test_a_vqvae_is_trained_in_a_loop_by_convolutions_that_the_cpu_backend_is_fast_at():
    """In a loop, XLA calls its library for no other order of axes; the rest runs a hundred times slower."""
    model = VqVae(VQVAE)
    motion = jnp.zeros((3, 32, VQVAE.feature_dim))
    variables = model.init(jax.random.key(0), motion, train=False)

    def loss(params):
        return jnp.sum(model.apply({**variables, "params": params}, motion, train=False).reconstruction ** 2)

    @jax.jit
    def descend(params, count):
        return jax.lax.fori_loop(0, count, lambda _, params: jax.grad(loss)(params), params)

    with optimized():
        program = descend.lower(variables["params"], 1).compile().as_text()
    convolutions = [line for line in program.splitlines() if " convolution(" in line]
    assert len(convolutions) > 20
    slow = [line for line in convolutions if "dim_labels=b0f_0io->b0f" not in line or "reversal" in line]
    assert not slow, slow


def test_a_convolution_computes_in_the_dtype_of_its_inputs():
    inputs, mask = jnp.ones((1, 6, 5), jnp.bfloat16), jnp.ones((1, 6), bool)
    layer = MaskedConv(4, 3, padding=1)
    variables = layer.init(jax.random.key(0), inputs, mask)
    gradient = jax.grad(lambda variables: layer.apply(variables, inputs, mask).sum().astype(jnp.float32))(variables)
    assert layer.apply(variables, inputs, mask).dtype == jnp.bfloat16
    assert all(leaf.dtype == jnp.float32 for leaf in jax.tree.leaves((variables, gradient)))
