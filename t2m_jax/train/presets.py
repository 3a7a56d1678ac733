"""Configs of the published trainings.

T2M-GPT: `official` follows the published commands, `paper` follows the text of the paper. `docs/paper_and_code.md`
lists every difference and the reason for each choice. T2M-HiFiGPT has no published code: `hifigpt/paper` follows its
paper, and `docs/hifigpt.md` says what the paper leaves open.
"""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

from t2m_jax.config import flat_fields
from t2m_jax.errors import UserError
from t2m_jax.models.vqvae import RvqVaeConfig, VqVaeConfig
from t2m_jax.motion.skeleton import HUMANML3D, KIT_ML, Skeleton
from t2m_jax.train.config import LoopConfig
from t2m_jax.train.gpt import TrainGptConfig
from t2m_jax.train.hifigpt import TrainHiFiGptConfig
from t2m_jax.train.optimizer import OptimizerConfig
from t2m_jax.train.vqvae_config import TrainRvqVaeConfig, TrainVqVaeConfig

SKELETONS = {skeleton.name: skeleton for skeleton in (HUMANML3D, KIT_ML)}
"""The skeletons of the data sets that have presets, by name."""
OFFICIAL_FOLDERS = {HUMANML3D.name: "t2m", KIT_ML.name: "kit"}
"""The folder of each data set in the original code, which contains the statistics published with the weights."""

# The paper counts epochs: 3,600 with batches of 256 (250 at a constant rate), and 1,600 with batches of 128 (200).
HIFIGPT_UPDATES = {
    ("rvqvae", HUMANML3D.name): (22_000, 300_000),
    ("rvqvae", KIT_ML.name): (4_600, 66_000),
    ("hifigpt", HUMANML3D.name): (37_500, 300_000),
    ("hifigpt", KIT_ML.name): (7_300, 59_000),
}
"""The update at which the rate of a stage of T2M-HiFiGPT begins to fall, and its last update, on a data set."""


def _folders(skeleton: Skeleton, recipe: str, *stages: str) -> dict[str, Any]:
    """Returns the data and the runs of a recipe; the last stage is trained, after the tokenizer of the one before."""
    runs = [Path(f"runs/{skeleton.name}-{recipe}-{stage}") for stage in stages]
    return {"data": Path(f"data/{skeleton.name}"), "run": runs[-1]} | ({"vqvae": runs[0]} if len(runs) > 1 else {})


def official_vqvae(skeleton: Skeleton) -> TrainVqVaeConfig:
    """Returns the config of the published command for the first stage."""
    return TrainVqVaeConfig(
        **_folders(skeleton, "official", "vqvae"),
        model=VqVaeConfig(feature_dim=skeleton.feature_dim),
        short_clips="drop",
        statistics=f"checkpoints/{OFFICIAL_FOLDERS[skeleton.name]}/VQVAEV3_CB1024_CMT_H1024_NRES3/meta",
        # The original trains for 300,000 updates after 999 updates of warm-up.
        loop=LoopConfig(num_steps=300_999, seed=123),
    )


def paper_vqvae(skeleton: Skeleton) -> TrainVqVaeConfig:
    """Returns the config that the paper describes for the first stage (section 3.1 and implementation details)."""
    return dataclasses.replace(
        official_vqvae(skeleton),
        **_folders(skeleton, "paper", "vqvae"),
        velocity="frame_difference",  # equation 3
        commitment_weight=1.0,
        optimizer=OptimizerConfig(milestones=(200_000,)),
        loop=LoopConfig(num_steps=300_000, seed=123),
    )


def official_gpt(skeleton: Skeleton) -> TrainGptConfig:
    """Returns the config of the published command for the second stage."""
    paths = _folders(skeleton, "official", "vqvae", "gpt")
    loop = LoopConfig(batch_size=128, seed=123)
    return TrainGptConfig(**paths, text_encoder="clip", offsets="one", timed_captions="slice", loop=loop)


def paper_gpt(skeleton: Skeleton) -> TrainGptConfig:
    """Returns the config that the paper describes for the second stage (section 3.2 and implementation details).

    The paper's best results are with a tau of 0.5 on HumanML3D, and with a random tau on KIT-ML.
    """
    return dataclasses.replace(
        official_gpt(skeleton),
        **_folders(skeleton, "paper", "vqvae", "gpt"),
        tau=0.5 if skeleton is HUMANML3D else "per_motion",
        corrupt_past_end=False,  # the text replaces codes; the code replaces whatever is in their places
        mean_over="tokens",
        optimizer=OptimizerConfig(learning_rate=1e-4, milestones=(150_000,), betas=(0.5, 0.99)),
    )


def hifigpt_rvqvae(skeleton: Skeleton) -> TrainRvqVaeConfig:
    """Returns the config of T2M-HiFiGPT's first stage: section 4.1 of its paper, and the sum over depths of 3.2."""
    updates = HIFIGPT_UPDATES["rvqvae", skeleton.name]
    return TrainRvqVaeConfig(
        **_folders(skeleton, "hifigpt", "rvqvae"),
        model=RvqVaeConfig(feature_dim=skeleton.feature_dim, commitment="sum"),
        optimizer=OptimizerConfig(betas=(0.9, 0.95), cosine=updates),
        loop=LoopConfig(num_steps=updates[1]),
    )


def hifigpt_gpt(skeleton: Skeleton) -> TrainHiFiGptConfig:
    """Returns the config of T2M-HiFiGPT's second stage: the default, but with CLIP (section 4.1 of its paper)."""
    updates = HIFIGPT_UPDATES["hifigpt", skeleton.name]
    optimizer = dataclasses.replace(TrainHiFiGptConfig().optimizer, cosine=updates)
    loop = LoopConfig(num_steps=updates[1], batch_size=128)
    paths = _folders(skeleton, "hifigpt", "rvqvae", "gpt")
    return TrainHiFiGptConfig(**paths, text_encoder="clip", optimizer=optimizer, loop=loop)


PRESETS: dict[tuple[str, str], Callable[[Skeleton], Any]] = {
    ("vqvae", "official"): official_vqvae,
    ("vqvae", "paper"): paper_vqvae,
    ("gpt", "official"): official_gpt,
    ("gpt", "paper"): paper_gpt,
    ("rvqvae", "hifigpt/paper"): hifigpt_rvqvae,
    ("hifigpt", "hifigpt/paper"): hifigpt_gpt,
}
"""From what is trained and a recipe to a config."""


def preset_names(kind: str | None = None) -> tuple[str, ...]:
    """Returns the names of the presets of a kind, or of all.

    A name is a recipe for HumanML3D, or a data set and a recipe such as `kit_ml/paper`.
    """
    recipes = tuple(dict.fromkeys(recipe for stage, recipe in PRESETS if kind in (None, stage)))
    return (*recipes, *(f"{data}/{recipe}" for data in SKELETONS for recipe in recipes))


def load_preset(stage: str, name: str) -> Any:
    """Returns the config of a stage by a name such as "paper", "humanml3d/paper" or "kit_ml/official".

    Raises:
        UserError: There is no such preset.
    """
    if name not in preset_names(stage):
        raise UserError(f"{name}: no preset of stage {stage}; known: {', '.join(preset_names(stage)) or 'none'}")
    data, _, recipe = name.partition("/")
    if data in SKELETONS:
        return PRESETS[stage, recipe](SKELETONS[data])
    return PRESETS[stage, name](HUMANML3D)


def differences(one: Any, other: Any) -> dict[str, tuple[Any, Any]]:
    """Returns the fields in which two configs of the same stage differ, with both values."""
    left = flat_fields(one)
    right = flat_fields(other)
    return {name: (left[name], right[name]) for name in left if left[name] != right[name]}
