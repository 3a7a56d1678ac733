"""Published files put together: the four of a T2M-GPT as a bundle, the five of an evaluator as an evaluator."""

import dataclasses
import hashlib
from pathlib import Path
from typing import Literal, NamedTuple

from t2m_jax.checkpoints.bundle import Bundle, BundleConfig
from t2m_jax.checkpoints.evaluator import TrainedEvaluator, make_trained_evaluator
from t2m_jax.checkpoints.official.load import load_evaluator, load_gpt, load_vqvae
from t2m_jax.errors import UserError
from t2m_jax.models.convolution import NormKind
from t2m_jax.models.quantizer import QuantizerKind
from t2m_jax.motion.normalizer import normalizer_from_files
from t2m_jax.motion.skeleton import skeleton_from_feature_dim
from t2m_jax.text.word_vectors import load_vocabulary


class OfficialFiles(NamedTuple):
    """What the original's authors publish for one data set."""

    vqvae: Path
    gpt: Path
    mean: Path
    std: Path


@dataclasses.dataclass(frozen=True, kw_only=True)
class OfficialOptions:
    """What the files do not tell; the defaults are the published models."""

    num_heads: int = 16
    """Attention heads of the GPT."""
    dilation_growth: int = 3
    """Ratio of the dilations of neighbouring residual units."""
    activation: Literal["relu", "silu", "gelu"] = "relu"
    """Activation inside the residual units."""
    norm: NormKind | None = None
    """Norm of the residual units, where the file leaves `LN` and `GN` open; then `LN`."""
    quantizer: QuantizerKind | None = None
    """How the codebook learnt, where the file leaves it open; then `ema_reset`."""


def load_official(files: OfficialFiles, *, options: OfficialOptions = OfficialOptions()) -> Bundle:
    """Returns the model of four published files; its text encoder is CLIP, which is not among them.

    Raises:
        UserError: if a file is missing, damaged or of something else, or they do not fit each other.
    """
    choices = dataclasses.asdict(options)
    gpt_config, gpt = load_gpt(files.gpt, num_heads=choices.pop("num_heads"))
    vqvae_config, vqvae = load_vqvae(files.vqvae, **choices)
    if gpt_config.num_codes != vqvae_config.num_codes:
        raise UserError(
            f"{files.gpt}: for {gpt_config.num_codes} codes, but {files.vqvae} has {vqvae_config.num_codes}; "
            "the two were not trained together"
        )
    normalizer = normalizer_from_files(files.mean, files.std)
    if len(normalizer.mean) != vqvae_config.feature_dim:
        raise UserError(
            f"{files.mean}: statistics of {len(normalizer.mean)} features, {files.vqvae} has {vqvae_config.feature_dim}"
        )
    try:
        skeleton = skeleton_from_feature_dim(vqvae_config.feature_dim).name
    except UserError as error:
        raise UserError(f"{files.vqvae}: {error}") from None
    config = BundleConfig(skeleton=skeleton, vqvae=vqvae_config, gpt=gpt_config, text_encoder="clip")
    return Bundle(config, {"vqvae": vqvae, "gpt": gpt}, normalizer, None)


class OfficialEvaluatorFiles(NamedTuple):
    """What an evaluator of Guo et al. is made of."""

    evaluator: Path
    """`finest.tar`."""
    mean: Path
    """Statistics of its own, `Comp_v6_*/meta`; not the data set's."""
    std: Path
    words: Path
    """One word a line, in the order of the vectors."""
    word_vectors: Path
    """`our_vab_data.npy`."""


def load_official_evaluator(files: OfficialEvaluatorFiles) -> TrainedEvaluator:
    """Returns a published evaluator.

    Raises:
        UserError: if a file is missing, damaged or of something else, or they do not fit each other.
    """
    config, variables = load_evaluator(files.evaluator, word_vectors=files.word_vectors)
    normalizer, vocabulary = normalizer_from_files(files.mean, files.std), load_vocabulary(files.words)
    if len(normalizer.mean) != config.feature_dim:
        raise UserError(
            f"{files.mean}: statistics of {len(normalizer.mean)} features, {files.evaluator} reads {config.feature_dim}"
        )
    if len(vocabulary) != config.num_words:
        raise UserError(f"{files.words}: {len(vocabulary)} words, but {files.word_vectors} has {config.num_words}")
    return make_trained_evaluator(config, variables, normalizer, vocabulary)


def official_card(files: OfficialFiles, bundle: Bundle) -> str:
    """Returns Markdown that says what a converted model was made of."""
    vqvae, gpt = bundle.config.vqvae, bundle.config.gpt
    rows = "".join(f"| {name} | `{path.name}` | `{_sha256(path)}` |\n" for name, path in files._asdict().items())
    return (
        "# T2M-GPT, converted\n\n"
        "Published weights of T2M-GPT (arXiv 2301.06052) as t2m_jax reads them; no number was changed. Licence and\n"
        "conditions are those of the source the files came from, and of the data they were trained on: look there\n"
        "before you use or pass them on.\n\n"
        f"| part | file | SHA-256 |\n|---|---|---|\n{rows}\n"
        f"- motion: {bundle.config.skeleton}, {vqvae.feature_dim} features a frame\n"
        f"- VQ-VAE: {vqvae.num_codes} codes of {vqvae.code_dim} numbers, {vqvae.width} channels, "
        f"{vqvae.downsample} frames a code\n"
        f"- GPT: {gpt.num_layers} blocks of width {gpt.embed_dim} with {gpt.num_heads} heads, "
        f"at most {gpt.max_codes} codes\n"
    )


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
