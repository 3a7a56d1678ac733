"""Where the measured motions come from: a model that reads captions, or a tokenizer that reads real motion."""

import dataclasses
from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Key

from t2m_jax.checkpoints.tokenizer import TrainedTokenizer
from t2m_jax.data.folder import Clip
from t2m_jax.errors import UserError
from t2m_jax.evaluation.protocols import Plan, Protocol
from t2m_jax.sampling.batches import batches_of, for_each_batch
from t2m_jax.sampling.decode import pad_codes
from t2m_jax.sampling.loop import CHUNK, Sampling
from t2m_jax.sampling.pipeline import TextToMotion
from t2m_jax.sampling.programs import encode_motions
from t2m_jax.sampling.request import SamplingOptions
from t2m_jax.sampling.strategies import Greedy

TEXT_BATCH = 256
"""Captions that the model's text encoder reads together."""
BATCH = 128
"""Motions that are generated together."""
EMPTY_CODE = 1
"""The only code of a motion that ends at once, as in T2M-GPT's code."""
MARGIN = 4
"""Rows that a motion may have beyond its expected length before it is generated again."""


class MotionCodes(NamedTuple):
    """Codes of many motions, 0 after their ends."""

    codes: Int[np.ndarray, "B N R"]
    code_lengths: Int[np.ndarray, " B"]
    """Rows of each motion."""

    @property
    def rows(self) -> list[Int[np.ndarray, "_ R"]]:
        """The rows of each motion."""
        return [codes[:length] for codes, length in zip(self.codes, self.code_lengths, strict=True)]

    def count_codes(self, num_codes: int) -> Int[np.ndarray, " K"]:
        """Returns how often each code was used, in all rows and depths."""
        used = np.arange(self.codes.shape[1])[None] < self.code_lengths[:, None]
        return np.bincount(self.codes[used].ravel(), minlength=num_codes)


class SourceCodes(NamedTuple):
    """Motions of a source for a plan of N items. The first N are one per item; more follow if variety is measured."""

    codes: MotionCodes
    items: Int[np.ndarray, " G"]
    """The item that each motion is for."""
    numbers: Int[np.ndarray, " G"]
    """Its number among the samples of that item."""


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
        """Returns the real motions of the plan, as `Generation.make` does; neither protocol nor key is used."""
        del protocol, key
        codes = encode_pieces(self.tokenizer, plan.pieces(samples))
        items = np.arange(len(plan.samples))
        return SourceCodes(codes, items, np.zeros_like(items))


@dataclasses.dataclass(frozen=True)
class Generation:
    """Motion that a model generates from captions."""

    kind: ClassVar[str] = "generated"

    model: TextToMotion
    options: SamplingOptions
    """How codes are chosen; motion is measured as decoded, so `raw` changes nothing."""
    texts: dict[str, Float[np.ndarray, " E"]]
    """The model's embedding of each caption."""

    @property
    def tokenizer(self) -> TrainedTokenizer:
        """The model's tokenizer."""
        return self.model.tokenizer

    @property
    def fingerprint(self) -> str:
        """Identifies the model: a digest of its weights."""
        return self.model.fingerprint

    @property
    def sampling(self) -> dict[str, Any]:
        """The options as fields of the header."""
        options = self.options
        is_greedy = isinstance(options.make_strategy(), Greedy)
        # A strategy that somebody else wrote may have no temperature, and the likeliest code needs none.
        has_temperature = options.strategy is None and not is_greedy
        return {
            "sampling": "greedy" if is_greedy else "sampled",
            "temperature": options.temperature if has_temperature else None,
            "top_k": options.top_k,
            "top_p": options.top_p,
            "guidance_scale": self.model.parts.guidance_scale(options.guidance_scale),
            "stop_rule": options.stop_rule or self.model.config.generator.stop_rule,
        }

    def make(self, samples: Sequence[Clip], protocol: Protocol, plan: Plan, key: Key[Array, ""]) -> SourceCodes:
        """Returns motions generated from the captions of the plan; each depends on the key, its item and its number."""
        items, numbers = measured_samples(plan, protocol)
        text = np.stack([self.texts[caption.text] for caption in plan.chosen_captions(samples)])[items]
        keys = sample_keys(key, jnp.asarray(items), jnp.asarray(numbers))
        # Motions may end at once, unlike those that users generate.
        options = self.options
        sampling = self.model.parts.sampling(options, min_codes=0)
        codes = generate_many(
            self.model,
            text,
            keys,
            sampling=sampling,
            lengths=plan.lengths[items],
            exact=protocol.generated_length == "real",
            guidance_scale=options.guidance_scale,
        )
        return SourceCodes(codes, items, numbers)


CodeSource = Generation | Reconstruction
"""Gives the motions that are measured, as codes of a tokenizer."""


def make_generation(
    model: TextToMotion, samples: Sequence[Clip], *, options: SamplingOptions | None = None
) -> Generation:
    """Returns the source that generates with a model; the text encoder reads the captions of all samples now.

    Raises:
        UserError: The options say the longest motion, which the protocol decides.
    """
    if options is not None and options.max_codes is not None:
        raise UserError("max-codes: the protocol of an evaluation says how long motions are; leave it out")
    # Clips share captions. Sorted, the batches do not depend on the order of the clips.
    captions = sorted({caption.text for sample in samples for caption in sample.captions})
    texts: dict[str, Float[np.ndarray, " E"]] = {}
    for first in range(0, len(captions), TEXT_BATCH):
        chosen = captions[first : first + TEXT_BATCH]
        texts |= dict(zip(chosen, np.asarray(model.text_encoder(chosen)), strict=True))
    return Generation(model, options or SamplingOptions(), texts)


def generate_many(
    model: TextToMotion,
    text_embedding: Float[np.ndarray, "B E"],
    keys: Key[Array, " B"],
    *,
    sampling: Sampling,
    lengths: Int[np.ndarray, " B"],
    exact: bool = False,
    guidance_scale: float | None = None,
) -> MotionCodes:
    """Returns the codes of one motion per text, at least one row each.

    A batch takes as long as its longest motion. So motions of similar expected length are generated together, up to a
    little more than that length. Those that have not ended by then are generated again, up to the longest length. A
    motion depends on its text and key only, so the second attempt begins like the first.

    Args:
        model: The model.
        text_embedding: One text per motion.
        keys: One key per motion [B]; consumed.
        sampling: How to choose codes; its `max_codes` is the longest motion.
        lengths: Expected frames, such as those of the real motion. They change the time that it takes, not the result.
        exact: Whether each motion gets as many rows as fit into `lengths`; the model does not end it.
        guidance_scale: Strength of the guidance, None for none.
    """
    longest = sampling.max_codes
    expected = lengths // model.config.tokenizer.downsample
    codes = np.zeros((len(expected), longest, model.config.tokenizer.num_quantizers), np.int32)
    code_lengths = np.zeros(len(expected), np.int32)
    # The loop runs in chunks, so the rest of a chunk costs nothing.
    limits = np.minimum(-(-(expected + MARGIN) // CHUNK) * CHUNK, longest)
    # The model must not end a motion early; what it makes beyond the real length is cut below.
    if exact:
        sampling = sampling._replace(min_codes=longest)
    # A first attempt with a shorter limit pays only if most motions end by themselves.
    if exact or not sampling.stop_rule.ends_early:
        limits = np.full_like(limits, longest)

    def generate(chosen: Int[np.ndarray, " C"]) -> None:
        # The batch takes as long as its longest motion anyway, so the others may be as long.
        limits[chosen] = limit = int(limits[chosen].max())
        limited = sampling._replace(max_codes=limit)
        text = jnp.asarray(text_embedding[chosen])
        sampled = model.parts.sample_codes(text, keys[chosen], limited, guidance_scale=guidance_scale)
        codes[chosen, :limit] = sampled.codes
        code_lengths[chosen] = sampled.code_lengths

    for_each_batch(generate, batches_of(np.argsort(limits, kind="stable"), BATCH))
    unfinished = np.flatnonzero((code_lengths == limits) & (limits < longest))
    limits[unfinished] = longest
    for_each_batch(generate, batches_of(unfinished, BATCH))
    codes[code_lengths == 0, 0] = EMPTY_CODE
    code_lengths = np.clip(expected if exact else code_lengths, 1, longest).astype(np.int32)
    codes[np.arange(longest)[None] >= code_lengths[:, None]] = 0
    return MotionCodes(codes, code_lengths)


def encode_pieces(tokenizer: TrainedTokenizer, pieces: Sequence[Float[np.ndarray, "_ D"]]) -> MotionCodes:
    """Returns the codes of real motions (raw features)."""
    return MotionCodes(*pad_codes(encode_motions(tokenizer, pieces, progress=False)))


def measured_samples(plan: Plan, protocol: Protocol) -> tuple[Int[np.ndarray, " G"], Int[np.ndarray, " G"]]:
    """Returns which items to generate motions for, and the number of each motion among the samples of its item.

    Of the samples of a caption, only those that a metric uses are generated. One does not depend on another.
    """
    # T2M-GPT's code measures the first of the samples, MoMask's the last.
    first = 0 if protocol.first_counts else protocol.samples_per_caption - 1
    others = np.setdiff1d(plan.multimodality_pairs, [first])
    items = np.concatenate([np.arange(len(plan.samples)), np.tile(plan.varied, len(others))])
    return items, np.concatenate([np.full(len(plan.samples), first), np.repeat(others, len(plan.varied))])


@jax.jit
def sample_keys(key: Key[Array, ""], items: Int[Array, " G"], numbers: Int[Array, " G"]) -> Key[Array, " G"]:
    """Returns a key for each sample of each item."""
    # One after the other, so that no two pairs of item and number share a key.
    return jax.vmap(lambda item, number: jax.random.fold_in(jax.random.fold_in(key, item), number))(items, numbers)
