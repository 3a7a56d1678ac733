"""Reading the golden arrays."""

import numpy as np
from flax import traverse_util

from t2m_jax.checkpoints.official.names import EVALUATOR_PARTS
from t2m_jax.models.evaluator import EvaluatorConfig
from t2m_jax.models.hifigpt import HiFiGptConfig
from t2m_jax.models.vqvae import RvqVaeConfig


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


def rvqvae_config(sizes, **options) -> RvqVaeConfig:
    """Returns our config for the sizes that a file of T2M-HiFiGPT names."""
    return RvqVaeConfig(
        feature_dim=sizes["feature_dim"],
        num_codes=sizes["num_codes"],
        code_dim=sizes["code_dim"],
        width=sizes["width"],
        num_stages=sizes["stages"],
        depth=sizes["unit_depth"],
        dilation_growth=sizes["dilation_growth"],
        num_quantizers=sizes["depth"],
        projections=sizes["projections"],
        **options,
    )


def _rvqvae_path(name: str) -> tuple[str, ...]:
    """Returns where our parameter tree has an array of T2M-HiFiGPT's tokenizer."""
    *parts, kind = name.split("/")
    if parts[0].startswith("project"):
        return (*parts, kind)
    layers = {"conv1": "dilated", "conv2": "pointwise", "middle": "penultimate"}
    part, *rest = parts
    if len(rest) == 1:
        return (part, layers.get(rest[0], rest[0]), "conv", kind)
    stage, layer, *unit = rest
    if not unit:
        return (part, f"{layer}_{stage}", "conv", kind)
    return (part, f"stack_{stage}", f"unit_{unit[0]}", layers[unit[1]], "conv", kind)


def rvqvae_params(arrays, prefix: str = "weights/") -> dict:
    """Returns the arrays of T2M-HiFiGPT's tokenizer with some prefix as our tree of parameters."""
    found = {_rvqvae_path(name): array for name, array in state_dict(arrays, prefix).items()}
    return traverse_util.unflatten_dict(found)


def hifigpt_config(sizes) -> HiFiGptConfig:
    """Returns our config for the sizes that a file of T2M-HiFiGPT names."""
    return HiFiGptConfig(
        num_codes=sizes["num_codes"],
        num_quantizers=sizes["depth"],
        code_dim=sizes["code_dim"],
        embed_dim=sizes["width"],
        text_dim=sizes["text_dim"],
        num_layers=sizes["temporal_layers"],
        num_residual_layers=sizes["residual_layers"],
        num_heads=sizes["heads"],
        max_codes=sizes["max_rows"],
        dropout=0.0,
        code_embedding=sizes["code_embedding"],
        cumulative_depth=sizes["cumulative_depth"],
        head=sizes["head"],
    )


def _hifigpt_path(name: str) -> tuple[str, ...]:
    """Returns where our parameter tree has an array of the double-tier GPT."""
    layers = {
        "text": ("text_projection",),
        "stop/ln": ("stop_norm",),
        "stop/linear": ("stop_head",),
        "head/ln": ("head_norm",),
        "head/shared": ("head",),
    }
    if name == "head/per_depth/kernel":
        return ("heads",)
    layer, _, kind = name.rpartition("/")
    if layer in layers:
        return (*layers[layer], kind)
    parts = [f"block_{part}" if part.isdigit() else part for part in layer.split("/") if part]
    return (*["proj" if part == "output" else part for part in parts], kind)


def hifigpt_params(arrays, prefix: str = "weights/", *, config: HiFiGptConfig | None = None) -> dict:
    """Returns the arrays of the double-tier GPT with some prefix as our tree, without those that a config lacks."""
    left_out = {"codebook"}
    if config is not None:
        left_out |= {"embedding"} if config.code_embedding != "learned" else set()
        left_out |= {"head/per_depth/kernel" if config.head == "shared" else "head/shared/kernel"}
    found = state_dict(arrays, prefix)
    if config is not None and config.code_embedding != "projected":
        left_out |= {name for name in found if "/project/" in name}
    kept = {name: array for name, array in found.items() if name not in left_out}
    return traverse_util.unflatten_dict({_hifigpt_path(name): array for name, array in kept.items()})
