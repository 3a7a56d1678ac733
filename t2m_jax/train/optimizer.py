"""The optimizer, its learning-rate schedule, and the update that every trainer makes with it."""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float, Int

from t2m_jax.devices import global_mean
from t2m_jax.field_checks import check_amounts

Metrics = dict[str, Float[Array, ""]]


@dataclasses.dataclass(frozen=True, kw_only=True)
class OptimizerConfig:
    """AdamW with warm-up, and step or cosine decay."""

    learning_rate: float = 2e-4
    """Learning rate after the warm-up. With a warm-up it is slightly lower, see `warmup_steps`."""
    warmup_steps: int = 0
    """Length W of the linear warm-up. As in the original code, it takes W - 1 updates, and the rate then stays at its
    last value, learning_rate * W / (W + 1)."""
    milestones: tuple[int, ...] = ()
    """Updates after the warm-up at which the learning rate is multiplied by `gamma`."""
    gamma: float = 0.05
    """Factor at each milestone."""
    cosine: tuple[int, int] | None = None
    """Updates at which a decay along half a cosine begins, and at which it has reached 0; null for none."""
    betas: tuple[float, float] = (0.9, 0.99)
    """Decay rates of AdamW's two averages."""
    weight_decay: float = 0.0
    """Decoupled weight decay, which is multiplied by the learning rate."""
    clip_norm: float = 0.0
    """Largest global norm of the gradients. Larger gradients are scaled down to it; 0 turns this off."""

    def __post_init__(self) -> None:
        check_amounts(self, "learning_rate", "gamma", "weight_decay", "clip_norm")
        if not all(0 <= beta < 1 for beta in self.betas):
            raise ValueError(f"betas: {list(self.betas)} are not two numbers from 0 to 1, without 1")
        for step in (self.warmup_steps, *self.milestones):
            if not 0 <= step < 2**31:
                raise ValueError(f"warmup_steps, milestones: {step} is not a number of updates from 0 to {2**31 - 1}")
        if self.cosine is not None and not 0 <= self.cosine[0] < self.cosine[1] < 2**31:
            raise ValueError(f"cosine: {list(self.cosine)} is not the first and the last update of a decay")


class TrainState(NamedTuple):
    """Everything that an update changes, for models that have only parameters."""

    step: Int[Array, ""]
    params: Any
    opt_state: Any


def learning_rate_at(step: Int[Array, ""] | int, config: OptimizerConfig) -> Float[Array, ""]:
    """Returns the learning rate of update `step`, counted from 0 at the start of the warm-up."""
    warmup = config.warmup_steps
    # The original counts updates from 1 and scales by (number + 1) / (W + 1), hence the 2.
    num_warmup_updates = max(warmup - 1, 0)
    warm = config.learning_rate * jnp.minimum(step + 2, warmup) / (warmup + 1) if warmup else config.learning_rate
    # Milestones count from the end of the warm-up, as the original's scheduler does.
    passed = jnp.sum(jnp.asarray(config.milestones, jnp.int32) <= step - num_warmup_updates)
    rate = warm * config.gamma**passed
    if config.cosine is not None:
        first, last = config.cosine
        rate *= 0.5 * (1.0 + jnp.cos(jnp.pi * jnp.clip((step - first) / (last - first), 0.0, 1.0)))
    return jnp.asarray(rate, jnp.float32)


def make_optimizer(config: OptimizerConfig) -> optax.GradientTransformation:
    """Returns AdamW (decoupled weight decay, arXiv 1711.05101) with the learning-rate schedule."""
    schedule = functools.partial(learning_rate_at, config=config)
    adamw = optax.adamw(schedule, *config.betas, eps=1e-8, weight_decay=config.weight_decay)
    # First, because the averages of Adam should not see the outliers.
    if config.clip_norm > 0:
        return optax.chain(optax.clip_by_global_norm(config.clip_norm), adamw)
    return adamw


def first_state(params: Any, config: OptimizerConfig) -> TrainState:
    """Returns the state before the first update."""
    return TrainState(jnp.array(0, jnp.int32), params, make_optimizer(config).init(params))


def descend(
    state: Any, measure: Callable[[Any], tuple[Metrics, dict[str, Any]]], config: OptimizerConfig
) -> tuple[Any, Metrics]:
    """Returns the state after one update and the metrics before it.

    Args:
        state: A `TrainState`, or a `NamedTuple` with its fields and others.
        measure: From `params` to metrics with the `loss` to minimize, and new values of the other fields of `state`.
        config: The optimizer.
    """

    def objective(params: Any) -> tuple[Float[Array, ""], tuple[Metrics, dict[str, Any]]]:
        metrics, fields = measure(params)
        return metrics["loss"], (metrics, fields)

    # The gradient is that of the loss over the global batch, the same on all devices.
    (_, (metrics, fields)), gradient = jax.value_and_grad(objective, has_aux=True)(state.params)
    return _apply_gradient(state, global_mean(gradient), config)._replace(**fields), metrics


def descend_in_parts(
    state: Any, measure: Callable[[Any, Any], Metrics], batch: Any, config: OptimizerConfig, *, num_parts: int
) -> tuple[Any, Metrics]:
    """Returns the state after one update and the metrics before it, computed for one part of the batch after another.

    Only one part's intermediate values are in memory at a time. Gradients and metrics are added up.

    Args:
        state: A `TrainState`, or a `NamedTuple` with its fields.
        measure: From `params` and a part of the batch to that part's share of the metrics, with the `loss` to minimize.
        batch: A tree of arrays whose first axis is the batch.
        config: The optimizer.
        num_parts: Number of parts; must divide the batch.
    """

    def objective(params: Any, part: Any) -> tuple[Float[Array, ""], Metrics]:
        metrics = measure(params, part)
        return metrics["loss"], metrics

    def part_gradient(part: Any) -> tuple[Metrics, Any]:
        (_, metrics), gradient = jax.value_and_grad(objective, has_aux=True)(state.params, part)
        return metrics, global_mean(gradient)

    def add_part(total: Any, part: Any) -> tuple[Any, None]:
        return jax.tree.map(jnp.add, total, part_gradient(part)), None

    if num_parts == 1:
        metrics, gradient = part_gradient(batch)
    else:
        # Every `num_parts`-th row, and not neighbors, because neighbors are on one device.
        parts = jax.tree.map(lambda rows: rows.reshape(-1, num_parts, *rows.shape[1:]).swapaxes(0, 1), batch)
        shapes = jax.eval_shape(part_gradient, jax.tree.map(lambda rows: rows[0], parts))
        # From zeros of the right shapes: the first part in the scan is no special case that would be compiled twice.
        zeros = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shapes)
        (metrics, gradient), _ = jax.lax.scan(add_part, zeros, parts)
    return _apply_gradient(state, gradient, config), metrics


def _apply_gradient(state: Any, gradient: Any, config: OptimizerConfig) -> Any:
    updates, opt_state = make_optimizer(config).update(gradient, state.opt_state, state.params)
    params = optax.apply_updates(state.params, updates)
    return state._replace(step=state.step + 1, params=params, opt_state=opt_state)
