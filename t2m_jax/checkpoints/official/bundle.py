"""Puts published files together: four files of T2M-GPT make a bundle, five files make an evaluator."""

import hashlib
from pathlib import Path
from typing import Any, NamedTuple

from t2m_jax.checkpoints.bundle import Bundle, BundleConfig, check_statistics_width
from t2m_jax.checkpoints.evaluator import TrainedEvaluator, make_trained_evaluator
from t2m_jax.checkpoints.official.load import load_evaluator, load_gpt, load_vqvae
from t2m_jax.checkpoints.text_encoder import ClipReference
from t2m_jax.errors import UserError
from t2m_jax.motion.normalizer import normalizer_from_files
from t2m_jax.motion.skeleton import skeleton_from_feature_dim
from t2m_jax.text.word_vectors import load_vocabulary


class OfficialFiles(NamedTuple):
    """The files that the authors of T2M-GPT publish for one data set."""

    vqvae: Path
    gpt: Path
    mean: Path
    std: Path


def load_official(files: OfficialFiles, *, num_heads: int = 16, **vqvae_options: Any) -> Bundle:
    """Returns the model in four published files. Its text encoder is CLIP, which is not part of the files.

    Args:
        files: The files.
        num_heads: Attention heads of the GPT, which its file does not contain.
        vqvae_options: What the file of the VQ-VAE does not contain; see `load_vqvae`.

    Raises:
        UserError: A file is missing, damaged or of something else, or the files do not fit each other.
    """
    gpt_config, gpt = load_gpt(files.gpt, num_heads=num_heads)
    vqvae_config, vqvae = load_vqvae(files.vqvae, **vqvae_options)
    normalizer = normalizer_from_files(files.mean, files.std)
    check_statistics_width(files.mean, normalizer, vqvae_config.feature_dim)
    try:
        name = skeleton_from_feature_dim(vqvae_config.feature_dim).name
        clip = ClipReference()
        config = BundleConfig(skeleton=name, tokenizer=vqvae_config, generator=gpt_config, text_encoder=clip)
    except ValueError as error:
        raise UserError(f"{files.vqvae} and {files.gpt} do not make a model: {error}") from None
    return Bundle(config, {"tokenizer": vqvae, "generator": gpt}, normalizer, None)


class OfficialEvaluatorFiles(NamedTuple):
    """The files of an evaluator by Guo et al."""

    evaluator: Path
    """`finest.tar`."""
    mean: Path
    """The evaluator's own statistics, `Comp_v6_*/meta`. They are not those of the data set."""
    std: Path
    words: Path
    """One word per line, in the order of the vectors."""
    word_vectors: Path
    """`our_vab_data.npy`."""


def load_official_evaluator(files: OfficialEvaluatorFiles) -> TrainedEvaluator:
    """Returns a published evaluator.

    Raises:
        UserError: A file is missing, damaged or of something else, or the files do not fit each other.
    """
    config, variables = load_evaluator(files.evaluator, word_vectors=files.word_vectors)
    normalizer = normalizer_from_files(files.mean, files.std)
    vocabulary = load_vocabulary(files.words)
    check_statistics_width(files.mean, normalizer, config.feature_dim)
    if len(vocabulary) != config.num_words:
        raise UserError(f"{files.words}: has {len(vocabulary)} words, but {files.word_vectors} has {config.num_words}")
    return make_trained_evaluator(config, variables, normalizer, vocabulary)


def official_card(files: OfficialFiles, bundle: Bundle) -> str:
    """Returns a Markdown card that says which files a converted model was made from."""
    vqvae = bundle.config.tokenizer
    gpt = bundle.config.generator
    rows = ""
    for name, path in files._asdict().items():
        with path.open("rb") as file:
            rows += f"| {name} | `{path.name}` | `{hashlib.file_digest(file, 'sha256').hexdigest()}` |\n"
    return (
        "# T2M-GPT, converted\n\n"
        "Published weights of T2M-GPT (arXiv 2301.06052), converted for t2m_jax without changing a number. License\n"
        "and conditions are those of the source of the files, and of the data that they were trained on. Read them\n"
        "before you use or share this model.\n\n"
        f"| part | file | SHA-256 |\n|---|---|---|\n{rows}\n"
        f"- motion: {bundle.config.skeleton}, {vqvae.feature_dim} features per frame\n"
        f"- VQ-VAE: {vqvae.num_codes} codes of {vqvae.code_dim} numbers, {vqvae.width} channels, "
        f"{vqvae.downsample} frames per code\n"
        f"- GPT: {gpt.num_layers} blocks of width {gpt.embed_dim} with {gpt.num_heads} heads, "
        f"at most {gpt.max_codes} codes\n"
    )
