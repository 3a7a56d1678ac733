"""The operations that are counted are those of the products, whatever is around them."""

import jax
import jax.numpy as jnp
import pytest

from t2m_jax.bench.timing import count_flops

A, B = jnp.zeros((3, 4)), jnp.zeros((4, 5))
PRODUCT = 2 * 3 * 4 * 5


def scanned(a, b):
    return jax.lax.scan(lambda carry, _: (carry + 1, a @ b), 0, None, length=7)


def branching(a, b):
    return jax.lax.cond(a[0, 0] > 0, lambda: (a @ b).sum(), lambda: 0.0)


@pytest.mark.parametrize(
    ("function", "expected"),
    [
        (jnp.matmul, PRODUCT),
        (jax.jit(jnp.matmul), PRODUCT),
        (lambda a, b: jnp.sin(a) @ b + 1, PRODUCT),
        (scanned, 7 * PRODUCT),
        (branching, PRODUCT),
        (jax.checkpoint(jnp.matmul), PRODUCT),
        (jax.grad(lambda a, b: (a @ b).sum(), argnums=(0, 1)), 3 * PRODUCT),
        (jax.vmap(lambda row, b: row @ b, in_axes=(0, None)), PRODUCT),
    ],
)
def test_products_are_counted(function, expected):
    assert count_flops(function, A, B) == expected


def test_convolutions_are_counted():
    def convolve(inputs, kernel):
        return jax.lax.conv_general_dilated(inputs, kernel, (1,), "SAME", dimension_numbers=("NHC", "HIO", "NHC"))

    assert count_flops(convolve, jnp.zeros((2, 10, 4)), jnp.zeros((3, 4, 5))) == 2 * (2 * 10 * 5) * (3 * 4)
