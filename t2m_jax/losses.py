"""Loss functions of all models, as functions of arrays."""

import functools
from typing import Literal

import chex
import jax.numpy as jnp
import optax
from jaxtyping import Array, Bool, Float, Int

from t2m_jax.devices import global_mean, global_sum
from t2m_jax.masks import masked_mean
from t2m_jax.motion.features import bone_vectors, local_positions, positions_from_features
from t2m_jax.motion.normalizer import Normalizer
from t2m_jax.motion.skeleton import Skeleton

ReconstructionKind = Literal["l1", "l2", "l1_smooth"]
VelocityKind = Literal["joint_positions", "frame_difference"]
TokenMean = Literal["motions", "tokens"]

# The arrays that many losses have in common.
Features = Float[Array, "B T D"]
Mask = Bool[Array, "B T"]
Embeddings = Float[Array, "B E"]
Scalar = Float[Array, ""]


def elementwise_loss(difference: Float[Array, "..."], kind: ReconstructionKind) -> Float[Array, "..."]:
    """Returns the loss of each difference. `l1_smooth` is quadratic below 1 and linear above."""
    if kind == "l2":
        return difference**2
    if kind == "l1":
        return jnp.abs(difference)
    return optax.losses.huber_loss(difference, delta=1.0)


def reconstruction_loss(
    reconstruction: Features, motion: Features, mask: Mask, *, kind: ReconstructionKind, features: slice = slice(None)
) -> Scalar:
    """Returns the mean loss over the True frames and the given features."""
    _check_motion(reconstruction, motion, mask)
    difference = (reconstruction - motion)[..., features]
    return masked_mean(elementwise_loss(difference, kind), mask[:, :, None])


def velocity_loss(
    reconstruction: Features,
    motion: Features,
    mask: Mask,
    *,
    kind: ReconstructionKind,
    velocity: VelocityKind,
    positions: slice,
) -> Scalar:
    """Returns the second term of T2M-GPT's reconstruction loss. Its paper and its code define it differently.

    `frame_difference` compares differences of consecutive frames (arXiv 2301.06052, equation 3). `joint_positions` is
    the reconstruction loss of the joint positions alone (the published code), whose columns are `positions`.
    """
    if velocity == "joint_positions":
        return reconstruction_loss(reconstruction, motion, mask, kind=kind, features=positions)
    steps = (jnp.diff(reconstruction, axis=1), jnp.diff(motion, axis=1))
    return reconstruction_loss(*steps, _runs(mask, 2), kind=kind)


def acceleration_loss(reconstruction: Features, motion: Features, mask: Mask, *, kind: ReconstructionKind) -> Scalar:
    """Returns the mean loss of second differences in time (T2M-HiFiGPT, arXiv 2312.10628, section 3.2).

    A difference counts if all its three frames are data.
    """
    changes = (jnp.diff(reconstruction, 2, axis=1), jnp.diff(motion, 2, axis=1))
    return reconstruction_loss(*changes, _runs(mask, 3), kind=kind)


def bone_loss(
    reconstruction: Features, motion: Features, mask: Mask, *, skeleton: Skeleton, normalizer: Normalizer | None = None
) -> Scalar:
    """Returns the mean length of the differences of bone vectors.

    This is the last term of T2M-HiFiGPT's reconstruction loss (arXiv 2312.10628, section 3.2). Its gradient is 0 where
    the vectors agree. The normalizer turns features into the skeleton's unit; without it, vectors are those of
    normalized features.
    """
    _check_motion(reconstruction, motion, mask)
    if normalizer is not None:
        reconstruction = normalizer.denormalize(reconstruction)
        motion = normalizer.denormalize(motion)
    bones = [bone_vectors(local_positions(features, skeleton), skeleton) for features in (reconstruction, motion)]
    return masked_mean(_lengths(bones[0] - bones[1]), mask[:, :, None])


def joint_loss(
    reconstruction: Features, motion: Features, mask: Mask, *, skeleton: Skeleton, normalizer: Normalizer
) -> Scalar:
    """Returns the mean distance of the joints but the root, relative to its place and heading, in the skeleton's unit.

    Arguments as for `bone_loss`; the normalizer is needed.
    """
    _check_motion(reconstruction, motion, mask)
    difference = normalizer.denormalize(reconstruction) - normalizer.denormalize(motion)
    joints = difference[..., skeleton.layout.positions].reshape(*difference.shape[:2], -1, 3)
    return masked_mean(_lengths(joints), mask[:, :, None])


def facing_loss(
    reconstruction: Features, motion: Features, mask: Mask, *, skeleton: Skeleton, normalizer: Normalizer
) -> Scalar:
    """Returns the mean angle between the directions of hips and shoulders over the ground, in radians if it is small.

    The vectors are relative to the heading of each frame. Arguments as for `joint_loss`.
    """
    _check_motion(reconstruction, motion, mask)

    def along(features: Features) -> Float[Array, "B T 2"]:
        # The root is no column of the positions, so joint j is row j - 1.
        joints = normalizer.denormalize(features)[..., skeleton.layout.positions].reshape(*mask.shape, -1, 3)
        right_hip, left_hip, right_shoulder, left_shoulder = (joints[:, :, j - 1, ::2] for j in skeleton.face_joints)
        vectors = left_hip - right_hip + left_shoulder - right_shoulder
        return vectors / jnp.maximum(_lengths(vectors), 1e-6)[..., None]

    return masked_mean(_lengths(along(reconstruction) - along(motion)), mask)


def world_loss(
    reconstruction: Features, motion: Features, mask: Mask, *, order: int, skeleton: Skeleton, normalizer: Normalizer
) -> Scalar:
    """Returns the mean distance of the joints' differences in time in the world, in the skeleton's unit.

    Order 1 compares steps from a frame to the next, and order 2 the differences of steps. Both contain the root's path
    and heading. A difference counts if all its frames are data. Arguments as for `joint_loss`.
    """
    _check_motion(reconstruction, motion, mask)
    apart = positions_from_features(normalizer.denormalize(reconstruction), skeleton)
    apart -= positions_from_features(normalizer.denormalize(motion), skeleton)
    return masked_mean(_lengths(jnp.diff(apart, order, axis=1)), _runs(mask, order + 1)[:, :, None])


def _runs(mask: Mask, count: int) -> Bool[Array, "B U"]:
    """Returns whether each run of `count` consecutive frames is data."""
    places = mask.shape[1] - count + 1
    return functools.reduce(jnp.logical_and, [mask[:, first : first + places] for first in range(count)])


def _check_motion(reconstruction: Array, motion: Array, mask: Array) -> None:
    """Raises `AssertionError` if arguments have shapes that do not belong together, which might broadcast."""
    chex.assert_rank(motion, 3)
    chex.assert_equal_shape([reconstruction, motion])
    chex.assert_shape(mask, motion.shape[:2])


def _lengths(vectors: Float[Array, "*batch D"]) -> Float[Array, "*batch"]:
    """Returns the lengths of vectors, whose gradient is 0 where they are 0."""
    squares = jnp.sum(vectors**2, axis=-1)
    # The root of 0 has no gradient, and `where` would still multiply its infinity by 0.
    differs = squares > 0
    return jnp.where(differs, jnp.sqrt(jnp.where(differs, squares, 1.0)), 0.0)


def mean_weights(
    counts: Int[Array, " B"], length: int, *, mean_over: TokenMean = "motions"
) -> Float[Array, "B {length}"]:
    """Returns the weights of a mean over the first `counts[b]` positions of each motion.

    They sum to 1 over the global batch, if every motion has a position. With `mean_over` "motions", all motions have
    the same weight (T2M-GPT's code). With "tokens", all positions have the same weight, so that long motions count more
    (the likelihood in its paper).
    """
    chex.assert_rank(counts, 1)
    mask = jnp.arange(length)[None] < counts[:, None]
    if mean_over == "tokens":
        return mask / global_sum(jnp.sum(mask))
    # `psum` of the number of rows, because a device has only its part of the batch.
    return mask / (jnp.maximum(counts, 1) * global_sum(jnp.asarray(len(counts))))[:, None]


def token_weights(
    code_lengths: Int[Array, " B"], length: int, *, mean_over: TokenMean = "motions"
) -> Float[Array, "B {length}"]:
    """Returns the `mean_weights` of each motion's codes and its End token."""
    return mean_weights(code_lengths + 1, length, mean_over=mean_over)


def token_loss(logits: Float[Array, "B L V"], targets: Int[Array, "B L"], weights: Float[Array, "B L"]) -> Scalar:
    """Returns the weighted sum of the cross-entropies, over the global batch. Targets without weight may be anything.

    The sums of the parts of a batch, with the weights of the whole, add up to the sum of the whole.
    """
    chex.assert_shape([targets, weights], logits.shape[:-1])
    # A target such as Pad is no class of the logits.
    safe_targets = jnp.where(weights > 0, targets, 0)
    losses = optax.losses.softmax_cross_entropy_with_integer_labels(logits.astype(jnp.float32), safe_targets)
    return global_sum(jnp.sum(jnp.where(weights > 0, weights * losses, 0.0)))


def token_accuracy(logits: Float[Array, "B L V"], targets: Int[Array, "B L"], weights: Float[Array, "B L"]) -> Scalar:
    """Returns the sum of the weights of the targets that have the highest logits, over the global batch."""
    chex.assert_shape([targets, weights], logits.shape[:-1])
    return global_sum(jnp.sum(jnp.where(jnp.argmax(logits, axis=-1) == targets, weights, 0.0)))


def stop_loss(
    stop_logits: Float[Array, "B N"],
    is_last: Bool[Array, "B N"],
    weights: Float[Array, "B N"],
    *,
    positive_weight: float = 1.0,
) -> Scalar:
    """Returns the weighted sum of the binary cross-entropies of each row being the last, over the global batch.

    `weights` are those of `mean_weights`, and `positive_weight` is a factor of the terms of last rows.
    """
    chex.assert_equal_shape([stop_logits, is_last, weights])
    losses = optax.losses.sigmoid_binary_cross_entropy(stop_logits.astype(jnp.float32), is_last.astype(jnp.float32))
    losses *= jnp.where(is_last, positive_weight, 1.0)
    return global_sum(jnp.sum(jnp.where(weights > 0, weights * losses, 0.0)))


def movement_loss(
    reconstruction: Features,
    motion: Features,
    movements: Float[Array, "B N M"],
    *,
    sparsity_weight: float,
    smoothness_weight: float,
) -> dict[str, Scalar]:
    """Returns the terms of the movement autoencoder's loss (Guo et al. 2022) and their weighted sum, `loss`.

    The terms are the mean absolute values of the error, of the movements, and of their differences in time.
    """
    chex.assert_equal_shape([reconstruction, motion])
    terms = {
        "reconstruction": global_mean(jnp.mean(jnp.abs(reconstruction - motion))),
        "sparsity": global_mean(jnp.mean(jnp.abs(movements))),
        "smoothness": global_mean(jnp.mean(jnp.abs(jnp.diff(movements, axis=1)))),
    }
    loss = terms["reconstruction"] + sparsity_weight * terms["sparsity"] + smoothness_weight * terms["smoothness"]
    return {"loss": loss} | terms


def pair_distances(text: Embeddings, motion: Embeddings) -> Float[Array, " B"]:
    """Returns the distance of each text from the motion in its row. It is never zero, so that it has a gradient."""
    chex.assert_equal_shape([text, motion])
    # The small number is that of PyTorch's `pairwise_distance`, which the original uses.
    return jnp.sqrt(jnp.sum((text - motion + 1e-6) ** 2, axis=-1))


def margin_loss(
    text: Embeddings, motion: Embeddings, shift: Int[Array, ""] | int, *, margin: float
) -> dict[str, Scalar]:
    """Returns the evaluator's contrastive loss (Guo et al. 2022): `loss`, `positive` and `negative`.

    A positive pair costs its squared distance. The negative of text i is motion i + `shift`, modulo B. It costs the
    square of the amount by which its distance is below the margin. The original sometimes draws a shift of 0. The
    negatives are then the pairs themselves.
    """
    positive = jnp.mean(pair_distances(text, motion) ** 2)
    # A roll gives each text one negative, for the price of one more distance per text.
    apart = pair_distances(text, jnp.roll(motion, -shift, axis=0))
    negative = jnp.mean(jnp.maximum(margin - apart, 0.0) ** 2)
    return {"loss": positive + negative, "positive": positive, "negative": negative}


def infonce_loss(text: Embeddings, motion: Embeddings, same: Bool[Array, "B B"], *, temperature: float) -> Scalar:
    """Returns the mean of two cross-entropies: finding each text's motion and each motion's text in the batch.

    The logits are the negative squared distances divided by `temperature`. Rows with the same caption (`same` is True)
    are not negatives of each other.
    """
    chex.assert_equal_shape([text, motion])
    chex.assert_shape(same, (len(text), len(text)))
    squares = jnp.sum((text[:, None] - motion[None, :]) ** 2, axis=-1)
    # A row is always its own positive, whatever else has its caption.
    own = jnp.eye(len(text), dtype=bool)
    logits = jnp.where(same & ~own, -jnp.inf, -squares / temperature)
    rows = jnp.arange(len(text))
    losses = [optax.losses.softmax_cross_entropy_with_integer_labels(side, rows) for side in (logits, logits.T)]
    return (jnp.mean(losses[0]) + jnp.mean(losses[1])) / 2
