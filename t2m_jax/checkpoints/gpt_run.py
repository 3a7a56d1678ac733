"""A GPT's run directory as a complete model: what it trained, and the VQ-VAE it trained on."""

from collections.abc import Sequence
from pathlib import Path

import jax
import numpy as np

from t2m_jax.checkpoints.best import restore_trained
from t2m_jax.checkpoints.bundle import CONFIG_FILE as BUNDLE_FILE
from t2m_jax.checkpoints.bundle import Bundle, BundleConfig, bundle_path, expected_variables, load_bundle
from t2m_jax.checkpoints.run import is_run_directory, run_info
from t2m_jax.checkpoints.vqvae import load_vqvae
from t2m_jax.config import load_config
from t2m_jax.errors import UserError
from t2m_jax.text.bpe import load_bpe


def load_gpt_run(path: Path) -> Bundle:
    """Returns what a GPT's run stands for as a bundle: its best weights, or its newest where none were chosen.

    Raises:
        UserError: if it is no such run, or has no checkpoint.
    """
    if run_info(path).kind != "gpt":
        raise UserError(f"{path}: holds a VQ-VAE alone; generation needs the run of a GPT")
    config = load_config(path / BUNDLE_FILE, BundleConfig)
    expected = expected_variables(config)
    shapes = {name: expected[name]["params"] for name in expected if name != "vqvae"}
    params = restore_trained(path, {"params": shapes})["params"]
    vqvae = load_vqvae(path)
    variables = {name: {"params": params[name]} for name in shapes} | {"vqvae": vqvae.variables}
    tokenizer = load_bpe(path) if config.text_encoder == "caption_encoder" else None
    return Bundle(config, jax.device_get(variables), vqvae.normalizer, tokenizer)


def load_model(name_or_path: str | Path) -> Bundle:
    """Returns a model by a bundled name, a bundle folder, or a GPT's run directory.

    Raises:
        UserError: if there is none, or it is damaged.
    """
    path = bundle_path(name_or_path)
    return load_gpt_run(path) if is_run_directory(path) else load_bundle(path)


def load_gpt_runs(paths: Sequence[Path]) -> tuple[Path, Bundle]:
    """Returns the one GPT run among some run directories, and its model.

    VQ-VAE runs may stand beside it: the GPT's run holds the copy it was trained on, so they are checked and not used.

    Raises:
        UserError: if there is not exactly one GPT run, or a VQ-VAE is not the one the GPT was trained on.
    """
    gpt_runs = [path for path in paths if run_info(path).kind == "gpt"]
    if len(gpt_runs) != 1:
        raise UserError(f"{len(gpt_runs)} of {len(paths)} folders are runs of a GPT; a bundle needs exactly one")
    bundle = load_gpt_run(gpt_runs[0])
    for path in paths:
        if path == gpt_runs[0]:
            continue
        vqvae = load_vqvae(path)
        same = vqvae.config == bundle.config.vqvae and jax.tree.all(
            jax.tree.map(np.array_equal, jax.device_get(vqvae.variables), bundle.variables["vqvae"])
        )
        if not same:
            raise UserError(f"{path}: not the VQ-VAE that {gpt_runs[0]} was trained on")
    return gpt_runs[0], bundle
