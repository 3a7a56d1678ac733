"""A loaded model: from text embeddings to codes, and from codes to motions and back."""

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Key

from t2m_jax.checkpoints.bundle import Bundle, part_kinds
from t2m_jax.checkpoints.text_encoder import pretrained_reference, with_encoder_name
from t2m_jax.checkpoints.tokenizer import TrainedTokenizer
from t2m_jax.devices import put_everywhere, put_rows
from t2m_jax.errors import UserError
from t2m_jax.models.projection import restore_kernels
from t2m_jax.models.rows import apply_compiled
from t2m_jax.models.system import make_module
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.normalizer import Normalizer
from t2m_jax.motion.skeleton import skeleton_from_name
from t2m_jax.sampling.batches import fill_up
from t2m_jax.sampling.decode import Codes, decode_motions
from t2m_jax.sampling.loop import Given, SampledCodes, Sampling
from t2m_jax.sampling.programs import (
    begin_motions,
    encode_motion,
    generate_codes,
    generate_row,
    sampling_variables,
)
from t2m_jax.sampling.prompts import Sample
from t2m_jax.sampling.request import SamplingOptions
from t2m_jax.sampling.slots import Slots
from t2m_jax.sampling.stopping import find_stop_rule
from t2m_jax.sampling.text_encoders import StatesTextEncoder, make_text_encoder
from t2m_jax.text.coverage import make_knowledge
from t2m_jax.text.encoder import TextEncoder

SAME_FEATURES = 1e-3
"""Standard deviations by which features differ at most that were decoded from the same codes by another program."""


class ModelParts:
    """The parts of a model on the devices of this process, and what they do with codes."""

    def __init__(self, bundle: Bundle, *, text_encoder: TextEncoder | None = None):
        """Puts the weights on all devices of this process.

        Args:
            bundle: The model.
            text_encoder: Used instead of the model's own; it must give the same embeddings.

        Raises:
            UserError: The model's pretrained text encoder cannot be found; or `bundle` is a name or a path.
        """
        if not isinstance(bundle, Bundle):
            raise UserError(f"{bundle!r} is not a loaded bundle; use t2m_jax.load({str(bundle)!r})")
        self.config = bundle.config
        self.skeleton = skeleton_from_name(bundle.config.skeleton)
        self.text_encoder = text_encoder or make_text_encoder(bundle)
        encoder = self.text_encoder
        embed = encoder.sentence_embeddings if isinstance(encoder, StatesTextEncoder) else None
        self.knowledge = make_knowledge(bundle.training_data, embed)
        self._rest = bundle._replace(variables={})
        self._variables = put_everywhere(bundle.variables)
        self._ready_to_sample = False
        self._normalizer = Normalizer(*map(jnp.asarray, bundle.normalizer))
        self._generator = make_module(self.config.generator)

    @property
    def variables(self) -> dict[str, Any]:
        """The weights of `tokenizer`, `generator` and (if trained with the model) `text_encoder` for `apply`."""
        # The layout for sampling is private: files, `apply` and the fingerprint have that of training.
        return self._variables | {"generator": restore_kernels(self._variables["generator"])}

    @property
    def bundle(self) -> Bundle:
        """The model as files have it."""
        return self._rest._replace(variables=self.variables)

    @property
    def fingerprint(self) -> str:
        """Identifies the model: a digest of sizes, weights, statistics and subwords."""
        config = self.config
        encoder = getattr(self.text_encoder, "fingerprint", None)
        # Where the encoder is does not matter.
        if encoder is not None and pretrained_reference(config.text_encoder) is not None:
            config = dataclasses.replace(config, text_encoder=with_encoder_name(config.text_encoder, encoder))
        return self.bundle._replace(config=config).fingerprint

    def describe(self) -> dict[str, str]:
        """Returns sizes, data, license, source and what the model knows, a line each."""
        kinds = part_kinds(self.config)
        sizes = {kinds[role]: sum(leaf.size for leaf in jax.tree.leaves(tree)) for role, tree in self.variables.items()}
        data = self._rest.training_data or {}
        return {
            "parts": ", ".join(f"{kind} ({size / 1e6:.2f} M numbers)" for kind, size in sizes.items()),
            "motion": f"{self.skeleton.name}, {self.skeleton.fps:g} frames a second",
            "data": f"{data.get('data', 'unknown')} ({data.get('num_clips', 0):,} clips)",
            "license": self._rest.license,
            "source": self._rest.source or "unknown",
            "actions": ", ".join(self.knowledge.actions) or "unknown",
        }

    @property
    def tokenizer(self) -> TrainedTokenizer:
        """The tokenizer with its statistics."""
        return TrainedTokenizer(self.config.tokenizer, self._variables["tokenizer"], self._normalizer)

    def sampling(self, options: SamplingOptions | None = None, *, min_codes: int | None = None) -> Sampling:
        """Returns how codes are sampled with some options; `min_codes` is by default the model's own.

        Raises:
            UserError: The length or the stop rule does not fit the model.
        """
        options = options or SamplingOptions()
        longest = self.config.generator.max_codes
        shortest = self._rest.min_codes if min_codes is None else min_codes
        if options.max_codes is not None and not 1 <= options.max_codes <= longest:
            raise UserError(f"max-codes: {options.max_codes} is not between 1 and {longest}")
        rule = find_stop_rule(self.config.generator, options.stop_rule)
        most = options.max_codes or longest
        return Sampling(options.make_strategy(), rule, most, min(shortest, most))

    def guidance_scale(self, given: float | None = None) -> float | None:
        """Returns the strength of the classifier-free guidance: as given, or the model's own; None for none."""
        return self.config.generator.guidance_scale if given is None else given

    def _guidance(self, given: float | None) -> Float[Array, ""] | None:
        """Returns the scale for the generator."""
        scale = self.guidance_scale(given)
        # A scale of 1 changes nothing, so the second half of the batch, without text, is not computed.
        return None if scale is None or scale == 1 else jnp.asarray(scale, jnp.float32)

    def sample_codes(
        self,
        text_embedding: Float[Array, "B E"],
        keys: Key[Array, " B"],
        sampling: Sampling,
        *,
        guidance_scale: float | None = None,
        given: Given | None = None,
    ) -> SampledCodes:
        """Returns codes for text embeddings of `text_encoder`, one key per motion (consumed)."""
        scale = self._guidance(guidance_scale)
        # Data parallelism: the motions of a batch are divided among the devices, and do not depend on each other.
        text_embedding, keys, given = put_rows((text_embedding, keys, given))
        variables = self._variables_for_sampling()
        return generate_codes(
            variables, text_embedding, keys, scale, given, generator=self._generator, sampling=sampling
        )

    def sample_rows(
        self, text_embedding: Float[Array, "1 E"], key: Key[Array, ""], sampling: Sampling, guidance_scale: float | None
    ) -> Iterator[tuple[Codes, bool]]:
        """Yields each row of codes of one motion as soon as it is sampled, [1, R], and whether it is the last.

        The row that a stop rule does not keep has no codes, [0, R].
        """
        variables = self._variables_for_sampling()
        keys = put_everywhere(key[None])
        # One call for each row and not one for all (as `sample_codes`), so that a row can be shown at once.
        state = begin_motions(variables, text_embedding, self._guidance(guidance_scale), generator=self._generator)
        for number in range(1, sampling.max_codes + 1):
            state, row = generate_row(variables, state, keys, generator=self._generator, sampling=sampling)
            ended = bool(state.done[0])
            # A stop rule ends a motion with a row (HiFiGPT) or with the token End in place of a row (T2M-GPT).
            kept = not ended or sampling.stop_rule.keeps_last
            yield np.asarray(row)[: int(kept)], ended or number == sampling.max_codes
            if ended:
                return

    def slots(self, num_slots: int, sampling: Sampling, *, guidance_scale: float | None = None) -> Slots:
        """Returns slots, for motions that begin and end at any time."""
        return Slots(
            self._variables_for_sampling(),
            self._generator,
            num_slots=num_slots,
            num_quantizers=self.config.tokenizer.num_quantizers,
            sampling=sampling,
            guidance_scale=self._guidance(guidance_scale),
        )

    def log_likelihood(self, codes: Int[Array, "B N R"], text_embedding: Float[Array, "B E"]) -> Float[Array, "B N"]:
        """Returns the logarithm of the probability of each row of codes after its text and the rows before it.

        Guidance is not used.
        """
        # Teacher forcing: all rows are known, so they are read at once, and not one after the other.
        variables = self._variables_for_sampling()
        inputs = put_rows((codes, text_embedding))
        return apply_compiled(variables, *inputs, module=self._generator, method="log_likelihood")

    def _variables_for_sampling(self) -> dict[str, Any]:
        """Returns the generator's variables, rearranged at the first call; the old arrangement is not kept."""
        if not self._ready_to_sample:
            generator = sampling_variables(self._variables["generator"], self.config.generator)
            # A new dictionary, because another thread may be in this function, too. Both make the same variables.
            self._variables = self._variables | {"generator": generator}
            self._ready_to_sample = True
        return self._variables["generator"]

    def encode(self, motion: Motion) -> Int[np.ndarray, "N R"]:
        """Returns the codes of a motion, see `TextToMotion.encode`."""
        own = self._own_codes(motion)
        return encode_motion(self.tokenizer, motion, self.skeleton) if own is None else own

    def _own_codes(self, motion: Motion) -> Codes | None:
        """Returns the codes that a motion was decoded from, None if it is not as this model decodes them."""
        config = self.config.tokenizer
        if motion.codes is None or motion.features is None or motion.skeleton != self.skeleton:
            return None
        codes = np.asarray(motion.codes, np.int32)
        if codes.ndim == 1:
            codes = codes[:, None]
        shape = (len(motion.features) / config.downsample, config.num_quantizers)
        if not codes.size or codes.shape != shape or not ((codes >= 0) & (codes < config.num_codes)).all():
            return None
        # Codes of another model mean something else, and a motion of several pieces is not decoded as a whole.
        (decoded,) = decode_motions(self.tokenizer, [codes], skeleton=self.skeleton, clean=False)
        assert decoded.features is not None
        if motion.features.shape != decoded.features.shape:
            return None
        apart = np.abs(decoded.features - motion.features) / np.asarray(self.tokenizer.normalizer.std)
        return codes if (apart <= SAME_FEATURES).all() else None

    def decode(self, codes: Int[np.ndarray, "N ..."], *, caption: str = "", raw: bool = False) -> Motion:
        """Returns the motion of codes, see `TextToMotion.decode`."""
        config = self.config.tokenizer
        codes = np.asarray(codes, np.int32)
        if codes.ndim == 1:
            codes = codes[:, None]
        if codes.ndim != 2 or not len(codes) or not 1 <= codes.shape[1] <= config.num_quantizers:
            raise UserError(f"codes: expected rows of {config.num_quantizers} codes (or fewer), at least one row")
        if codes.min() < 0 or codes.max() >= config.num_codes:
            raise UserError(f"codes: must be between 0 and {config.num_codes - 1}")
        (motion,) = decode_motions(self.tokenizer, [codes], skeleton=self.skeleton, clean=not raw)
        return dataclasses.replace(motion, caption=caption, seed=0)

    def make_samples(self, samples: Sequence[Sample], sampling: Sampling, options: SamplingOptions) -> list[Motion]:
        """Returns the motions of samples that are made together."""
        filled = fill_up(samples)
        texts = self.text_encoder([sample.prompt.read for sample in filled])
        keys = jnp.stack([sample.key for sample in filled])
        sampled = self.sample_codes(texts, keys, sampling, guidance_scale=options.guidance_scale)
        ends = np.asarray(sampled.code_lengths)
        codes = [rows[:end] for rows, end in zip(np.asarray(sampled.codes), ends, strict=True)][: len(samples)]
        sizes = {"size": sampling.max_codes, "batch": len(filled)}
        return self.decode_samples(samples, codes, clean=not options.raw, **sizes)

    def decode_samples(
        self, samples: Sequence[Sample], codes: Sequence[Codes], *, size: int, batch: int, clean: bool
    ) -> list[Motion]:
        """Returns the motions of samples from their codes; `size` and `batch` are those of `pad_codes`."""
        motions = decode_motions(self.tokenizer, codes, skeleton=self.skeleton, size=size, batch=batch, clean=clean)
        return [
            dataclasses.replace(
                motion,
                caption=sample.prompt.text,
                seed=sample.seed,
                warning=sample.prompt.warning,
                unknown_words=sample.prompt.unknown_words,
            )
            for motion, sample in zip(motions, samples, strict=True)
        ]
