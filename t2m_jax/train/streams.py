"""Randomness by purpose: the keys of a run's named streams, and the windows that belong to a stream."""

import zlib
from collections.abc import Callable
from typing import Any

import jax
from jaxtyping import Array, Int, Key

from t2m_jax.data.banks.host import FeedPlan
from t2m_jax.data.banks.motions import Cuts
from t2m_jax.keys import new_key
from t2m_jax.train.config import LoopConfig


def stream_key(seed: int, name: str) -> Key[Array, ""]:
    """Returns the key of stream `name` of a run. Fold the step into it before use."""
    # The checksum is the same on every platform and in every process, unlike `hash`.
    return jax.random.fold_in(new_key(seed), zlib.crc32(name.encode()))


def window_options(loop: LoopConfig, stream: str, *, window: int) -> dict[str, Any]:
    """Returns what decides, with the step, which windows of a stream are cut: the options of the functions of banks."""
    return {"key": stream_key(loop.seed, stream), "batch_size": loop.batch_size, "window": window}


def plan_feed(cuts_at: Callable[..., Cuts], loop: LoopConfig, stream: str, *, window: int) -> FeedPlan:
    """Returns how the host cuts the windows of a stream; `cuts_at` is a function of a bank's module."""

    def cuts(bank: Any, step: Int[Array, ""]) -> Cuts:
        # The key is made in here, because the host traces this function for its own CPU.
        return cuts_at(bank, step=step, **window_options(loop, stream, window=window))

    return FeedPlan(cuts, window)
