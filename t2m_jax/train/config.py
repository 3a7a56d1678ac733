"""What the configs of all trainings share."""

import dataclasses
from pathlib import Path
from typing import Any, ClassVar, Literal

from t2m_jax.field_checks import check_amounts, check_limits, check_seed, check_sizes

EvaluationMetric = Literal["fid", "matching_score", "r_precision_1", "r_precision_2", "r_precision_3"]
"""Metrics that can choose weights: a larger value is always better, or always worse. Diversity is not one of them."""
DrawMode = Literal["greedy", "sampled"]
"""How an evaluation during training chooses codes: the likeliest each time, or drawn."""
Placement = Literal["auto", "device", "host"]
"""Where the training motion is."""
InitParts = Literal["all", "fitting"]
"""Whether a training starts from all weights of a model, or from those that fit."""
FROM_DATA = "data"
"""The value of `statistics` that means the data set's own."""
MAX_BATCH = 65_536
"""Most clips of an update, 256 times the default: more would only fill the memory."""
MAX_STEPS_PER_CALL = 10_000
"""Most updates of a call. More save nothing, and their metrics and rows of data would fill the memory."""
MAX_WINDOW = 10_000
"""Longest training window in frames, eight minutes: a window beyond all motions would only fill the memory."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class LoopConfig:
    """How long to train and what to keep."""

    num_steps: int = 300_000
    """Number of updates."""
    batch_size: int = 256
    """Clips per update."""
    seed: int = 0
    """Seed of every random choice: weights, order, windows, dropout. From 0 to 2**32 - 1."""
    log_every: int = 50
    """Updates per row of metrics."""
    validate_every: int = 1000
    """Updates between two validations; 0 turns validation off."""
    checkpoint_every: int = 1000
    """Updates between two checkpoints; one more is written at the end."""
    keep_checkpoints: int = 2
    """How many of the newest checkpoints are kept."""
    steps_per_call: int = 1
    """Updates that the devices make without waiting for the host. Rows of metrics, measurements and checkpoints cut a
    call short."""

    def __post_init__(self) -> None:
        check_sizes(self, "num_steps", "batch_size", "keep_checkpoints", "steps_per_call")
        # Steps are counted in 32 bits on the devices.
        check_limits(self, num_steps=2**31 - 1, batch_size=MAX_BATCH, steps_per_call=MAX_STEPS_PER_CALL)
        check_seed(self.seed)
        check_amounts(self, "log_every", "validate_every", "checkpoint_every")


@dataclasses.dataclass(frozen=True, kw_only=True)
class StepConfig:
    """The part of a training's config that its compiled step reads. A training extends it by what its own step reads.

    Steps are compiled for these fields alone, so that trainings which differ in others share their programs.
    """

    loop: LoopConfig = LoopConfig()
    """Length, batch, seed, checkpoints."""

    def __post_init__(self) -> None:
        names = [field.name for field in dataclasses.fields(self)]
        check_amounts(self, *(name for name in names if name.endswith("_weight")))


@dataclasses.dataclass(frozen=True, kw_only=True)
class ShardingConfig:
    """How a training uses devices. Nothing of it changes what is learned, and a resumed run may change it."""

    mode: Literal["jit", "pmap"] = "jit"
    """How one program runs on all devices: XLA divides it (`jit`), or each device runs it on its rows (`pmap`)."""
    devices: int | Literal["auto"] = "auto"
    """Number of devices; it must divide the batch. `auto` takes as many as possible."""
    optimizer: Literal["replicated", "sharded"] = "replicated"
    """Whether each device has all of the optimizer's state, or its share of it (ZeRO). Shares need less memory."""
    bank: Literal["replicated", "sharded"] = "replicated"
    """Whether each device has all of the training motion, or its share of it."""

    def __post_init__(self) -> None:
        check_sizes(self)
        # Without a global view of arrays, nothing could put the shares together.
        if self.mode == "pmap" and "sharded" in (self.optimizer, self.bank):
            raise ValueError("mode: pmap has all of the state and the data on each device; shares need mode jit")


@dataclasses.dataclass(frozen=True, kw_only=True)
class EvaluationConfig:
    """Evaluation on the validation split during training."""

    evaluator: Path | None = None
    """Folder or run of an evaluator. The weights with the best `metric` are then loaded from the run. Without an
    evaluator these are the weights with the lowest validation loss, and without validation the newest."""
    every: int = 10_000
    """Updates between two evaluations; one more is made at the end."""
    metric: EvaluationMetric = "fid"
    """What the best weights are chosen by."""
    seed: int = 0
    """Seed of an evaluation's random choices, the same each time, so that two steps can be compared."""

    def __post_init__(self) -> None:
        check_sizes(self, "every")
        check_seed(self.seed)


@dataclasses.dataclass(frozen=True, kw_only=True)
class GenerationEvaluationConfig(EvaluationConfig):
    """Evaluation of generated motion during training."""

    sampling: DrawMode = "greedy"
    """How codes are chosen: the likeliest each time (the original, during training), or drawn (its final test)."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class ExperimentConfig(StepConfig):
    """Fields of every training."""

    kind: ClassVar[str]
    """Name of the trainer's entry point, and of what is trained."""
    step: ClassVar[type[StepConfig] | None] = None
    """The class of the fields that the compiled step reads; None if it may read all."""

    data: Path = Path("data/humanml3d")
    """Data-set folder."""
    data_fraction: float = 1.0
    """Share of the training clips that is used; a smaller share is part of a larger one."""
    run: Path
    """Run directory to write."""
    init: Path | None = None
    """Bundle, bundled name or run to start from: its weights instead of random ones, of the same sizes."""
    init_parts: InitParts = "all"
    """What is taken of `init`: all weights, which must have the sizes of the config and the same codes; or those that
    have its names and sizes (`fitting`), while the others start at random. So a generator may get another tokenizer
    or text encoder. What its codes mean has changed then, which it has to learn."""
    sharding: ShardingConfig = ShardingConfig()
    """How devices share the work."""
    placement: Placement = "auto"
    """Where the training motion is: on the devices, or on the host, which reads the windows of the next steps from the
    data set's cache and feeds them. `auto` chooses the host for motion that takes more than half of a device's free
    memory. The batches are the same, and a resumed run may change it. A generator's codes are always on the devices."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 < self.data_fraction <= 1:
            raise ValueError(f"data_fraction: {self.data_fraction} is not a share above 0 and at most 1")


@dataclasses.dataclass(frozen=True, kw_only=True)
class NormalizedConfig(ExperimentConfig):
    """Fields of a training whose model keeps the statistics of the motion that it reads."""

    statistics: str = FROM_DATA
    """Mean and standard deviation that normalize the motion: `data` for the data set's own, weighted by `root_weight`;
    or a folder or a file `mean.npy` (with `std.npy` next to it), or a model, used as they are."""
    root_weight: float = 25.0
    """By how much the root's columns and the contacts are scaled up; published evaluators have 25. For its VQ-VAE, the
    original divides their standard deviations by 5 twice; without it, heading and path drift."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.root_weight > 0:
            raise ValueError(f"root_weight: {self.root_weight} is not above 0")


def compiled_config(config: ExperimentConfig) -> Any:
    """Returns the part of a config that compiled steps read, an instance of `config.step`.

    Of `loop`, only the batch and the seed change what a step computes.
    """
    if config.step is None:
        return config
    # A field that is not in the section is not there at all, so a step cannot read it by mistake.
    fields = {field.name: getattr(config, field.name) for field in dataclasses.fields(config.step)}
    fields["loop"] = LoopConfig(batch_size=config.loop.batch_size, seed=config.loop.seed)
    return config.step(**fields)
