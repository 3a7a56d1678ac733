"""Loss functions of both stages, on plain arrays."""

from typing import Literal

import jax.numpy as jnp
import optax
from jaxtyping import Array, Bool, Float, Int

from t2m_jax.masks import masked_mean

ReconstructionKind = Literal["l1", "l2", "l1_smooth"]
VelocityKind = Literal["joint_positions", "frame_difference"]
TokenMean = Literal["motions", "tokens"]


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
    """Returns the mean loss over the True frames and the chosen features."""
    difference = (reconstruction - motion)[..., features]
    return masked_mean(elementwise_loss(difference, kind), mask[:, :, None])


def velocity_loss(
    reconstruction: Float[Array, "B T D"],
    motion: Float[Array, "B T D"],
    mask: Bool[Array, "B T"],
    *,
    kind: ReconstructionKind,
    velocity: VelocityKind,
    positions: slice,
) -> Float[Array, ""]:
    """Returns the second term of T2M-GPT's reconstruction loss, which its paper and its code understand differently.

    Args:
        reconstruction: What the decoder made.
        motion: What it should have made.
        mask: True where there is data.
        kind: Loss of a difference.
        velocity: `frame_difference` compares differences of neighbouring frames (arXiv 2301.06052, equation 3);
            `joint_positions` is the plain loss once more over the joint positions (its code).
        positions: Features that are joint positions.
    """
    if velocity == "joint_positions":
        return reconstruction_loss(reconstruction, motion, mask, kind=kind, features=positions)
    both = mask[:, 1:] & mask[:, :-1]
    return reconstruction_loss(jnp.diff(reconstruction, axis=1), jnp.diff(motion, axis=1), both, kind=kind)


def token_loss(
    logits: Float[Array, "B L V"],
    targets: Int[Array, "B L"],
    code_lengths: Int[Array, " B"],
    *,
    mean_over: TokenMean = "motions",
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Returns the cross-entropy and the share of right arg-max guesses over each motion's codes and its End.

    With `mean_over` "motions" the mean is taken within a motion first (T2M-GPT's code): every motion weighs the same,
    whatever its length. With "tokens" every code and End weighs the same (the likelihood of its paper).
    """
    mask = jnp.arange(logits.shape[1])[None] <= code_lengths[:, None]
    safe_targets = jnp.where(mask, targets, 0)
    losses = optax.losses.softmax_cross_entropy_with_integer_labels(logits, safe_targets)
    right = masked_mean((jnp.argmax(logits, axis=-1) == targets).astype(logits.dtype), mask)
    if mean_over == "tokens":
        return masked_mean(losses, mask), right
    per_motion = jnp.sum(jnp.where(mask, losses, 0.0), axis=1) / (code_lengths + 1)
    return jnp.mean(per_motion), right
