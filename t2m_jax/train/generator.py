"""What the trainings of all generators share: the tokenizer, the codes, the captions, and the run as a model."""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, ClassVar, Literal, NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Float, Int, Key

from t2m_jax.checkpoints.bundle import CONFIG_FILE, Bundle, BundleConfig, part_kinds
from t2m_jax.checkpoints.encoder_files import PACKAGED_ENCODERS
from t2m_jax.checkpoints.text_encoder import CLIP_NAME
from t2m_jax.checkpoints.tokenizer import TrainedTokenizer, load_tokenizer, load_tokenizer_config, save_tokenizer_copy
from t2m_jax.config import check_sizes, flat_fields, save_config
from t2m_jax.data.banks.codes import Captions, CodeBank, CodeBatch, code_batch_at
from t2m_jax.data.folder import Clip, Dataset, open_dataset
from t2m_jax.data.index import INDEX, action_of, load_index
from t2m_jax.errors import UserError
from t2m_jax.evaluation.sources import CodeSource, make_generation
from t2m_jax.models.caption_encoder import (
    CaptionEncoderConfig,
    NetworkConfig,
    StateEncoderConfig,
    init_network,
    network_module,
)
from t2m_jax.models.rows import Precision, apply_rows
from t2m_jax.sampling.pipeline import TextToMotion
from t2m_jax.sampling.request import SamplingOptions
from t2m_jax.text.bpe import save_bpe
from t2m_jax.text.caption_states import CaptionStates
from t2m_jax.train.captions import CaptionReader, make_caption_reader, open_text_encoder, state_width
from t2m_jax.train.config import ExperimentConfig, GenerationEvaluationConfig, StepConfig, compiled_config
from t2m_jax.train.experiment import Evaluation, Setup, Validation
from t2m_jax.train.optimizer import Metrics, OptimizerConfig, descend_in_parts
from t2m_jax.train.program import Update
from t2m_jax.train.streams import stream_key
from t2m_jax.train.tokenize import (
    CodedMotion,
    LongClipKind,
    OffsetKind,
    TimedCaptionKind,
    add_rewordings,
    balanced_shares,
    check_tokenizer,
    draw_captions,
    encode_clips,
    make_code_bank,
)
from t2m_jax.train.warm_start import start_from_model

SIZES_OF_TOKENIZER = {"num_codes", "num_quantizers", "code_dim"}
"""Fields of a generator's config that are taken from its tokenizer."""


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
    all labels of the data set's `index.csv`, and 0.5 is between. Of a label such as `walk, happy`, only the action
    counts; composed motions are one label for each number of actions; motions without a label are one, too."""
    balance_limit: float = 10.0
    """How many times as often as the average a motion is drawn at most."""
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
    """Validations without a lower loss after which training ends; 0 never ends it. The best weights are kept anyway."""
    evaluation: GenerationEvaluationConfig = GenerationEvaluationConfig()
    """Evaluation of generated motion during training."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 <= self.balance <= 1:
            raise ValueError(f"balance: {self.balance} is not a power from 0 to 1")
        if not 1 <= self.balance_limit <= 1000:
            raise ValueError(f"balance_limit: {self.balance_limit} is not from 1 to 1000")
        for name in ("patience", "rewordings", "max_captions"):
            if not 0 <= getattr(self, name) <= 1000:
                raise ValueError(f"{name}: {getattr(self, name)} is not from 0 to 1000")


class GeneratorSteps(NamedTuple):
    """The jitted functions of a generator's training; each takes `config` as a keyword."""

    init: Callable[..., Any]
    """From a config and a key to the state, whose collections have one entry per kind of part."""
    update: Callable[..., Any]
    """From a state and a `CodeBank` to the next state and its metrics."""
    validate: Callable[..., Any]
    """From a state, a `CodeBank` and the number of a batch to metrics."""
    with_tokenizer: Callable[[Any, TrainedTokenizer], Any] = lambda state, tokenizer: state
    """From the first state to the state with what the generator takes from its tokenizer; not jitted."""


def init_caption_encoder(config: GeneratorStepConfig, key: Key[Array, ""]) -> dict[str, Any]:
    """Returns the parameters of the network that reads captions by its kind, if it is trained; `key` is consumed."""
    network = config.text_network
    return {} if network is None else {network.kind: init_network(network, key)["params"]}


def embed_captions(
    params: Any, captions: Captions, keys: Key[Array, " B"] | None, *, config: GeneratorStepConfig
) -> Float[Array, "B E"]:
    """Returns the text embeddings: of the network that is trained (`keys`, consumed, are for dropout), or as given."""
    network = config.text_network
    # A pretrained encoder is applied once to all captions, and the bank has its embeddings.
    if network is None:
        assert isinstance(captions, jax.Array)
        return captions
    inputs = (captions.states, captions.mask) if isinstance(captions, CaptionStates) else captions
    return apply_rows(network_module(network), {"params": params[network.kind]}, *inputs, keys=keys)


def update_trained(
    state: Any, measure: Callable[[Any, Any], Metrics], batch: Any, *, config: GeneratorStepConfig, generator: str
) -> tuple[Any, Metrics]:
    """Returns the state after one update of what is trained, and the metrics before it (`descend_in_parts`)."""
    if config.trained == "all":
        return descend_in_parts(state, measure, batch, config.optimizer, num_parts=config.num_parts)
    fixed = {generator: state.params[generator]}

    def measure_text(params: Any, part: Any) -> Metrics:
        return measure(params | jax.lax.stop_gradient(fixed), part)

    after, metrics = descend_in_parts(state, measure_text, batch, config.optimizer, num_parts=config.num_parts)
    # Weight decay would change what has no gradient.
    return after._replace(params=after.params | fixed), metrics


def resolve_generator(config: Any, resume: bool) -> Any:
    """Returns the config with its tokenizer, and with the sizes of this.

    Raises:
        UserError: There is no tokenizer, or it has several codes per row and the generator does not; or the text alone
            is to be trained, without a generator in `init`.
    """
    if config.trained == "text" and config.init is None:
        raise UserError("trained: the text alone needs `init`, the model whose generator reads it")
    if config.vqvae is None:
        config = dataclasses.replace(config, vqvae=config.init)
    path = config.run if resume else config.vqvae
    if path is None:
        raise UserError("vqvae: not given; name the run of a tokenizer, or start from a model with `--init`")
    tokenizer = load_tokenizer_config(path)
    sizes = flat_fields(tokenizer) | {"num_quantizers": tokenizer.num_quantizers}
    # The sizes that a generator shares with its tokenizer are fields of its config, or they cannot be changed.
    shared = sizes.keys() & flat_fields(config.model).keys() & SIZES_OF_TOKENIZER
    try:
        model = dataclasses.replace(config.model, **{name: sizes[name] for name in shared})
    except ValueError as error:
        raise UserError(f"{path}: with this tokenizer, model.{error}") from None
    # Only a generator of one code per row has no such field: its number is not taken from the tokenizer.
    if tokenizer.num_quantizers != model.num_quantizers:
        raise UserError(
            f"{path}: has {tokenizer.num_quantizers} codes per row, but a {config.kind} predicts "
            f"{model.num_quantizers}; choose another tokenizer"
        )
    config = dataclasses.replace(config, model=model)
    if config.text_encoder == "sentence_states":
        sizes = dataclasses.replace(config.state_encoder, state_dim=state_width(config, resume=resume))
        config = dataclasses.replace(config, state_encoder=sizes)
    return config


def codes_at(bank: CodeBank, stream: str, step: Int[Array, ""], *, config: GeneratorStepConfig) -> CodeBatch:
    """Returns the codes of a step of a stream."""
    key = stream_key(config.loop.seed, stream)
    return code_batch_at(bank, key, step, batch_size=config.loop.batch_size, max_codes=config.model.max_codes)


TRAINING_FIELDS = ("step", "opt_state", "head")
"""Fields of a training state that are no part of the model."""


def weights_of(state: Any) -> dict[str, Any]:
    """Returns the fields of a training state that are the model: its collections, each with one entry per kind."""
    return {name: tree for name, tree in state._asdict().items() if name not in TRAINING_FIELDS}


def prepare_generator(config: Any, steps: GeneratorSteps, *, resume: bool) -> Setup:
    """Returns the setup of a generator's training; the run is a complete model that `TextToMotion.load` reads.

    Raises:
        UserError: Data, tokenizer and generator do not fit.
    """
    dataset = open_dataset(config.data)
    tokenizer = load_tokenizer(config.run if resume else config.vqvae)
    check_tokenizer(tokenizer, dataset, may_differ=config.init is not None)
    clips = dataset.clips("train", fraction=config.data_fraction)
    opened = open_text_encoder(config, resume=resume)  # first, because encoding the clips takes long
    motions = code_motions(config, clips, dataset, tokenizer)
    motions = draw_captions(motions, count=config.max_captions, seed=config.loop.seed)
    motions = add_rewordings(motions, count=config.rewordings, seed=config.loop.seed)
    reader = make_caption_reader(config, motions, opened, resume=resume)
    bank = make_code_bank(motions, reader.read, shares=draw_shares(config, dataset, motions))
    compiled = compiled_config(config)
    parts = BundleConfig(
        skeleton=dataset.skeleton.name,
        tokenizer=tokenizer.config,
        generator=config.model,
        text_encoder=opened.config,
    )

    def write_parts(run: Path) -> None:
        save_tokenizer_copy(run, tokenizer)
        if reader.bpe is not None:
            save_bpe(run, reader.bpe)
        save_config(run / CONFIG_FILE, parts)

    return Setup(
        dataset=dataset,
        clips=clips,
        data=bank,
        init=lambda: steps.with_tokenizer(steps.init(compiled, stream_key(config.loop.seed, "init")), tokenizer),
        update=Update(steps.update, config=compiled),
        optimizer=config.optimizer,
        frames_per_step=config.loop.batch_size * float(bank.code_lengths.mean()) * tokenizer.config.downsample,
        weights=weights_of,
        write_parts=write_parts,
        start_from=lambda path: start_from_model(path, tokenizer, parts=config.init_parts),
        validation=make_validation(config, steps, dataset, tokenizer, reader),
        evaluation=make_evaluation(config, parts, tokenizer, reader),
        # The config counts validations, and the loop updates.
        patience=config.patience * config.loop.validate_every,
    )


def code_motions(
    config: Any, clips: Sequence[Clip], dataset: Dataset, tokenizer: TrainedTokenizer
) -> list[CodedMotion]:
    """Returns clips as codes, as the config asks for."""
    options = {name: getattr(config, name) for name in ("offsets", "timed_captions", "long_clips")}
    options["seed"] = config.loop.seed  # not of the evaluation: clips have the same offsets in all of a run
    return encode_clips(clips, dataset.info, tokenizer, **options)


def draw_shares(
    config: TrainGeneratorConfig, dataset: Dataset, motions: Sequence[CodedMotion]
) -> Float[np.ndarray, " M"] | None:
    """Returns the shares of motions in the draws of training (`CodeBank.shares`), None if they are equal.

    Raises:
        UserError: The data set has no labels.
    """
    if not config.balance:
        return None
    index = load_index(dataset.folder)
    labels = [None if index is None else index.label(motion.clip) for motion in motions]
    if not any(labels):
        raise UserError(f"{dataset.folder / INDEX}: has no labels of these clips, which balance needs; set it to 0")
    actions = ["" if label is None else action_of(label) for label in labels]
    return balanced_shares(actions, power=config.balance, limit=config.balance_limit)


def make_validation(
    config: Any, steps: GeneratorSteps, dataset: Dataset, tokenizer: TrainedTokenizer, reader: CaptionReader
) -> Validation | None:
    """Returns the validation on one pass over the validation split, None if it is empty or turned off."""
    clips = dataset.clips("val") if config.loop.validate_every else []
    if not clips:
        return None
    motions = code_motions(config, clips, dataset, tokenizer)
    measure = functools.partial(steps.validate, config=compiled_config(config))
    return Validation(make_code_bank(motions, reader.read), len(motions), measure)


def make_evaluation(config: Any, parts: BundleConfig, tokenizer: TrainedTokenizer, reader: CaptionReader) -> Evaluation:
    """Returns the evaluation of generated motion."""
    kinds = {role: kind for role, kind in part_kinds(parts).items() if role != "tokenizer"}
    options = SamplingOptions(temperature=0.0 if config.evaluation.sampling == "greedy" else 1.0)
    # Once, and not at every evaluation: only the generator changes in between.
    on_device = tokenizer._replace(variables=jax.device_put(tokenizer.variables))

    def model(state: Any) -> TextToMotion:
        weights = weights_of(state)
        variables = {
            role: {name: tree[kind] for name, tree in weights.items() if kind in tree} for role, kind in kinds.items()
        }
        variables["tokenizer"] = on_device.variables
        bundle = Bundle(parts, variables, tokenizer.normalizer, reader.bpe)
        return TextToMotion(bundle, text_encoder=reader.make_encoder(bundle))

    def source(state: Any, clips: Sequence[Clip]) -> CodeSource:
        return make_generation(model(state), clips, options=options)

    unit = tokenizer.config.downsample
    return Evaluation(config.evaluation, unit, source, sampling=config.evaluation.sampling)
