"""What the trainings of all generators share: the tokenizer, the codes, the captions, and the run as a model."""

import dataclasses
import functools
import logging
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Float, Int, Key

from t2m_jax.checkpoints.bundle import CONFIG_FILE, Bundle, BundleConfig, part_kinds
from t2m_jax.checkpoints.model import load_model
from t2m_jax.checkpoints.tokenizer import TrainedTokenizer, load_tokenizer, load_tokenizer_config, save_tokenizer_copy
from t2m_jax.config import flat_fields, save_config
from t2m_jax.data.banks.codes import Captions, CodeBank, CodeBatch, code_batch_at
from t2m_jax.data.cache import CODES_NAME, cache_places
from t2m_jax.data.folder import Clip, Dataset
from t2m_jax.data.index import INDEX, is_single, label_actions, load_index
from t2m_jax.errors import UserError
from t2m_jax.evaluation.sources import CodeSource, make_generation
from t2m_jax.files.arrays import fingerprint
from t2m_jax.models.caption_encoder import init_network, network_module
from t2m_jax.models.rows import apply_rows
from t2m_jax.sampling.pipeline import TextToMotion
from t2m_jax.sampling.request import SamplingOptions
from t2m_jax.text.bpe import save_bpe
from t2m_jax.text.caption_states import CaptionStates
from t2m_jax.train import tokenize
from t2m_jax.train.captions import CaptionReader, make_caption_reader, open_text_encoder, state_width
from t2m_jax.train.checks import check_same_model, open_data
from t2m_jax.train.config import InitParts, compiled_config
from t2m_jax.train.experiment import Evaluation, Setup, Trainer, Validation
from t2m_jax.train.generator_config import GeneratorStepConfig, TrainGeneratorConfig
from t2m_jax.train.optimizer import Metrics, descend_in_parts
from t2m_jax.train.program import Update
from t2m_jax.train.streams import stream_key

logger = logging.getLogger(__name__)

SIZES_OF_TOKENIZER = {"num_codes", "num_quantizers", "code_dim"}
"""Fields of a generator's config that are taken from its tokenizer."""


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


def make_trainer(config: type[TrainGeneratorConfig], steps: GeneratorSteps) -> Trainer:
    """Returns the trainer of a kind of generator."""
    return Trainer(
        config=config,
        prepare=lambda config, resume: prepare_generator(config, steps, resume=resume),
        resolve=resolve_generator,
        next_command='t2m generate "a person walks forward" --model {run}',
    )


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


def descend_trained(
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
    # Codes only mean something with their own tokenizer.
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
    dataset = open_data(config.data, resume=resume)
    tokenizer = load_tokenizer(config.run if resume else config.vqvae)
    tokenize.check_tokenizer(tokenizer, dataset, may_differ=config.init is not None)
    clips = training_clips(config, dataset, "train", fraction=config.data_fraction)
    opened = open_text_encoder(config, resume=resume)  # first, because encoding the clips takes long
    motions = code_motions(config, clips, dataset, tokenizer)
    motions = tokenize.add_rewordings(motions, count=config.rewordings, seed=config.loop.seed)
    reader = make_caption_reader(config, motions, opened, resume=resume)
    shares = draw_shares(config, dataset, motions)
    bank = tokenize.make_code_bank(motions, reader.read, shares=shares)
    compiled = compiled_config(config)
    parts = BundleConfig(
        skeleton=dataset.skeleton.name, tokenizer=tokenizer.config, generator=config.model, text_encoder=opened.config
    )

    def write_parts(run: Path) -> None:
        save_tokenizer_copy(run, tokenizer)
        if reader.bpe is not None:
            save_bpe(run, reader.bpe)
        save_config(run / CONFIG_FILE, parts)

    return Setup(
        dataset=dataset,
        clips=learned_clips(clips, motions),
        data=bank,
        draws="" if shares is None else fingerprint("", {"shares": shares}),
        init=lambda: steps.with_tokenizer(steps.init(compiled, stream_key(config.loop.seed, "init")), tokenizer),
        update=Update(steps.update, config=compiled),
        optimizer=config.optimizer,
        frames_per_step=config.loop.batch_size * float(bank.code_lengths.mean()) * tokenizer.config.downsample,
        weights=weights_of,
        write_parts=write_parts,
        start_from=lambda path: start_from_model(path, tokenizer, like=parts, **_start_options(config)),
        validation=make_validation(config, steps, dataset, tokenizer, reader),
        evaluation=make_evaluation(config, parts, tokenizer, reader),
        # The config counts what chooses the weights, and the loop updates.
        patience=config.patience
        * (config.evaluation.every if config.evaluation.evaluator else config.loop.validate_every),
    )


def _start_options(config: Any) -> dict[str, Any]:
    return {"parts": config.init_parts, "stays": config.trained == "text"}


def start_from_model(
    path: Path,
    tokenizer: TrainedTokenizer,
    *,
    parts: InitParts = "all",
    like: BundleConfig | None = None,
    stays: bool = False,
) -> Mapping[str, Any]:
    """Returns the weights to start from (`init`): of a model's generator and text encoder, by collection and kind.

    The tokenizer may have another decoder than that of the model, because codes do not depend on it. With `fitting`
    parts it may be any, and a codebook that the generator reads is not among the collections; but not if the generator
    `stays` as it is.

    Raises:
        UserError: There is none, its codes mean something else because it has another tokenizer, or all of its weights
            would compute something else in a model with the config `like`.
    """
    model = load_model(path)
    codes = model.config.tokenizer.num_quantizers
    if codes != tokenizer.config.num_quantizers:
        kind = f"a {model.config.generator.kind} with {codes} codes per row"
        raise UserError(
            f"init: {path} is {kind}, and the tokenizer has {tokenizer.config.num_quantizers}; start from another model"
        )
    own = TrainedTokenizer(model.config.tokenizer, model.variables["tokenizer"], model.normalizer)
    same = tokenizer.has_codes_of(own)
    if not same and stays:
        raise UserError(
            f"vqvae: the generator of {path} stays as it is, and was trained with another tokenizer; use its own"
        )
    if not same and parts == "all":
        raise UserError(
            f"init: {path} was trained with another tokenizer; use its own with `--vqvae {path}`, or take the weights "
            "that fit with `--init-parts fitting`"
        )
    if like is not None:
        check_same_model(path, model.config, like, parts=parts, stays=stays)
    weights: dict[str, Any] = {}
    for role, kind in part_kinds(model.config).items():
        # A state has its parts by collection first, a model by role first.
        for name, tree in model.variables[role].items() if role != "tokenizer" else ():
            weights.setdefault(name, {})[kind] = tree
    if not same:
        weights.pop("codebook", None)
    return weights


def training_clips(config: TrainGeneratorConfig, dataset: Dataset, split: str, *, fraction: float = 1.0) -> list[Clip]:
    """Returns the clips of a split with the captions that are learned, which are also those that the run records."""
    clips = dataset.clips(split, fraction=fraction)
    return tokenize.draw_captions(clips, count=config.max_captions, seed=config.loop.seed)


def code_motions(
    config: Any, clips: Sequence[Clip], dataset: Dataset, tokenizer: TrainedTokenizer
) -> list[tokenize.CodedMotion]:
    """Returns clips as codes, as the config asks for."""
    # The seed is not that of the evaluation: clips have the same offsets in all of a run.
    seed = config.loop.seed
    options = tokenize.CodingOptions(config.offsets, config.timed_captions, seed, config.long_clips)
    places = cache_places(dataset.folder, CODES_NAME)
    return tokenize.encode_clips(clips, dataset.info, tokenizer, options, places)


def learned_clips(clips: Sequence[Clip], motions: Sequence[tokenize.CodedMotion]) -> list[Clip]:
    """Returns the clips that motions are codes of; others are too long or too short."""
    learned = {motion.clip for motion in motions}
    return [clip for clip in clips if clip.name in learned]


def draw_shares(
    config: TrainGeneratorConfig, dataset: Dataset, motions: Sequence[tokenize.CodedMotion]
) -> tokenize.Weights | None:
    """Returns the shares of motions in the draws of training (`CodeBank.shares`), None if they are equal.

    Raises:
        UserError: The data set has no labels, or `single_share` is given and all motions are of one kind.
    """
    if not config.balance and config.single_share is None:
        return None
    index = load_index(dataset.folder)
    labels = [None if index is None else index.label(motion.clip) for motion in motions]
    if not any(labels):
        raise UserError(f"{dataset.folder / INDEX}: has no labels of these clips, which balance and single_share need")
    actions = [("",) if label is None else label_actions(label) for label in labels]
    weights = tokenize.balanced_weights(actions, power=config.balance, limit=config.balance_limit)
    if config.single_share is not None:
        single = np.array([label is None or is_single(label) for label in labels])
        if single.all() or not single.any():
            raise UserError(f"single_share: {dataset.folder} has only motions of one kind; leave it out")
        weights = tokenize.with_share(weights, single, config.single_share)
    return (np.cumsum(weights) / weights.sum()).astype(np.float32)


def make_validation(
    config: Any, steps: GeneratorSteps, dataset: Dataset, tokenizer: TrainedTokenizer, reader: CaptionReader
) -> Validation | None:
    """Returns the validation on one pass over the validation split, None if it has nothing to use or is turned off."""
    clips = training_clips(config, dataset, "val") if config.loop.validate_every else []
    if not clips:
        return None
    try:
        motions = code_motions(config, clips, dataset, tokenizer)
    except tokenize.NoMotionError as error:
        logger.warning("no validation, split val: %s", error)
        return None
    measure = functools.partial(steps.validate, config=compiled_config(config))
    return Validation(tokenize.make_code_bank(motions, reader.read), len(motions), measure)


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
