"""Motions on the device: all clips end to end, from which windows are cut with PRNG keys.

The clips of batch b of epoch e and the starts of their windows are a pure function of the key and the step, so a
resumed run gets exactly the batches that it would have got without the interruption.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from t2m_jax.data.folder import Clip
from t2m_jax.errors import UserError
from t2m_jax.motion.normalizer import Normalizer

UNUSED_SHARE = 0.25
"""Largest share of unused rows for which clips are shared with the cache and not copied."""


class MotionBank(NamedTuple):
    """Raw frames of all clips: clip m is `frames[starts[m] : starts[m] + lengths[m]]`.

    Windows are normalized when they are cut, because normalized frames would be a second copy of the data set.
    """

    frames: Float[Array, "F D"]
    starts: Int[Array, " M"]
    lengths: Int[Array, " M"]
    mean: Float[Array, " D"]
    std: Float[Array, " D"]


class Windows(NamedTuple):
    """Pieces of clips, all of one length. `mask` is True where there is data; `motion` (normalized) is 0 elsewhere."""

    motion: Float[Array, "B T D"]
    mask: Bool[Array, "B T"]


def make_bank(clips: Sequence[Clip], normalizer: Normalizer) -> MotionBank:
    """Returns the clips on the default device.

    Clips that are views of one read-only array, such as the cache of a data set, are not copied if they use most of
    it: a CPU shares their memory, and an accelerator gets them in one transfer.

    Args:
        clips: Training clips; each counts once per epoch.
        normalizer: Statistics of the training split.

    Raises:
        UserError: There are no clips, or the statistics have another number of features.
    """
    if not clips:
        raise UserError("no clips to train on: the split is empty or every clip was left out")
    width = clips[0].features.shape[1]
    if normalizer.mean.shape != (width,):
        raise UserError(f"the clips have {width} features, the statistics {normalizer.mean.shape[0]}; use their own")
    lengths = np.array([len(clip.features) for clip in clips], dtype=np.int32)
    frames, starts = _gather_frames([clip.features for clip in clips], lengths)
    mean, std = (jnp.asarray(statistic, jnp.float32) for statistic in normalizer)
    # `jnp.asarray` would copy. This shares the memory if the device can; nobody writes to it.
    return MotionBank(jax.device_put(frames, may_alias=True), jnp.asarray(starts), jnp.asarray(lengths), mean, std)


def _gather_frames(
    clips: Sequence[Float[np.ndarray, "_ D"]], lengths: Int[np.ndarray, " M"]
) -> tuple[Float[np.ndarray, "F D"], Int[np.ndarray, " M"]]:
    """Returns rows that contain all clips, and the first row of each clip."""
    whole = clips[0].base
    if (
        isinstance(whole, np.ndarray)
        and (whole.ndim, whole.dtype) == (2, np.float32)
        and whole.flags.c_contiguous
        and not whole.flags.writeable
        and all(
            clip.base is whole and (clip.shape[1:], clip.strides) == (whole.shape[1:], whole.strides) for clip in clips
        )
    ):
        starts = np.array([clip.ctypes.data - whole.ctypes.data for clip in clips]) // whole.strides[0]
        # Devices share only memory that begins at a multiple of 64 bytes: every 16th row of an aligned float32 array.
        first, end = int(starts.min()) // 16 * 16, int((starts + lengths).max())
        if lengths.sum() >= (1 - UNUSED_SHARE) * (end - first):
            return whole[first:end], (starts - first).astype(np.int32)
    return np.concatenate(clips, dtype=np.float32), np.cumsum(lengths, dtype=np.int32) - lengths


def epoch_order(key: PRNGKeyArray, epoch: Int[Array, ""] | int, *, num_clips: int) -> Int[Array, " M"]:
    """Returns the order of the clips in an epoch, each exactly once: a pure function of key and epoch."""
    return jax.random.permutation(jax.random.fold_in(key, epoch), num_clips)


def batch_clips(key: PRNGKeyArray, step: Int[Array, ""] | int, *, num_clips: int, batch_size: int) -> Int[Array, " B"]:
    """Returns the clips of training step `step` (counted from 0 over the whole run).

    An epoch has `num_clips // batch_size` steps; the clips at the end of the order that do not fill a batch are not
    used in this epoch. A data set smaller than one batch is repeated in the batch.

    Args:
        key: Key of the run's data order. It is not consumed: give the same key at every step.
        step: Number of the step.
        num_clips: Clips in the bank.
        batch_size: Clips per step.
    """
    steps_per_epoch = max(num_clips // batch_size, 1)
    order = epoch_order(key, step // steps_per_epoch, num_clips=num_clips)
    first = (step % steps_per_epoch) * batch_size
    return order[(first + jnp.arange(batch_size)) % num_clips]


def cut_windows(bank: MotionBank, clips: Int[Array, " B"], key: PRNGKeyArray, *, window: int) -> Windows:
    """Returns one window of `window` frames from each of the given clips.

    The start is uniform over all positions where the window fits. A shorter clip is returned from its first frame, with
    zeros and a False mask after its end.

    Args:
        bank: The clips.
        clips: Positions in the bank.
        key: Consumed.
        window: Frames to cut.
    """
    lengths = bank.lengths[clips]
    offsets = jax.random.randint(key, clips.shape, 0, jnp.maximum(lengths - window, 0) + 1)
    return windows_at(bank, bank.starts[clips] + offsets, lengths, window=window)


def windows_at(bank: MotionBank, first_rows: Int[Array, " B"], lengths: Int[Array, " B"], *, window: int) -> Windows:
    """Returns windows that begin at the given rows of the bank; the mask is True for the first `lengths[b]` frames."""
    rows = first_rows[:, None] + jnp.arange(window)[None, :]
    mask = jnp.arange(window)[None, :] < lengths[:, None]
    raw = bank.frames.at[rows].get(mode="clip")
    # Without the barrier XLA multiplies by 1 / std, which differs from the division in the last bit.
    std = jax.lax.optimization_barrier(jnp.broadcast_to(bank.std[None, None], raw.shape))
    motion = (raw - bank.mean[None, None]) / std
    return Windows(jnp.where(mask[:, :, None], motion, 0.0), mask)


def batch_at(
    bank: MotionBank, key: PRNGKeyArray, step: Int[Array, ""] | int, *, batch_size: int, window: int
) -> Windows:
    """Returns the batch of a training step: a pure function of the run's data key and the step."""
    order_key, cut_key = jax.random.split(key)
    clips = batch_clips(order_key, step, num_clips=bank.lengths.shape[0], batch_size=batch_size)
    return cut_windows(bank, clips, jax.random.fold_in(cut_key, step), window=window)
