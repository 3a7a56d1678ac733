"""The config of `t2m train evaluator`."""

import dataclasses
from pathlib import Path
from typing import ClassVar, Literal

from t2m_jax.field_checks import check_amounts, check_limits, check_sizes
from t2m_jax.models.evaluator import FRAMES_PER_MOVEMENT, EvaluatorConfig
from t2m_jax.text.word_vectors import MIN_COUNT
from t2m_jax.train.config import MAX_WINDOW, LoopConfig, NormalizedConfig, StepConfig
from t2m_jax.train.optimizer import OptimizerConfig


@dataclasses.dataclass(frozen=True, kw_only=True)
class EvaluatorStepConfig(StepConfig):
    """What the steps of the evaluator and of its movement encoder read."""

    model: EvaluatorConfig = EvaluatorConfig()
    """Sizes; `num_words` is taken from the vocabulary."""
    word_vectors: Path | None = None
    """Word vectors that are not trained: a GloVe file, or a table (.npy) of the word list. By default they are
    trained. With `init`, its vectors are taken, and this only says that they stay."""
    window: int = 24
    """Frames of a training window of the movement encoder."""
    movement_batch_size: int = 128
    """Windows per update of the movement encoder."""
    decoder_hidden: int = 512
    """Channels between the two convolutions of the movement decoder."""
    sparsity_weight: float = 0.001
    """Weight of the movements' mean absolute value."""
    smoothness_weight: float = 0.001
    """Weight of the movements' mean absolute difference in time."""
    movement_optimizer: OptimizerConfig = OptimizerConfig(learning_rate=1e-4, betas=(0.9, 0.999))
    """Optimizer of the movement encoder."""
    objective: Literal["margin", "infonce"] = "margin"
    """Loss of matching: pairs together and one shifted batch apart (the original), or cross-entropy over the batch in
    both directions, without rows that have the same caption."""
    margin: float = 10.0
    """Distance to which `margin` pushes negatives."""
    temperature: float = 10.0
    """Divisor of squared distances in `infonce`."""
    optimizer: OptimizerConfig = OptimizerConfig(learning_rate=1e-4, betas=(0.9, 0.999), clip_norm=0.5)
    """Optimizer of the encoders of motion and text; each has its own, and the gradient norm of each is limited."""
    loop: LoopConfig = LoopConfig(num_steps=110_000, batch_size=64, validate_every=350, checkpoint_every=3500)
    """Length, batch, seed and intervals of the matching; the movement encoder has the same intervals."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_sizes(self, "movement_batch_size", "decoder_hidden")
        check_limits(self, window=MAX_WINDOW)
        # One movement alone has no difference in time, which `smoothness_weight` is about.
        if self.window < 2 * FRAMES_PER_MOVEMENT or self.window % FRAMES_PER_MOVEMENT:
            raise ValueError(f"window: {self.window} is not a multiple of {FRAMES_PER_MOVEMENT} above one movement")
        if self.loop.batch_size < 2:
            raise ValueError(f"loop.batch_size: {self.loop.batch_size} leaves no negatives; use 2 or more")
        if not (self.temperature > 0 and self.margin > 0):
            raise ValueError("temperature, margin: must be above 0")


@dataclasses.dataclass(frozen=True, kw_only=True)
class TrainEvaluatorConfig(EvaluatorStepConfig, NormalizedConfig):
    """Training of the evaluator; sizes, losses and optimizers are by default those of the published one.

    The movement encoder is trained first, with a decoder that is not kept. Then it is frozen, and the encoders of
    motion and text are trained, for as long as `loop` says.
    """

    kind: ClassVar[str] = "evaluator"
    step: ClassVar[type[StepConfig]] = EvaluatorStepConfig

    run: Path = Path("runs/evaluator")
    """Run directory to write."""
    words: Path | None = None
    """Word list, one per line; by default the words of the training captions."""
    min_count: int = MIN_COUNT
    """How often a word must occur in the training captions to be in the vocabulary."""
    movement_steps: int = 100_000
    """Updates of the movement encoder; the original makes up to 270 passes over every window of the data."""
    patience: int = 20
    """Validations without a lower loss after which training ends; 0 never ends it. The best weights are kept anyway."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_sizes(self, "min_count", "movement_steps")
        check_amounts(self, "patience")
