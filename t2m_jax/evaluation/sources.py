"""Who makes the motions that are measured: a model from captions, or its VQ-VAE from the real ones."""

import typing
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Key

from t2m_jax.checkpoints.vqvae import TrainedVqVae
from t2m_jax.data.folder import Clip
from t2m_jax.evaluation.codes import MotionCodes, encode_pieces, generate_at_length, generate_many
from t2m_jax.evaluation.protocols import SAMPLES_A_CAPTION, Plan, Protocol
from t2m_jax.sampling.pipeline import TextToMotion
from t2m_jax.sampling.strategies import Strategy

TEXT_BATCH = 256


class Made(NamedTuple):
    """Motions made for a plan; the first N stand for its N items, more follow where variety is measured."""

    codes: MotionCodes
    items: Int[np.ndarray, " G"]
    """Which of the plan's items each is for."""
    numbers: Int[np.ndarray, " G"]
    """Its number among the samples of that item."""


@typing.runtime_checkable
class Maker(typing.Protocol):
    """Makes motions for a plan, as codes of a VQ-VAE."""

    @property
    def row(self) -> str:
        """What its row is called in reports."""
        ...

    @property
    def vqvae(self) -> TrainedVqVae:
        """Decodes what it makes."""
        ...

    def make(self, samples: Sequence[Clip], protocol: Protocol, plan: Plan, key: Key[Array, ""]) -> Made:
        """Returns the motions of one repeat; each depends on key, item and number alone."""
        ...


class Reconstruction(NamedTuple):
    """Real motion through a VQ-VAE: what no model on top of it can surpass."""

    vqvae: TrainedVqVae

    @property
    def row(self) -> str:
        """What its row is called in reports."""
        return "reconstruction"

    def make(self, samples: Sequence[Clip], protocol: Protocol, plan: Plan, key: Key[Array, ""]) -> Made:
        """Returns the plan's real motions as codes; nothing is drawn."""
        del protocol, key
        codes = encode_pieces(self.vqvae, [samples[owner] for owner in plan.samples], plan.starts, plan.lengths)
        items = np.arange(len(plan.samples))
        return Made(codes, items, np.zeros_like(items))


class Generation(NamedTuple):
    """Motion generated from captions."""

    model: TextToMotion
    strategy: Strategy
    texts: dict[str, Float[np.ndarray, " E"]]
    """Caption -> the model's embedding."""

    @property
    def row(self) -> str:
        """What its row is called in reports."""
        return "generated"

    @property
    def vqvae(self) -> TrainedVqVae:
        """Decodes what it makes."""
        return TrainedVqVae(self.model.config.vqvae, self.model.variables["vqvae"], self.model.normalizer)

    def make(self, samples: Sequence[Clip], protocol: Protocol, plan: Plan, key: Key[Array, ""]) -> Made:
        """Returns motions generated from the plan's captions."""
        captions = [samples[owner].captions[caption].text for owner, caption in zip(*plan[:2], strict=True)]
        items, numbers = samples_that_count(plan, protocol)
        text = np.stack([self.texts[caption] for caption in captions])[items]
        keys = sample_keys(key, jnp.asarray(items), jnp.asarray(numbers))
        lengths = plan.lengths[items]
        if protocol.generated_length == "real":
            codes = generate_at_length(self.model, text, keys, strategy=self.strategy, lengths=lengths)
        else:
            codes = generate_many(self.model, text, keys, strategy=self.strategy, expected=lengths)
        return Made(codes, items, numbers)


def make_generation(model: TextToMotion, strategy: Strategy, samples: Sequence[Clip]) -> Generation:
    """Returns the maker that draws motions of a model; the captions of all samples are read at once."""
    captions = sorted({caption.text for sample in samples for caption in sample.captions})
    texts: dict[str, Float[np.ndarray, " E"]] = {}
    for first in range(0, len(captions), TEXT_BATCH):
        chosen = captions[first : first + TEXT_BATCH]
        texts |= dict(zip(chosen, np.asarray(model.text_encoder(chosen)), strict=True))
    return Generation(model, strategy, texts)


def samples_that_count(plan: Plan, protocol: Protocol) -> tuple[Int[np.ndarray, " G"], Int[np.ndarray, " G"]]:
    """Returns which items to generate for, and the number of each sample among those of its item.

    Of the 30 samples of a caption only those are made that a metric looks at: one does not depend on another.
    """
    standing = 0 if protocol.first_counts else SAMPLES_A_CAPTION - 1
    looked_at = np.union1d(plan.multimodality_pairs.ravel(), [standing])
    items = [np.arange(len(plan.samples)), *(plan.varied for number in looked_at if number != standing)]
    numbers = [standing, *(number for number in looked_at if number != standing)]
    sizes = [len(rows) for rows in items]
    return np.concatenate(items), np.repeat(numbers, sizes)


@jax.jit
def sample_keys(key: Key[Array, ""], items: Int[Array, " G"], numbers: Int[Array, " G"]) -> Key[Array, " G"]:
    """Returns a key for each sample of each item."""
    return jax.vmap(lambda item, number: jax.random.fold_in(jax.random.fold_in(key, item), number))(items, numbers)
