"""From sentences to motions: text encoder, generator, tokenizer and skeleton in one object."""

import dataclasses
import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Int

from t2m_jax.checkpoints.bundle import Bundle, part_kinds
from t2m_jax.checkpoints.model import load_model
from t2m_jax.checkpoints.tokenizer import TrainedTokenizer
from t2m_jax.errors import UserError
from t2m_jax.motion.motion import Motion
from t2m_jax.sampling.batches import padded_batch_size
from t2m_jax.sampling.compilation import use_compilation_cache
from t2m_jax.sampling.decode import GrowingMotion, split_rows
from t2m_jax.sampling.inbetween import redo, vary
from t2m_jax.sampling.loop import Sampling
from t2m_jax.sampling.model import ModelParts
from t2m_jax.sampling.prompts import MAX_BATCH, Prompt, Sample, read_prompts
from t2m_jax.sampling.request import MotionRequest, SamplingOptions, sentences
from t2m_jax.sampling.timeline import make_chain, make_chain_pieces
from t2m_jax.text.encoder import TextEncoder

OnProgress = Callable[[int, int], None]
"""Called with the number of motions that are ready and the number of all, after each batch."""


class TextToMotion:
    """A loaded model: `TextToMotion.load("demo").generate(["a person walks forward"])`.

    `make` and `make_pieces` take a `MotionRequest`, and the other methods are short ways to them. Their `**options` are
    the fields of `SamplingOptions`: how codes are chosen, when motions end, and whether they are cleaned.
    """

    def __init__(self, bundle: Bundle, *, text_encoder: TextEncoder | None = None):
        """Puts the weights on all devices of this process.

        Args:
            bundle: The model.
            text_encoder: Used instead of the model's own; it must give the same embeddings.

        Raises:
            UserError: The model's pretrained text encoder cannot be found; or `bundle` is a name or a path.
        """
        self.parts = ModelParts(bundle, text_encoder=text_encoder)
        self.config = self.parts.config
        self.skeleton = self.parts.skeleton
        self.text_encoder = self.parts.text_encoder
        self.knowledge = self.parts.knowledge
        self.training_data = bundle.training_data
        self.license = bundle.license
        self.source = bundle.source

    @classmethod
    def load(cls, name_or_path: str | Path) -> "TextToMotion":
        """Returns a model by bundled name ("demo"), bundle folder or run directory; turns on the compilation cache.

        Raises:
            UserError: There is no such model, or it is damaged.
        """
        use_compilation_cache()
        return cls(load_model(name_or_path))

    def __repr__(self) -> str:
        """Returns sizes, data, license, source and what the model knows, in some lines."""
        kinds = part_kinds(self.config)
        sizes = {kinds[role]: sum(leaf.size for leaf in jax.tree.leaves(tree)) for role, tree in self.variables.items()}
        data = self.training_data or {}
        lines = {
            "parts": ", ".join(f"{kind} ({size / 1e6:.2f} M numbers)" for kind, size in sizes.items()),
            "motion": f"{self.skeleton.name}, {self.skeleton.fps:g} frames a second",
            "data": f"{data.get('data', 'unknown')} ({data.get('num_clips', 0):,} clips)",
            "license": self.license,
            "source": self.source or "unknown",
            "actions": ", ".join(self.knowledge.actions) or "unknown",
        }
        return "\n".join([f"{type(self).__name__}:", *(f"  {name}: {line}" for name, line in lines.items())])

    @property
    def variables(self) -> dict[str, Any]:
        """The weights of `tokenizer`, `generator` and (if trained with the model) `text_encoder` for `apply`."""
        return self.parts.variables

    @property
    def fingerprint(self) -> str:
        """Identifies the model: a digest of sizes, weights, statistics and subwords."""
        return self.parts.fingerprint

    @property
    def tokenizer(self) -> TrainedTokenizer:
        """The tokenizer with its statistics."""
        return self.parts.tokenizer

    def encode(self, motion: Motion) -> Int[np.ndarray, "N R"]:
        """Returns the codes of a motion. Frames at its end that do not fill a code are left out.

        Raises:
            UserError: It has another skeleton than the model's, or is too short for a code.
        """
        return self.parts.encode(motion)

    def decode(self, codes: Int[np.ndarray, "N ..."], *, caption: str = "", raw: bool = False) -> Motion:
        """Returns the motion of codes [N, R]; the last axis may be left out if there is one code per row.

        With fewer than R codes per row, those of the first depths, the motion is coarser. It is cleaned as by
        `generate`, unless `raw`.

        Raises:
            UserError: There are no codes, too many per row, or one that is not in the codebook.
        """
        return self.parts.decode(codes, caption=caption, raw=raw)

    def make(self, *requests: MotionRequest, on_progress: OnProgress | None = None) -> Iterator[Motion]:
        """Returns an iterator over the motions of requests, request by request.

        Requests of one sentence that have the same options are sampled together. A motion depends on its request and
        its number among the samples, but not on the other motions.

        Args:
            *requests: What is asked for.
            on_progress: Called with the number of motions that are ready and the number of all, after each batch.

        Warns:
            PromptWarning: The model cannot know what a sentence asks for. The motions say so, too.

        Raises:
            UserError: A request does not fit the model, such as a motion of another skeleton.
        """
        captions = [caption for request in requests for caption in request.captions]
        prompts = iter(read_prompts(captions, self.knowledge, self.text_encoder))
        read = [(request, list(itertools.islice(prompts, len(request.captions)))) for request in requests]
        # Only requests that follow each other are put together, so that motions come in the order of requests.
        groups = itertools.groupby(read, key=lambda pair: (pair[0].is_plain, pair[0].options))
        # A list, so that options are checked now, and not when the first motion is taken.
        batches = [self._make_group(list(group), self._sampling(options)) for (_, options), group in groups]
        total = sum(request.num_samples for request in requests)
        return _unpack(itertools.chain.from_iterable(batches), total, on_progress)

    def _make_group(
        self, group: Sequence[tuple[MotionRequest, Sequence[Prompt]]], sampling: Sampling
    ) -> Iterator[list[Motion]]:
        """Yields the motions of requests with the same options in batches. This is where their kinds are told apart."""
        if group[0][0].is_plain:
            yield from self._make_together(group, sampling)
            return
        for request, prompts in group:
            if request.span is not None:
                yield redo(self.parts, request, prompts[0], sampling)
            elif request.strength is not None:
                yield from vary(self.parts, request, prompts[0], sampling)
            else:
                yield from make_chain(self.parts, request, prompts, sampling)

    def _make_together(
        self, group: Sequence[tuple[MotionRequest, Sequence[Prompt]]], sampling: Sampling
    ) -> Iterator[list[Motion]]:
        """Yields the motions of plain requests in batches."""
        options = group[0][0].options
        samples = (
            Sample(prompt, request.seed, number)
            for request, (prompt,) in group
            for number in range(request.num_samples)
        )
        while batch := list(itertools.islice(samples, MAX_BATCH)):
            # A power of two, so that few programs are compiled.
            filled = [*batch, *[batch[0]] * (padded_batch_size(len(batch)) - len(batch))]
            embedding = self.text_encoder([sample.prompt.text for sample in filled])
            keys = jnp.stack([sample.key for sample in filled])
            sampled = self.parts.sample_codes(embedding, keys, sampling, guidance_scale=options.guidance_scale)
            lengths = np.asarray(sampled.code_lengths)
            rows = np.asarray(sampled.codes)
            codes = [rows[number, : lengths[number]] for number in range(len(batch))]
            yield self.parts.decode_samples(
                batch, codes, size=sampling.max_codes, batch=len(filled), clean=not options.raw
            )

    def _sampling(self, options: SamplingOptions) -> Sampling:
        strategy = options.make_strategy()
        return self.parts.sampling(strategy, max_codes=options.max_codes, stop_rule=options.stop_rule)

    def make_pieces(self, request: MotionRequest, *, sample: int = 0) -> Iterator[Motion]:
        """Returns an iterator over the motion of a request while it is generated.

        Each piece goes on where the one before it ends. Pieces are as decoded, because a clean-up needs the whole
        motion: together they are the motion that `make` returns with `raw=True`. Of a request of one sentence, there is
        a piece for each row of codes, as soon as its frames are final. They also depend on some rows after them (see
        `TokenizerConfig.decoder_context`), so the last pieces come together. Of a longer request, pieces have some
        seconds, and say which sentences begin in them; it needs hardly more memory for a longer motion.

        Args:
            request: What is asked for; not a change of a motion.
            sample: Number of the motion among the samples of a request of one sentence.

        Warns:
            PromptWarning: The model cannot know what a sentence asks for.

        Raises:
            UserError: The request does not fit the model, or it cannot be made in pieces.
        """
        if request.span is not None or request.strength is not None:
            raise UserError("stream: a change of a motion has no pieces; use make")
        options = request.options
        sampling = self._sampling(options)
        prompts = read_prompts(request.captions, self.knowledge, self.text_encoder)
        if not request.is_plain:
            return make_chain_pieces(self.parts, request, prompts, sampling)
        # The rule of the highest score cuts a motion when all rows are known, and then nothing is left to stream.
        if not sampling.stop_rule.ends_early:
            if options.stop_rule is not None:
                raise UserError(f"stop-rule: {options.stop_rule!r} needs all rows first; use threshold for a stream")
            sampling = self._sampling(dataclasses.replace(options, stop_rule="threshold"))
        return self._make_rows(Sample(prompts[0], request.seed, sample), sampling, options.guidance_scale)

    def _make_rows(self, sample: Sample, sampling: Sampling, guidance_scale: float | None) -> Iterator[Motion]:
        """Yields the motion of each row of codes of a sample when it is final."""
        text = sample.prompt.text
        growing = GrowingMotion(self.tokenizer, skeleton=self.skeleton, step=1, max_codes=sampling.max_codes)
        rows = self.parts.sample_rows(self.text_encoder([text]), sample.key, sampling, guidance_scale)
        for row, ended in rows:
            motion = growing.add(row, ended=ended)
            if motion is not None:
                yield from split_rows(dataclasses.replace(motion, caption=text, seed=sample.seed))

    def generate(
        self,
        captions: Sequence[str] | str,
        *,
        seed: int = 0,
        num_samples: int = 1,
        on_progress: OnProgress | None = None,
        **options: Any,
    ) -> list[Motion]:
        """Returns `num_samples` motions for each caption, caption by caption.

        Args:
            captions: Sentences, or a single one.
            seed: From 0 to 2**32 - 1.
            num_samples: Motions per caption.
            on_progress: As in `make`.
            **options: Of `SamplingOptions`, such as `temperature=0.7`.

        Warns:
            PromptWarning: The model cannot know what a caption asks for. The motions say so, too.

        Raises:
            UserError: A caption or a number cannot be used.
        """
        return list(
            self.generate_each(captions, seed=seed, num_samples=num_samples, on_progress=on_progress, **options)
        )

    def generate_each(
        self,
        captions: Sequence[str] | str,
        *,
        seed: int = 0,
        num_samples: int = 1,
        on_progress: OnProgress | None = None,
        **options: Any,
    ) -> Iterator[Motion]:
        """Returns an iterator over the motions of `generate`, for more of them than fit into the memory.

        Arguments and errors are those of `generate`.
        """
        sampling = SamplingOptions(**options)
        requests = [
            MotionRequest(captions=(caption,), seed=seed, num_samples=num_samples, options=sampling)
            for caption in sentences(captions)
        ]
        return self.make(*requests, on_progress=on_progress)

    def generate_chain(
        self,
        captions: Sequence[str],
        *,
        start: Motion | None = None,
        seconds: float | int | None = None,
        seed: int = 0,
        num_samples: int = 1,
        **options: Any,
    ) -> list[Motion]:
        """Returns motions that show sentences in turn, of any length.

        Each sentence is sampled as if it were alone, and fades into the next. Only the first one goes on from the last
        codes of `start`. The motions say where each begins (`part_starts`, `part_captions`).

        Args:
            captions: Sentences in turn.
            start: A motion that the first sentence goes on from. It is part of the result, as the tokenizer gives it
                back.
            seconds: Length for each sentence, rounded to whole rows of codes; by default the model decides.
            seed: From 0 to 2**32 - 1.
            num_samples: Motions to return.
            **options: Of `SamplingOptions`.

        Warns:
            PromptWarning: The model cannot know what a sentence asks for.

        Raises:
            UserError: A sentence or a number cannot be used, or `start` is too short or has another skeleton.
        """
        request = MotionRequest(
            captions=sentences(captions),
            start=start,
            seconds=None if seconds is None else float(seconds),
            seed=seed,
            num_samples=num_samples,
            options=SamplingOptions(**options),
        )
        motions = list(self.make(request))
        # A single sentence is not sampled as a chain, but says the same.
        if request.is_plain:
            motions = [
                dataclasses.replace(motion, part_starts=(0,), part_captions=request.captions) for motion in motions
            ]
        return motions

    def redo(
        self,
        motion: Motion,
        span: tuple[float, float],
        caption: str,
        *,
        seed: int = 0,
        num_samples: int = 1,
        num_candidates: int = MotionRequest.candidates,
        **options: Any,
    ) -> list[Motion]:
        """Returns a motion with another middle, which a sentence describes. Head and tail stay as they are.

        Several middles are sampled after the head. Those come first after which the tail is likely, and that jump
        least to it. The tail is turned and moved to where the middle ends. The motion has the model's frame rate.

        Args:
            motion: Any motion of the model's skeleton.
            span: Begin and end of the middle in seconds, rounded to whole rows of codes.
            caption: What happens in the middle.
            seed: From 0 to 2**32 - 1.
            num_samples: Motions to return, the best ones first.
            num_candidates: Middles to choose them from.
            **options: Of `SamplingOptions`; `raw` leaves the middle as decoded.

        Warns:
            PromptWarning: The model cannot know what the sentence asks for.

        Raises:
            UserError: The sentence, the span or a number cannot be used, or the motion is too short or has another
                skeleton.
        """
        request = MotionRequest(
            captions=(caption,),
            start=motion,
            span=span,
            seed=seed,
            num_samples=num_samples,
            candidates=num_candidates,
            options=SamplingOptions(**options),
        )
        return list(self.make(request))

    def vary(
        self,
        motion: Motion,
        strength: float | int,
        caption: str | None = None,
        *,
        seed: int = 0,
        num_samples: int = 1,
        **options: Any,
    ) -> list[Motion]:
        """Returns variations of a motion, of the same length.

        Args:
            motion: Any motion of the model's skeleton.
            strength: Probability of each row of codes to be sampled again; 0 changes nothing but what the tokenizer
                loses, and 1 keeps nothing.
            caption: What happens; by default the motion's own caption.
            seed: From 0 to 2**32 - 1.
            num_samples: Variations to return.
            **options: Of `SamplingOptions`.

        Warns:
            PromptWarning: The model cannot know what the sentence asks for.

        Raises:
            UserError: The sentence or a number cannot be used, or the motion is too short or has another skeleton.
        """
        request = MotionRequest(
            captions=(motion.caption if caption is None else caption,),
            start=motion,
            strength=float(strength),
            seed=seed,
            num_samples=num_samples,
            options=SamplingOptions(**options),
        )
        return list(self.make(request))

    def stream(self, caption: str, *, seed: int = 0, sample: int = 0, **options: Any) -> Iterator[Motion]:
        """Returns an iterator over the motion of a caption while it is generated: a piece for each row of codes.

        Together they are the motion that `generate` returns with the same arguments and `raw=True`, and with
        `stop_rule="threshold"` if the model's own rule needs all rows first. See `make_pieces`.

        Args:
            caption: A sentence.
            seed: From 0 to 2**32 - 1.
            sample: Number of the motion among the samples of `generate`.
            **options: Of `SamplingOptions`.

        Raises:
            UserError: The caption or a number cannot be used.
        """
        request = MotionRequest(captions=(caption,), seed=seed, options=SamplingOptions(**options))
        return self.make_pieces(request, sample=sample)

    def stream_chain(
        self,
        captions: Sequence[str],
        *,
        start: Motion | None = None,
        seconds: float | int | None = None,
        seed: int = 0,
        **options: Any,
    ) -> Iterator[Motion]:
        """Returns an iterator over the motion of `generate_chain` while it is generated, in pieces of some seconds.

        Arguments, warnings and errors are those of `generate_chain`. See `make_pieces`.
        """
        request = MotionRequest(
            captions=sentences(captions),
            start=start,
            seconds=None if seconds is None else float(seconds),
            seed=seed,
            options=SamplingOptions(**options),
        )
        prompts = read_prompts(request.captions, self.knowledge, self.text_encoder)
        return make_chain_pieces(self.parts, request, prompts, self._sampling(request.options))


def _unpack(batches: Iterable[list[Motion]], total: int, on_progress: OnProgress | None) -> Iterator[Motion]:
    """Yields the motions of batches one by one."""
    ready = 0
    for motions in batches:
        ready += len(motions)
        if on_progress is not None:
            on_progress(ready, total)
        yield from motions
