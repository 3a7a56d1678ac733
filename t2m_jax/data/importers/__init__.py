"""Importers: functions that make a data-set folder from other files."""

from t2m_jax.data.importers.bandai_namco import import_bandai_namco
from t2m_jax.data.importers.bvh import import_bvh_folder
from t2m_jax.data.importers.humanml3d import import_humanml3d
from t2m_jax.data.importers.synthetic import KINDS, make_motion, write_synthetic_dataset
from t2m_jax.data.importers.synthetic_scale import write_scaled_dataset

__all__ = [
    "KINDS",
    "import_bandai_namco",
    "import_bvh_folder",
    "import_humanml3d",
    "make_motion",
    "write_scaled_dataset",
    "write_synthetic_dataset",
]
