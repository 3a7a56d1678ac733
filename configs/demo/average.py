"""Writes a bundle with the mean weights of two bundles, the second of which was trained on from the first.

  python configs/demo/average.py FIRST SECOND DESTINATION CARD

Such a mean often does what either of them does well (Wortsman et al., "Model soups", 2022, arXiv:2203.05482).
"""

import sys
from pathlib import Path

import jax
import numpy as np

from t2m_jax.checkpoints.bundle import save_bundle
from t2m_jax.checkpoints.model import load_model


def mean(first: jax.Array, second: jax.Array) -> jax.Array:
    """Returns the mean of two arrays; flags and counts are those of the second."""
    return (first + second) / 2 if np.issubdtype(second.dtype, np.floating) else second


first, second = (load_model(name) for name in sys.argv[1:3])
if first.config != second.config:
    raise SystemExit("the two bundles have other sizes or parts")
variables = jax.tree.map(mean, first.variables, second.variables)
save_bundle(Path(sys.argv[3]), second._replace(variables=variables), card=Path(sys.argv[4]).read_text(encoding="utf-8"))
