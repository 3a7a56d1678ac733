"""Training data that lives on the device: all clips end to end, windows cut there under PRNG keys.

Which clips make batch b of epoch e, and where their windows start, is a pure function of the key and of the step, so a
resumed run sees exactly the batches it would have seen.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from t2m_jax.config import UserError
from t2m_jax.data.folder import Clip
from t2m_jax.motion.normalizer import Normalizer


class MotionBank(NamedTuple):
    """All clips of a split, normalized, end to end: `frames[starts[m] : starts[m] + lengths[m]]` is clip m."""

    frames: Float[Array, "F D"]
    starts: Int[Array, " M"]
    lengths: Int[Array, " M"]


class Windows(NamedTuple):
    """Equally long pieces of clips; `mask` is True where there is data, `motion` (normalized) is zero elsewhere."""

    motion: Float[Array, "B T D"]
    mask: Bool[Array, "B T"]


def make_bank(clips: Sequence[Clip], normalizer: Normalizer, *, max_window: int) -> MotionBank:
    """Returns the clips on the default device.

    Args:
        clips: what to train on; every clip counts once an epoch.
        normalizer: statistics of the training split.
        max_window: the longest window that will be cut. So many zero frames are put behind the last clip:
            `dynamic_slice` moves a window that would leave the array back inside it, which would show wrong frames.

    Raises:
        UserError: there are no clips.
    """
    if not clips:
        raise UserError("no clips to train on: the split is empty or every clip was left out")
    lengths = np.array([len(clip.features) for clip in clips], dtype=np.int32)
    frames = np.zeros((int(lengths.sum()) + max_window, clips[0].features.shape[1]), dtype=np.float32)
    starts = np.cumsum(lengths, dtype=np.int32) - lengths
    for clip, start in zip(clips, starts, strict=True):
        frames[start : start + len(clip.features)] = normalizer.normalize(clip.features)
    return MotionBank(jnp.asarray(frames), jnp.asarray(starts), jnp.asarray(lengths))


def epoch_order(key: PRNGKeyArray, epoch: Int[Array, ""] | int, *, num_clips: int) -> Int[Array, " M"]:
    """Returns the order in which an epoch visits the clips, each exactly once: a pure function of key and epoch."""
    return jax.random.permutation(jax.random.fold_in(key, epoch), num_clips)


def batch_clips(key: PRNGKeyArray, step: Int[Array, ""] | int, *, num_clips: int, batch_size: int) -> Int[Array, " B"]:
    """Returns the clips of training step `step` (counted from 0 over the whole run).

    Epochs have `num_clips // batch_size` steps; the clips left over at the end of an order are dropped for that
    epoch. A data set smaller than one batch is repeated inside the batch.

    Args:
        key: key of the run's data order; not consumed, give the same key at every step.
        step: number of the step.
        num_clips: clips in the bank.
        batch_size: clips a step.
    """
    steps_per_epoch = max(num_clips // batch_size, 1)
    order = epoch_order(key, step // steps_per_epoch, num_clips=num_clips)
    first = (step % steps_per_epoch) * batch_size
    return order[(first + jnp.arange(batch_size)) % num_clips]


def cut_windows(bank: MotionBank, clips: Int[Array, " B"], key: PRNGKeyArray, *, window: int) -> Windows:
    """Returns one window of `window` frames from each of the given clips.

    The start is uniform over all positions where the window fits. A shorter clip is returned from its first frame, with
    zeros and a False mask behind its end.

    Args:
        bank: made with `max_window >= window`.
        clips: positions in the bank.
        key: consumed.
        window: frames to cut.
    """
    lengths = bank.lengths[clips]
    slack = jnp.maximum(lengths - window, 0)
    offsets = jax.random.randint(key, clips.shape, 0, slack + 1)

    def cut(start: Int[Array, ""]) -> Float[Array, "T D"]:
        return jax.lax.dynamic_slice_in_dim(bank.frames, start, window)

    motion = jax.vmap(cut)(bank.starts[clips] + offsets)
    mask = jnp.arange(window)[None, :] < lengths[:, None]
    return Windows(jnp.where(mask[:, :, None], motion, 0.0), mask)


def batch_at(
    bank: MotionBank, key: PRNGKeyArray, step: Int[Array, ""] | int, *, batch_size: int, window: int
) -> Windows:
    """Returns the batch of a training step: a pure function of the run's data key and the step."""
    order_key, cut_key = jax.random.split(key)
    clips = batch_clips(order_key, step, num_clips=bank.lengths.shape[0], batch_size=batch_size)
    return cut_windows(bank, clips, jax.random.fold_in(cut_key, step), window=window)
