"""One program on many devices: the mesh with its axis `data`, and what a traced function sees of it.

The rows of a batch are divided among the devices; everything else is on all of them. Under `jax.jit` arrays are global
and XLA adds the communication. Under `jax.pmap` a function sees only the rows of its own device. The functions of this
page are the one place where results of devices are put together. Without a mapped axis they return what they are given.
"""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.experimental import multihost_utils
from jax.sharding import AxisType, Mesh, NamedSharding, PartitionSpec
from jaxtyping import Array, Int

AXIS = "data"
"""Name of the mesh's axis."""


def is_mapped() -> bool:
    """Returns whether this function is traced for one device of many, by `jax.pmap`."""
    try:
        jax.lax.axis_size(AXIS)
    except NameError:
        return False
    return True


def global_sum(tree: Any) -> Any:
    """Returns the sums of arrays over all devices."""
    return jax.lax.psum(tree, AXIS) if is_mapped() else tree


def global_mean(tree: Any) -> Any:
    """Returns the means of arrays over all devices, each of which has the same number of rows.

    The gradient of a global loss is the mean of the devices' gradients, because `psum` is its own transpose.
    """
    return jax.lax.pmean(tree, AXIS) if is_mapped() else tree


def global_rows(tree: Any) -> Any:
    """Returns the rows of all devices, in the order of the global batch."""
    if not is_mapped():
        return tree
    size, index = jax.lax.axis_size(AXIS), jax.lax.axis_index(AXIS)

    def gather(rows: jax.Array) -> jax.Array:
        # A sum and not `all_gather`: its gradient needs `psum_scatter`, which fails between processes on CPU.
        numbers = rows.astype(jnp.int32) if rows.dtype == bool else rows
        empty = jnp.zeros((size * len(rows), *rows.shape[1:]), numbers.dtype)
        placed = jax.lax.dynamic_update_slice_in_dim(empty, numbers, index * len(rows), axis=0)
        return jax.lax.psum(placed, AXIS).astype(rows.dtype)

    return jax.tree.map(gather, tree)


def own_rows(batch_size: int) -> Int[Array, " B"]:
    """Returns the numbers of the rows of the global batch that this function computes: all but under `jax.pmap`."""
    if not is_mapped():
        return jnp.arange(batch_size)
    count = batch_size // jax.lax.axis_size(AXIS)
    return jax.lax.axis_index(AXIS) * count + jnp.arange(count)


def split_rows(tree: Any) -> Any:
    """Returns a batch whose rows are divided among the devices of the current mesh (`jax.set_mesh`), if any."""
    if is_mapped() or AXIS not in jax.sharding.get_abstract_mesh().axis_names:
        return tree
    return jax.lax.with_sharding_constraint(tree, PartitionSpec(AXIS))


def make_data_mesh(devices: Any) -> Mesh:
    """Returns the mesh of some devices."""
    # Linen does not support explicit axes, which are JAX's default.
    return jax.make_mesh((len(devices),), (AXIS,), axis_types=(AxisType.Auto,), devices=devices)


@functools.cache
def _local_mesh() -> Mesh:
    return make_data_mesh(jax.local_devices())


def put_rows(tree: Any) -> Any:
    """Returns a batch on all devices of this process, divided by rows; on the default device if that is not possible.

    Use it for work that a process does alone, such as sampling, together with `put_everywhere` for the weights.
    """
    count = jax.local_device_count()
    if count == 1 or any(np.shape(leaf)[0] % count for leaf in jax.tree.leaves(tree)):
        return put_everywhere(tree)
    return jax.device_put(tree, NamedSharding(_local_mesh(), PartitionSpec(AXIS)))


def put_everywhere(tree: Any) -> Any:
    """Returns a tree of arrays on every device of this process."""
    if jax.local_device_count() == 1:
        return jax.device_put(tree)
    return jax.device_put(tree, NamedSharding(_local_mesh(), PartitionSpec()))


def is_true_anywhere(value: bool) -> bool:
    """Returns whether a value is true in any process; all processes must ask."""
    if jax.process_count() == 1:
        return value
    return bool(np.any(multihost_utils.process_allgather(np.array(value))))
