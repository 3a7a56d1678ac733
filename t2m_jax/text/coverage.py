"""What a model can know of a prompt: the words and actions of the captions that it was trained on."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

from t2m_jax.text.verbs import GENERIC_NOUNS, LIGHT_VERBS, SIDES, Word, word_set, words_of

MIN_USES = 100
"""A word is known if the captions use it this often."""
USES_SHARE = 1e-4
"""In small data sets, a word is known if this share of all words is it."""
MIN_CLIPS = 50
"""An action is known if the captions of this many clips have the verb."""
CLIPS_SHARE = 1 / 200
"""In small data sets, an action is known if the captions of this share of the clips have the verb."""
MAX_NAMED = 12
"""Words that a warning names, and actions."""

DIRECTIONS = word_set(
    """ahead anticlockwise anti-clockwise back backward backwards clockwise counterclockwise counter-clockwise
    diagonal diagonally down downstairs downward downwards east forward forwards inward inwards north outward
    outwards sidewards sideways south up upstairs upward upwards west"""
)
NUMBERS = word_set(
    """zero two three four five six seven eight nine ten eleven twelve thirteen fourteen fifteen sixteen seventeen
    eighteen nineteen twenty thirty forty fifty sixty seventy eighty ninety hundred thousand dozen twice thrice"""
)


class PromptWarning(UserWarning):
    """The model cannot know what the prompt asks for."""


class Knowledge(NamedTuple):
    """The words and actions that a model was trained on often enough."""

    words: frozenset[str]
    """In lower case, as used or in their basic form."""
    actions: tuple[str, ...]
    """Basic forms of verbs, the most frequent first; empty if the model's record does not have them."""


class Coverage(NamedTuple):
    """What a model knows of a prompt."""

    warning: str
    """What it cannot know, in a line; empty if it may know all that matters."""
    unknown_words: tuple[str, ...]
    """All words that it did not learn, also those that matter little."""


def count_actions(captions: Iterable[Sequence[str]]) -> dict[str, int]:
    """Returns the number of clips per action of their captions, the most frequent action first."""
    counts: Counter[str] = Counter()
    for of_clip in captions:
        counts.update({word.action for caption in of_clip for word in words_of(caption)} - LIGHT_VERBS - {""})
    return dict(counts.most_common())


def make_knowledge(training_data: Mapping[str, Any] | None) -> Knowledge:
    """Returns what a model knows, from the record of its training data; nothing if there is none."""
    training_data = training_data or {}
    words = training_data.get("words", {})
    actions = training_data.get("actions", {})
    uses = min(MIN_USES, USES_SHARE * sum(words.values()))
    clips = min(MIN_CLIPS, CLIPS_SHARE * training_data.get("num_clips", 0))
    return Knowledge(
        words=frozenset(word for word, count in words.items() if count >= uses),
        actions=tuple(sorted((name for name in actions if actions[name] >= clips), key=lambda name: -actions[name])),
    )


def check_coverage(
    prompt: str,
    knowledge: Knowledge,
    *,
    read_part: str,
    typed: str = "",
    corrected: Mapping[str, str] = MappingProxyType({}),
) -> Coverage:
    """Returns what a model knows of a prompt, of which its text encoder reads only `read_part`.

    If there is no record of the model's training data, only what is not read can be told.

    Args:
        prompt: A checked prompt, without typing mistakes.
        knowledge: Of the model.
        read_part: The whole prompt, or its beginning.
        typed: The prompt as it was typed, if mistakes were corrected; the warning quotes it.
        corrected: Words that were typed -> those in the prompt.
    """
    words = words_of(prompt) if knowledge.words else []
    unknown = [word for word in words if knowledge.words.isdisjoint(word.bases)]
    problems = list(_problems(words, unknown, knowledge))
    if read_part != prompt:
        # The end of what is read tells where the prompt was cut.
        problems.append(f"too long, so cut after {_shortened(read_part[::-1])[::-1]!r}")
    known = [f"the model knows {', '.join(knowledge.actions[:MAX_NAMED])}"] if problems and knowledge.actions else []
    said = [*(f"{typed}: read as {read}" for typed, read in corrected.items()), *problems, *known]
    warning = f"{_shortened(typed or prompt)!r}: {'; '.join(said)}" if said else ""
    return Coverage(warning, tuple(dict.fromkeys(word.text for word in unknown)))


def _problems(words: Sequence[Word], unknown: Sequence[Word], knowledge: Knowledge) -> Iterable[str]:
    # So many unknown words are hardly a matter of the choice of words.
    is_foreign = 2 * len(unknown) > len(words)
    named = list(dict.fromkeys(word.text for word in unknown if is_foreign or _is_important(word)))
    if named:
        yield f"not learned, so without effect: {', '.join(named[:MAX_NAMED])}{', ...' * (len(named) > MAX_NAMED)}"
    if is_foreign:
        yield "write it in the language and style of the training captions"
    actions = set(knowledge.actions)
    if actions and not any(
        actions & word.bases and (word.action or word.bases.isdisjoint(GENERIC_NOUNS)) for word in words
    ):
        yield "it has no action that the model knows"


def _is_important(word: Word) -> bool:
    """Returns whether the motion is another one without the word."""
    kinds = NUMBERS | DIRECTIONS | SIDES
    return bool(word.action and word.action not in LIGHT_VERBS) or word.text in kinds or word.text[0].isdigit()


def _shortened(text: str, longest: int = 50) -> str:
    return text if len(text) <= longest else f"{text[:longest]}..."
