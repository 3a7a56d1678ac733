"""The weights of a trained model, from which a generator starts (`init`)."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from flax import traverse_util

from t2m_jax.checkpoints.bundle import part_kinds
from t2m_jax.checkpoints.model import load_model
from t2m_jax.checkpoints.tokenizer import TrainedTokenizer
from t2m_jax.errors import UserError
from t2m_jax.train.config import InitParts
from t2m_jax.train.vqvae import DECODER_PARTS

SAME_WEIGHTS = 2e-3
"""Relative and absolute tolerance for the weights of one tokenizer: bundles store them in 16 bits."""
DECODER_WEIGHTS = tuple(f"codes/params/{part}/" for part in DECODER_PARTS)
"""How the names of weights begin that do not change the codes of motion."""


def start_from_model(path: Path, tokenizer: TrainedTokenizer, *, parts: InitParts = "all") -> Mapping[str, Any]:
    """Returns the collections of a trained model's generator and text encoder, by name and kind.

    The tokenizer may have another decoder than that of the model, because codes do not depend on it. With `fitting`
    parts it may be any, and a codebook that the generator reads is not among the collections.

    Raises:
        UserError: There is none, or its codes mean something else because it has another tokenizer.
    """
    model = load_model(path)
    own_parts = {"codes": model.variables["tokenizer"], "statistics": model.normalizer._asdict()}
    given_parts = {"codes": tokenizer.variables, "statistics": tokenizer.normalizer._asdict()}
    own = traverse_util.flatten_dict(own_parts, sep="/")
    given = traverse_util.flatten_dict(given_parts, sep="/")
    # Of equal codebooks and encoders, code k means the same motion.
    same = model.config.tokenizer == tokenizer.config and all(
        np.allclose(own[name], given[name], rtol=SAME_WEIGHTS, atol=SAME_WEIGHTS)
        for name in given
        if not name.startswith(DECODER_WEIGHTS)
    )
    if not same and parts == "all":
        raise UserError(
            f"init: {path} was trained with another tokenizer; use its own with `--vqvae {path}`, or take the weights "
            "that fit with `--init-parts fitting`"
        )
    weights: dict[str, Any] = {}
    for role, kind in part_kinds(model.config).items():
        # A state has its parts by collection first, a model by role first.
        for name, tree in model.variables[role].items() if role != "tokenizer" else ():
            weights.setdefault(name, {})[kind] = tree
    if not same:
        weights.pop("codebook", None)
    return weights
