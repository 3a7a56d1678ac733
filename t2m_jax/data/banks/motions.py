"""Motions on the device: all clips end to end, from which windows are cut with PRNG keys.

The clips of batch b of epoch e and the starts of their windows are a pure function of the key and the step, so a
resumed run gets exactly the batches that it would have got without the interruption.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import PartitionSpec
from jaxtyping import Array, Bool, Float, Int, Key

from t2m_jax.data.banks.order import AnyArray, Step, batch_items, draw_below, row_keys
from t2m_jax.data.folder import Clip
from t2m_jax.devices import AXIS, global_sum, own_rows, split_rows
from t2m_jax.errors import UserError
from t2m_jax.motion.normalizer import Normalizer

UNUSED_SHARE = 0.25
"""Largest share of unused rows with which frames are put on a device as they are. With more, the clips are copied."""


class ShardedFrames(NamedTuple):
    """Frames that are divided among the devices of a mesh, in order."""

    rows: Float[AnyArray, "F D"]


class FedFrames(NamedTuple):
    """Raw windows that the host has cut for S consecutive steps. The frames themselves are not on the devices."""

    first_step: Int[AnyArray, ""]
    windows: Float[AnyArray, "S B T D"]


class MotionBank(NamedTuple):
    """Raw frames of all clips: clip m is `frames[starts[m] : starts[m] + lengths[m]]`.

    Windows are normalized when they are cut, because normalized frames would be a second copy of the data set.
    """

    frames: Float[AnyArray, "F D"] | ShardedFrames | FedFrames
    starts: Int[AnyArray, " M"]
    lengths: Int[AnyArray, " M"]
    mean: Float[AnyArray, " D"]
    std: Float[AnyArray, " D"]


class Cuts(NamedTuple):
    """The windows of a batch: their first rows in the bank, and the number of their frames that are data."""

    first_rows: Int[Array, " B"]
    lengths: Int[Array, " B"]


class Windows(NamedTuple):
    """Pieces of clips, all of one length. `mask` is True where there is data; `motion` (normalized) is 0 elsewhere."""

    motion: Float[Array, "B T D"]
    mask: Bool[Array, "B T"]


def make_bank(clips: Sequence[Clip], normalizer: Normalizer) -> MotionBank:
    """Returns the clips as NumPy arrays, which training puts on its devices or feeds to them.

    Clips that are views of one read-only array, such as the cache of a data set, are not copied: `frames` is then the
    part of it from the first clip to the last.

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
    mean, std = (np.asarray(statistic, np.float32) for statistic in normalizer)
    return MotionBank(frames, starts, lengths, mean, std)


def map_banks(data: Any, change: Callable[[MotionBank], MotionBank]) -> Any:
    """Returns data in which every bank of motions is changed."""

    def is_bank(leaf: Any) -> bool:
        return isinstance(leaf, MotionBank)

    return jax.tree.map(lambda leaf: change(leaf) if is_bank(leaf) else leaf, data, is_leaf=is_bank)


def banks_of(data: Any) -> list[MotionBank]:
    """Returns the banks of motions in data."""
    # A bank is a tuple, which would be taken apart.
    leaves = jax.tree.leaves(data, is_leaf=lambda leaf: isinstance(leaf, MotionBank))
    return [leaf for leaf in leaves if isinstance(leaf, MotionBank)]


def used_rows(bank: MotionBank) -> int:
    """Returns the number of rows that a bank on the host has when it is compact."""
    used = int(np.sum(bank.lengths))
    rows = len(bank.frames)
    return rows if used >= (1 - UNUSED_SHARE) * rows else used


def compact(bank: MotionBank) -> MotionBank:
    """Returns a bank on the host without the rows between its clips, if these are more than `UNUSED_SHARE`.

    Other banks keep their frames. If these are mapped, a CPU shares them, and an accelerator gets them in one transfer.
    """
    # A copy would no longer be mapped, so a few unused rows are the smaller cost.
    if used_rows(bank) == len(bank.frames):
        return bank
    frames = np.asarray(bank.frames)
    lengths = np.asarray(bank.lengths)
    clips = [frames[start : start + length] for start, length in zip(bank.starts, lengths, strict=True)]
    return bank._replace(frames=np.concatenate(clips), starts=_first_rows(lengths))


def divide_frames(bank: MotionBank, count: int) -> MotionBank:
    """Returns a bank whose frames can be divided among `count` devices."""
    # Devices of a mesh hold parts of one size. No window reads the rows of zeros.
    return bank._replace(frames=ShardedFrames(np.pad(bank.frames, ((0, -len(bank.frames) % count), (0, 0)))))


def without_frames(bank: MotionBank) -> MotionBank:
    """Returns a bank on the host without its frames: what is needed to choose windows."""
    return bank._replace(frames=np.asarray(bank.frames)[:0])


def take_frames(frames: Float[AnyArray, "F D"] | ShardedFrames, rows: Int[Array, "B T"]) -> Float[Array, "B T D"]:
    """Returns some rows of the frames; numbers after the last row give the last row."""
    if not isinstance(frames, ShardedFrames):
        return jnp.take(jnp.asarray(frames), rows, axis=0, mode="clip")

    def own_part(part: Float[Array, "P D"], rows: Int[Array, "B T"]) -> Float[Array, "B T D"]:
        local = rows - jax.lax.axis_index(AXIS) * len(part)
        is_here = (local >= 0) & (local < len(part))
        return global_sum(jnp.where(is_here[:, :, None], jnp.take(part, local, axis=0, mode="clip"), 0.0))

    # XLA would bring all frames to all devices. Each device looks up what it has, and the results are added.
    look_up = jax.shard_map(
        own_part, in_specs=(PartitionSpec(AXIS), PartitionSpec()), out_specs=PartitionSpec(), check_vma=False
    )
    return look_up(jnp.asarray(frames.rows), jnp.minimum(rows, len(frames.rows) - 1))


def _first_rows(lengths: Int[np.ndarray, " M"]) -> Int[np.ndarray, " M"]:
    """Returns the first row of each clip when clips of these lengths are end to end."""
    return np.cumsum(lengths, dtype=np.int32) - lengths


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
        # Memory tells where a view begins; NumPy does not keep it.
        starts = np.array([clip.ctypes.data - whole.ctypes.data for clip in clips]) // whole.strides[0]
        # Devices share only memory that begins at a multiple of 64 bytes: every 16th row of an aligned float32 array.
        first = int(starts.min()) // 16 * 16
        end = int((starts + lengths).max())
        return whole[first:end], (starts - first).astype(np.int32)
    return np.concatenate(clips, dtype=np.float32), _first_rows(lengths)


def draw_cuts(bank: MotionBank, clips: Int[Array, " B"], keys: Key[Array, " B"], *, window: int) -> Cuts:
    """Returns where one window of each of the given clips is cut; the length is that of the clip.

    The start is uniform over all positions where the window fits. A shorter clip is used from its first frame.

    Args:
        bank: The clips.
        clips: Positions in the bank.
        keys: One per window; consumed.
        window: Frames to cut.
    """
    lengths = jnp.asarray(bank.lengths)[clips]
    return Cuts(jnp.asarray(bank.starts)[clips] + draw_below(keys, jnp.maximum(lengths - window, 0) + 1), lengths)


def windows_at(bank: MotionBank, step: Step, cuts: Cuts, *, window: int) -> Windows:
    """Returns the windows of a step; the mask is True for the first `cuts.lengths[b]` frames of window b."""
    mask = jnp.arange(window)[None, :] < cuts.lengths[:, None]
    if isinstance(bank.frames, FedFrames):
        # The host has cut them at the same rows.
        raw = jnp.asarray(bank.frames.windows)[step - bank.frames.first_step]
    else:
        raw = take_frames(bank.frames, cuts.first_rows[:, None] + jnp.arange(window)[None, :])
    # Without the barrier XLA multiplies by 1 / std, which differs from the division in the last bit.
    std = jax.lax.optimization_barrier(jnp.broadcast_to(bank.std[None, None], raw.shape))
    motion = (raw - bank.mean[None, None]) / std
    return Windows(jnp.where(mask[:, :, None], motion, 0.0), mask)


def cuts_at(bank: MotionBank, key: Key[Array, ""], step: Step, *, batch_size: int, window: int) -> Cuts:
    """Returns the cuts of a training step: a pure function of the run's data key and the step. No frames are read."""
    order_key, cut_key = jax.random.split(key)
    rows = own_rows(batch_size)
    clips = batch_items(order_key, step, rows, num_items=bank.lengths.shape[0], batch_size=batch_size)
    return draw_cuts(bank, clips, row_keys(cut_key, step, rows), window=window)


def batch_at(bank: MotionBank, key: Key[Array, ""], step: Step, *, batch_size: int, window: int) -> Windows:
    """Returns the batch of a training step: normalized windows [B, W, D], and where they have motion.

    Args:
        bank: The clips.
        key: The data key of the training. Each epoch has its own order of the clips.
        step: Number of the step; the same number always gives the same batch.
        batch_size: Windows of a batch.
        window: Frames of a window.
    """
    cuts = cuts_at(bank, key, step, batch_size=batch_size, window=window)
    return split_rows(windows_at(bank, step, cuts, window=window))
