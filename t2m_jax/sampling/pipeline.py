"""From sentences to motions: text encoder, generator, tokenizer and skeleton in one object."""

import functools
import itertools
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from t2m_jax.checkpoints.model import load_model
from t2m_jax.config import check_seed
from t2m_jax.devices import put_everywhere
from t2m_jax.errors import UserError
from t2m_jax.motion.motion import Motion
from t2m_jax.sampling.batches import padded_batch_size
from t2m_jax.sampling.compilation import use_compilation_cache
from t2m_jax.sampling.editor import MotionEditor
from t2m_jax.sampling.loop import Sampling
from t2m_jax.sampling.programs import begin_motions, generate_row
from t2m_jax.sampling.prompts import MAX_BATCH, Prompt, check_num_samples, read_prompts, sample_key
from t2m_jax.sampling.stopping import find_stop_rule
from t2m_jax.sampling.strategies import Strategy, make_strategy
from t2m_jax.sampling.streaming import stream_pieces
from t2m_jax.sampling.together import Sample, batch_inputs, batch_motions


class TextToMotion(MotionEditor):
    """A loaded model: `TextToMotion.load("demo").generate(["a person walks forward"])`."""

    @classmethod
    def load(cls, name_or_path: str | Path) -> "TextToMotion":
        """Returns a model by bundled name ("demo"), bundle folder or run directory; turns on the compilation cache.

        Raises:
            UserError: There is no such model, or it is damaged.
        """
        use_compilation_cache()
        return cls(load_model(name_or_path))

    def generate(
        self,
        captions: Sequence[str] | str,
        *,
        seed: int = 0,
        num_samples: int = 1,
        temperature: float | int = 1.0,
        top_k: int | None = None,
        top_p: float | None = None,
        strategy: Strategy | None = None,
        max_codes: int | None = None,
        guidance_scale: float | None = None,
        stop_rule: str | None = None,
        raw: bool = False,
        on_progress: Callable[[int, int], None] | None = None,
    ) -> list[Motion]:
        """Returns `num_samples` motions for each caption, caption by caption.

        A motion depends on the seed, its caption and its number among the samples. It does not depend on the other
        motions of the call.

        Args:
            captions: Sentences, or a single one.
            seed: From 0 to 2**32 - 1.
            num_samples: Motions per caption.
            temperature: Below 1, likely codes are chosen more often; with 0, always the likeliest.
            top_k: Number of the likeliest codes to choose among.
            top_p: Codes are chosen among the likeliest ones, up to this sum of their probabilities.
            strategy: Another way to choose codes, instead of the three numbers.
            max_codes: Longest motion in codes; by default the model's maximum.
            guidance_scale: Strength of the guidance by the text, for models that were trained for it; 1 is none. By
                default the model's own.
            stop_rule: `argmax`, `threshold` or `sampled`, for models with a stop head; by default the model's own.
            raw: Whether positions stay as decoded. By default they are cleaned: they tremble less, bones have constant
                lengths, and feet slide less (`t2m_jax.motion.cleanup`).
            on_progress: Called with the number of motions that are ready and the number of all, after each batch.

        Warns:
            PromptWarning: The model cannot know what a caption asks for. The motions say so, too.

        Raises:
            UserError: A caption or a number cannot be used.
        """
        motions = self.generate_each(
            captions,
            seed=seed,
            num_samples=num_samples,
            temperature=temperature,
            top_k=top_k,
            top_p=top_p,
            strategy=strategy,
            max_codes=max_codes,
            guidance_scale=guidance_scale,
            stop_rule=stop_rule,
            raw=raw,
            on_progress=on_progress,
        )
        return list(motions)

    def generate_each(
        self,
        captions: Sequence[str] | str,
        *,
        seed: int = 0,
        num_samples: int = 1,
        temperature: float | int = 1.0,
        top_k: int | None = None,
        top_p: float | None = None,
        strategy: Strategy | None = None,
        max_codes: int | None = None,
        guidance_scale: float | None = None,
        stop_rule: str | None = None,
        raw: bool = False,
        on_progress: Callable[[int, int], None] | None = None,
    ) -> Iterator[Motion]:
        """Returns an iterator over the motions of `generate`, for more of them than fit into the memory.

        Arguments and errors are those of `generate`.
        """
        check_seed(seed)
        check_num_samples(num_samples)
        if strategy is None:
            strategy = make_strategy(float(temperature), top_k, top_p=top_p)
        elif (temperature, top_k, top_p) != (1.0, None, None):
            raise UserError("strategy: excludes temperature, top-k and top-p; give them to the strategy")
        sampling = self.sampling(strategy, max_codes=max_codes, stop_rule=stop_rule)
        prompts = read_prompts(captions, self.knowledge, self.text_encoder)
        total = len(prompts) * num_samples
        requests = itertools.product(prompts, range(num_samples))
        batches = iter(lambda: list(itertools.islice(requests, MAX_BATCH)), [])

        def generate_batches() -> Iterator[Motion]:
            for number, batch in enumerate(batches):
                motions = self._generate_batch(
                    batch, seed=seed, sampling=sampling, guidance_scale=guidance_scale, clean=not raw
                )
                if on_progress is not None:
                    on_progress(number * MAX_BATCH + len(batch), total)
                yield from motions

        return generate_batches()

    def stream(
        self,
        caption: str,
        *,
        seed: int = 0,
        sample: int = 0,
        strategy: Strategy | None = None,
        max_codes: int | None = None,
        guidance_scale: float | None = None,
    ) -> Iterator[Motion]:
        """Returns an iterator over the motion of a caption while it is generated: a piece for each row of codes.

        A piece comes as soon as its frames are final. They also depend on some rows after them (see
        `TokenizerConfig.decoder_context`), so the last pieces come together. Pieces are as decoded, because a clean-up
        needs the whole motion: together they are the motion that `generate` returns with the same arguments and
        `raw=True`, and with `stop_rule="threshold"` if the model's own rule needs all rows first.

        Args:
            caption: A sentence.
            seed: From 0 to 2**32 - 1.
            sample: Number of the motion among the samples of `generate`.
            strategy: How codes are chosen; by default from the model's own probabilities.
            max_codes: Longest motion in codes; by default the model's maximum.
            guidance_scale: Strength of the guidance by the text; by default the model's own.

        Raises:
            UserError: The caption or a number cannot be used.
        """
        check_seed(seed)
        ((text, *_),) = read_prompts(caption, self.knowledge, self.text_encoder)
        ends_early = find_stop_rule(self.config.generator).ends_early
        sampling = self.sampling(strategy, max_codes=max_codes, stop_rule=None if ends_early else "threshold")
        keys = put_everywhere(sample_key(seed, text, sample)[None])
        variables, scale = self._variables_for_sampling(), self._guidance(guidance_scale)
        state = begin_motions(variables, self.text_encoder([text]), scale, generator=self._generator)
        return stream_pieces(
            lambda state: generate_row(variables, state, keys, generator=self._generator, sampling=sampling),
            state,
            sampling,
            functools.partial(self._decode_padded, size=sampling.max_codes, caption=text, seed=seed, clean=False),
            decoder_context=self.config.tokenizer.decoder_context,
        )

    def _generate_batch(
        self,
        requests: Sequence[tuple[Prompt, int]],
        *,
        seed: int,
        sampling: Sampling,
        guidance_scale: float | None,
        clean: bool,
    ) -> list[Motion]:
        samples = [Sample(prompt, seed, number) for prompt, number in requests]
        embedding, keys = batch_inputs(self, samples, padded_batch_size(len(samples)))
        sampled = self.sample_codes(embedding, keys, sampling, guidance_scale=guidance_scale)
        return batch_motions(self, sampled, samples, clean=clean)
