"""Training of the double-tier GPT of T2M-HiFiGPT, together with its caption encoder if it has one."""

import dataclasses
import functools
from pathlib import Path
from typing import Any, ClassVar, Literal, NamedTuple

import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Bool, Float, Int, Key

from t2m_jax.checkpoints.tokenizer import TrainedTokenizer
from t2m_jax.data.banks.codes import Captions, CodeBank, CodeBatch
from t2m_jax.data.banks.order import row_keys, split_each
from t2m_jax.devices import global_rows, global_sum, own_rows, split_rows
from t2m_jax.errors import UserError
from t2m_jax.field_checks import check_shares
from t2m_jax.losses import TokenMean, infonce_loss, mean_weights, stop_loss, token_accuracy, token_loss
from t2m_jax.models.contrastive import ContrastiveHead
from t2m_jax.models.hifigpt import HiFiGpt, HiFiGptConfig
from t2m_jax.models.rows import Precision, apply_rows, in_precision
from t2m_jax.models.system import find_part
from t2m_jax.text.bpe import CaptionTokens
from t2m_jax.text.caption_states import CaptionStates
from t2m_jax.train import generator
from t2m_jax.train.config import LoopConfig, StepConfig
from t2m_jax.train.generator_config import GeneratorStepConfig, TrainGeneratorConfig
from t2m_jax.train.log import by_depth
from t2m_jax.train.optimizer import Metrics, OptimizerConfig, make_optimizer
from t2m_jax.train.streams import stream_key

CorruptionKind = Literal["rows", "codes", "none"]
HEAD = "contrastive_head"
"""Name of the module."""
TEMPERATURE = 0.1
"""Of the contrastive loss, for squared distances of unit vectors."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class HiFiGptStepConfig(GeneratorStepConfig):
    """What a step of the double-tier GPT reads."""

    model: HiFiGptConfig = HiFiGptConfig()
    """Sizes of the double-tier GPT."""
    tau: float = 0.5
    """Probability with which a row (or a code) that is read is replaced by random codes."""
    corruption: CorruptionKind = "rows"
    """What is replaced: all codes of a row (the paper's method), single codes, or nothing (its ablations)."""
    corrupt_residual: bool = False
    """Whether the residual tier reads the replaced codes, too."""
    condition_dropout: float = 0.1
    """Probability with which a motion is learned without its text, which guidance needs."""
    mean_over: TokenMean = "tokens"
    """Mean of the losses: over all rows, or over motions of their means."""
    stop_weight: float = 1.0
    """Weight of the stop loss."""
    stop_positive_weight: float = 1.0
    """Weight of the last row of a motion in the stop loss."""
    contrastive_weight: float = 0.0
    """Weight of a loss by which the caption encoder learns which motion of a batch each caption is about. It is not in
    the paper; manners and paces are learned much faster with it (`docs/ablations.md`)."""
    optimizer: OptimizerConfig = OptimizerConfig(
        learning_rate=1e-4, betas=(0.9, 0.95), weight_decay=1e-6, clip_norm=1.0, cosine=(37_500, 300_000)
    )
    """Optimizer and schedule."""
    loop: LoopConfig = LoopConfig(batch_size=128)
    """Length, batch, seed, checkpoints."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_shares(self, "tau", "condition_dropout")
        if self.condition_dropout == 0 and self.model.guidance_scale != 1:
            raise ValueError("condition_dropout: without it, guidance means nothing; set model.guidance_scale to 1")
        if self.contrastive_weight and self.text_network is None:
            raise ValueError(f"contrastive_weight: the {self.text_encoder} encoder is not trained; set the weight to 0")
        if self.contrastive_weight and self.model.code_embedding == "learned":
            raise ValueError("contrastive_weight: needs the tokenizer's codes; model.code_embedding learned has none")


@dataclasses.dataclass(frozen=True, kw_only=True)
class TrainHiFiGptConfig(HiFiGptStepConfig, TrainGeneratorConfig):
    """Training of the double-tier GPT; the defaults are the paper's, except for the text encoder."""

    kind: ClassVar[str] = "hifigpt"
    step: ClassVar[type[StepConfig]] = HiFiGptStepConfig

    run: Path = Path("runs/hifigpt")
    """Run directory to write."""


class HiFiGptState(NamedTuple):
    """Everything that an update changes, and the codebook, which it does not."""

    step: Int[Array, ""]
    params: Any
    codebook: Any
    """The tokenizer's codebook, as a collection of the `hifigpt`; empty if the model learns its own table."""
    opt_state: optax.OptState
    head: Any = {}  # noqa: RUF012 - nothing changes it
    """Parameters of the `contrastive_head`, which only training uses; empty without its loss."""


class HiFiGptBatch(NamedTuple):
    """What the tiers read and predict. The weights are those of a mean over the global batch."""

    codes: Int[Array, "B N R"]
    """The targets."""
    inputs: Int[Array, "B N R"]
    """What the temporal tier reads."""
    is_last: Bool[Array, "B N"]
    weights: Float[Array, "B N"]
    captions: Captions
    dropped: Bool[Array, " B"]
    """Motions without text."""
    dropout_keys: Key[Array, "B 2"] | None
    """Of caption encoder and GPT; None turns dropout off."""


@functools.partial(jax.jit, static_argnames="config")
def init_hifigpt_state(config: HiFiGptStepConfig, key: Key[Array, ""]) -> HiFiGptState:
    """Returns the state before the first update, with a codebook of zeros; `key` is consumed.

    Its `params` have the entries `hifigpt` and, if it is trained too, `caption_encoder`.
    """
    gpt_key, caption_key = jax.random.split(key)
    codes = jnp.zeros((1, 1, config.model.num_quantizers), jnp.int32)
    variables = HiFiGpt(config.model).init(gpt_key, codes, jnp.zeros((1, config.model.text_dim)), train=False)
    params = {"hifigpt": variables["params"]} | generator.init_caption_encoder(config, caption_key)
    codebook = {"hifigpt": variables["codebook"]} if "codebook" in variables else {}
    head = init_head(config)
    opt_state = make_optimizer(config.optimizer).init(params | head)
    return HiFiGptState(jnp.array(0, jnp.int32), params, codebook, opt_state, head)


def init_head(config: HiFiGptStepConfig) -> dict[str, Any]:
    """Returns the parameters of the `contrastive_head`, if its loss has a weight."""
    if not config.contrastive_weight:
        return {}
    text = jnp.zeros((1, config.model.text_dim))
    rows = jnp.zeros((1, 1, config.model.code_dim))
    # A stream of its own, so that the generator starts with the same weights as without the head.
    variables = ContrastiveHead().init(stream_key(config.loop.seed, HEAD), text, rows, jnp.ones((1, 1), bool))
    return {HEAD: variables["params"]}


def with_codebook(state: HiFiGptState, tokenizer: TrainedTokenizer) -> HiFiGptState:
    """Returns the state with the codebook of a tokenizer, if the model reads one.

    Raises:
        UserError: The tokenizer has none.
    """
    if not state.codebook:
        return state
    codebook = find_part(tokenizer.config.kind).codebook
    if codebook is None:
        raise UserError(f"vqvae: a {tokenizer.config.kind} has no codebook to read; use model.code_embedding learned")
    # A copy, because the state is donated and the tokenizer is still used.
    codes = jnp.array(codebook(tokenizer.config, tokenizer.variables))
    return state._replace(codebook={"hifigpt": {"codebook": codes}})


def corrupt_codes(
    codes: Int[Array, "B N R"], keys: Key[Array, " B"], *, kind: CorruptionKind, tau: float, num_codes: int
) -> Int[Array, "B N R"]:
    """Returns codes of which some are replaced by codes from a uniform distribution; the right code may be drawn, too.

    Args:
        codes: What a model reads in training.
        keys: One per motion; consumed.
        kind: Whether rows are replaced as a whole, or each code by itself, or nothing.
        tau: Probability of being replaced.
        num_codes: Number of codes to draw from.
    """
    if kind == "none":
        return codes

    def corrupt(key: Key[Array, ""], rows: Int[Array, "N R"]) -> Int[Array, "N R"]:
        replace_key, code_key = jax.random.split(key)
        # One draw for a row replaces all its codes: they depend on each other, so a wrong row is wrong as a whole.
        shape = (rows.shape[0], 1) if kind == "rows" else rows.shape
        replace = jax.random.uniform(replace_key, shape) < tau
        return jnp.where(replace, jax.random.randint(code_key, rows.shape, 0, num_codes), rows)

    return jax.vmap(corrupt)(keys, codes)


def make_hifigpt_batch(
    batch: CodeBatch,
    *,
    config: HiFiGptStepConfig,
    inputs: Int[Array, "B N R"] | None = None,
    dropped: Bool[Array, " B"] | None = None,
    dropout_keys: Key[Array, "B 2"] | None = None,
) -> HiFiGptBatch:
    """Returns a batch for the model; without more arguments its inputs are the targets, with all texts."""
    length = batch.codes.shape[1]
    return HiFiGptBatch(
        codes=batch.codes,
        inputs=batch.codes if inputs is None else inputs,
        is_last=jnp.arange(length)[None] == batch.code_lengths[:, None] - 1,
        weights=mean_weights(batch.code_lengths, length, mean_over=config.mean_over),
        captions=batch.captions,
        dropped=jnp.zeros(len(batch.codes), bool) if dropped is None else dropped,
        dropout_keys=dropout_keys,
    )


def hifigpt_metrics(
    params: Any, codebook: Any, batch: HiFiGptBatch, *, config: HiFiGptStepConfig, precision: Precision = "float32"
) -> Metrics:
    """Returns losses and accuracy of a batch, or the shares of a part of a batch in them."""
    params, codebook, captions = in_precision((params, codebook, batch.captions), precision)
    keys = (None, None) if batch.dropout_keys is None else (batch.dropout_keys[:, 0], batch.dropout_keys[:, 1])
    text = generator.embed_captions(params, captions, keys[0], config=config)
    contrastive = contrastive_loss(params[HEAD], codebook, batch, text) if config.contrastive_weight else None
    # After the contrastive loss, which needs all texts. Zeros are what guidance reads for no text.
    text = jnp.where(batch.dropped[:, None], jnp.zeros_like(text), text)
    variables = {"params": params["hifigpt"]} | ({"codebook": codebook["hifigpt"]} if codebook else {})
    model = HiFiGpt(config.model, remat=config.remat)
    # The corruption is for the temporal tier. The residual tier reads true codes of the row that it predicts.
    residual = batch.inputs if config.corrupt_residual else batch.codes
    # By position, because `apply_rows` divides what it is given by rows.
    output = apply_rows(model, variables, batch.inputs, text, residual, keys=keys[1])
    given = (output.code_logits, batch.codes, batch.weights)
    nll, accuracy = (jax.vmap(measure, (2, 2, None))(*given) for measure in (token_loss, token_accuracy))
    stop = stop_loss(output.stop_logits, batch.is_last, batch.weights, positive_weight=config.stop_positive_weight)
    loss = jnp.mean(nll) + config.stop_weight * stop
    metrics = {"loss": loss, "nll": jnp.mean(nll), "stop": stop, "accuracy": jnp.mean(accuracy)}
    if contrastive is not None:
        metrics |= {"loss": loss + config.contrastive_weight * contrastive, "contrastive": contrastive}
    return metrics | by_depth("nll", nll) | by_depth("accuracy", accuracy)


def contrastive_loss(
    params: Any, codebook: Any, batch: HiFiGptBatch, text_embedding: Float[Array, "B E"]
) -> Float[Array, ""]:
    """Returns the share of a part of a batch in the InfoNCE loss of captions and motions; `params` are the head's.

    The other motions of the part, on all devices, are the negatives.
    """
    captions = batch.captions
    assert isinstance(captions, CaptionTokens | CaptionStates), "the config needs a network that reads captions"
    # True codes, not corrupted inputs: the caption is about this motion.
    rows = codebook["hifigpt"]["codebook"][batch.codes].sum(axis=2)
    embedded = ContrastiveHead().apply({"params": params}, text_embedding, rows, batch.weights > 0)
    tokens = captions.tokens if isinstance(captions, CaptionTokens) else captions.numbers[:, None]
    (text, motion), tokens = global_rows((embedded, tokens))
    same = jnp.all(tokens[:, None] == tokens[None, :], axis=-1)
    # Weights sum to 1 over the batch. So the losses of its parts add up to their mean.
    return infonce_loss(text, motion, same, temperature=TEMPERATURE) * global_sum(jnp.sum(batch.weights))


def hifigpt_train_step(
    state: HiFiGptState, batch: HiFiGptBatch, *, config: HiFiGptStepConfig
) -> tuple[HiFiGptState, Metrics]:
    """Returns the state after one update and the metrics before it."""

    def measure(params: Any, part: HiFiGptBatch) -> Metrics:
        return hifigpt_metrics(params, state.codebook, part, config=config, precision=config.precision)

    # One optimizer trains both; the head is kept apart, because it is no part of the model.
    together = state._replace(params=state.params | state.head)
    after, metrics = generator.descend_trained(together, measure, batch, config=config, generator="hifigpt")
    params, head = ({name: after.params[name] for name in part} for part in (state.params, state.head))
    return after._replace(params=params, head=head), metrics


def training_batch(bank: CodeBank, step: Int[Array, ""], *, config: HiFiGptStepConfig) -> HiFiGptBatch:
    """Returns the batch of an update: some rows are replaced in what is read, and some texts are left out."""
    seed = config.loop.seed
    rows = own_rows(config.loop.batch_size)
    keys = {name: row_keys(stream_key(seed, name), step, rows) for name in ("condition", "corruption", "dropout")}
    batch = generator.codes_at(bank, "data", step, config=config)
    options: Any = {"kind": config.corruption, "tau": config.tau, "num_codes": config.model.num_codes}
    inputs = corrupt_codes(batch.codes, keys["corruption"], **options)
    dropped = jax.vmap(lambda key: jax.random.bernoulli(key, config.condition_dropout))(keys["condition"])
    dropout_keys = jnp.stack(split_each(keys["dropout"], 2), axis=1)
    return split_rows(
        make_hifigpt_batch(batch, config=config, inputs=inputs, dropped=dropped, dropout_keys=dropout_keys)
    )


def update(state: HiFiGptState, bank: CodeBank, *, config: HiFiGptStepConfig) -> tuple[HiFiGptState, Metrics]:
    """Returns the state after one step on the batch of that step."""
    return hifigpt_train_step(state, training_batch(bank, state.step, config=config), config=config)


@functools.partial(jax.jit, static_argnames="config")
def validate(state: HiFiGptState, bank: CodeBank, step: Int[Array, ""], *, config: HiFiGptStepConfig) -> Metrics:
    """Returns the metrics of a batch of held-out motions, with clean codes and all texts."""
    batch = make_hifigpt_batch(generator.codes_at(bank, "validation", step, config=config), config=config)
    # The best weights are those of the best generator, whatever else it learns from.
    config = dataclasses.replace(config, contrastive_weight=0.0)
    return hifigpt_metrics(state.params, state.codebook, batch, config=config)


TRAINER = generator.make_trainer(
    TrainHiFiGptConfig, generator.GeneratorSteps(init_hifigpt_state, update, validate, with_codebook)
)
"""The entry point `hifigpt`."""
