"""Teaching a model other words for what it knows: `t2m teach`.

The network that reads captions learns to give a new sentence the text embedding of one that it understands
(distillation; Hinton et al., arXiv 1503.02531; here by the squared error of embeddings). The generator stays as it is,
so no motion is needed, and a CPU takes minutes.
"""

import dataclasses
import functools
import random
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Key
from tqdm import tqdm

from t2m_jax.checkpoints.bundle import Bundle
from t2m_jax.checkpoints.text_encoder import SentenceStatesConfig, trained_network
from t2m_jax.errors import UserError
from t2m_jax.models.caption_encoder import NetworkConfig, network_module
from t2m_jax.models.rows import apply_rows
from t2m_jax.sampling.text_encoders import SentenceStates
from t2m_jax.text.bpe import CaptionTokens, tokenize_captions
from t2m_jax.text.caption_states import StateTable, StoredStates, table_from_states
from t2m_jax.train.lessons import Lesson, vary_lessons, with_taught_words
from t2m_jax.train.optimizer import Metrics, OptimizerConfig, TrainState, descend, first_state
from t2m_jax.train.streams import stream_key

BATCH_SIZE = 96
"""Half of a batch are lessons, and half are captions that keep their meaning."""
SHORT = (16, 24)
"""Tokens of batches of short sentences; the others have room for the longest that the network reads."""
EMBEDDED_AT_ONCE = 256
"""Sentences whose targets are computed together."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class TeachingConfig:
    """What a step of teaching reads."""

    network: NetworkConfig
    """Sizes of the network that reads captions."""
    optimizer: OptimizerConfig
    """Optimizer and schedule."""


class Taught(NamedTuple):
    """A model that was taught, and how well it understands sentences that it was not taught."""

    bundle: Bundle
    right_before: int
    """Held-out sentences whose text embedding was nearest to that of their meaning, among all meanings."""
    right_after: int


class _Sentences(NamedTuple):
    """All sentences as the network reads them, each once; other arrays name them by their numbers."""

    network: NetworkConfig
    captions: CaptionTokens | StateTable
    lengths: Int[np.ndarray, " M"]
    """Tokens of each."""
    numbers: dict[str, int]

    def find(self, texts: Iterable[str]) -> Int[np.ndarray, " B"]:
        """Returns the numbers of sentences."""
        return np.array([self.numbers[text] for text in texts], np.int32)

    def size(self, length: int) -> int:
        """Returns the tokens of a batch whose sentences have at most `length`."""
        return next((size for size in SHORT if length <= size < self.network.max_length), self.network.max_length)


def _inputs_at(captions: CaptionTokens | StateTable, numbers: Int[Array, " B"], size: int) -> tuple[Any, Any]:
    """Returns the first `size` tokens of some sentences, or their states, and the mask of what is used."""
    if isinstance(captions, StateTable):
        states, mask, _ = captions._replace(places=captions.places[:size]).batch(numbers)
        return states, mask
    return captions.tokens[numbers, :size], captions.mask[numbers, :size]


@functools.partial(jax.jit, static_argnames=("network", "size"))
def embed_sentences(
    params: Any, captions: CaptionTokens | StateTable, numbers: Int[Array, " B"], *, network: NetworkConfig, size: int
) -> Float[Array, "B E"]:
    """Returns the text embeddings of some sentences, of which at most `size` tokens are read."""
    return network_module(network).apply({"params": params}, *_inputs_at(captions, numbers, size), train=False)


@functools.partial(jax.jit, static_argnames=("config", "size"), donate_argnums=0)
def teach_step(
    state: TrainState,
    captions: CaptionTokens | StateTable,
    numbers: Int[Array, " B"],
    targets: Float[Array, "B E"],
    key: Key[Array, ""],
    *,
    config: TeachingConfig,
    size: int,
) -> tuple[TrainState, Metrics]:
    """Returns the state after one update, and the loss before it.

    The loss is the mean squared distance of the text embeddings from their targets, relative to the targets' norms.

    Args:
        state: Its `params` are those of the network.
        captions: All sentences.
        numbers: Those of the batch.
        targets: The embeddings that they are to get.
        key: For dropout; consumed.
        config: Sizes and optimizer.
        size: Tokens that are read.
    """
    inputs = _inputs_at(captions, numbers, size)
    keys = jax.random.split(key, len(numbers))

    def measure(params: Any) -> tuple[Metrics, dict[str, Any]]:
        found = apply_rows(network_module(config.network), {"params": params}, *inputs, keys=keys)
        errors = jnp.sum((found - targets) ** 2, axis=-1) / jnp.sum(targets**2, axis=-1)
        return {"loss": jnp.mean(errors)}, {}

    return descend(state, measure, config.optimizer)


def teachable_network(bundle: Bundle) -> NetworkConfig:
    """Returns the sizes of a model's network that reads captions.

    Raises:
        UserError: The model has none, as with CLIP.
    """
    network = trained_network(bundle.config.text_encoder)
    if network is None:
        raise UserError("its text encoder was trained by others and stays as it is, so it cannot be taught")
    return network


def teach(
    bundle: Bundle,
    lessons: Sequence[Lesson],
    kept: Sequence[str],
    *,
    held_out: Sequence[Lesson] = (),
    num_steps: int,
    seed: int,
) -> Taught:
    """Returns the model with a network that understands new sentences.

    Args:
        bundle: The model.
        lessons: New sentences.
        kept: Captions that keep their meaning.
        held_out: Sentences that are only measured.
        num_steps: Updates.
        seed: Of variations, batches and dropout.

    Raises:
        UserError: The model has no network that reads captions, as with CLIP, or its weights did not stay finite.
    """
    network = teachable_network(bundle)
    varied = tuple(vary_lessons(lessons, random.Random(f"lessons {seed}")))
    sentences = _read(bundle, network, [text for lesson in (*varied, *held_out) for text in lesson] + list(kept))
    before = jax.device_put(bundle.variables["text_encoder"]["params"])
    embeddings = _embed(before, sentences, np.arange(len(sentences.numbers)))
    # What is not taught keeps its embedding, or the generator would no longer understand it.
    targets = embeddings.copy()
    taught = sentences.find(lesson.sentence for lesson in varied)
    targets[taught] = embeddings[sentences.find(lesson.like for lesson in varied)]
    batches = _draw_batches(sentences, varied, kept, seed=seed)
    after = _train(before, sentences, targets, batches, num_steps=num_steps, seed=seed)

    meanings = tuple(dict.fromkeys(lesson.meaning for lesson in (*lessons, *held_out)))
    answers = [meanings.index(lesson.meaning) for lesson in held_out]
    asked = sentences.find(lesson.sentence for lesson in held_out)
    # Meanings stay where they were, because the generator has learned them there.
    keys = embeddings[sentences.find(meanings)]
    right = [_count_nearest(found, keys, answers) for found in (embeddings[asked], _embed(after, sentences, asked))]
    variables = bundle.variables | {"text_encoder": {"params": jax.device_get(after)}}
    data = with_taught_words(bundle.training_data, lessons)
    return Taught(bundle._replace(variables=variables, training_data=data), *right)


def _read(bundle: Bundle, network: NetworkConfig, sentences: Iterable[str]) -> _Sentences:
    """Returns the sentences as the model's network reads them."""
    texts = tuple(dict.fromkeys(sentences))
    numbers = {text: number for number, text in enumerate(texts)}
    config = bundle.config.text_encoder
    if not isinstance(config, SentenceStatesConfig):
        assert bundle.bpe is not None
        tokens = tokenize_captions(bundle.bpe, texts, max_length=network.max_length)
        return _Sentences(network, jax.device_put(tokens), np.sum(tokens.mask, axis=1), numbers)
    found = dict(SentenceStates(config.encoder, state_dim=config.network.state_dim).read_all(texts))
    stored = StoredStates(np.concatenate(list(found.values())), list(found), list(map(len, found.values())))
    table = table_from_states(stored, texts, max_length=network.max_length)
    lengths = np.minimum(np.asarray(table.lengths)[table.numbers], network.max_length)
    return _Sentences(network, jax.device_put(table), lengths, numbers)


def _embed(params: Any, sentences: _Sentences, numbers: Int[np.ndarray, " B"]) -> Float[np.ndarray, "B E"]:
    """Returns the text embeddings of sentences, those with few tokens first."""
    order = np.argsort(sentences.lengths[numbers], kind="stable")
    embeddings = np.zeros((len(numbers), sentences.network.text_dim), np.float32)
    for first in range(0, len(numbers), EMBEDDED_AT_ONCE):
        places = order[first : first + EMBEDDED_AT_ONCE]
        # The last ones are filled up, because programs are compiled for their shape.
        batch = np.resize(numbers[places], EMBEDDED_AT_ONCE)
        size = sentences.size(int(sentences.lengths[batch].max()))
        found = embed_sentences(params, sentences.captions, batch, network=sentences.network, size=size)
        embeddings[places] = found[: len(places)]
    return embeddings


def _draw_batches(
    sentences: _Sentences, lessons: Sequence[Lesson], kept: Iterable[str], *, seed: int
) -> Iterator[Int[np.ndarray, " B"]]:
    """Yields the sentences of each batch: lessons of about the same length, and as many captions that are not longer.

    Of a meaning with four times as many lessons, twice as many are drawn.
    """
    generator = np.random.default_rng(seed)
    counts = Counter(lesson.meaning for lesson in lessons)
    shares = np.array([counts[lesson.meaning] ** -0.5 for lesson in lessons])
    taught = sentences.find(lesson.sentence for lesson in lessons)
    stay = sentences.find(kept)
    sizes = np.array([sentences.size(length) for length in sentences.lengths[taught].tolist()])
    num_kept = BATCH_SIZE // 2
    while True:
        size = sizes[generator.choice(len(taught), p=shares / shares.sum())]
        fitting = shares * (sizes == size)
        drawn = generator.choice(taught, BATCH_SIZE - num_kept, p=fitting / fitting.sum())
        # A longer caption would need the program of a larger size for the whole batch.
        short = stay[sentences.lengths[stay] <= sentences.lengths[drawn].max()]
        yield np.concatenate([drawn, generator.choice(short, num_kept)]) if len(short) else drawn


def _train(
    params: Any,
    sentences: _Sentences,
    targets: Float[np.ndarray, "M E"],
    batches: Iterator[Int[np.ndarray, " B"]],
    *,
    num_steps: int,
    seed: int,
) -> Any:
    """Returns the parameters after `num_steps` updates."""
    # Few updates hardly overfit, and drawing the masks of dropout would take a third of the time on a CPU.
    network = dataclasses.replace(sentences.network, dropout=0.0)
    config = TeachingConfig(network=network, optimizer=_optimizer(num_steps))
    state = first_state(params, config.optimizer)
    for step in tqdm(range(num_steps), desc="teaching", unit="update", disable=None):
        numbers = next(batches)
        key = jax.random.fold_in(stream_key(seed, "dropout"), step)
        size = sentences.size(int(sentences.lengths[numbers].max()))
        state, _ = teach_step(state, sentences.captions, numbers, targets[numbers], key, config=config, size=size)
    if not all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(state.params)):
        raise UserError("its text network did not stay finite, so nothing was taught; are its weights damaged?")
    return state.params


def _optimizer(num_steps: int) -> OptimizerConfig:
    warmup = min(50, num_steps // 10)
    decay = (warmup, num_steps)
    return OptimizerConfig(learning_rate=3e-4, warmup_steps=warmup, cosine=decay, betas=(0.9, 0.98), clip_norm=1.0)


def _count_nearest(found: Float[np.ndarray, "B E"], meanings: Float[np.ndarray, "K E"], answers: Sequence[int]) -> int:
    """Returns how many embeddings are nearest, by their angle, to that of their own meaning."""
    directions = meanings / np.linalg.norm(meanings, axis=1, keepdims=True)
    return int(np.sum((found @ directions.T).argmax(axis=1) == answers))
