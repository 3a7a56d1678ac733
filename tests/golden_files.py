"""Reading the golden arrays."""

import numpy as np

from t2m_jax.checkpoints.official.names import EVALUATOR_PARTS
from t2m_jax.models.evaluator import EvaluatorConfig


def state_dict(arrays, prefix: str = "sd/") -> dict[str, np.ndarray]:
    """Returns the arrays whose key starts with `prefix`, that prefix cut off."""
    return {key.removeprefix(prefix): arrays[key] for key in arrays if key.startswith(prefix)}


def evaluator_config(sizes, *, num_words: int) -> EvaluatorConfig:
    """Returns our config for the sizes that a file of the evaluation names."""
    return EvaluatorConfig(
        feature_dim=sizes["dim_pose"],
        movement_hidden=sizes["mov_hidden"],
        movement_dim=sizes["mov_latent"],
        motion_hidden=sizes["motion_hidden"],
        text_hidden=sizes["text_hidden"],
        embedding_dim=sizes["coemb"],
        word_dim=sizes["dim_word"],
        num_words=num_words,
    )


def evaluator_state_dict(arrays, *, prefix: str = "") -> dict[str, np.ndarray]:
    """Returns the weights of a file of the evaluation, by part and key; `prefix` stands before the trained parts."""
    state = {}
    for part in EVALUATOR_PARTS:
        start = f"{'' if part == 'movement_encoder' else prefix}{part}/"
        state |= {f"{part}.{key}": array for key, array in state_dict(arrays, start).items()}
    return state


def plain_variables(arrays, part: str) -> dict:
    """Returns the weights of the movement encoder or decoder by our names."""
    names = {"main.0": "conv_0", "main.2": "conv_1", "main.3": "conv_1", "out_net": "output"}
    ours: dict = {}
    for key, array in state_dict(arrays, f"{part}/").items():
        layer, _, kind = key.rpartition(".")
        ours.setdefault(names[layer], {})["kernel" if kind == "weight" else "bias"] = array.T
    return ours
