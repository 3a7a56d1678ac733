"""What a page warns of: actions that a model's data lack, although its captions have their words."""

from typing import Any

import numpy as np

from t2m_jax.checkpoints.bundle import Bundle
from t2m_jax.sampling.text_encoders import StatesTextEncoder, make_text_encoder
from t2m_jax.text.meanings import NUM_COMPARED

LARGEST = 127
"""Embeddings are stored in 8 bits, with one scale for all: only their order matters."""


def meanings_record(bundle: Bundle) -> dict[str, Any] | None:
    """Returns the sentences of the actions that are missing, and embeddings of them and of what was learned.

    None if the record of the model does not say what is missing, or if it has no sentence encoder.
    """
    learned, missing = ((bundle.training_data or {}).get(name, []) for name in ("learned", "missing"))
    encoder = make_text_encoder(bundle) if learned and missing else None
    if not isinstance(encoder, StatesTextEncoder):
        return None
    embeddings = np.asarray(encoder.sentence_embeddings([*learned, *missing]), np.float32)
    embeddings /= np.linalg.norm(embeddings, axis=1, keepdims=True)
    rows = np.rint(embeddings * (LARGEST / np.abs(embeddings).max())).astype(int).tolist()
    first = len(learned)
    return {"compared": NUM_COMPARED, "sentences": missing, "learned": rows[:first], "missing": rows[first:]}
