"""Learning-rate schedules and the optimiser."""

import dataclasses

import jax.numpy as jnp
import optax
from jaxtyping import Array, Float, Int


@dataclasses.dataclass(frozen=True, kw_only=True)
class OptimizerConfig:
    """AdamW with warm-up and step decay."""

    learning_rate: float = 2e-4
    """Rate after the warm-up (see `warmup_steps` for the original's quirk)."""
    warmup_steps: int = 0
    """Length of the linear warm-up, W. It takes W - 1 updates, and the rate stays at its last value,
    learning_rate * W / (W + 1), as in the original code."""
    milestones: tuple[int, ...] = ()
    """Updates after the warm-up at which the rate is multiplied by `gamma`."""
    gamma: float = 0.05
    """Factor at each milestone."""
    betas: tuple[float, float] = (0.9, 0.99)
    """Decay rates of AdamW's two averages."""
    weight_decay: float = 0.0
    """Decoupled weight decay, times the learning rate."""
    clip_norm: float = 0.0
    """Global norm to which gradients are cut; 0 leaves them alone."""


def learning_rate_at(step: Int[Array, ""] | int, config: OptimizerConfig) -> Float[Array, ""]:
    """Returns the learning rate of update `step` (from 0, warm-up included)."""
    warmup = config.warmup_steps
    num_warmup_updates = max(warmup - 1, 0)
    warm = config.learning_rate * jnp.minimum(step + 2, warmup) / (warmup + 1) if warmup else config.learning_rate
    passed = jnp.sum(jnp.asarray(config.milestones, jnp.int32) <= step - num_warmup_updates)
    return jnp.asarray(warm * config.gamma**passed, jnp.float32)


def make_optimizer(config: OptimizerConfig) -> optax.GradientTransformation:
    """Returns AdamW (decoupled decay, arXiv 1711.05101) that follows the schedule."""
    adamw = optax.adamw(
        lambda count: learning_rate_at(count, config),
        b1=config.betas[0],
        b2=config.betas[1],
        eps=1e-8,
        weight_decay=config.weight_decay,
    )
    if config.clip_norm > 0:
        return optax.chain(optax.clip_by_global_norm(config.clip_norm), adamw)
    return adamw
