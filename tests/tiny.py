"""Tiny models: everything of the real ones but their size, so that tests make and train them in seconds."""

import dataclasses
from pathlib import Path

import jax
import numpy as np

from t2m_jax.checkpoints.bundle import Bundle, BundleConfig, expected_variables, part_kinds
from t2m_jax.checkpoints.evaluator import TrainedEvaluator, make_trained_evaluator
from t2m_jax.data.importers.synthetic import make_motion
from t2m_jax.models.caption_encoder import CaptionEncoderConfig
from t2m_jax.models.evaluator import EvaluatorConfig, evaluator_shapes
from t2m_jax.models.hifigpt import HiFiGptConfig
from t2m_jax.models.motion_gpt import MotionGptConfig
from t2m_jax.models.vqvae import RvqVaeConfig, VqVaeConfig
from t2m_jax.motion.features import features_from_positions
from t2m_jax.motion.normalizer import Normalizer, normalizer_from_clips
from t2m_jax.motion.skeleton import HUMANML3D
from t2m_jax.text.bpe import train_bpe
from t2m_jax.text.word_vectors import tokens_from_text, vocabulary_from_captions
from t2m_jax.train import LoopConfig, OptimizerConfig, TrainVqVaeConfig
from t2m_jax.train.gpt import TrainGptConfig
from t2m_jax.train.hifigpt import TrainHiFiGptConfig
from t2m_jax.train.vqvae_config import TrainRvqVaeConfig

VQVAE = VqVaeConfig(num_codes=16, code_dim=8, width=16, depth=1)
RVQVAE = RvqVaeConfig(num_codes=16, code_dim=8, width=16, num_quantizers=3)
GPT = MotionGptConfig(num_codes=16, embed_dim=16, text_dim=12, num_layers=2, num_heads=2, block_size=41)
HIFIGPT = HiFiGptConfig(
    num_codes=16,
    num_quantizers=3,
    code_dim=8,
    embed_dim=16,
    text_dim=12,
    num_layers=2,
    num_residual_layers=2,
    num_heads=2,
    max_codes=20,
)
CAPTION_ENCODER = CaptionEncoderConfig(
    vocabulary_size=90, max_length=16, embed_dim=16, num_layers=1, num_heads=2, text_dim=12
)
BUNDLE = BundleConfig(tokenizer=VQVAE, generator=GPT, text_encoder=CAPTION_ENCODER)
HIFIGPT_BUNDLE = BundleConfig(tokenizer=RVQVAE, generator=HIFIGPT, text_encoder=CAPTION_ENCODER)
BUNDLES = {"gpt": BUNDLE, "hifigpt": HIFIGPT_BUNDLE}
EVALUATOR = EvaluatorConfig(
    movement_hidden=10, movement_dim=12, motion_hidden=8, text_hidden=6, embedding_dim=16, word_dim=5
)
LOOP = LoopConfig(num_steps=8, batch_size=4, seed=5, log_every=3, validate_every=4, checkpoint_every=4)
OPTIMIZER = OptimizerConfig(learning_rate=1e-3, warmup_steps=4)
CAPTIONS = (
    "a person walks forward",
    "a person waves with the left hand",
    "the man turns to the right while walking",
    "someone raises both arms",
    "a woman is walking slowly and turns left",
)


def vqvae_training(data: Path, run: Path, *, loop: LoopConfig = LOOP) -> TrainVqVaeConfig:
    """Returns the config of a first stage that takes seconds."""
    return TrainVqVaeConfig(data=data, run=run, model=VQVAE, window=32, optimizer=OPTIMIZER, loop=loop)


def gpt_training(data: Path, vqvae: Path, run: Path, *, loop: LoopConfig = LOOP) -> TrainGptConfig:
    """Returns the config of a second stage that takes seconds."""
    return TrainGptConfig(
        data=data, vqvae=vqvae, run=run, model=GPT, caption_encoder=CAPTION_ENCODER, optimizer=OPTIMIZER, loop=loop
    )


def rvqvae_training(data: Path, run: Path, *, loop: LoopConfig = LOOP) -> TrainRvqVaeConfig:
    """Returns the config of a residual first stage that takes seconds."""
    return TrainRvqVaeConfig(data=data, run=run, model=RVQVAE, optimizer=OPTIMIZER, loop=loop)


def hifigpt_training(data: Path, vqvae: Path, run: Path, *, loop: LoopConfig = LOOP) -> TrainHiFiGptConfig:
    """Returns the config of a double-tier second stage that takes seconds."""
    return TrainHiFiGptConfig(
        data=data, vqvae=vqvae, run=run, model=HIFIGPT, caption_encoder=CAPTION_ENCODER, optimizer=OPTIMIZER, loop=loop
    )


def random_variables(shapes, *, seed: int = 10, gain: float = 2.0):
    """Returns weights that say something: matrices of the given gain, scales of one, biases of zero.

    With these a GPT's answers depend on text and position, and its motions end at different places, also greedily.
    """
    generator = np.random.default_rng(seed)

    def fill(path, leaf):
        if leaf.dtype == bool or "scale" in jax.tree_util.keystr(path):
            return np.ones(leaf.shape, leaf.dtype)
        if leaf.ndim < 2:
            return np.zeros(leaf.shape, leaf.dtype)
        return (gain * generator.normal(size=leaf.shape) / np.sqrt(np.prod(leaf.shape[:-1]))).astype(leaf.dtype)

    return jax.tree_util.tree_map_with_path(fill, shapes)


def walking_normalizer() -> Normalizer:
    """Returns statistics of a synthetic walk, so that random features still look like somebody."""
    features = features_from_positions(make_motion("walk", seed=0, num_frames=60), HUMANML3D)
    return normalizer_from_clips([np.asarray(features)], HUMANML3D.layout)


def random_bundle(config: BundleConfig = BUNDLE, *, seed: int = 10) -> Bundle:
    """Returns a complete model that nobody trained."""
    bpe = train_bpe(CAPTIONS, vocabulary_size=CAPTION_ENCODER.vocabulary_size)
    kinds, shapes = part_kinds(config), expected_variables(config)
    # Drawn in the order of the kinds' names: tests know what these weights generate.
    drawn = random_variables({kind: shapes[role] for role, kind in kinds.items()}, seed=seed)
    variables = {role: drawn[kind] for role, kind in kinds.items()}
    return Bundle(config, variables, walking_normalizer(), bpe)


def random_evaluator(*, seed: int = 10) -> TrainedEvaluator:
    """Returns an evaluator that nobody trained; it knows the words of `CAPTIONS`."""
    vocabulary = vocabulary_from_captions(map(tokens_from_text, CAPTIONS), min_count=1)
    config = dataclasses.replace(EVALUATOR, num_words=len(vocabulary))
    variables = random_variables(evaluator_shapes(config), seed=seed)
    return make_trained_evaluator(config, variables, walking_normalizer(), vocabulary)


def trust_manifests(monkeypatch) -> None:
    """Lets tests change the files of models. A stranger's model may also have a manifest that fits its files."""
    for module in ("bundle", "evaluator"):
        monkeypatch.setattr(f"t2m_jax.checkpoints.{module}.check_folder", lambda folder: None)
