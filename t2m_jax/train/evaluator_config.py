"""The schema of `t2m train evaluator`."""

import dataclasses
from pathlib import Path
from typing import Literal

from t2m_jax.config import check_sizes
from t2m_jax.models.evaluator import FRAMES_PER_MOVEMENT, EvaluatorConfig
from t2m_jax.text.word_vectors import MIN_COUNT
from t2m_jax.train.config import LoopConfig, check_fraction
from t2m_jax.train.optimizer import OptimizerConfig


@dataclasses.dataclass(frozen=True, kw_only=True)
class TrainEvaluatorConfig:
    """Training of the evaluator; sizes, losses and optimisers are by default those of the published one.

    First the movement encoder is trained, with a decoder that is thrown away; then, with it left as it is, the encoders
    of motion and text, which `loop` is about.
    """

    data: Path = Path("data/humanml3d")
    """Data-set folder."""
    data_fraction: float = 1.0
    """Share of the training clips that is used; a smaller share is part of a larger one."""
    run: Path = Path("runs/evaluator")
    """Run directory to write."""
    model: EvaluatorConfig = EvaluatorConfig()
    """Sizes; `num_words` is set to what the vocabulary has."""
    words: Path | None = None
    """Word list, one a line; by default the words of the training captions."""
    min_count: int = MIN_COUNT
    """How often a word must stand in the training captions to be one of the vocabulary."""
    word_vectors: Path | None = None
    """Word vectors that are left as they are: a GloVe file, or a table (.npy) of the word list. By default they are
    learned."""
    root_weight: float = 25.0
    """How much larger the root's columns and the contacts are made before the evaluator sees them; published
    evaluators have 25."""
    window: int = 24
    """Frames of a window on which the movement encoder is trained."""
    movement_steps: int = 100_000
    """Updates of the movement encoder; the original goes up to 270 times over every window of the data."""
    movement_batch_size: int = 128
    """Windows an update of the movement encoder."""
    decoder_hidden: int = 512
    """Channels between the two convolutions of the movement decoder."""
    sparsity_weight: float = 0.001
    """Weight of the movements' mean absolute value."""
    smoothness_weight: float = 0.001
    """Weight of the movements' mean absolute step."""
    movement_optimizer: OptimizerConfig = OptimizerConfig(learning_rate=1e-4, betas=(0.9, 0.999))
    """Optimiser of the movement encoder."""
    objective: Literal["margin", "infonce"] = "margin"
    """Loss of matching: pairs together and one shifted batch apart (the original), or every text told from all motions
    of the batch and the other way round, rows of one caption left out."""
    margin: float = 10.0
    """Distance to which `margin` pushes negatives."""
    temperature: float = 10.0
    """What `infonce` divides squared distances by."""
    optimizer: OptimizerConfig = OptimizerConfig(learning_rate=1e-4, betas=(0.9, 0.999), clip_norm=0.5)
    """Optimiser of the encoders of motion and text; each has its own, and its own norm that is cut."""
    patience: int = 20
    """Validations without a lower loss after which training ends; 0 goes on. The best weights are kept either way."""
    loop: LoopConfig = LoopConfig(num_steps=110_000, batch_size=64, validate_every=350, checkpoint_every=3500)
    """Length, batch, seed, checkpoints of the matching; also how often the movement encoder is looked at."""

    def __post_init__(self) -> None:
        check_fraction(self.data_fraction)
        check_sizes(self, "min_count", "movement_steps", "movement_batch_size", "decoder_hidden")
        if self.window < 2 * FRAMES_PER_MOVEMENT:
            raise ValueError(f"window: {self.window} frames are fewer than two movements")
        if self.window % FRAMES_PER_MOVEMENT:
            raise ValueError(f"window: {self.window} is no multiple of {FRAMES_PER_MOVEMENT}")
        if self.loop.batch_size < 2:
            raise ValueError(f"loop.batch_size: {self.loop.batch_size} leaves no negative")
        if not (self.temperature > 0 and self.margin > 0 and self.root_weight > 0):
            raise ValueError("temperature, margin, root_weight: must be above 0")
        if self.patience < 0:
            raise ValueError(f"patience: {self.patience} is below 0")
