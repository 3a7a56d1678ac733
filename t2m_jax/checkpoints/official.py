"""Variables of our modules from the state dicts of the original PyTorch code, by key name (facts: T2M-GPT b1446f1)."""

from collections.abc import Mapping

import jax.numpy as jnp
import numpy as np

StateDict = Mapping[str, np.ndarray]


def _conv(state_dict: StateDict, key: str) -> dict:
    """Returns a convolution: (out, in, kernel) becomes (kernel, in, out)."""
    kernel = state_dict[f"{key}.weight"].transpose(2, 1, 0)
    return {"conv": {"kernel": jnp.asarray(kernel), "bias": jnp.asarray(state_dict[f"{key}.bias"])}}


def _dense(state_dict: StateDict, key: str) -> dict:
    """Returns a linear layer: (out, in) becomes (in, out)."""
    layer = {"kernel": jnp.asarray(state_dict[f"{key}.weight"].T)}
    if f"{key}.bias" in state_dict:
        layer["bias"] = jnp.asarray(state_dict[f"{key}.bias"])
    return layer


def _layer_norm(state_dict: StateDict, key: str) -> dict:
    return {"scale": jnp.asarray(state_dict[f"{key}.weight"]), "bias": jnp.asarray(state_dict[f"{key}.bias"])}


def _unit(state_dict: StateDict, key: str) -> dict:
    """Returns a residual unit, with its norms where there are some."""
    norms = {
        name: _layer_norm(state_dict, f"{key}.{name}")
        for name in ("norm1", "norm2")
        if f"{key}.{name}.weight" in state_dict
    }
    return norms | {"dilated": _conv(state_dict, f"{key}.conv1"), "pointwise": _conv(state_dict, f"{key}.conv2")}


def _stack(state_dict: StateDict, key: str, depth: int) -> dict:
    return {f"unit_{unit}": _unit(state_dict, f"{key}.model.{unit}") for unit in range(depth)}


def vqvae_variables(state_dict: StateDict, *, num_stages: int, depth: int) -> dict:
    """Returns the `params` and `codebook` collections of a `VqVae`.

    The original does not save the codebook's averages: they start from the loaded codebook with counts of one, and
    the codebook counts as initialised (the original would throw it away on the first training step).
    """
    encoder = {"input": _conv(state_dict, "vqvae.encoder.model.0")}
    decoder = {"input": _conv(state_dict, "vqvae.decoder.model.0")}
    for stage in range(num_stages):
        key = f"model.{2 + stage}"
        encoder[f"down_{stage}"] = _conv(state_dict, f"vqvae.encoder.{key}.0")
        encoder[f"stack_{stage}"] = _stack(state_dict, f"vqvae.encoder.{key}.1", depth)
        decoder[f"stack_{stage}"] = _stack(state_dict, f"vqvae.decoder.{key}.0", depth)
        decoder[f"up_{stage}"] = _conv(state_dict, f"vqvae.decoder.{key}.2")
    encoder["output"] = _conv(state_dict, f"vqvae.encoder.model.{2 + num_stages}")
    decoder["penultimate"] = _conv(state_dict, f"vqvae.decoder.model.{2 + num_stages}")
    decoder["output"] = _conv(state_dict, f"vqvae.decoder.model.{4 + num_stages}")
    params = {"encoder": encoder, "decoder": decoder}
    if "vqvae.quantizer.embedding.weight" in state_dict:
        return {
            "params": params | {"quantizer": {"codebook": jnp.asarray(state_dict["vqvae.quantizer.embedding.weight"])}}
        }
    codebook = jnp.asarray(state_dict["vqvae.quantizer.codebook"])
    quantizer = {
        "codebook": codebook,
        "ema_sum": codebook,
        "ema_count": jnp.ones(codebook.shape[0]),
        "initialised": jnp.array(True),
    }
    return {"params": params, "codebook": {"quantizer": quantizer}}


def _block(state_dict: StateDict, key: str) -> dict:
    attention = {name: _dense(state_dict, f"{key}.attn.{name}") for name in ("query", "key", "value", "proj")}
    return {
        "ln1": _layer_norm(state_dict, f"{key}.ln1"),
        "ln2": _layer_norm(state_dict, f"{key}.ln2"),
        "attn": attention,
        "mlp": {"up": _dense(state_dict, f"{key}.mlp.0"), "down": _dense(state_dict, f"{key}.mlp.2")},
    }


def gpt_variables(state_dict: StateDict, *, num_layers: int) -> dict:
    """Returns the `params` collection of a `MotionGpt` with `num_layers` blocks (base and head together).

    The masks, the unused learned position table and the fixed sinusoid are left out.
    """
    half = num_layers // 2
    params = {
        "token_embedding": {"embedding": jnp.asarray(state_dict["trans_base.tok_emb.weight"])},
        "text_projection": _dense(state_dict, "trans_base.cond_emb"),
        "final_norm": _layer_norm(state_dict, "trans_head.ln_f"),
        "head": _dense(state_dict, "trans_head.head"),
    }
    for layer in range(num_layers):
        key = f"trans_base.blocks.{layer}" if layer < half else f"trans_head.blocks.{layer - half}"
        params[f"block_{layer}"] = _block(state_dict, key)
    return {"params": params}
