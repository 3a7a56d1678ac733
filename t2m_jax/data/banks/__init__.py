"""Training data on the device, and the batches that are drawn from it."""

from t2m_jax.data.banks.captions import CaptionBank, CaptionBatch, caption_batch_at, make_caption_bank
from t2m_jax.data.banks.codes import CodeBank, CodeBatch, code_batch_at, crop_codes
from t2m_jax.data.banks.motions import MotionBank, Windows, batch_at, batch_clips, cut_windows, epoch_order, make_bank

__all__ = [
    "CaptionBank",
    "CaptionBatch",
    "CodeBank",
    "CodeBatch",
    "MotionBank",
    "Windows",
    "batch_at",
    "batch_clips",
    "caption_batch_at",
    "code_batch_at",
    "crop_codes",
    "cut_windows",
    "epoch_order",
    "make_bank",
    "make_caption_bank",
]
