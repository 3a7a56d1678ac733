"""`t2m train gpt`: from a data-set folder and a trained VQ-VAE to a run directory."""

import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Int, Key
from tokenizers import Tokenizer

from t2m_jax.checkpoints.bundle import CONFIG_FILE as BUNDLE_FILE
from t2m_jax.checkpoints.bundle import Bundle, BundleConfig
from t2m_jax.checkpoints.clip import load_clip
from t2m_jax.checkpoints.run import create_run, restore_latest
from t2m_jax.checkpoints.vqvae import TrainedVqVae, load_vqvae, save_vqvae_copy
from t2m_jax.config import save_config
from t2m_jax.data.banks.codes import Captions, CodeBank, CodeBatch, code_batch_at
from t2m_jax.data.folder import Dataset, open_dataset
from t2m_jax.errors import UserError
from t2m_jax.evaluation.monitor import ModelInTraining, held_out_figures
from t2m_jax.evaluation.sources import make_generation
from t2m_jax.evaluation.task import Subject
from t2m_jax.sampling.clip_text_encoder import ClipTextEncoder
from t2m_jax.sampling.strategies import Greedy, Temperature
from t2m_jax.text.bpe import load_bpe, save_bpe, tokenize_captions, train_bpe
from t2m_jax.text.embedding_cache import EmbeddingCache
from t2m_jax.train.config import TrainGptConfig, computation
from t2m_jax.train.evaluation import make_evaluation, open_evaluation
from t2m_jax.train.gpt import GptBatch, GptState, gpt_train_step, gpt_validation_step, init_gpt_state
from t2m_jax.train.loop import Look, Metrics, mean_over_batches, run_loop
from t2m_jax.train.resume import check_start
from t2m_jax.train.run_vqvae import check_feature_dim
from t2m_jax.train.streams import stream_key
from t2m_jax.train.targets import drop_one_code, make_targets
from t2m_jax.train.tokenize import CodedMotion, coded_motions, make_code_bank


def make_batch(batch: CodeBatch, key: Key[Array, ""] | None, *, config: TrainGptConfig) -> GptBatch:
    """Returns targets and captions; with a key (consumed), some motions lose a code at one end."""
    codes, code_lengths = batch.codes, batch.code_lengths
    if key is not None:
        drop_key, head_key = jax.random.split(key)
        drop = jax.random.bernoulli(drop_key, config.drop_probability, code_lengths.shape)
        at_head = jax.random.bernoulli(head_key, 0.5, code_lengths.shape)
        codes, code_lengths = drop_one_code(codes, code_lengths, drop, at_head=at_head)
    targets = make_targets(codes, code_lengths, num_codes=config.model.num_codes, block_size=config.model.block_size)
    return GptBatch(targets, batch.captions)


def _batch_at(bank: CodeBank, stream: str, step: Int[Array, ""], *, config: TrainGptConfig) -> CodeBatch:
    key = stream_key(config.loop.seed, stream)
    return code_batch_at(bank, key, step, batch_size=config.loop.batch_size, max_codes=config.model.max_codes)


@functools.partial(jax.jit, static_argnames="config", donate_argnums=0)
def update(state: GptState, bank: CodeBank, *, config: TrainGptConfig) -> tuple[GptState, Metrics]:
    """Returns the state after one step on the batch that belongs to it; `state` is donated."""
    keys = (stream_key(config.loop.seed, name) for name in ("drop", "model"))
    drop_key, model_key = (jax.random.fold_in(key, state.step) for key in keys)
    batch = make_batch(_batch_at(bank, "data", state.step, config=config), drop_key, config=config)
    return gpt_train_step(state, batch, model_key, config=config)


@functools.partial(jax.jit, static_argnames="config")
def _validation_batch(state: GptState, bank: CodeBank, step: Int[Array, ""], *, config: TrainGptConfig) -> Metrics:
    batch = make_batch(_batch_at(bank, "validation", step, config=config), None, config=config)
    return gpt_validation_step(state, batch, config=config)


def check_fit(vqvae: TrainedVqVae, dataset: Dataset, config: TrainGptConfig) -> None:
    """Raises `UserError` where GPT, VQ-VAE and data do not fit each other."""
    check_feature_dim(dataset, vqvae.config.feature_dim)
    if config.model.num_codes != vqvae.config.num_codes:
        raise UserError(
            f"model.num_codes: {config.model.num_codes}, but {config.vqvae} has {vqvae.config.num_codes} codes"
        )
    check_statistics(dataset, vqvae)


def check_statistics(dataset: Dataset, vqvae: TrainedVqVae) -> None:
    """Raises `UserError` where a VQ-VAE was trained with statistics of other data.

    Root and contact columns are left out of the comparison of deviations: training may have weighted them.
    """
    layout = dataset.skeleton.layout
    kept = np.r_[layout.positions, layout.rotations, layout.velocities]
    ours, theirs = dataset.normalizer, vqvae.normalizer
    if not (
        np.allclose(ours.mean, theirs.mean, atol=1e-5) and np.allclose(ours.std[kept], theirs.std[kept], atol=1e-5)
    ):
        raise UserError(
            f"{dataset.folder}: its statistics (Mean.npy, Std.npy) are not those the VQ-VAE was trained with"
        )


class CaptionReader(NamedTuple):
    """How captions are made ready for training."""

    read: Callable[[Sequence[str]], Captions]
    tokenizer: Tokenizer | None
    """Of the caption encoder that is trained along; None with CLIP."""


def make_caption_reader(config: TrainGptConfig, tokenizer: Tokenizer | None) -> CaptionReader:
    """Returns the reader of the configured text encoder; `tokenizer` is that of a caption encoder.

    Raises:
        UserError: if CLIP is not to be had, or of another width than the GPT reads.
    """
    if tokenizer is not None:
        max_length = config.caption_encoder.max_length
        return CaptionReader(lambda captions: tokenize_captions(tokenizer, captions, max_length=max_length), tokenizer)
    clip = load_clip(config.clip, text_dim=config.model.text_dim)
    return CaptionReader(ClipTextEncoder(clip, cache=EmbeddingCache()), None)


def _tokenizer(config: TrainGptConfig, motions: Sequence[CodedMotion], *, resume: bool) -> Tokenizer | None:
    """Returns the caption encoder's tokenizer, trained on the captions or, in a resumed run, read; None with CLIP."""
    if config.text_encoder == "clip":
        return None
    if resume:
        return load_bpe(config.run)
    captions = [caption.text for motion in motions for caption in motion.captions]
    return train_bpe(captions, vocabulary_size=config.caption_encoder.vocabulary_size)


def _bundle_config(config: TrainGptConfig, vqvae: TrainedVqVae, dataset: Dataset) -> BundleConfig:
    return BundleConfig(
        skeleton=dataset.skeleton.name,
        vqvae=vqvae.config,
        gpt=config.model,
        text_encoder=config.text_encoder,
        clip=config.clip,
        caption_encoder=config.caption_encoder,
    )


def _write_run(config: TrainGptConfig, bundle: Bundle, vqvae: TrainedVqVae) -> None:
    save_vqvae_copy(config.run, vqvae)
    if bundle.tokenizer is not None:
        save_bpe(config.run, bundle.tokenizer)
    save_config(config.run / BUNDLE_FILE, bundle.config)
    create_run(config.run, "gpt", config)


def _make_validation(
    dataset: Dataset, vqvae: TrainedVqVae, reader: CaptionReader, config: TrainGptConfig
) -> Callable[[GptState], Mapping[str, float]] | None:
    """Returns a function from state to mean metrics over one pass of the validation split, None where it is empty."""
    clips = dataset.clips("val") if config.loop.validate_every else []
    if not clips:
        return None
    bank = make_code_bank(coded_motions(clips, dataset.info, vqvae, config=config), reader.read)
    compiled = computation(config)
    num_batches = max(bank.codes.shape[0] // config.loop.batch_size, 1)

    return lambda state: mean_over_batches(
        lambda batch: _validation_batch(state, bank, batch, config=compiled), num_batches
    )


def _variables(state: GptState) -> dict[str, Any]:
    """Returns what was trained as modules take it."""
    return {name: {"params": params} for name, params in state.params.items()}


def _make_evaluation(config: TrainGptConfig, held_out: Subject | None, bundle: Bundle, *, resume: bool) -> Look | None:
    """Returns the evaluation of motion generated on the way, None where there is nothing held out."""
    if held_out is None:
        return None
    model = ModelInTraining(bundle)
    strategy = Greedy() if config.evaluation.sampling == "greedy" else Temperature()
    make = functools.partial(make_generation, model, strategy, held_out.samples.clips)
    # CLIP does not move, so what it says of the captions is asked for once.
    with_clip = make() if bundle.tokenizer is None else None

    def evaluate(state: GptState) -> Mapping[str, float]:
        model.take(_variables(state))
        return held_out_figures(held_out, with_clip or make())

    return make_evaluation(
        config.run,
        config.evaluation,
        evaluator=held_out.evaluator.fingerprint,
        evaluate=evaluate,
        trained=lambda state: {"params": state.params},
        sampling=config.evaluation.sampling,
        resume=resume,
    )


def train_gpt(config: TrainGptConfig, *, resume: bool = False) -> GptState:
    """Returns the trained state; the run directory is a complete model that `TextToMotion.load` reads.

    Raises:
        UserError: if data, VQ-VAE and GPT do not fit, the run exists (or, to resume, does not), or a loss is infinite.
    """
    check_start(config.run, config, resume=resume)
    dataset = open_dataset(config.data)
    vqvae = load_vqvae(config.run if resume else config.vqvae)
    check_fit(vqvae, dataset, config)
    held_out = open_evaluation(config.evaluation, dataset)
    clips = dataset.clips("train", fraction=config.data_fraction)
    motions = coded_motions(clips, dataset.info, vqvae, config=config)
    reader = make_caption_reader(config, _tokenizer(config, motions, resume=resume))
    bank = make_code_bank(motions, reader.read)
    compiled = computation(config)
    validate = _make_validation(dataset, vqvae, reader, config)
    state = init_gpt_state(compiled, stream_key(config.loop.seed, "init"))
    variables = _variables(state) | {"vqvae": jax.device_get(vqvae.variables)}
    bundle = Bundle(_bundle_config(config, vqvae, dataset), variables, vqvae.normalizer, reader.tokenizer)
    evaluation = _make_evaluation(config, held_out, bundle, resume=resume)
    if resume:
        state = restore_latest(config.run, state)
    else:
        _write_run(config, bundle, vqvae)
    return run_loop(
        config.run,
        state,
        lambda state: update(state, bank, config=compiled),
        config=config.loop,
        validate=validate,
        evaluation=evaluation,
    )
