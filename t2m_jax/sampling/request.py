"""What a user may ask a model for: one record for Python, command line and server."""

import dataclasses
import functools
import itertools
import logging
import math
from collections.abc import Callable, Collection, Iterator, Sequence
from numbers import Integral, Real
from typing import Any, Literal, TypeVar

from t2m_jax.errors import UserError
from t2m_jax.field_checks import check_number, check_seed, is_number
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.part_captions import with_neighbors
from t2m_jax.motion.repetitions import COUNTED_ACTIONS, SIDED_ACTIONS
from t2m_jax.motion.targets import Target
from t2m_jax.sampling.prompts import MAX_BATCH
from t2m_jax.sampling.stopping import make_stop_rule
from t2m_jax.sampling.strategies import Strategy, make_strategy
from t2m_jax.text.at_once import SaidAtOnce, said_at_once
from t2m_jax.text.counts import SaidSide, Times, said_side, said_times
from t2m_jax.text.coverage import Knowledge
from t2m_jax.text.paces import SaidPace, said_pace
from t2m_jax.text.prompts import check_prompt
from t2m_jax.text.quantities import said_seconds
from t2m_jax.text.sequence import split_sequence
from t2m_jax.text.spelling import correct_spelling

logger = logging.getLogger(__name__)

T = TypeVar("T")

MAX_SAMPLES = 1_000_000
"""Most motions of a request. A larger number is probably a mistake: they would take weeks and 100 GB."""
MAX_SECONDS = 3600.0
"""Longest motion for a sentence. A larger number is probably a mistake."""


def check_seconds(seconds: float) -> None:
    """Raises `UserError` if a length is not a number of seconds up to `MAX_SECONDS`."""
    if not (is_number(seconds) and 0 < seconds <= MAX_SECONDS):
        given = f"{seconds:g}" if is_number(seconds) else repr(seconds)
        raise UserError(f"seconds: {given} is not a number above 0, up to {MAX_SECONDS:g}")


def check_numbers(record: Any, names: str, kind: type = Real) -> None:
    """Raises `UserError` if a field of a record is neither None nor a number of a kind."""
    for name in names.split():
        if (value := getattr(record, name)) is not None:
            check_number(name, value, kind)


def sentences(captions: Sequence[str]) -> tuple[str, ...]:
    """Returns sentences as a tuple; a single string is one sentence."""
    return (captions,) if isinstance(captions, str) else tuple(captions)


StopRuleName = Literal["argmax", "threshold", "sampled"]


@dataclasses.dataclass(frozen=True, kw_only=True)
class SamplingOptions:
    """How codes are chosen. The same options can be used for every kind of request."""

    temperature: float = 1.0
    """Below 1, likely codes are chosen more often; with 0, always the likeliest."""
    top_k: int | None = None
    """Number of the likeliest codes to choose among."""
    top_p: float | None = None
    """Codes are chosen among the likeliest ones, up to this sum of their probabilities."""
    strategy: Strategy | None = None
    """Another way to choose codes, instead of the three numbers; only in Python."""
    guidance_scale: float | None = None
    """Strength of the guidance by the text, for models that were trained for it; 1 is none. By default the model's."""
    stop_rule: StopRuleName | None = None
    """When a motion ends whose length is not given, for models with a stop head; by default the model's own rule."""
    max_codes: int | None = None
    """Longest motion in rows of codes, if the model decides its length; by default the model's maximum."""
    raw: bool = False
    """Whether positions stay as decoded. By default they are cleaned: they tremble less, bones have constant lengths,
    and feet slide less (`t2m_jax.motion.cleanup`)."""

    whole: bool = False
    """Whether a sentence is sampled as it is. By default, one of several actions in turn ("walks, then waves") is
    sampled action by action, if there is a record of the actions that the model knows; "for five seconds" sets the
    length; of "kicks twice", that of 16 samples is taken, or made by a cut or a repetition, that shows it twice; of
    "walks slowly", the slowest of 4 samples; and of "waves while walking", the first of 8 that does both. Changes of a
    motion and targets decide all this themselves."""

    def __post_init__(self) -> None:
        """Checks each field.

        Raises:
            UserError: A value cannot be used with any model, or two fields exclude each other.
        """
        check_numbers(self, "temperature top_p guidance_scale")
        check_numbers(self, "top_k max_codes", Integral)
        # Strategy and stop rule check their own numbers and names.
        self.make_strategy()
        if self.stop_rule is not None:
            make_stop_rule(self.stop_rule)
        if self.guidance_scale is not None and not 0 <= self.guidance_scale < math.inf:
            raise UserError(f"guidance-scale: {self.guidance_scale} is not a number from 0")

    def make_strategy(self) -> Strategy:
        """Returns how codes are chosen."""
        if self.strategy is None:
            return make_strategy(self.temperature, self.top_k, top_p=self.top_p)
        if (self.temperature, self.top_k, self.top_p) != (1.0, None, None):
            raise UserError("strategy: excludes temperature, top-k and top-p; give them to the strategy")
        return self.strategy


@dataclasses.dataclass(frozen=True, kw_only=True)
class MotionRequest:
    """From a user to `TextToMotion.make`: one motion, or several samples of it."""

    captions: tuple[str, ...]
    """Sentences; several become one motion that shows them one after the other. With `strength`, one for the whole
    motion or as many as it has."""
    start: Motion | None = None
    """A motion to continue. With `span` or `strength`, it is changed instead."""
    span: tuple[float, float] | None = None
    """Begin and end of the seconds of `start` that the sentence replaces. If both are the same, it is added there."""
    strength: float | None = None
    """Share of `start` that is sampled again: 0 keeps all of its codes, which give it nearly, and 1 none."""
    seconds: float | None = None
    """Length for each sentence, rounded to whole rows of codes; by default what the sentence says ("for five seconds"),
    else the model decides. With `span`, the length of the new part; by default that of the span."""
    seed: int = 0
    """From 0 to 2**32 - 1. The same seed gives the same motion."""
    num_samples: int = 1
    """Motions to make."""
    candidates: int = 16
    """Samples to choose the motions from; only with `span` or `targets`."""
    targets: tuple[Target, ...] = ()
    """Where joints, the root or the whole pose should be at a time; with `span`, in that part of the motion."""
    options: SamplingOptions = SamplingOptions()
    """How codes are chosen."""

    def __post_init__(self) -> None:
        """Checks each field, and cleans the sentences.

        Raises:
            UserError: A value cannot be used with any model, or fields do not go together.
        """
        if not self.captions:
            raise UserError("captions: give at least one sentence")
        captions = sentences(self.captions)
        if self.strength is not None:  # the parts of a motion may have no sentence
            captions = with_neighbors(captions)
        # The only way to set a field of a frozen dataclass.
        object.__setattr__(self, "captions", tuple(_checked(captions)))
        check_seed(self.seed)
        if not (is_number(self.num_samples, Integral) and 1 <= self.num_samples <= MAX_SAMPLES):
            raise UserError(f"num-samples: {self.num_samples} is not a whole number from 1 to {MAX_SAMPLES:,}")
        if self.seconds is not None:
            check_seconds(self.seconds)
        check_numbers(self, "strength")
        # Which fields go together does not depend on the model, so every door says it before a model is loaded.
        if self.span is not None or self.strength is not None:
            self._check_change("strength" if self.span is None else "span")
        if self.span is not None:
            self._check_span(*self.span)
        if self.targets:
            self._check_targets()
        self._check_end()
        if self.span is not None or self.targets:
            self._check_candidates()
        elif self.candidates != MotionRequest.candidates:
            raise UserError("candidates: is only for targets or a span to redo; give them, or leave it out")

    @property
    def is_plain(self) -> bool:
        """Whether it asks for motions of one sentence alone, which can be sampled together with those of others."""
        is_alone = len(self.captions) == 1 and self.start is None and not self.targets
        return is_alone and self.lengths == self.times == self.paces == self.sides == self.at_once == (None,)

    @property
    def is_bound(self) -> bool:
        """Whether another motion or targets decide how long, how often and how fast something is done."""
        return bool(self.targets) or self.span is not None or self.strength is not None

    @property
    def reads_quantities(self) -> bool:
        """Whether sentences are cut into actions in turn, and say how long, how often and how fast."""
        return not (self.options.whole or self.is_bound)

    @functools.cached_property
    def lengths(self) -> tuple[float | None, ...]:
        """Seconds of each sentence: `seconds`, or what it says itself; None leaves its length to the model."""
        return self._said(said_seconds) if self.seconds is None else (self.seconds,) * len(self.captions)

    @functools.cached_property
    def times(self) -> tuple[Times | None, ...]:
        """How often each sentence says that something is done; None if it does not say so."""
        return self._said(functools.partial(said_times, countable=COUNTED_ACTIONS))

    @functools.cached_property
    def paces(self) -> tuple[SaidPace | None, ...]:
        """Whether each sentence says that something is done slowly or fast."""
        return self._said(said_pace)

    @functools.cached_property
    def sides(self) -> tuple[SaidSide | None, ...]:
        """With which leg or arm each sentence says that something is done."""
        return self._said(functools.partial(said_side, sided=SIDED_ACTIONS))

    @functools.cached_property
    def at_once(self) -> tuple[SaidAtOnce | None, ...]:
        """What each sentence says that legs and arms do at the same time."""
        return self._said(said_at_once)

    def _said(self, read: Callable[[str], T | None]) -> tuple[T | None, ...]:
        """Returns what a function reads in each sentence, None for all if quantities are not read."""
        return tuple(map(read, self.captions)) if self.reads_quantities else (None,) * len(self.captions)

    @property
    def notes(self) -> tuple[str, ...]:
        """What each sentence says that is not followed, in a line; empty if there is nothing."""
        return tuple(map(self._note, self.captions))

    def _note(self, caption: str) -> str:
        if self.options.whole:
            return ""
        seconds = said_seconds(caption)
        said = {
            "length": self.seconds is None and seconds is not None,
            "number of times": said_times(caption, COUNTED_ACTIONS) is not None,
            "pace": said_pace(caption) is not None,
        }
        parts = ", ".join(name for name, is_said in said.items() if is_said and self.is_bound)
        notes = [f"not followed in a change of a motion or with targets: {parts}"] if parts else []
        if seconds is not None and self.seconds not in (None, seconds):
            notes.append(f"takes {self.seconds:g} s, as asked for, and not {seconds:g} s")
        return f"{caption!r}: {'; '.join(notes)}" if notes else ""

    def in_turn(self, knowledge: Knowledge) -> "MotionRequest":
        """Returns the request with a sentence for each action that its sentences say in turn (see `split_sequence`).

        Typing mistakes that hide an order, a length, a number of times or a pace are corrected; others are left to the
        reading of the sentence. All sentences together have the same `seconds`. Requests with `options.whole`,
        `targets`, `span` or `strength` stay as they are.
        """
        if not self.reads_quantities:
            return self
        read = [_with_quantities(caption, knowledge) for caption in self.captions]
        actions = tuple(itertools.chain.from_iterable(split_sequence(one, knowledge.actions) for one in read))
        if actions == self.captions:
            return self
        seconds = None if self.seconds is None else self.seconds * len(self.captions) / len(actions)
        return dataclasses.replace(self, captions=actions, seconds=seconds)

    def _check_change(self, name: str) -> None:
        if self.start is None:
            raise UserError(f"{name}: changes a motion; give it as start")
        if self.span is not None and self.strength is not None:
            raise UserError("span: excludes strength")
        # A variation of a chain may keep its sentences.
        parts = len(self.start.part_captions) if self.strength is not None else 0
        if len(self.captions) not in (1, parts):
            each = f" (or {parts}, one for each of the motion's)" if parts > 1 else ""
            raise UserError(f"{name}: takes one sentence{each}")
        if self.strength is not None and self.seconds is not None:
            raise UserError("strength: excludes seconds; a variation is as long as the motion")
        if self.strength is not None and not 0 <= self.strength <= 1:
            raise UserError(f"strength: {self.strength:g} is not a number from 0 to 1")

    def _check_span(self, begin: float, end: float) -> None:
        if not (is_number(begin) and is_number(end)):
            raise UserError(f"span: {begin!r} to {end!r} are not two numbers of seconds")
        # NaN fails each comparison, so it is refused, too. Where the motion ends is checked with its codes.
        if not (0 <= begin < math.inf and 0 <= end < math.inf):
            raise UserError(f"span: {begin:g} to {end:g} is not a part of the motion")
        if end < begin:
            raise UserError(f"span: {begin:g} to {end:g} s ends before it begins")
        if begin == end and self.seconds is None:
            raise UserError(f"span: {begin:g} to {end:g} is no time; give seconds, the length of what comes there")

    def _check_targets(self) -> None:
        others = {
            "a second sentence": len(self.captions) > 1,
            "a variation": self.strength is not None,
            "a motion to continue": self.start is not None and self.span is None,
            "a length in seconds": self.seconds is not None and self.span is None,
        }
        for name, is_given in others.items():
            if is_given:
                raise UserError(
                    f"targets: targets are for a new motion of one sentence, or a span to redo; leave out {name}"
                )

    def _check_end(self) -> None:
        """Refuses options that say when a motion ends if its length is given: they would be ignored."""
        lengths = [name for name in ("span", "strength", "seconds") if getattr(self, name) is not None]
        ends = [name for name in ("stop_rule", "max_codes") if getattr(self.options, name) is not None]
        if lengths and ends:
            raise UserError(f"{lengths[0]}: excludes {ends[0].replace('_', '-')}; the length of the motion is given")

    def _check_candidates(self) -> None:
        if not (is_number(self.candidates, Integral) and 1 <= self.candidates <= MAX_BATCH):
            raise UserError(f"candidates: {self.candidates} is not a whole number from 1 to {MAX_BATCH}")
        if self.num_samples > self.candidates:
            raise UserError(
                f"num-samples: {self.num_samples} motions cannot be chosen from {self.candidates} candidates"
            )


def _checked(captions: Sequence[str]) -> Iterator[str]:
    """Yields the cleaned sentences.

    Raises:
        UserError: A sentence cannot be used. The message says which of several.
    """
    for number, caption in enumerate(captions, start=1):
        yield check_prompt(caption, "captions" if len(captions) == 1 else f"captions: sentence {number}")


def _with_quantities(caption: str, knowledge: Knowledge) -> str:
    """Returns a sentence, without its typing mistakes if they hide what `_quantities` finds."""
    read, mistakes = correct_spelling(caption, knowledge.words, rare=knowledge.taught)
    if not mistakes or _quantities(read, knowledge.actions) == _quantities(caption, knowledge.actions):
        return caption
    logger.info("%r: read as %r", caption, read)
    return read


def _quantities(caption: str, known: Collection[str]) -> tuple[Any, ...]:
    """Returns how many actions a sentence says in turn and which at once, how long, how often and how fast."""
    parts = len(split_sequence(caption, known))
    times = said_times(caption, COUNTED_ACTIONS)
    return parts, said_seconds(caption), times, said_pace(caption), said_at_once(caption)
