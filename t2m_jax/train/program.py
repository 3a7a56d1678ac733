"""The compiled step of every training: several updates in one call, on one device or on many.

`compile_updates` is the one place where a step is jitted, and where `jax.jit` or `jax.pmap` is chosen.
"""

import collections
import functools
import logging
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import Array, Float, Int

from t2m_jax.data.banks.motions import ShardedFrames, compact, divide_frames, map_banks
from t2m_jax.devices import AXIS, make_data_mesh
from t2m_jax.errors import UserError
from t2m_jax.train.config import ShardingConfig

logger = logging.getLogger(__name__)

CALLS_AHEAD = 2
"""Calls that the host may be ahead of the devices. Each has its own data if these stay on the host."""
SHARDED_FIELDS = ("opt_state",)
"""Fields of a training state that may be divided among devices."""


class Update(functools.partial[tuple[Any, Any]]):
    """A pure update with its options: from a state and data to the next state and metrics with a `loss`.

    Two are equal if their functions and (hashable) options are, so that equal trainings share their compiled programs.
    """

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Update) and (self.func, self.keywords) == (other.func, other.keywords)

    def __hash__(self) -> int:
        return hash((self.func, frozenset(self.keywords.items())))


@functools.cache
def compile_updates(update: Update, *, size: int, shares: int, mapped: Mesh | None = None) -> Callable[..., Any]:
    """Returns the compiled step of a training: `many_updates`, to which the state is donated.

    Args:
        update: What one step does.
        size: Most updates of a call.
        shares: Number of devices that share the optimizer's state, 1 if each has all of it.
        mapped: The devices on each of which `jax.pmap` runs the step, on its rows and with all of the state and the
            data. None compiles one global program with `jax.jit`, which XLA divides among the devices of the mesh.
    """
    if mapped is None:
        return jax.jit(functools.partial(many_updates, update=update, size=size, shares=shares), donate_argnums=0)
    return jax.pmap(
        functools.partial(many_updates, update=update, size=size),
        axis_name=AXIS,
        # `jax.pmap` needs one argument that has an axis of devices: each gets its own copy of the count.
        in_axes=(None, None, 0),
        out_axes=(None, None),
        devices=list(mapped.devices.flat),
        donate_argnums=0,
    )


def many_updates(
    state: Any,
    data: Any,
    count: Int[Array, ""],
    *,
    update: Callable[[Any, Any], tuple[Any, Any]],
    size: int,
    shares: int | None = None,
) -> tuple[Any, Any]:
    """Returns the state after `count` updates, and the metrics of each in arrays of `size` rows.

    `count` is not a constant of the program. So a call that is cut short runs the same program, and its results are
    those of a longer call to the last bit. With `shares`, every update keeps the state divided as it is.
    """

    def keep_divided(state: Any) -> Any:
        # Without it, XLA may move the whole state to all devices inside of the loop.
        return jax.lax.with_sharding_constraint(state, state_specs(state, shares=shares)) if shares else state

    if size == 1:
        state, metrics = update(state, data)
        return keep_divided(state), jax.tree.map(lambda value: value[None], metrics)

    def one_more(carry: tuple[Any, Any, Any]) -> tuple[Any, Any, Any]:
        number, state, rows = carry
        state, metrics = update(state, data)
        return number + 1, keep_divided(state), jax.tree.map(lambda row, new: row.at[number].set(new), rows, metrics)

    shapes = jax.eval_shape(update, state, data)[1]
    rows = jax.tree.map(lambda leaf: jnp.zeros((size, *leaf.shape), leaf.dtype), shapes)
    # A loop and not `scan`, whose number of steps would be a constant of the program.
    first = (jnp.array(0, jnp.int32), state, rows)
    return jax.lax.while_loop(lambda carry: carry[0] < count, one_more, first)[1:]


def largest_share(shape: Sequence[int], count: int) -> PartitionSpec:
    """Returns how an array is divided among `count` devices: along its longest axis that they divide, or not at all."""
    axes = [axis for axis, size in enumerate(shape) if size % count == 0 and size > 0]
    if not axes:  # such as scalars, which every device has
        return PartitionSpec()
    longest = max(axes, key=lambda axis: shape[axis])
    return PartitionSpec(*[None] * longest, AXIS)


def state_specs(state: Any, *, shares: int) -> Any:
    """Returns how each array of a training state is divided: `SHARDED_FIELDS` into `shares`, others not at all."""

    def specs(name: str, tree: Any) -> Any:
        parts = shares if name in SHARDED_FIELDS else 1
        return jax.tree.map(lambda leaf: largest_share(leaf.shape, parts) if parts > 1 else PartitionSpec(), tree)

    return type(state)(**{name: specs(name, tree) for name, tree in state._asdict().items()})


def choose_devices(config: ShardingConfig, *, batch_size: int) -> Mesh:
    """Returns the mesh of a training.

    Raises:
        UserError: There are not so many devices, or they do not divide the batch.
    """
    available = jax.devices()
    count: Any = config.devices
    if count == "auto":
        # Several processes must use all devices, since each has at least one of its own.
        fitting = [number for number in range(1, len(available) + 1) if batch_size % number == 0]
        count = len(available) if jax.process_count() > 1 else fitting[-1]
        if count < len(available):
            logger.warning("%d of %d devices are used, because they divide the batch", count, len(available))
    if count > len(available) or (jax.process_count() > 1 and count != len(available)):
        raise UserError(f"sharding.devices: {count}, but there are {len(available)}")
    if batch_size % count:
        raise UserError(f"loop.batch_size: {batch_size} is not a multiple of the {count} devices; change one of them")
    return make_data_mesh(available[:count])


class Devices:
    """The devices of a training: puts state and data on them, and runs compiled updates."""

    def __init__(self, config: ShardingConfig, *, batch_size: int):
        """Chooses the devices.

        Raises:
            UserError: There are not so many devices, or they do not divide the batch.
        """
        self._config = config
        self.mesh = choose_devices(config, batch_size=batch_size)
        self.is_mapped = config.mode == "pmap"
        """Whether `jax.pmap` runs the program."""
        self.bank_shares = self.mesh.size if config.bank == "sharded" else 1
        """Parts into which the frames of a bank are divided."""
        self._shares = self.mesh.size if config.optimizer == "sharded" else 1
        self._running: collections.deque[Any] = collections.deque()
        # On a CPU, devices share one pool of threads. Many programs that wait for all of them at once can block it.
        self._waits = self.mesh.size > 1 and self.mesh.devices.flat[0].platform == "cpu"

    def put_state(self, state: Any) -> Any:
        """Returns a training state on the devices."""
        return jax.tree.map(self._put, state, state_specs(state, shares=self._shares))

    def put_data(self, data: Any) -> Any:
        """Returns data on all devices; the frames of a bank are divided among them if the config says so."""
        # Before they are divided, so that every device gets the same share of what is used.
        data = map_banks(data, compact)
        if self._config.bank == "sharded":
            data = map_banks(data, lambda bank: divide_frames(bank, self.mesh.size))

        def put(leaf: Any) -> Any:
            if isinstance(leaf, ShardedFrames):
                return ShardedFrames(self._put(leaf.rows, PartitionSpec(AXIS)))
            return self._put(leaf, PartitionSpec(), may_alias=True)  # nobody writes to data

        return jax.tree.map(put, data, is_leaf=lambda leaf: isinstance(leaf, ShardedFrames))

    def put_windows(self, windows: Float[np.ndarray, "S R T D"]) -> jax.Array:
        """Returns the windows of S steps on the devices, each of which gets its rows.

        `windows` has the `rows_of_process` of each batch.
        """
        return jax.make_array_from_process_local_data(NamedSharding(self.mesh, PartitionSpec(None, AXIS)), windows)

    def rows_of_process(self, batch_size: int) -> Int[np.ndarray, " R"]:
        """Returns the rows of a global batch that the devices of this process compute, in order."""
        sharding = NamedSharding(self.mesh, PartitionSpec(AXIS))
        rows = np.arange(batch_size)
        return np.unique([rows[index] for index in sharding.addressable_devices_indices_map(rows.shape).values()])

    def run(self, update: Update, state: Any, data: Any, count: int, *, size: int) -> tuple[Any, Any]:
        """Returns the state after `count` updates, and the metrics of each in arrays of `size` rows.

        Args:
            update: What to run.
            state: On the devices; it is donated.
            data: On the devices.
            count: Number of updates, up to `size`.
            size: Most updates of a call; the program is compiled for it.
        """
        if self.is_mapped:
            counts = self._put(np.full(self.mesh.size, count, np.int32), PartitionSpec(AXIS))
            result = self._compiled(update, size)(state, data, counts)
        else:
            with jax.set_mesh(self.mesh):
                result = self._compiled(update, size)(state, data, np.int32(count))
        # Metrics are outputs of the same program as the state, which the next call will have deleted by donation.
        self._running.append(result[1])
        if len(self._running) > CALLS_AHEAD:
            jax.block_until_ready(self._running.popleft())
        return self._finished(result)

    def lower(self, update: Update, state: Any, data: Any, *, size: int) -> jax.stages.Lowered:
        """Returns the program that `run` uses in mode `jit`; once it is compiled, `run` does not compile it again."""
        with jax.set_mesh(self.mesh):
            return self._compiled(update, size).lower(state, data, np.int32(1))

    def measure(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """Returns what a jitted function returns for arguments on the devices; it divides batches among them."""
        with jax.set_mesh(self.mesh):
            return self._finished(function(*arguments))

    def _finished(self, found: Any) -> Any:
        return jax.block_until_ready(found) if self._waits else found

    def _compiled(self, update: Update, size: int) -> Any:
        mapped = self.mesh if self.is_mapped else None
        return compile_updates(update, size=size, shares=self._shares, mapped=mapped)

    def _put(self, leaf: Any, spec: PartitionSpec, *, may_alias: bool | None = None) -> jax.Array:
        sharding = NamedSharding(self.mesh, spec)
        if jax.process_count() == 1:
            return jax.device_put(leaf, sharding, may_alias=may_alias)
        # `device_put` cannot reach the devices of other processes: each process fills its own.
        values = np.asarray(leaf)
        return jax.make_array_from_callback(values.shape, sharding, lambda index: values[index])
