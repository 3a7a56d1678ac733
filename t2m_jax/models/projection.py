"""The dense layer of the transformers, which can compute with transposed weights: faster for small batches on a CPU."""

import functools
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp
from flax.traverse_util import flatten_dict, unflatten_dict
from jaxtyping import Array, Float

from t2m_jax.models.system import PartConfig, trace_init

WEIGHT_INIT = nn.initializers.normal(0.02)
TRANSPOSED = "transposed"
"""The collection of transposed kernels. It replaces the kernels in `params` and is not part of any file."""

Path = tuple[str, ...]


class Projection(nn.Module):
    """A dense layer with the parameters of `nn.Dense`: `kernel` [I, O] and `bias` [O].

    If the collection `transposed` has a `kernel` [O, I] for this layer, the layer uses it and reads no `kernel` from
    `params`. The result is the same up to rounding.
    """

    features: int
    use_bias: bool = True

    @nn.compact
    def __call__(self, inputs: Float[Array, "*rows I"]) -> Float[Array, "*rows O"]:
        """Returns `inputs @ kernel + bias`."""
        if self.has_variable(TRANSPOSED, "kernel"):
            outputs = _transposed_product(inputs, self.get_variable(TRANSPOSED, "kernel"))
        else:
            outputs = inputs @ self.param("kernel", WEIGHT_INIT, (inputs.shape[-1], self.features))
        if not self.use_bias:
            return outputs
        bias = self.param("bias", nn.initializers.zeros, (self.features,))
        return outputs + bias.reshape((1,) * (outputs.ndim - 1) + bias.shape)


def _transposed_product(inputs: Float[Array, "*rows I"], kernel: Float[Array, "O I"]) -> Float[Array, "*rows O"]:
    """Returns `inputs @ kernel.T`, computed with the weights as the left operand.

    XLA on a CPU is faster with the weights on the left, in this layout, if there are few rows. Without the barrier it
    folds both transposes into the product, which is then slower than with the usual kernel.
    """
    columns = jax.lax.optimization_barrier(kernel @ inputs.reshape(-1, inputs.shape[-1]).T)
    return columns.T.reshape(*inputs.shape[:-1], kernel.shape[0])


@functools.lru_cache
def projection_paths(config: PartConfig) -> tuple[Path, ...]:
    """Returns the paths of all projections of a part's module, as in its parameter tree."""
    paths: dict[Path, None] = {}

    def note(call: Any, args: Any, kwargs: Any, context: nn.module.InterceptorContext) -> Any:
        if isinstance(context.module, Projection):
            paths[context.module.path] = None
        return call(*args, **kwargs)

    # The modules know their own paths; the names in the tree would not say which kernels are projections.
    with nn.intercept_methods(note):
        trace_init(config)
    return tuple(paths)


def transpose_kernels(variables: dict[str, Any], config: PartConfig) -> dict[str, Any]:
    """Returns variables with the kernels of the projections in `transposed` and not in `params`.

    Other layers, for example `nn.Dense`, keep their kernels. Nothing is stored twice.
    """
    flat = flatten_dict(variables)
    for path in projection_paths(config):
        name = ("params", *path, "kernel")
        # A kernel with more axes belongs to several layers (`nn.scan`), which do not see the collection.
        if name in flat and flat[name].ndim == 2:
            flat[TRANSPOSED, *path, "kernel"] = jnp.transpose(flat.pop(name))
    return unflatten_dict(flat)


def restore_kernels(variables: dict[str, Any]) -> dict[str, Any]:
    """Returns the variables from which `transpose_kernels` made `variables`."""
    flat = flatten_dict(variables)
    for name in [name for name in flat if name[0] == TRANSPOSED]:
        flat["params", *name[1:]] = jnp.transpose(flat.pop(name))
    return unflatten_dict(flat)
