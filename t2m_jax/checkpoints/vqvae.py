"""A trained VQ-VAE by itself: from a run directory, a bundle, or the copy that a GPT's run keeps."""

from pathlib import Path
from typing import Any, NamedTuple

from t2m_jax.checkpoints.best import restore_trained
from t2m_jax.checkpoints.bundle import CONFIG_FILE as BUNDLE_FILE
from t2m_jax.checkpoints.bundle import bundle_path, load_bundle, vqvae_shapes
from t2m_jax.checkpoints.run import is_run_directory, run_info
from t2m_jax.config import load_config, save_config
from t2m_jax.errors import UserError
from t2m_jax.files import load_arrays, save_arrays
from t2m_jax.models.vqvae import VqVaeConfig
from t2m_jax.motion.normalizer import Normalizer, load_normalizer, save_normalizer

VQVAE_CONFIG, COPY_WEIGHTS, COPY_FOLDER = "vqvae.yaml", "vqvae.safetensors", "vqvae"


class TrainedVqVae(NamedTuple):
    """A VQ-VAE and the statistics of what it reads."""

    config: VqVaeConfig
    variables: dict[str, Any]
    normalizer: Normalizer


def load_vqvae(path: Path) -> TrainedVqVae:
    """Returns the VQ-VAE of a run directory (of either stage) or of a bundle.

    Of its own run it is the best, where evaluation chose one, else the newest.

    Raises:
        UserError: if there is none, or it is damaged.
    """
    path = bundle_path(path)
    if not is_run_directory(path):
        if (path / BUNDLE_FILE).is_file():
            bundle = load_bundle(path)
            return TrainedVqVae(bundle.config.vqvae, bundle.variables["vqvae"], bundle.normalizer)
        raise UserError(f"{path}: neither a run directory nor a bundle; train a VQ-VAE with `t2m train vqvae` first")
    if run_info(path).kind == "gpt":
        return _load_copy(path / COPY_FOLDER)
    config = load_config(path / VQVAE_CONFIG, VqVaeConfig)
    return TrainedVqVae(config, restore_trained(path, vqvae_shapes(config)), load_normalizer(path))


def save_vqvae_copy(run: Path, vqvae: TrainedVqVae) -> None:
    """Writes the VQ-VAE into a GPT's run, so that the run needs no other folder."""
    folder = run / COPY_FOLDER
    folder.mkdir(parents=True, exist_ok=True)
    save_config(folder / VQVAE_CONFIG, vqvae.config)
    save_arrays(folder / COPY_WEIGHTS, vqvae.variables)
    save_normalizer(folder, vqvae.normalizer)


def _load_copy(folder: Path) -> TrainedVqVae:
    config = load_config(folder / VQVAE_CONFIG, VqVaeConfig)
    return TrainedVqVae(config, load_arrays(folder / COPY_WEIGHTS, vqvae_shapes(config)), load_normalizer(folder))
