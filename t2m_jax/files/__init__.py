"""Files: written whole or not at all, with checksums, and read without trusting them."""

from t2m_jax.files.arrays import (
    fingerprint,
    fit_arrays,
    flatten_tree,
    load_arrays,
    read_arrays,
    save_arrays,
    save_weights,
    unflatten_tree,
)
from t2m_jax.files.locks import LockedError, lock
from t2m_jax.files.manifest import MANIFEST, check_folder, has_manifest, read_manifest, write_manifest
from t2m_jax.files.reading import first_line, load_archive, load_array, load_json, load_text, reading
from t2m_jax.files.writing import (
    PARTIAL,
    atomic_file,
    atomic_folder,
    check_new,
    check_output,
    claim,
    commit_folder,
    save_json,
    save_text,
    writing,
)

__all__ = [
    "MANIFEST",
    "PARTIAL",
    "LockedError",
    "atomic_file",
    "atomic_folder",
    "check_folder",
    "check_new",
    "check_output",
    "claim",
    "commit_folder",
    "fingerprint",
    "first_line",
    "fit_arrays",
    "flatten_tree",
    "has_manifest",
    "load_archive",
    "load_array",
    "load_arrays",
    "load_json",
    "load_text",
    "lock",
    "read_arrays",
    "read_manifest",
    "reading",
    "save_arrays",
    "save_json",
    "save_text",
    "save_weights",
    "unflatten_tree",
    "write_manifest",
    "writing",
]
