"""What the configs of all generators share: the text encoder, and how their data are made."""

import dataclasses
from pathlib import Path
from typing import Any, ClassVar, Literal

from t2m_jax.checkpoints.encoder_files import PACKAGED_ENCODERS
from t2m_jax.checkpoints.text_encoder import CLIP_NAME
from t2m_jax.field_checks import check_sizes
from t2m_jax.models.caption_encoder import CaptionEncoderConfig, NetworkConfig, StateEncoderConfig
from t2m_jax.models.rows import Precision
from t2m_jax.train.config import ExperimentConfig, GenerationEvaluationConfig, StepConfig
from t2m_jax.train.optimizer import OptimizerConfig
from t2m_jax.train.tokenize import LongClipKind, OffsetKind, TimedCaptionKind


@dataclasses.dataclass(frozen=True, kw_only=True)
class GeneratorStepConfig(StepConfig):
    """What a step of every generator reads."""

    model: Any
    """Sizes of the generator."""
    optimizer: OptimizerConfig
    """Optimizer and schedule."""
    text_encoder: Literal["caption_encoder", "clip", "sentence", "sentence_states"] = "caption_encoder"
    """What reads the captions: a small transformer that is trained with the generator; a pretrained encoder, which is
    not (CLIP or a sentence encoder); or a small transformer that is trained and reads the token states of a sentence
    encoder, which is not."""
    caption_encoder: CaptionEncoderConfig = CaptionEncoderConfig(text_dim=512)
    """Sizes of the caption encoder."""
    state_encoder: StateEncoderConfig = StateEncoderConfig(text_dim=512)
    """Sizes of the transformer that reads token states, with `text_encoder: sentence_states`."""
    trained: Literal["all", "text"] = "all"
    """What is trained. With `text`, and `init`, only the network that reads the captions: it learns to speak to the
    generator, which stays as it is."""
    precision: Precision = "float32"
    """What products are computed in during training."""
    remat: bool = False
    """Whether intermediate values of a block are computed again for the gradient. This needs less memory, but not in
    XLA's order of computations on a CPU; use `num_parts` there."""
    num_parts: int = 1
    """Parts of a batch, computed one after another, whose gradients are added up. This needs less memory."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_sizes(self, "num_parts")
        if self.loop.batch_size % self.num_parts:
            raise ValueError(f"num_parts: {self.num_parts} does not divide loop.batch_size {self.loop.batch_size}")
        network = self.text_network
        if network is None and self.trained == "text":
            raise ValueError(f"trained: the {self.text_encoder} encoder is not trained, so nothing would be")
        if network is not None and self.model.text_dim != network.text_dim:
            raise ValueError(
                f"{network.kind}.text_dim: {network.text_dim}, but the generator reads model.text_dim "
                f"{self.model.text_dim}; set both to the same number"
            )

    @property
    def text_network(self) -> NetworkConfig | None:
        """Sizes of the network that reads captions and is trained with the generator, None if there is none."""
        if self.text_encoder == "caption_encoder":
            return self.caption_encoder
        return self.state_encoder if self.text_encoder == "sentence_states" else None


@dataclasses.dataclass(frozen=True, kw_only=True)
class TrainGeneratorConfig(GeneratorStepConfig, ExperimentConfig):
    """Fields of the training of every generator."""

    step: ClassVar[type[StepConfig]] = GeneratorStepConfig

    vqvae: Path | None = None
    """Run or bundle of the tokenizer that makes the codes, by default that of `init`. It stays as it is. The sizes that
    the model shares with it, such as `model.num_codes`, are taken from it."""
    clip: str = CLIP_NAME
    """CLIP model with `text_encoder: clip`: a folder or a name on the Hugging Face hub (`owner/name@revision`)."""
    sentence: str = PACKAGED_ENCODERS[0]
    """Sentence encoder with `text_encoder: sentence` or `sentence_states`: that of the package (`minilm`), a folder or
    a name on the Hugging Face hub. Its network is one of the BERT family, as of `sentence-transformers`. With
    `sentence`, `model.text_dim` is the width of its embeddings."""
    balance: float = 0.0
    """Power with which motions of rare actions are drawn more often in training: 0 draws all motions equally often, 1
    all actions of the data set's `index.csv`, and 0.5 is between. Of a label such as `walk, happy`, only the action
    counts. A motion of several actions is drawn as often as their mean; motions without a label are one action."""
    balance_limit: float = 10.0
    """Largest weight of a motion in these draws, as a multiple of the mean weight without this limit."""
    single_share: float | None = None
    """Share of the draws that motions of one action have which is done once, as the labels of `index.csv` say. The rest
    are those of several actions, in turn or at once, of counted and of timed ones. null draws by `balance` alone."""
    max_captions: int = 0
    """Captions of each motion that are learned, drawn once; 0 for all. Fewer take less time to read and less space on
    disk with `text_encoder: sentence_states`."""
    rewordings: int = 0
    """Further wordings of each caption that are learned, made by rules: another subject, form of the verb, or article
    (`t2m_jax.text.rewording`). They help if there are few captions."""
    offsets: OffsetKind = "all"
    """Frames at which the first code of a clip may start: all that leave the same number of codes or one fewer, drawn
    each time, or one drawn for each clip before training (the original). `hold` is like `all`, but where a clip begins
    or ends at rest, its pose is held for some frames instead of cut: so generated motion begins and ends like clips."""
    timed_captions: TimedCaptionKind = "encode"
    """Codes for a caption with times: of those frames alone, or cut out of the codes of the whole clip (the
    original)."""
    long_clips: LongClipKind = "drop"
    """Clips that are longer than the data set's longest motion: left out (the original), or cut into windows that
    overlap by half, each with the captions of the clip."""
    patience: int = 0
    """Validations without a lower loss after which training ends, or evaluations without a better metric if there is an
    evaluator; 0 never ends it. The best weights are kept anyway."""
    evaluation: GenerationEvaluationConfig = GenerationEvaluationConfig()
    """Evaluation of generated motion during training."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 <= self.balance <= 1:
            raise ValueError(f"balance: {self.balance} is not a power from 0 to 1")
        if not 1 <= self.balance_limit <= 1000:
            raise ValueError(f"balance_limit: {self.balance_limit} is not from 1 to 1000")
        if self.single_share is not None and not 0 < self.single_share < 1:
            raise ValueError(f"single_share: {self.single_share} is not a share between 0 and 1")
        for name in ("patience", "rewordings", "max_captions"):
            if not 0 <= getattr(self, name) <= 1000:
                raise ValueError(f"{name}: {getattr(self, name)} is not from 0 to 1000")
