"""Training data on the device or on the host, and the batches that are drawn from it."""

from t2m_jax.data.banks.captions import (
    CaptionBank,
    CaptionBatch,
    caption_batch_at,
    caption_cuts_at,
    make_caption_bank,
)
from t2m_jax.data.banks.codes import CodeBank, CodeBatch, code_batch_at, crop_codes
from t2m_jax.data.banks.host import FeedPlan, HostWindows
from t2m_jax.data.banks.motions import (
    Cuts,
    FedFrames,
    MotionBank,
    Windows,
    batch_at,
    cuts_at,
    draw_cuts,
    make_bank,
    windows_at,
)
from t2m_jax.data.banks.order import batch_items, row_keys, shuffled

__all__ = [
    "CaptionBank",
    "CaptionBatch",
    "CodeBank",
    "CodeBatch",
    "Cuts",
    "FedFrames",
    "FeedPlan",
    "HostWindows",
    "MotionBank",
    "Windows",
    "batch_at",
    "batch_items",
    "caption_batch_at",
    "caption_cuts_at",
    "code_batch_at",
    "crop_codes",
    "cuts_at",
    "draw_cuts",
    "make_bank",
    "make_caption_bank",
    "row_keys",
    "shuffled",
    "windows_at",
]
