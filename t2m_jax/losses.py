"""Loss functions of both stages, on plain arrays."""

from typing import Literal

import jax.numpy as jnp
import optax
from jaxtyping import Array, Bool, Float, Int

from t2m_jax.masks import masked_mean

ReconstructionKind = Literal["l1", "l2", "l1_smooth"]


def elementwise_loss(difference: Float[Array, "..."], kind: ReconstructionKind) -> Float[Array, "..."]:
    """Returns the loss of each difference; `l1_smooth` is quadratic below 1 and linear above."""
    if kind == "l2":
        return difference**2
    if kind == "l1":
        return jnp.abs(difference)
    return optax.losses.huber_loss(difference, delta=1.0)


def reconstruction_loss(
    reconstruction: Float[Array, "B T D"],
    motion: Float[Array, "B T D"],
    mask: Bool[Array, "B T"],
    *,
    kind: ReconstructionKind,
    features: slice = slice(None),
) -> Float[Array, ""]:
    """Returns the mean loss over the True frames and the chosen features.

    With `features` set to the position slice this is the term the original code calls its velocity loss.
    """
    difference = (reconstruction - motion)[..., features]
    return masked_mean(elementwise_loss(difference, kind), mask[:, :, None])


def token_loss(
    logits: Float[Array, "B L V"], targets: Int[Array, "B L"], code_lengths: Int[Array, " B"]
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Returns the cross-entropy and the share of right arg-max guesses over each motion's codes and its End.

    The mean is taken within a motion first (T2M-GPT's rule): every motion weighs the same, whatever its length.
    """
    mask = jnp.arange(logits.shape[1])[None] <= code_lengths[:, None]
    safe_targets = jnp.where(mask, targets, 0)
    losses = optax.losses.softmax_cross_entropy_with_integer_labels(logits, safe_targets)
    per_motion = jnp.sum(jnp.where(mask, losses, 0.0), axis=1) / (code_lengths + 1)
    right = masked_mean((jnp.argmax(logits, axis=-1) == targets).astype(logits.dtype), mask)
    return jnp.mean(per_motion), right
