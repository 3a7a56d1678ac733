"""Data sets: the folder they live in, importers that make one, checks, and device-resident batches."""

from t2m_jax.data.audit import AuditReport, audit_dataset
from t2m_jax.data.banks.motions import MotionBank, Windows, batch_at, batch_clips, cut_windows, epoch_order, make_bank
from t2m_jax.data.folder import Clip, Dataset, DatasetInfo, open_dataset, samples_from_clip
from t2m_jax.data.importers.bandai_namco.importer import import_bandai_namco
from t2m_jax.data.importers.bvh import import_bvh_folder
from t2m_jax.data.importers.humanml3d import import_humanml3d
from t2m_jax.data.importers.synthetic import make_motion, write_synthetic_dataset
from t2m_jax.data.texts import Caption, load_captions, parse_caption, save_captions
from t2m_jax.data.writer import ImportReport

__all__ = [
    "AuditReport",
    "Caption",
    "Clip",
    "Dataset",
    "DatasetInfo",
    "ImportReport",
    "MotionBank",
    "Windows",
    "audit_dataset",
    "batch_at",
    "batch_clips",
    "cut_windows",
    "epoch_order",
    "import_bandai_namco",
    "import_bvh_folder",
    "import_humanml3d",
    "load_captions",
    "make_bank",
    "make_motion",
    "open_dataset",
    "parse_caption",
    "samples_from_clip",
    "save_captions",
    "write_synthetic_dataset",
]
