"""A bundle: one folder that holds a complete text-to-motion model and can be passed on."""

import dataclasses
import importlib.resources
import shutil
import tempfile
from pathlib import Path
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
from tokenizers import Tokenizer

from t2m_jax.checkpoints.clip import TrainedClip, save_clip
from t2m_jax.config import load_config, save_config
from t2m_jax.errors import UserError
from t2m_jax.files import load_arrays, save_arrays
from t2m_jax.models.caption_encoder import CaptionEncoder, CaptionEncoderConfig
from t2m_jax.models.motion_gpt import MotionGpt, MotionGptConfig
from t2m_jax.models.vqvae import VqVae, VqVaeConfig
from t2m_jax.motion.normalizer import Normalizer, load_normalizer, save_normalizer
from t2m_jax.motion.skeleton import skeleton_from_name
from t2m_jax.text.bpe import load_bpe, save_bpe

CONFIG_FILE = "bundle.yaml"
WEIGHTS_FILE = "weights.safetensors"
CARD_FILE = "README.md"
CLIP_FOLDER = "clip"
"""Folder of a bundle that may hold its CLIP."""
CLIP_NAME = "openai/clip-vit-base-patch32"
"""The CLIP of T2M-GPT on the Hugging Face hub."""
BUNDLED = ("demo",)
"""Names of the bundles that come with the package."""


TextEncoderKind = Literal["caption_encoder", "clip"]


@dataclasses.dataclass(frozen=True, kw_only=True)
class BundleConfig:
    """What a bundle says of itself."""

    format_version: int = 1
    """Layout of the folder."""
    skeleton: str = "humanml3d"
    """Name of the skeleton the motion is on."""
    vqvae: VqVaeConfig = VqVaeConfig()
    """Sizes of the VQ-VAE."""
    gpt: MotionGptConfig = MotionGptConfig()
    """Sizes of the GPT."""
    text_encoder: TextEncoderKind = "caption_encoder"
    """What reads the captions."""
    clip: str = CLIP_NAME
    """With text encoder `clip`: folder or name on the Hugging Face hub. A folder `clip` in the bundle comes first."""
    caption_encoder: CaptionEncoderConfig = CaptionEncoderConfig()
    """Sizes of the caption encoder, where it is the text encoder."""


class Bundle(NamedTuple):
    """A complete text-to-motion model."""

    config: BundleConfig
    variables: dict[str, Any]
    """The collections of `vqvae`, `gpt` and, where it is the text encoder, `caption_encoder`."""
    normalizer: Normalizer
    tokenizer: Tokenizer | None
    """Of the caption encoder; None with another text encoder."""


def bundle_path(name_or_path: str | Path) -> Path:
    """Returns the folder of a bundled model's name, or the path itself."""
    if str(name_or_path) in BUNDLED:
        return Path(str(importlib.resources.files("t2m_jax") / "bundles" / str(name_or_path)))
    return Path(name_or_path)


def vqvae_shapes(config: VqVaeConfig) -> dict[str, Any]:
    """Returns the shapes of the VQ-VAE's variables."""
    motion = jnp.zeros((1, config.downsample, config.feature_dim))
    return jax.eval_shape(lambda: VqVae(config).init(jax.random.key(0), motion, train=False))


def expected_variables(config: BundleConfig) -> dict[str, Any]:
    """Returns the shapes of all variables of a bundle."""
    text = jnp.zeros((1, config.gpt.text_dim))
    tokens = jnp.zeros((1, config.caption_encoder.max_length), jnp.int32)

    def gpt() -> Any:
        return MotionGpt(config.gpt).init(jax.random.key(0), jnp.zeros((1, 0), jnp.int32), text, train=False)

    def caption_encoder() -> Any:
        module = CaptionEncoder(config.caption_encoder)
        return module.init(jax.random.key(0), tokens, jnp.ones(tokens.shape, bool), train=False)

    shapes = {"vqvae": vqvae_shapes(config.vqvae), "gpt": jax.eval_shape(gpt)}
    if config.text_encoder == "caption_encoder":
        shapes["caption_encoder"] = jax.eval_shape(caption_encoder)
    return shapes


def _check_config(config: BundleConfig, path: Path) -> None:
    """Raises `UserError` where the parts do not fit each other."""
    if config.format_version != BundleConfig().format_version:
        raise UserError(f"{path}: format_version {config.format_version} is not known to this version of t2m_jax")
    feature_dim = skeleton_from_name(config.skeleton).feature_dim
    fits = [
        ("vqvae.feature_dim", config.vqvae.feature_dim, feature_dim),
        ("gpt.num_codes", config.gpt.num_codes, config.vqvae.num_codes),
    ]
    if config.text_encoder == "caption_encoder":
        fits.append(("gpt.text_dim", config.gpt.text_dim, config.caption_encoder.text_dim))
    for name, found, wanted in fits:
        if found != wanted:
            raise UserError(f"{path}: {name} is {found}, but the other parts want {wanted}")


def load_bundle(path: Path) -> Bundle:
    """Returns the model of a bundle folder.

    Raises:
        UserError: if a file is missing or damaged, or the parts do not fit each other.
    """
    if not path.is_dir():
        known = ", ".join(BUNDLED)
        raise UserError(f"{path}: no such model; give a bundle folder, a run folder, or a bundled name ({known})")
    config = load_config(path / CONFIG_FILE, BundleConfig)
    _check_config(config, path / CONFIG_FILE)
    variables = load_arrays(path / WEIGHTS_FILE, expected_variables(config))
    normalizer = load_normalizer(path)
    if normalizer.mean.shape != (config.vqvae.feature_dim,):
        raise UserError(f"{path}: statistics of {normalizer.mean.shape[0]} features, {config.vqvae.feature_dim} wanted")
    tokenizer = None
    if config.text_encoder == "caption_encoder":
        tokenizer = load_bpe(path)
        if tokenizer.get_vocab_size() > config.caption_encoder.vocabulary_size:
            raise UserError(f"{path}: the tokenizer has more tokens than caption_encoder.vocabulary_size")
    elif (path / CLIP_FOLDER).is_dir():
        config = dataclasses.replace(config, clip=str(path / CLIP_FOLDER))
    return Bundle(config, variables, normalizer, tokenizer)


def save_bundle(path: Path, bundle: Bundle, *, card: str, half: bool = True, clip: TrainedClip | None = None) -> None:
    """Writes a bundle folder; it appears complete or not at all.

    Args:
        path: Folder to make.
        bundle: The model.
        card: Markdown on what it is.
        half: Whether weights are stored in 16 bits.
        clip: The text encoder to put in, where it is CLIP; without, a user of the bundle needs it by its name.

    Raises:
        UserError: if `path` exists already.
    """
    if path.exists():
        raise UserError(f"{path}: exists already; choose another folder or remove it")
    path.parent.mkdir(parents=True, exist_ok=True)
    folder = Path(tempfile.mkdtemp(prefix=f".{path.name}-", dir=path.parent))
    try:
        save_config(folder / CONFIG_FILE, bundle.config)
        save_arrays(folder / WEIGHTS_FILE, bundle.variables, half=half)
        save_normalizer(folder, bundle.normalizer)
        if bundle.tokenizer is not None:
            save_bpe(folder, bundle.tokenizer)
        if clip is not None:
            save_clip(folder / CLIP_FOLDER, clip)
        (folder / CARD_FILE).write_text(card, encoding="utf-8")
        # A temporary folder and safetensors' files are private; a bundle is made to be shared.
        folder.chmod(0o755)
        for file in folder.rglob("*"):
            file.chmod(0o755 if file.is_dir() else 0o644)
        folder.rename(path)
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
