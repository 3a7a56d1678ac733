"""Where the measured motions come from: a model that reads captions, or a tokenizer that reads real motion."""

import dataclasses
import typing
from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Key

from t2m_jax.checkpoints.tokenizer import TrainedTokenizer
from t2m_jax.data.folder import Clip
from t2m_jax.evaluation.codes import MotionCodes, encode_pieces, generate_many
from t2m_jax.evaluation.protocols import Plan, Protocol
from t2m_jax.sampling.pipeline import TextToMotion
from t2m_jax.sampling.strategies import Greedy, Strategy

TEXT_BATCH = 256
"""Captions that the model's text encoder reads together."""


class SourceCodes(NamedTuple):
    """Motions of a source for a plan of N items. The first N are one per item; more follow if variety is measured."""

    codes: MotionCodes
    items: Int[np.ndarray, " G"]
    """The item that each motion is for."""
    numbers: Int[np.ndarray, " G"]
    """Its number among the samples of that item."""


@typing.runtime_checkable
class CodeSource(typing.Protocol):
    """Gives the motions that are measured, as codes of a tokenizer."""

    kind: ClassVar[str]
    """Name of its row in reports."""

    @property
    def tokenizer(self) -> TrainedTokenizer:
        """The tokenizer that decodes the codes."""
        ...

    @property
    def fingerprint(self) -> str:
        """Identifies what is measured: a digest of its weights."""
        ...

    @property
    def sampling(self) -> dict[str, Any]:
        """How codes are chosen: `sampling` and further fields of a report's header."""
        ...

    def make(self, samples: Sequence[Clip], protocol: Protocol, plan: Plan, key: Key[Array, ""]) -> SourceCodes:
        """Returns the motions of one repeat; each depends on the key, its item and its number only."""
        ...


@dataclasses.dataclass(frozen=True)
class Reconstruction:
    """Real motion, encoded and decoded: no generator with this tokenizer can do better."""

    kind: ClassVar[str] = "reconstruction"

    tokenizer: TrainedTokenizer
    """Encodes and decodes."""

    @property
    def fingerprint(self) -> str:
        """Identifies the tokenizer."""
        return self.tokenizer.fingerprint

    @property
    def sampling(self) -> dict[str, Any]:
        """The field of the header: nothing is drawn."""
        return {"sampling": "none"}

    def make(self, samples: Sequence[Clip], protocol: Protocol, plan: Plan, key: Key[Array, ""]) -> SourceCodes:
        """Returns the real motions of the plan; neither protocol nor key is used."""
        del protocol, key
        codes = encode_pieces(self.tokenizer, [samples[owner] for owner in plan.samples], plan.starts, plan.lengths)
        items = np.arange(len(plan.samples))
        return SourceCodes(codes, items, np.zeros_like(items))


@dataclasses.dataclass(frozen=True)
class Generation:
    """Motion that a model generates from captions."""

    kind: ClassVar[str] = "generated"

    model: TextToMotion
    strategy: Strategy
    texts: dict[str, Float[np.ndarray, " E"]]
    """The model's embedding of each caption."""
    guidance_scale: float | None = None
    """Strength of the guidance by the text, None for the model's own."""
    stop_rule: str | None = None
    """When a motion ends, None for the model's own rule."""

    @property
    def tokenizer(self) -> TrainedTokenizer:
        """The model's tokenizer."""
        return self.model.tokenizer

    @property
    def fingerprint(self) -> str:
        """Identifies the model."""
        return self.model.fingerprint

    @property
    def sampling(self) -> dict[str, Any]:
        """The strategy and its numbers as fields of the header."""
        return {
            "sampling": "greedy" if isinstance(self.strategy, Greedy) else "sampled",
            "temperature": getattr(self.strategy, "temperature", None),
            "top_k": getattr(self.strategy, "k", None),
            "top_p": getattr(self.strategy, "p", None),
            "guidance_scale": self.model.parts.guidance_scale(self.guidance_scale),
            "stop_rule": self.stop_rule or self.model.config.generator.stop_rule,
        }

    def make(self, samples: Sequence[Clip], protocol: Protocol, plan: Plan, key: Key[Array, ""]) -> SourceCodes:
        """Returns motions generated from the captions of the plan."""
        captions = [samples[owner].captions[caption].text for owner, caption in zip(*plan[:2], strict=True)]
        items, numbers = measured_samples(plan, protocol)
        text = np.stack([self.texts[caption] for caption in captions])[items]
        keys = sample_keys(key, jnp.asarray(items), jnp.asarray(numbers))
        # Motions may end at once, unlike those that users generate.
        sampling = self.model.parts.sampling(self.strategy, min_codes=0, stop_rule=self.stop_rule)
        codes = generate_many(
            self.model,
            text,
            keys,
            sampling=sampling,
            lengths=plan.lengths[items],
            exact=protocol.generated_length == "real",
            guidance_scale=self.guidance_scale,
        )
        return SourceCodes(codes, items, numbers)


def make_generation(
    model: TextToMotion,
    strategy: Strategy,
    samples: Sequence[Clip],
    *,
    guidance_scale: float | None = None,
    stop_rule: str | None = None,
) -> Generation:
    """Returns the source that generates with a model; the text encoder reads the captions of all samples now."""
    captions = sorted({caption.text for sample in samples for caption in sample.captions})
    texts: dict[str, Float[np.ndarray, " E"]] = {}
    for first in range(0, len(captions), TEXT_BATCH):
        chosen = captions[first : first + TEXT_BATCH]
        texts |= dict(zip(chosen, np.asarray(model.text_encoder(chosen)), strict=True))
    return Generation(model, strategy, texts, guidance_scale, stop_rule)


def measured_samples(plan: Plan, protocol: Protocol) -> tuple[Int[np.ndarray, " G"], Int[np.ndarray, " G"]]:
    """Returns which items to generate motions for, and the number of each motion among the samples of its item.

    Of the samples of a caption, only those that a metric uses are generated. One does not depend on another.
    """
    first = 0 if protocol.first_counts else protocol.samples_per_caption - 1
    others = np.setdiff1d(plan.multimodality_pairs, [first])
    items = np.concatenate([np.arange(len(plan.samples)), np.tile(plan.varied, len(others))])
    return items, np.concatenate([np.full(len(plan.samples), first), np.repeat(others, len(plan.varied))])


@jax.jit
def sample_keys(key: Key[Array, ""], items: Int[Array, " G"], numbers: Int[Array, " G"]) -> Key[Array, " G"]:
    """Returns a key for each sample of each item."""
    return jax.vmap(lambda item, number: jax.random.fold_in(jax.random.fold_in(key, item), number))(items, numbers)
