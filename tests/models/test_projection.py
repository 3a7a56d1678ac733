"""The projection: parameters of `nn.Dense`, and the same results with transposed kernels."""

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax.models.projection import WEIGHT_INIT, Projection, projection_paths, restore_kernels, transpose_kernels
from t2m_jax.models.system import make_module, variable_shapes
from tests.jit import assert_jit_equals_eager, compiled_apply
from tests.tiny import GPT, VQVAE, random_variables

WIDTH, FEATURES = 6, 5
BLOCK_LAYERS = {("attn", "query"), ("attn", "key"), ("attn", "value"), ("attn", "proj"), ("mlp", "up"), ("mlp", "down")}


def dense_and_variables(*, use_bias=True, dtype=jnp.float32):
    """`nn.Dense` with weights, none of which is zero."""
    dense = nn.Dense(FEATURES, use_bias=use_bias, kernel_init=WEIGHT_INIT)
    shapes = dense.init(jax.random.key(0), jnp.zeros((1, WIDTH)))
    return dense, jax.tree.map(lambda leaf: jax.random.normal(jax.random.key(1), leaf.shape, dtype), shapes)


def transposed(variables):
    """The variables of a single projection with its kernel in the collection."""
    others = {name: leaf for name, leaf in variables["params"].items() if name != "kernel"}
    return {"params": others, "transposed": {"kernel": variables["params"]["kernel"].T}}


@pytest.mark.parametrize("use_bias", [True, False])
def test_parameters_are_those_of_dense(use_bias):
    inputs = jnp.zeros((2, WIDTH))
    dense = nn.Dense(FEATURES, use_bias=use_bias, kernel_init=WEIGHT_INIT).init(jax.random.key(3), inputs)
    projection = Projection(FEATURES, use_bias=use_bias).init(jax.random.key(3), inputs)
    jax.tree.map(np.testing.assert_array_equal, projection, dense)


@pytest.mark.parametrize("use_bias", [True, False])
@pytest.mark.parametrize("shape", [(), (1,), (3,), (2, 3), (2, 1, 3)])
def test_both_layouts_agree_with_dense(shape, use_bias):
    dense, variables = dense_and_variables(use_bias=use_bias)
    inputs = jax.random.normal(jax.random.key(2), (*shape, WIDTH))
    expected = dense.apply(variables, inputs)
    for found in (variables, transposed(variables)):
        outputs = Projection(FEATURES, use_bias=use_bias).apply(found, inputs)
        assert outputs.shape == (*shape, FEATURES)
        np.testing.assert_allclose(outputs, expected, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("weights", [jnp.float32, jnp.bfloat16])
@pytest.mark.parametrize("inputs", [jnp.float32, jnp.bfloat16])
def test_dtypes_are_those_of_dense(inputs, weights):
    dense, variables = dense_and_variables(dtype=weights)
    values = jax.random.normal(jax.random.key(2), (3, WIDTH), inputs)
    expected = dense.apply(variables, values)
    assert (expected.dtype == jnp.bfloat16) == (inputs == weights == jnp.bfloat16)
    for found in (variables, transposed(variables)):
        outputs = Projection(FEATURES).apply(found, values)
        assert outputs.dtype == expected.dtype
        np.testing.assert_allclose(outputs.astype(float), expected.astype(float), rtol=0.02, atol=0.02)


def test_a_transposed_kernel_is_used_and_not_the_parameter():
    _, variables = dense_and_variables()
    both = {"params": variables["params"], "transposed": {"kernel": jnp.zeros((FEATURES, WIDTH))}}
    outputs = Projection(FEATURES).apply(both, jnp.ones((2, WIDTH)))
    np.testing.assert_array_equal(outputs, jnp.broadcast_to(variables["params"]["bias"][None], (2, FEATURES)))


def test_both_layouts_jit_equals_eager():
    _, variables = dense_and_variables()
    for found in (variables, transposed(variables)):
        assert_jit_equals_eager(jax.jit(Projection(FEATURES).apply), found, jnp.ones((3, WIDTH)), atol=1e-6)


def test_paths_are_those_of_the_projections():
    blocks = {(f"block_{layer}", *path) for layer in range(GPT.num_layers) for path in BLOCK_LAYERS}
    assert set(projection_paths(GPT)) == blocks | {("text_projection",), ("head",)}
    assert projection_paths(VQVAE) == ()


def test_a_model_keeps_what_is_not_a_projection():
    variables = random_variables(variable_shapes(VQVAE))
    jax.tree.map(np.testing.assert_array_equal, transpose_kernels(variables, VQVAE), variables)


def test_kernels_move_and_come_back():
    variables = random_variables(variable_shapes(GPT))
    moved = transpose_kernels(variables, GPT)
    assert sum(leaf.size for leaf in jax.tree.leaves(moved)) == sum(leaf.size for leaf in jax.tree.leaves(variables))
    assert "head" not in moved["params"], "the kernel is the only parameter of the head"
    assert moved["transposed"]["head"]["kernel"].shape == (GPT.num_codes + 1, GPT.embed_dim)
    jax.tree.map(np.testing.assert_array_equal, restore_kernels(moved), variables)
    again = transpose_kernels(moved, GPT)
    jax.tree.map(np.testing.assert_array_equal, again, moved)


def test_logits_agree():
    variables = random_variables(variable_shapes(GPT))
    tokens, text = jnp.arange(6).reshape(2, 3), jax.random.normal(jax.random.key(0), (2, GPT.text_dim))
    usual, moved = (
        compiled_apply(make_module(GPT), found, tokens, text, train=False)
        for found in (variables, transpose_kernels(variables, GPT))
    )
    np.testing.assert_allclose(moved, usual, rtol=1e-5, atol=1e-5)
