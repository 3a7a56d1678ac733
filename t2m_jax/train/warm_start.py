"""The weights of a trained model, from which a generator starts (`init`)."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from t2m_jax.checkpoints.bundle import part_kinds
from t2m_jax.checkpoints.model import load_model
from t2m_jax.checkpoints.tokenizer import TrainedTokenizer
from t2m_jax.errors import UserError
from t2m_jax.train.config import InitParts


def start_from_model(path: Path, tokenizer: TrainedTokenizer, *, parts: InitParts = "all") -> Mapping[str, Any]:
    """Returns the collections of a trained model's generator and text encoder, by name and kind.

    The tokenizer may have another decoder than that of the model, because codes do not depend on it. With `fitting`
    parts it may be any, and a codebook that the generator reads is not among the collections.

    Raises:
        UserError: There is none, or its codes mean something else because it has another tokenizer.
    """
    model = load_model(path)
    own = TrainedTokenizer(model.config.tokenizer, model.variables["tokenizer"], model.normalizer)
    same = tokenizer.has_codes_of(own)
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
