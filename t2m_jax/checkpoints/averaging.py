"""The mean of two models, of which one was trained on from the other.

Training on with new data makes a model forget some of what it knew. Weights between both forget less and keep much of
what was learned (Wortsman et al. 2022, "Robust fine-tuning of zero-shot models", equation 1).
"""

from collections.abc import Mapping
from typing import Any

import jax
import numpy as np

from t2m_jax.checkpoints.bundle import Bundle
from t2m_jax.checkpoints.text_encoder import pretrained_reference, with_encoder_name
from t2m_jax.checkpoints.tokenizer import TrainedTokenizer
from t2m_jax.config import flat_fields
from t2m_jax.errors import UserError

FREE_FIELDS = ("dropout", "token_dropout", "stop_rule", "stop_threshold", "guidance_scale")
"""Fields of a config that may differ: weights mean the same with others. Those of the second model are kept."""


def mean_of_models(first: Bundle, second: Bundle, share: float) -> Bundle:
    """Returns a model whose generator and trained text network have weights between those of two models.

    Tokenizer, statistics and card are those of the second. The record of the training data has the words, the actions
    and the taught words of both.

    Args:
        first: A model.
        second: A model that was trained on from it.
        share: How much the second counts, from 0 to 1.

    Raises:
        UserError: `share` is not such a number, or the models have other sizes, codes or text encoders.
    """
    if not 0 <= share <= 1:
        raise UserError(f"mean: {share:g} is not a number from 0 to 1")
    _check_alike(first, second)
    means = {
        role: jax.tree.map(lambda a, b: _between(a, b, share), first.variables[role], tree)
        for role, tree in second.variables.items()
        if role != "tokenizer"
    }
    data = _both_records(first.training_data, second.training_data)
    return second._replace(variables=second.variables | means, training_data=data)


def _check_alike(first: Bundle, second: Bundle) -> None:
    """Raises `UserError` if a number of one model does not mean the same in the other."""
    fields, others = _counting_fields(first), _counting_fields(second)
    for name in sorted(fields.keys() | others.keys()):
        if fields.get(name) != others.get(name):
            found = f"{fields.get(name)!r} in the first and {others.get(name)!r} in the second"
            raise UserError(f"mean: {name} is {found} model; one must have been trained on from the other")
    tokenizers = [TrainedTokenizer(m.config.tokenizer, m.variables["tokenizer"], m.normalizer) for m in (first, second)]
    if not tokenizers[0].has_codes_of(tokenizers[1]):
        raise UserError("mean: the models have other tokenizers; one must have been trained on from the other")
    if (first.bpe and first.bpe.to_str()) != (second.bpe and second.bpe.to_str()):
        raise UserError("mean: the models have other subwords; one must have been trained on from the other")


def _counting_fields(bundle: Bundle) -> dict[str, Any]:
    """Returns the fields of a model's config that weights depend on. An encoder may be in another folder."""
    config = bundle.config.text_encoder
    encoder = config if pretrained_reference(config) is None else with_encoder_name(config, "")
    parts = {"generator": bundle.config.generator, "text_encoder": encoder}
    kinds = {f"{name}.kind": part.kind for name, part in parts.items()}
    fields = {f"{name}.{field}": value for name, part in parts.items() for field, value in flat_fields(part).items()}
    return kinds | {name: value for name, value in fields.items() if name.rpartition(".")[2] not in FREE_FIELDS}


def _between(first: Any, second: Any, share: float) -> np.ndarray:
    # What is the same stays so to the last bit, such as a copy of the codebook, which small bundles leave out.
    return np.where(first == second, second, (1 - share) * first + share * second)


def _both_records(first: Mapping[str, Any] | None, second: Mapping[str, Any] | None) -> dict[str, Any] | None:
    """Returns the record of the second training with the words, actions and taught words of both."""
    if first is None or second is None:
        return None if second is None else dict(second)
    both = dict(second)
    for name in ("words", "actions"):
        counts, others = first.get(name, {}), second.get(name, {})
        both[name] = {word: max(counts.get(word, 0), others.get(word, 0)) for word in counts | others}
    both["taught"] = sorted({*first.get("taught", ()), *second.get("taught", ())})
    return both
