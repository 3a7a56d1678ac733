"""What a model can know of a prompt: the words and actions of the captions that it was trained on."""

import itertools
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

from t2m_jax.text.counts import uncounted
from t2m_jax.text.meanings import Embed, Meanings, Nearest, sentence_of
from t2m_jax.text.paces import GAITS
from t2m_jax.text.path_shapes import find_path_shape
from t2m_jax.text.quantities import quantity_words, unread_amounts
from t2m_jax.text.spelling import has_foreign_word
from t2m_jax.text.subjects import subject_problems
from t2m_jax.text.verbs import GENERIC_NOUNS, LIGHT_VERBS, SIDES, Word, clause_before, readings, word_set, words_of

MIN_USES = 100
"""A word is known if the captions use it this often."""
USES_SHARE = 1e-4
"""In small data sets, a word is known if this share of all words is it."""
MIN_CLIPS = 20
"""An action is known if the captions of this many clips have the verb."""
CLIPS_SHARE = 1 / 200
"""In small data sets, an action is known if the captions of this share of the clips have the verb."""
MIN_LABELS = 30
"""Labels of a data set that tell verbs of actions from those that any caption may have."""
GENERIC_SHARE = 0.3
"""A verb is no action if the captions of this share of the labels have it, such as `show` or `want`."""
OWN_SHARE = 0.3
"""A verb is an action if this share of the clips of a label has it: of sitting down, `sit` and not `eat`."""
OWN_CLIPS = 8
"""Clips of such a label, at least."""
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

NOT = frozenset({"never", "nobody", "not"})
"""Words before what is not done. Others, such as "without" in "without stopping", hardly matter."""


class PromptWarning(UserWarning):
    """The model cannot know what the prompt asks for."""


class Knowledge(NamedTuple):
    """The words and actions that a model was trained on often enough."""

    words: frozenset[str]
    """In lower case, as used or in their basic form."""
    actions: tuple[str, ...]
    """Basic forms of verbs, the most frequent first; empty if the model's record does not have them."""
    meanings: Meanings | None = None
    """Finds those of the actions that are nearest to another one, and what the data lack, if the model has a sentence
    encoder."""
    taught: frozenset[str] = frozenset()
    """Those of the words that no caption taught, but sentences that mean what captions do (`t2m teach`)."""

    @property
    def is_labeled(self) -> bool:
        """Whether labels told what the motions are, so that captions are those of the grammar."""
        return self.meanings is not None and self.meanings.are_labeled


class Coverage(NamedTuple):
    """What a model knows of a prompt."""

    warning: str
    """What it cannot know, in a line; empty if it may know all that matters."""
    unknown_words: tuple[str, ...]
    """All words that it did not learn, also those that matter little."""


def count_actions(
    captions: Iterable[Sequence[str]],
    labels: Sequence[str] = (),
    *,
    learned: Iterable[str] = (),
    missing: Iterable[str] = (),
) -> dict[str, int]:
    """Returns the number of clips per action of their captions, the most frequent action first.

    Args:
        captions: Of each clip.
        labels: Of each clip, if they are known; empty for clips without one. With many labels, verbs of many of them
            are left out, and verbs that no label has often.
        learned: Plain sentences for actions of the labels, whose verbs are counted in any case.
        missing: Plain sentences for actions without a clip. Their verbs are left out: captions have them in another
            sense, as "throws punches" does.
    """
    verbs = [{word.action for caption in of_clip for word in words_of(caption)} for of_clip in captions]
    counts = Counter(itertools.chain.from_iterable(verbs))
    is_action = _find_own_verbs(verbs, labels) if len(set(labels) - {""}) >= MIN_LABELS else counts.keys()
    left_out = LIGHT_VERBS | {""} | (_verbs(missing) - _verbs(learned))
    is_action = (is_action | _verbs(learned)) - left_out
    return {verb: count for verb, count in counts.most_common() if verb in is_action}


def _verbs(sentences: Iterable[str]) -> set[str]:
    return {word.action for sentence in sentences for word in words_of(sentence)}


def _find_own_verbs(verbs: Sequence[set[str]], labels: Sequence[str]) -> set[str]:
    """Returns the verbs that some labels have often, and few have at all."""
    uses: dict[str, Counter[str]] = {}
    clips = Counter(labels)
    for of_clip, label in zip(verbs, labels, strict=True):
        if label:
            uses.setdefault(label, Counter()).update(of_clip)
    num_labels = Counter(itertools.chain.from_iterable(uses.values()))
    own = {
        verb
        for label, counts in uses.items()
        for verb, count in counts.items()
        if clips[label] >= OWN_CLIPS and count >= OWN_SHARE * clips[label]
    }
    return {verb for verb in own if num_labels[verb] <= GENERIC_SHARE * len(uses)}


def make_knowledge(training_data: Mapping[str, Any] | None, embed: Embed | None = None) -> Knowledge:
    """Returns what a model knows, from the record of its training data; nothing if there is none.

    `embed` is the model's sentence encoder.
    """
    training_data = training_data or {}
    words = training_data.get("words", {})
    actions = training_data.get("actions", {})
    uses = min(MIN_USES, USES_SHARE * sum(words.values()))
    clips = min(MIN_CLIPS, CLIPS_SHARE * training_data.get("num_clips", 0))
    known = tuple(sorted((name for name in actions if actions[name] >= clips), key=lambda name: -actions[name]))
    contrast = {name: training_data.get(name, ()) for name in ("learned", "missing")}
    in_captions = frozenset(word for word, count in words.items() if count >= uses)
    taught = frozenset(training_data.get("taught", ()))
    return Knowledge(
        words=in_captions | taught,
        actions=known,
        meanings=None if embed is None else Meanings(known, embed, **contrast),
        taught=taught - in_captions,
    )


def check_coverage(
    prompt: str,
    knowledge: Knowledge,
    *,
    read_part: str,
    typed: str = "",
    corrected: Mapping[str, str] = MappingProxyType({}),
    countable: Collection[str] = (),
) -> Coverage:
    """Returns what a model knows of a prompt, of which its text encoder reads only `read_part`.

    If there is no record of the model's training data, only what is not read can be told.

    Args:
        prompt: A checked prompt, without typing mistakes.
        knowledge: Of the model.
        read_part: The whole prompt, or its beginning.
        typed: The prompt as it was typed, if mistakes were corrected; the warning quotes it.
        corrected: Words that were typed -> those in the prompt.
        countable: Basic forms of the verbs whose number is followed.
    """
    words = words_of(prompt) if knowledge.words else []
    followed = quantity_words(prompt, countable)
    unknown = [word for word in _unknown_words(words, knowledge) if word.text not in followed]
    amounts = dict(_unread_amounts(prompt, unknown, knowledge))
    in_amounts = frozenset(word.text for amount in amounts for word in words_of(amount))
    problems = [
        *_problems(words, [word for word in unknown if word.text not in in_amounts], knowledge),
        *(f"{amount}: without effect; {advice}" for amount, advice in amounts.items()),
        *_path_problems(prompt, unknown, knowledge),
        *(f"{times}: {problem}" for times, problem in uncounted(prompt, countable)),
    ]
    if read_part != prompt:
        # The end of what is read tells where the prompt was cut.
        problems.append(f"too long, so cut after {_shortened(read_part[::-1])[::-1]!r}")
    known = [f"the model knows {', '.join(knowledge.actions[:MAX_NAMED])}"] if problems and knowledge.actions else []
    said = [*(f"{typed}: read as {read}" for typed, read in corrected.items()), *problems, *known]
    warning = f"{_shortened(typed or prompt)!r}: {'; '.join(said)}" if said else ""
    return Coverage(warning, tuple(dict.fromkeys(word.text for word in unknown)))


def _problems(words: Sequence[Word], unknown: Sequence[Word], knowledge: Knowledge) -> Iterator[str]:
    texts = [word.text for word in unknown]
    # So many words that are in no dictionary are hardly a matter of the choice of words.
    foreign = [text for text in texts if not (readings(text) or text[0].isdigit())]
    is_foreign = 2 * len(foreign) > len(words) or has_foreign_word(texts, knowledge.words)
    nearest = {} if is_foreign else _nearest_actions(words, unknown, knowledge)
    for text, found in nearest.items():
        if not found.is_same:
            yield f"{text}: not known; nearest: {', '.join(found.actions)}"
    named = dict.fromkeys(word.text for word in unknown if is_foreign or _is_important(word))
    without_effect = [text for text in named if text not in nearest]
    if without_effect:
        more = ", ..." * (len(without_effect) > MAX_NAMED)
        yield f"not learned, so without effect: {', '.join(without_effect[:MAX_NAMED])}{more}"
    if is_foreign:
        yield f"write it in {'English' if 'the' in knowledge.words else 'the language of the training captions'}"
    if knowledge.words:
        yield from subject_problems(words)
    if undone := _undone(words, knowledge.actions):
        yield f"not {undone}: words like 'not' have no effect; say what the person does"
    if not knowledge.actions or not all(found.is_same for found in nearest.values()):
        return
    missing = "" if is_foreign else _missing(words, knowledge)
    if missing:
        yield f"the training data have no motion like {missing!r}"
    elif not nearest and not has_action(words, _with_gaits(knowledge.actions)):
        yield from _no_action(words, knowledge)


def _undone(words: Sequence[Word], actions: Collection[str]) -> str:
    """Returns a known action that a prompt says is not done, "" if there is none."""
    for place, word in enumerate(words):
        before = clause_before(words, place)
        # Behind "no", it is a noun: "no jumping".
        is_prohibited = before[-1:] == ["no"] and word.text.endswith("ing") and not word.bases.isdisjoint(actions)
        if is_prohibited or (word.action in actions and not NOT.isdisjoint(before[-2:])):
            return word.text
    return ""


def _missing(words: Sequence[Word], knowledge: Knowledge) -> str:
    """Returns a plain sentence for what a prompt asks and the model did not learn, "" if there is none."""
    meanings = knowledge.meanings
    if meanings is None:
        return ""
    text = _joined(words)
    missing = meanings.missing(text)
    # That "the bolt of the door" was in a sentence about waving says nothing about tightening bolts.
    captions = knowledge._replace(words=knowledge.words - knowledge.taught)
    if missing or not _unknown_words(words, captions):
        return missing
    activity = meanings.activity(text)
    in_activity = words_of(activity)
    # The captions may have taught it, although nothing says so in plain sentences.
    is_learned = has_action(in_activity, captions.actions) and not _unknown_words(in_activity, captions)
    return "" if is_learned else activity


def _unknown_words(words: Iterable[Word], knowledge: Knowledge) -> list[Word]:
    return [word for word in words if knowledge.words.isdisjoint(word.bases)]


def _path_problems(prompt: str, unknown: Sequence[Word], knowledge: Knowledge) -> Iterator[str]:
    """Yields the option that gives the path the shape that a prompt says, if captions had none, as the grammar."""
    shape = find_path_shape(prompt)
    if shape is not None and (knowledge.is_labeled or any(shape.name in word.bases for word in unknown)):
        yield f"{shape.name}: words do not shape the path; {shape.option}"


def _unread_amounts(prompt: str, unknown: Sequence[Word], knowledge: Knowledge) -> Iterator[tuple[str, str]]:
    """Yields what `unread_amounts` finds, if captions of the grammar have no such amounts, or lack a word of it."""
    texts = {word.text for word in unknown}
    for amount, advice in unread_amounts(prompt):
        if knowledge.is_labeled or any(word.text in texts for word in words_of(amount)):
            yield amount, advice


def _nearest_actions(words: Sequence[Word], unknown: Sequence[Word], knowledge: Knowledge) -> dict[str, Nearest]:
    """Returns what is nearest to each unknown action of a prompt."""
    if knowledge.meanings is None or not knowledge.actions:
        return {}
    places = [place for place, word in enumerate(words) if word in unknown and _is_action(word)][:MAX_NAMED]
    return {words[place].text: knowledge.meanings.nearest(sentence_of(words, place)) for place in places}


def has_action(words: Iterable[Word], actions: Collection[str]) -> bool:
    """Returns whether words have one of some actions, such as those that a model knows."""
    known = set(actions)
    return any(known & word.bases and (word.action or word.bases.isdisjoint(GENERIC_NOUNS)) for word in words)


def _no_action(words: Sequence[Word], knowledge: Knowledge) -> Iterator[str]:
    """Yields that a prompt has no known action, unless it says one in other words: "goes ahead"."""
    if knowledge.meanings is None:
        yield "it has no action that the model knows"
        return
    # "Gets up" and "gives a round of applause" are actions, although their verbs say nothing.
    places = [place for place, word in enumerate(words) if word.action][:MAX_NAMED]
    texts = [sentence_of(words, place, is_long=is_long) for place in places for is_long in (False, True)]
    found = [knowledge.meanings.nearest(text) for text in dict.fromkeys([*texts, _joined(words)])]
    if not any(near.is_same for near in found):
        named = f"; nearest: {', '.join(found[0].actions)}" if found[0].is_near else ""
        yield f"it has no action that the model knows{named}"


def _with_gaits(actions: Collection[str]) -> frozenset[str]:
    """Returns actions with other verbs for the same gaits, such as `trudge`, which captions have too rarely."""
    return frozenset(actions).union(*(verbs for gait, verbs in GAITS.items() if gait in actions))


def _joined(words: Sequence[Word]) -> str:
    return " ".join(word.text for word in words)


def _is_action(word: Word) -> bool:
    return bool(word.action) and word.action not in LIGHT_VERBS


def _is_important(word: Word) -> bool:
    """Returns whether the motion is another one without the word."""
    return _is_action(word) or word.text in NUMBERS | DIRECTIONS | SIDES or word.text[0].isdigit()


def _shortened(text: str, longest: int = 50) -> str:
    return text if len(text) <= longest else f"{text[:longest]}..."
