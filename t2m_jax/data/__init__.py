"""Data sets: folders of clips with captions, importers that make them, checks, and batches on the device."""

from t2m_jax.data.audit import AuditReport, audit_dataset
from t2m_jax.data.banks import MotionBank, Windows, batch_at, make_bank
from t2m_jax.data.checks import check_feature_dim, check_statistics
from t2m_jax.data.folder import Clip, Dataset, DatasetInfo, open_dataset, samples_from_clip
from t2m_jax.data.importers import (
    import_bandai_namco,
    import_bvh_folder,
    import_humanml3d,
    make_motion,
    write_synthetic_dataset,
)
from t2m_jax.data.index import ClipIndex, IndexRow, load_index, save_index
from t2m_jax.data.summary import TrainingData, save_training_data, summarize_training_data
from t2m_jax.data.texts import Caption, load_captions, parse_caption, save_captions
from t2m_jax.data.writer import ImportReport, finish_folder, new_folder, write_clip

__all__ = [
    "AuditReport",
    "Caption",
    "Clip",
    "ClipIndex",
    "Dataset",
    "DatasetInfo",
    "ImportReport",
    "IndexRow",
    "MotionBank",
    "TrainingData",
    "Windows",
    "audit_dataset",
    "batch_at",
    "check_feature_dim",
    "check_statistics",
    "finish_folder",
    "import_bandai_namco",
    "import_bvh_folder",
    "import_humanml3d",
    "load_captions",
    "load_index",
    "make_bank",
    "make_motion",
    "new_folder",
    "open_dataset",
    "parse_caption",
    "samples_from_clip",
    "save_captions",
    "save_index",
    "save_training_data",
    "summarize_training_data",
    "write_clip",
    "write_synthetic_dataset",
]
