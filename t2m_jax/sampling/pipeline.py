"""From sentences to motions: text encoder, generator, tokenizer and skeleton in one object."""

import dataclasses
import itertools
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int

from t2m_jax.checkpoints.bundle import Bundle
from t2m_jax.checkpoints.hub_models import push_model
from t2m_jax.checkpoints.model import load_model
from t2m_jax.checkpoints.tokenizer import TrainedTokenizer
from t2m_jax.errors import UserError
from t2m_jax.field_checks import check_seed
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.targets import Target, read_target
from t2m_jax.sampling.compilation import use_compilation_cache
from t2m_jax.sampling.generation import OnProgress, make_motions, make_rows
from t2m_jax.sampling.model import ModelParts
from t2m_jax.sampling.prompts import Sample, read_prompts
from t2m_jax.sampling.request import MotionRequest, SamplingOptions, sentences
from t2m_jax.sampling.timeline import make_chain_pieces
from t2m_jax.text.encoder import TextEncoder


class TextToMotion:
    """A loaded model: `TextToMotion.from_pretrained("demo").generate(["a person walks forward"])`.

    `make` and `make_pieces` take a `MotionRequest`, and the other methods are short ways to them. Their `**options` are
    the fields of `SamplingOptions`: how codes are chosen, when motions end, and whether they are cleaned. All of them
    give a `PromptWarning` if the model cannot know what a sentence asks for, and raise `UserError` if a sentence or a
    number cannot be used, or a motion is too short or has another skeleton.
    """

    def __init__(self, bundle: Bundle, *, text_encoder: TextEncoder | None = None):
        """Puts the weights on all devices of this process.

        Args:
            bundle: The model.
            text_encoder: Used instead of the model's own; it must give the same embeddings.

        Raises:
            UserError: The pretrained text encoder cannot be found, or `bundle` is a name or a path.
        """
        self.parts = ModelParts(bundle, text_encoder=text_encoder)
        self.config = self.parts.config
        self.skeleton = self.parts.skeleton
        self.text_encoder = self.parts.text_encoder
        self.knowledge = self.parts.knowledge
        self.training_data = bundle.training_data
        self.license = bundle.license
        self.examples = bundle.examples
        self.source = bundle.source

    @classmethod
    def from_pretrained(cls, name_or_path: str | Path) -> "TextToMotion":
        """Returns a model by bundled name ("demo"), bundle folder, run directory, or name on the Hugging Face hub.

        `t2m_jax.load` and `TextToMotion.load` do the same. The compilation cache is turned on.

        Raises:
            UserError: There is no such model, or it is damaged.
        """
        use_compilation_cache()
        return cls(load_model(name_or_path))

    load = from_pretrained

    def push_to_hub(self, name: str, *, card: str | None = None, private: bool = False, half: bool = True) -> str:
        """Uploads the model to the Hugging Face hub, after `hf auth login`. Returns the address.

        Args:
            name: `user/name`, which is created if it does not exist, or `user/name@branch`.
            card: Markdown with a license in its metadata; by default the model's own card.
            private: Whether only you can see the repository.
            half: Whether weights are stored in 16 bits, as `t2m bundle` does.

        Raises:
            UserError: The card has no license, or the hub refuses the name or the model.
        """
        return push_model(self.parts.bundle, name, card=card, private=private, half=half)

    def __repr__(self) -> str:
        """Returns sizes, data, license, source and what the model knows, in some lines."""
        return "\n  ".join([f"{type(self).__name__}:", *map(": ".join, self.parts.describe().items())])

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
        """Returns the codes of a motion, its own if this model made it. Frames at the end that fill none are cut."""
        return self.parts.encode(motion)

    def decode(self, codes: Int[np.ndarray, "N ..."], *, caption: str = "", raw: bool = False) -> Motion:
        """Returns the motion of codes [N, R] ([N] if there is one per row), cleaned as by `generate` unless `raw`.

        With fewer than R codes per row, those of the first depths, the motion is coarser.

        Raises:
            UserError: There are no codes, too many per row, or one that is not in the codebook.
        """
        return self.parts.decode(codes, caption=caption, raw=raw)

    def make(self, *requests: MotionRequest, on_progress: OnProgress | None = None) -> Iterator[Motion]:
        """Returns an iterator over the motions of requests, request by request.

        Requests with the same options are sampled together, but a motion does not depend on the others.

        Args:
            *requests: What is asked for.
            on_progress: Called with the number of motions that are ready, of which parts count, and that of all.

        Warns:
            PromptWarning: The model cannot know what a sentence asks for. The motions say so, too, and what they miss.

        Raises:
            UserError: A request does not fit the model, such as a motion of another skeleton.
        """
        turns = [request.in_turn(self.knowledge) for request in requests]
        captions = [caption for request in turns for caption in request.captions]
        notes = [note for request in turns for note in request.notes]
        prompts = iter(read_prompts(captions, self.knowledge, self.text_encoder, notes=notes))
        read = [(request, list(itertools.islice(prompts, len(request.captions)))) for request in turns]
        return make_motions(self.parts, read, on_progress)

    def make_pieces(self, request: MotionRequest, *, sample: int = 0) -> Iterator[Motion]:
        """Returns an iterator over the motion of a request while it is generated.

        Each piece continues where the one before it ends. Pieces are as decoded, because a clean-up needs the whole
        motion: together they are the motion that `make` returns with `raw=True`. If it `is_plain`, there is a piece for
        each row of codes, when its frames are final (see `TokenizerConfig.decoder_context`); the last ones come
        together. Otherwise, pieces have some seconds, say which sentences begin in them, and need hardly any memory.

        Args:
            request: What is asked for; not a change of a motion.
            sample: Number of the motion among the samples of the request.

        Warns:
            PromptWarning: The model cannot know what a sentence asks for.

        Raises:
            UserError: The request does not fit the model, or it cannot be made in pieces.
        """
        check_seed(sample, "sample")
        if request.is_bound:
            raise UserError("stream: a change of a motion, or one with targets, has no pieces; use make")
        request = request.in_turn(self.knowledge)
        prompts = read_prompts(request.captions, self.knowledge, self.text_encoder, notes=request.notes)
        first = Sample(prompts[0], request.seed, sample)
        if request.is_plain:
            return make_rows(self.parts, first, request.options)
        return make_chain_pieces(self.parts, request, prompts, first.key, self.parts.sampling(request.options))

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
        """
        return [*self.generate_each(captions, seed=seed, num_samples=num_samples, on_progress=on_progress, **options)]

    def generate_each(
        self,
        captions: Sequence[str] | str,
        *,
        seed: int = 0,
        num_samples: int = 1,
        on_progress: OnProgress | None = None,
        **options: Any,
    ) -> Iterator[Motion]:
        """Returns an iterator over the motions of `generate`, for more of them than fit into the memory."""
        counts = {"seed": seed, "num_samples": num_samples}
        return self.make(*(_request(one, options, **counts) for one in sentences(captions)), on_progress=on_progress)

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
        """Returns motions that show sentences one after the other, of any length.

        Each sentence is sampled as if it were alone, with a cross-fade to the next. Only the first continues the last
        codes of `start`. The motions say where each begins (`part_starts`, `part_captions`).

        Args:
            captions: Sentences, one after the other.
            start: A motion that the first sentence continues. The result begins with what the tokenizer keeps of it.
            seconds: Length for each sentence, rounded to whole rows of codes; by default the model decides.
            seed: From 0 to 2**32 - 1.
            num_samples: Motions to return.
            **options: Of `SamplingOptions`.
        """
        request = _request(captions, options, start=start, seconds=seconds, seed=seed, num_samples=num_samples)
        whole: dict[str, Any] = {"part_starts": (0,), "part_captions": request.captions}
        return [motion if motion.part_starts else dataclasses.replace(motion, **whole) for motion in self.make(request)]

    def redo(
        self,
        motion: Motion,
        span: tuple[float, float],
        caption: str,
        *,
        seconds: float | int | None = None,
        seed: int = 0,
        num_samples: int = 1,
        num_candidates: int = MotionRequest.candidates,
        **options: Any,
    ) -> list[Motion]:
        """Returns a motion with another middle, which a sentence describes, at the model's frame rate.

        Those come first that lead best to the tail, which is turned and moved to where the middle ends.

        Args:
            motion: Any motion of the model's skeleton.
            span: Begin and end of the middle in seconds, rounded to whole rows of codes; the same to insert one.
            caption: What happens in the middle.
            seconds: Length of the new middle; by default that of the span.
            seed: From 0 to 2**32 - 1.
            num_samples: Motions to return, the best ones first.
            num_candidates: Middles to choose them from.
            **options: Of `SamplingOptions`.
        """
        counts = {"seconds": seconds, "seed": seed, "num_samples": num_samples, "candidates": num_candidates}
        return list(self.make(_request(caption, options, start=motion, span=span, **counts)))

    def direct(
        self,
        caption: str,
        targets: Sequence[Target | str | tuple[float, Motion]],
        *,
        start: Motion | None = None,
        span: tuple[float, float] | None = None,
        seed: int = 0,
        num_samples: int = 1,
        num_candidates: int = MotionRequest.candidates,
        **options: Any,
    ) -> list[Motion]:
        """Returns motions in which joints, the root or the whole pose are where they should be at a time.

        The nearest samples are changed by gradients of the decoder; `Motion.warning` says which targets are missed.

        Args:
            caption: A sentence.
            targets: Texts (see `docs/targets.md`), or pairs of seconds and a motion, whose first frame is the pose.
            start: A motion of which a part is made again, as by `redo`; by default, the whole motion is new.
            span: Begin and end of this part in seconds; all targets must be in it.
            seed: From 0 to 2**32 - 1.
            num_samples: Motions to return, the best ones first.
            num_candidates: Samples to choose them from.
            **options: Of `SamplingOptions`.
        """
        fields = {"start": start, "span": span, "seed": seed, "num_samples": num_samples, "candidates": num_candidates}
        return list(self.make(_request(caption, options, targets=tuple(map(read_target, targets)), **fields)))

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
            strength: Probability of each row of codes to be sampled again; 1 keeps nothing.
            caption: What happens; by default the motion's own sentences.
            seed: From 0 to 2**32 - 1.
            num_samples: Variations to return.
            **options: Of `SamplingOptions`.
        """
        captions = (motion.part_captions or motion.caption) if caption is None else caption
        fields = {"start": motion, "strength": strength, "seed": seed, "num_samples": num_samples}
        return list(self.make(_request(captions, options, **fields)))

    def stream(self, caption: str, *, seed: int = 0, sample: int = 0, **options: Any) -> Iterator[Motion]:
        """Returns an iterator over the motion of a caption while it is generated, in pieces (see `make_pieces`).

        If the model's own stop rule needs all rows first, motions end by `stop_rule="threshold"`.

        Args:
            caption: A sentence.
            seed: From 0 to 2**32 - 1.
            sample: Number of the motion among the samples of `generate`.
            **options: Of `SamplingOptions`.
        """
        return self.make_pieces(_request(caption, options, seed=seed), sample=sample)

    def stream_chain(
        self,
        captions: Sequence[str],
        *,
        start: Motion | None = None,
        seconds: float | int | None = None,
        seed: int = 0,
        **options: Any,
    ) -> Iterator[Motion]:
        """Returns an iterator over the motion of `generate_chain` in pieces, see `make_pieces`."""
        return self.make_pieces(_request(captions, options, start=start, seconds=seconds, seed=seed))


def _request(captions: Sequence[str] | str, options: dict[str, Any], **fields: Any) -> MotionRequest:
    """Returns what a method is asked for. Whole numbers may stand for seconds and shares."""
    numbers = {name: float(fields[name]) for name in ("seconds", "strength") if hasattr(fields.get(name), "__float__")}
    return MotionRequest(captions=sentences(captions), options=SamplingOptions(**options), **fields | numbers)
