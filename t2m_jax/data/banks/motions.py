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

from t2m_jax.data.folder import Clip
from t2m_jax.errors import UserError
from t2m_jax.motion.normalizer import Normalizer


class MotionBank(NamedTuple):
    """Raw frames that hold all clips of a split: clip m is `frames[starts[m] : starts[m] + lengths[m]]`.

    Windows are normalized when they are cut: normalized frames would be a second copy of the data set.
    """

    frames: Float[Array, "F D"]
    starts: Int[Array, " M"]
    lengths: Int[Array, " M"]
    mean: Float[Array, " D"]
    std: Float[Array, " D"]


class Windows(NamedTuple):
    """Equally long pieces of clips; `mask` is True where there is data, `motion` (normalized) is zero elsewhere."""

    motion: Float[Array, "B T D"]
    mask: Bool[Array, "B T"]


def make_bank(clips: Sequence[Clip], normalizer: Normalizer) -> MotionBank:
    """Returns the clips on the default device.

    Clips that are views of one array, as those of a data set's cache are, are not copied: on a CPU the bank is that
    very memory, on an accelerator it is uploaded in one piece.

    Args:
        clips: what to train on; every clip counts once an epoch.
        normalizer: statistics of the training split.

    Raises:
        UserError: there are no clips, or the statistics are of other features.
    """
    if not clips:
        raise UserError("no clips to train on: the split is empty or every clip was left out")
    width = clips[0].features.shape[1]
    if normalizer.mean.shape != (width,):
        raise UserError(f"the clips have {width} features, the statistics {normalizer.mean.shape[0]}; use their own")
    lengths = np.array([len(clip.features) for clip in clips], dtype=np.int32)
    frames, starts = _frames_in_place(clips) or _frames_joined(clips)
    mean, std = (jnp.asarray(statistic, jnp.float32) for statistic in normalizer)
    # `jnp.asarray` would copy; this shares the memory where the device can, which nobody writes to.
    return MotionBank(jax.device_put(frames, may_alias=True), jnp.asarray(starts), jnp.asarray(lengths), mean, std)


class _Frames(NamedTuple):
    """Rows that hold clips, and where each begins."""

    frames: Float[np.ndarray, "F D"]
    starts: Int[np.ndarray, " M"]


def _frames_in_place(clips: Sequence[Clip]) -> _Frames | None:
    """Returns the stretch of the array that all clips are views of, from the first clip to the last, or None."""
    whole = clips[0].features.base
    if not isinstance(whole, np.ndarray) or whole.ndim != 2 or not whole.flags.c_contiguous:
        return None
    for clip in clips:
        part = clip.features
        if part.base is not whole or part.shape[1] != whole.shape[1] or part.strides != whole.strides:
            return None
    if whole.dtype != np.float32 or whole.flags.writeable:
        return None
    offsets = np.array([clip.features.ctypes.data - whole.ctypes.data for clip in clips])
    starts = offsets // whole.strides[0]
    # Devices share only memory that begins at a multiple of 64 bytes, as every 16th row of an aligned array does.
    first = int(starts.min()) // 16 * 16
    last = max(int(start) + len(clip.features) for start, clip in zip(starts, clips, strict=True))
    return _Frames(whole[first:last], (starts - first).astype(np.int32))


def _frames_joined(clips: Sequence[Clip]) -> _Frames:
    """Returns a copy of the clips, end to end."""
    frames = np.concatenate([clip.features for clip in clips], dtype=np.float32)
    lengths = np.array([len(clip.features) for clip in clips], dtype=np.int32)
    return _Frames(frames, np.cumsum(lengths, dtype=np.int32) - lengths)


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
        bank: the clips.
        clips: positions in the bank.
        key: consumed.
        window: frames to cut.
    """
    lengths = bank.lengths[clips]
    offsets = jax.random.randint(key, clips.shape, 0, jnp.maximum(lengths - window, 0) + 1)
    return windows_at(bank, bank.starts[clips] + offsets, lengths, window=window)


def windows_at(bank: MotionBank, first_rows: Int[Array, " B"], lengths: Int[Array, " B"], *, window: int) -> Windows:
    """Returns the first `lengths[b]` of `window` frames from each of the given rows of the bank."""
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
