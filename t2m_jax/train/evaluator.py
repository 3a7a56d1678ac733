"""Training of the evaluator: the encoders of motion and text are matched (Guo et al. 2022)."""

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float, Int, Key

from t2m_jax.checkpoints.evaluator import WORDS_FILE, load_trained_evaluator, save_evaluator_parts
from t2m_jax.checkpoints.run import newest_step
from t2m_jax.data.banks import captions
from t2m_jax.data.folder import Clip, DatasetInfo, samples_from_clip
from t2m_jax.devices import global_mean, global_rows
from t2m_jax.errors import UserError
from t2m_jax.losses import infonce_loss, margin_loss, pair_distances
from t2m_jax.metrics.retrieval import r_precision
from t2m_jax.models.evaluator import FRAMES_PER_MOVEMENT, Evaluator, evaluator_shapes
from t2m_jax.motion.normalizer import Normalizer
from t2m_jax.text.word_vectors import Vocabulary, load_vocabulary, load_word_vectors, vocabulary_from_captions
from t2m_jax.train.checks import open_training_data
from t2m_jax.train.config import InitParts, compiled_config
from t2m_jax.train.evaluator_config import EvaluatorStepConfig, TrainEvaluatorConfig
from t2m_jax.train.experiment import Setup, Trainer, Validation
from t2m_jax.train.movement import MOVEMENTS, train_movements
from t2m_jax.train.optimizer import Metrics, TrainState, make_optimizer
from t2m_jax.train.program import Update
from t2m_jax.train.streams import plan_feed, stream_key, window_options

MOTION_PARTS = ("motion_encoder",)
TEXT_PARTS = ("text_encoder", "part_of_speech_projection")
WORDS = "word_embedding"


def trained_parts(params: Any, config: EvaluatorStepConfig) -> dict[str, Any]:
    """Returns the parameters that are trained, by encoder. Word vectors are trained only if none are given."""
    text = (*TEXT_PARTS, WORDS) if config.word_vectors is None else TEXT_PARTS
    return {"motion": {name: params[name] for name in MOTION_PARTS}, "text": {name: params[name] for name in text}}


@functools.partial(jax.jit, static_argnames="config")
def init_matching_state(
    config: EvaluatorStepConfig, key: Key[Array, ""], movement_encoder: Any, word_vectors: Float[Array, "W X"] | None
) -> TrainState:
    """Returns the state before the first update; `key` is consumed.

    Args:
        config: Sizes.
        key: For all weights that are not given.
        movement_encoder: Its trained weights.
        word_vectors: A table that is not trained; None trains one.
    """
    motion = jnp.zeros((1, config.window, config.model.feature_dim))
    words = jnp.zeros((1, 1), jnp.int32)
    length = jnp.ones(1, jnp.int32)
    # Lengths of one movement and one word are enough, because no weight depends on them.
    params = dict(Evaluator(config.model).init(key, motion, length, words, words, length)["params"])
    params[MOVEMENTS] = movement_encoder
    if word_vectors is not None:
        params[WORDS] = {"embedding": word_vectors}
    optimizer = make_optimizer(config.optimizer)
    opt_state = {name: optimizer.init(part) for name, part in trained_parts(params, config).items()}
    return TrainState(jnp.array(0, jnp.int32), params, opt_state)


def matching_metrics(
    params: Any, batch: captions.CaptionBatch, shift: Int[Array, ""], *, config: EvaluatorStepConfig
) -> Metrics:
    """Returns the loss, the mean distances of pairs and of negatives, and `top3`.

    `top3` is the share of texts whose motion is among the three nearest of the batch; motions at equal distances share
    their places. Before negatives are shifted, pairs are sorted by the length of their motions, longest first, as in
    the original.
    """
    embedded = Evaluator(config.model).apply({"params": params}, batch.motion, batch.lengths, *batch.captions)
    # Every text is compared with motions of other rows.
    (text, motion), lengths, words = global_rows((embedded, batch.lengths, batch.captions.words))
    order = jnp.argsort(-lengths, stable=True)
    text = text[order]
    motion = motion[order]
    if config.objective == "margin":
        loss = margin_loss(text, motion, shift, margin=config.margin)["loss"]
    else:
        # Many motions have the same caption, and are no negatives of each other.
        words = words[order]
        same = jnp.all(words[:, None] == words[None, :], axis=-1)
        loss = infonce_loss(text, motion, same, temperature=config.temperature)
    return {
        "loss": loss,
        "positive_distance": jnp.mean(pair_distances(text, motion)),
        "negative_distance": jnp.mean(pair_distances(text, jnp.roll(motion, -shift, axis=0))),
        # A batch of two has no third place; its texts are all among the first three.
        "top3": r_precision(text, motion, top_k=min(3, len(text)), batch=len(text))[-1],
    }


def matching_train_step(
    state: TrainState, batch: captions.CaptionBatch, shift: Int[Array, ""], *, config: EvaluatorStepConfig
) -> tuple[TrainState, Metrics]:
    """Returns the state after one update and the metrics before it, with the gradient norms before they are limited.

    `shift` is the distance of the negatives in the batch, 0 to B - 2.
    """
    trained = trained_parts(state.params, config)

    def objective(parts: Any) -> tuple[Float[Array, ""], Metrics]:
        metrics = matching_metrics(state.params | parts["motion"] | parts["text"], batch, shift, config=config)
        return metrics["loss"], metrics

    (_, metrics), gradient = jax.value_and_grad(objective, has_aux=True)(trained)
    gradient = global_mean(gradient)
    params = state.params
    opt_state = {}
    # Two optimizers, as in the original: the gradient of each encoder is clipped by its own norm.
    for name, part in trained.items():
        updates, opt_state[name] = make_optimizer(config.optimizer).update(gradient[name], state.opt_state[name], part)
        params = params | optax.apply_updates(part, updates)
        squares = [jnp.sum(leaf**2) for leaf in jax.tree.leaves(gradient[name])]
        metrics[f"{name}_gradient_norm"] = jnp.sqrt(sum(squares, jnp.zeros(())))
    return TrainState(state.step + 1, params, opt_state), metrics


def draw_shift(config: EvaluatorStepConfig, stream: str, step: Int[Array, ""]) -> Int[Array, ""]:
    """Returns the distance of a step's negatives; the original draws 0 too, but not B - 1."""
    key = jax.random.fold_in(stream_key(config.loop.seed, stream), step)
    return jax.random.randint(key, (), 0, config.loop.batch_size - 1)


def update(
    state: TrainState, bank: captions.CaptionBank, *, config: EvaluatorStepConfig, max_frames: int
) -> tuple[TrainState, Metrics]:
    """Returns the state after one step on the batch of that step."""
    batch = captions.caption_batch_at(bank, step=state.step, **window_options(config.loop, "data", window=max_frames))
    return matching_train_step(state, batch, draw_shift(config, "shift", state.step), config=config)


@functools.partial(jax.jit, static_argnames=("config", "max_frames"))
def validate(
    state: TrainState, bank: captions.CaptionBank, step: Int[Array, ""], *, config: EvaluatorStepConfig, max_frames: int
) -> Metrics:
    """Returns the metrics of a batch of held-out motions and captions."""
    batch = captions.caption_batch_at(bank, step=step, **window_options(config.loop, "validation", window=max_frames))
    return matching_metrics(state.params, batch, draw_shift(config, "validation shift", step), config=config)


def matching_samples(clips: Sequence[Clip], info: DatasetInfo) -> list[Clip]:
    """Returns the captioned parts of clips that have at least one movement."""
    samples = (sample for clip in clips for sample in samples_from_clip(clip, info))
    return [sample for sample in samples if len(sample.features) >= FRAMES_PER_MOVEMENT]


def make_vocabulary(config: TrainEvaluatorConfig, samples: Sequence[Clip], *, resume: bool) -> Vocabulary:
    """Returns the words of the run that is resumed, of a given list, of `init`, or of the training captions."""
    if resume:
        return load_vocabulary(config.run / WORDS_FILE)
    if config.words is not None:
        return load_vocabulary(config.words)
    if config.init is not None:
        return load_trained_evaluator(config.init).vocabulary
    return vocabulary_from_captions(captions.all_tokens(samples), min_count=config.min_count)


def _weights_to_start_from(
    path: Path, parts: InitParts, normalizer: Normalizer, vocabulary: Vocabulary
) -> Mapping[str, Any]:
    """Returns the weights of an evaluator.

    Raises:
        UserError: In the new run, they would read other motion or words than those that they have learned.
    """
    source = load_trained_evaluator(path)
    if not all(map(np.array_equal, normalizer, source.normalizer)):
        raise UserError(f"statistics: those of {path} are others, but its movement encoder stays; set it to `init`")
    words = (vocabulary.words, source.vocabulary.words)
    if words[0] != words[1] and (parts == "all" or len(words[0]) == len(words[1])):
        raise UserError(f"words: {path} has other words, so its word vectors would be exchanged; leave it out")
    return source.variables


def load_table(config: TrainEvaluatorConfig, vocabulary: Vocabulary) -> Array | None:
    """Returns the given word vectors, None if they are trained.

    Raises:
        UserError: The file is missing or damaged, or has vectors of another width.
    """
    if config.word_vectors is None:
        return None
    table = load_word_vectors(config.word_vectors, vocabulary.words)
    if table.shape[1] != config.model.word_dim:
        raise UserError(
            f"{config.word_vectors}: vectors of {table.shape[1]} numbers, but model.word_dim is "
            f"{config.model.word_dim}; set it to match"
        )
    return jnp.asarray(table)


def resolve(config: TrainEvaluatorConfig, resume: bool) -> TrainEvaluatorConfig:
    """Returns the config, whose movement encoder is trained before anything else looks at the devices.

    Raises:
        UserError: The devices do not divide its batch.
    """
    devices = config.sharding.devices
    if not resume and config.init is None and devices != "auto" and config.movement_batch_size % devices:
        raise UserError(f"movement_batch_size: {config.movement_batch_size} is not a multiple of {devices} devices")
    return config


def prepare(config: TrainEvaluatorConfig, resume: bool) -> Setup:
    """Returns the setup of a training; its first state contains the trained movement encoder.

    Raises:
        UserError: Data, words and model do not fit.
    """
    dataset, normalizer = open_training_data(config, reader="the evaluator", resume=resume)
    train = dataset.clips("train", fraction=config.data_fraction)
    held_out = dataset.clips("val") if config.loop.validate_every else []
    # Shorter motions have no movement, so that the evaluator could not tell them apart.
    samples, validated = (matching_samples(clips, dataset.info) for clips in (train, held_out))
    vocabulary = make_vocabulary(config, samples, resume=resume)
    # The state that is restored has the movement encoder and the word vectors; their files may be gone.
    is_restored = resume and newest_step(config.run) > 0
    table = None if is_restored else load_table(config, vocabulary)
    config = dataclasses.replace(config, model=dataclasses.replace(config.model, num_words=len(vocabulary)))
    options: dict[str, Any] = {"config": compiled_config(config), "max_frames": dataset.info.max_frames}
    plan = functools.partial(plan_feed, captions.caption_cuts_at, config.loop, window=dataset.info.max_frames)
    validation = None
    if validated:
        bank = captions.make_caption_bank(validated, normalizer, vocabulary)
        validation = Validation(bank, len(validated), functools.partial(validate, **options), plan("validation"))

    def init() -> TrainState:
        if is_restored:  # a checkpoint replaces these weights, and the movement run may have been removed
            movements = jax.tree.map(jnp.zeros_like, evaluator_shapes(config.model)["params"][MOVEMENTS])
        else:
            movements = train_movements(config, dataset, normalizer, train, held_out, resume=resume)
        return init_matching_state(options["config"], stream_key(config.loop.seed, "init"), movements, table)

    return Setup(
        dataset=dataset,
        clips=train,
        data=captions.make_caption_bank(samples, normalizer, vocabulary),
        init=init,
        update=Update(update, **options),
        plan=plan("data"),
        optimizer=config.optimizer,
        frames_per_step=config.loop.batch_size * dataset.info.max_frames,
        weights=lambda state: {"params": state.params},
        write_parts=lambda run: save_evaluator_parts(run, config.model, normalizer, vocabulary),
        start_from=lambda path: _weights_to_start_from(path, config.init_parts, normalizer, vocabulary),
        validation=validation,
        patience=config.patience * config.loop.validate_every if validated else 0,
    )


TRAINER = Trainer(
    config=TrainEvaluatorConfig,
    prepare=prepare,
    resolve=resolve,
    next_command="t2m evaluate generation --data {data} --evaluator {run} --model demo",
)
"""The entry point `evaluator`."""
