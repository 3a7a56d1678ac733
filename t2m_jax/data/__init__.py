"""Data sets: folders of clips with captions, importers that make them, checks, and batches on the device."""

from t2m_jax.data.audit import audit_dataset
from t2m_jax.data.folder import Clip, Dataset, DatasetInfo, open_dataset
from t2m_jax.data.importers.bandai_namco import import_bandai_namco
from t2m_jax.data.importers.bvh import import_bvh_folder
from t2m_jax.data.importers.humanml3d import import_humanml3d
from t2m_jax.data.importers.synthetic import make_motion, write_synthetic_dataset
from t2m_jax.data.index import IndexEntry, load_index, save_index
from t2m_jax.data.texts import Caption
from t2m_jax.data.writer import ImportReport, finish_folder, new_folder, write_clip

__all__ = [
    "Caption",
    "Clip",
    "Dataset",
    "DatasetInfo",
    "ImportReport",
    "IndexEntry",
    "audit_dataset",
    "finish_folder",
    "import_bandai_namco",
    "import_bvh_folder",
    "import_humanml3d",
    "load_index",
    "make_motion",
    "new_folder",
    "open_dataset",
    "save_index",
    "write_clip",
    "write_synthetic_dataset",
]
