"""`t2m train gpt`: from a data-set folder and a trained VQ-VAE to a run directory."""

import functools
import logging
from collections.abc import Callable, Mapping, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int, Key
from tokenizers import Tokenizer

from t2m_jax.checkpoints.bundle import CONFIG_FILE as BUNDLE_FILE
from t2m_jax.checkpoints.bundle import BundleConfig
from t2m_jax.checkpoints.run_directory import create_run, restore_latest
from t2m_jax.checkpoints.vqvae import TrainedVqVae, load_vqvae, save_vqvae_copy
from t2m_jax.config import UserError, save_config
from t2m_jax.data.code_bank import CodeBank, CodeBatch, code_batch_at
from t2m_jax.data.folder import Clip, Dataset, open_dataset, samples_from_clip
from t2m_jax.models.vqvae import VqVae
from t2m_jax.text.tokenization import load_tokenizer, save_tokenizer, train_tokenizer
from t2m_jax.train.config import TrainGptConfig
from t2m_jax.train.gpt import GptBatch, GptState, gpt_train_step, gpt_validation_step, init_gpt_state
from t2m_jax.train.loop import Metrics, run_loop
from t2m_jax.train.resume import check_start
from t2m_jax.train.run_vqvae import check_feature_dim
from t2m_jax.train.streams import stream_key
from t2m_jax.train.targets import drop_one_code, make_targets
from t2m_jax.train.tokenize import encode_motions, make_code_bank

logger = logging.getLogger(__name__)


def make_batch(batch: CodeBatch, key: Key[Array, ""] | None, *, config: TrainGptConfig) -> GptBatch:
    """Returns targets and captions; with a key (consumed), some motions lose a code at one end."""
    codes, code_lengths = batch.codes, batch.code_lengths
    if key is not None:
        drop_key, head_key = jax.random.split(key)
        drop = jax.random.bernoulli(drop_key, config.drop_probability, code_lengths.shape)
        at_head = jax.random.bernoulli(head_key, 0.5, code_lengths.shape)
        codes, code_lengths = drop_one_code(codes, code_lengths, drop, at_head=at_head)
    targets = make_targets(codes, code_lengths, num_codes=config.model.num_codes, block_size=config.model.block_size)
    return GptBatch(targets, batch.caption_tokens, batch.caption_mask)


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


def load_samples(dataset: Dataset, split: str, *, downsample: int) -> list[Clip]:
    """Returns what the GPT learns from: whole clips and time-tagged pieces of them, each long enough to be encoded.

    What is left out is counted in the log.
    """
    clips = dataset.clips(split)
    # One more code than the shortest: every starting offset must leave at least one.
    samples = [
        sample
        for clip in clips
        for sample in samples_from_clip(clip, dataset.info)
        if len(sample.features) >= 2 * downsample
    ]
    whole = {clip.name for clip in clips} & {sample.name for sample in samples}
    if len(whole) < len(clips):
        limits = f"shorter than {dataset.info.min_frames} or longer than {dataset.info.max_frames + 3} frames"
        left_out = len(clips) - len(whole)
        logger.warning("%s: %d clips of %s are not used whole (%s)", dataset.folder, left_out, split, limits)
    return samples


def check_fit(vqvae: TrainedVqVae, dataset: Dataset, config: TrainGptConfig) -> None:
    """Raises `UserError` where GPT, VQ-VAE, caption encoder and data do not fit each other."""
    check_feature_dim(dataset, vqvae.config.feature_dim)
    if config.model.num_codes != vqvae.config.num_codes:
        raise UserError(
            f"model.num_codes: {config.model.num_codes}, but {config.vqvae} has {vqvae.config.num_codes} codes"
        )
    if config.model.text_dim != config.caption_encoder.text_dim:
        raise UserError(
            f"caption_encoder.text_dim: {config.caption_encoder.text_dim}, "
            f"but the GPT reads model.text_dim {config.model.text_dim}"
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


def _write_run(config: TrainGptConfig, vqvae: TrainedVqVae, dataset: Dataset, tokenizer: Tokenizer) -> None:
    save_vqvae_copy(config.run, vqvae)
    save_tokenizer(config.run, tokenizer)
    bundle = BundleConfig(
        skeleton=dataset.skeleton.name, vqvae=vqvae.config, gpt=config.model, caption_encoder=config.caption_encoder
    )
    save_config(config.run / BUNDLE_FILE, bundle)
    create_run(config.run, "gpt", config)


def _make_validation(bank: CodeBank | None, config: TrainGptConfig) -> Callable[[GptState], Mapping[str, float]] | None:
    """Returns a function from state to mean metrics over one pass of the validation split."""
    if bank is None:
        return None
    num_batches = max(bank.codes.shape[0] // config.loop.batch_size, 1)

    def validate(state: GptState) -> Mapping[str, float]:
        results = [_validation_batch(state, bank, jnp.array(step), config=config) for step in range(num_batches)]
        fetched = jax.device_get(results)
        return {name: float(np.mean([metrics[name] for metrics in fetched])) for name in fetched[0]}

    return validate


def train_gpt(config: TrainGptConfig, *, resume: bool = False) -> GptState:
    """Returns the trained state; the run directory is a complete model that `TextToMotion.load` reads.

    Raises:
        UserError: if data, VQ-VAE and GPT do not fit, the run exists (or, to resume, does not), or a loss is infinite.
    """
    check_start(config.run, config, resume=resume)
    dataset = open_dataset(config.data)
    vqvae = load_vqvae(config.run if resume else config.vqvae)
    check_fit(vqvae, dataset, config)
    downsample = vqvae.config.downsample
    train_samples = load_samples(dataset, "train", downsample=downsample)
    if resume:
        tokenizer = load_tokenizer(config.run)
    else:
        captions = [caption.text for sample in train_samples for caption in sample.captions]
        tokenizer = train_tokenizer(captions, vocabulary_size=config.caption_encoder.vocabulary_size)

    def bank_of(samples: Sequence[Clip]) -> CodeBank:
        return make_code_bank(
            samples,
            vqvae.normalizer,
            lambda motions: encode_motions(VqVae(vqvae.config), vqvae.variables, motions),
            tokenizer,
            downsample=downsample,
            max_caption_tokens=config.caption_encoder.max_length,
        )

    bank = bank_of(train_samples)
    val_samples = load_samples(dataset, "val", downsample=downsample) if config.loop.validate_every else []
    validate = _make_validation(bank_of(val_samples) if val_samples else None, config)
    state = init_gpt_state(config, stream_key(config.loop.seed, "init"))
    if resume:
        state = restore_latest(config.run, state)
    else:
        _write_run(config, vqvae, dataset, tokenizer)
    return run_loop(
        config.run, state, lambda state: update(state, bank, config=config), config=config.loop, validate=validate
    )
