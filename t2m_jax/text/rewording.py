"""Other wordings of a caption with the same meaning, by rules: another subject, form of the verb, or article.

They help a model that has few captions to learn which words matter.
"""

from collections.abc import Sequence

import numpy as np

from t2m_jax.text.verbs import AUXILIARIES, BODY_PARTS, PREPOSITIONS, SIDES, Word, inflected, words_of

# fmt: off
PEOPLE = (
    "a person", "someone", "somebody", "a man", "a woman", "the man", "the woman", "he", "she", "a human", "a figure",
    "a boy", "a girl", "a child", "a guy", "a lady", "an adult", "a teenager", "a friend", "a neighbor", "a player",
    "a worker", "an athlete", "an actor", "a hero", "a student", "a teacher", "a stranger", "a gentleman", "a host",
)
# fmt: on
ARTICLES = ("the", "his", "her", "their")
"""Words that may stand before a part of the body."""
LONGEST_SUBJECT = 2
"""Words of a subject that may be exchanged. Longer ones often say how a person moves, as in `a tired man walks`."""


def reword(caption: str, generator: np.random.Generator) -> str:
    """Returns another wording of a caption, in lower case and without punctuation; `generator` draws it.

    Words with a meaning of their own stay, such as sides, numbers and directions. Only the subject may change, because
    who moves says little about the motion.
    """
    words = words_of(caption)
    texts = [_article(words, place, generator) for place in range(len(words))]
    verb = next((place for place, word in enumerate(words) if word.action), None)
    if verb is not None and _is_subject(words[:verb]):
        texts[: verb + 1] = [_clause([word.text for word in words[:verb]], words[verb].action, generator)]
    return " ".join(texts)


def _article(words: Sequence[Word], place: int, generator: np.random.Generator) -> str:
    """Returns a word, or, before a part of the body, one that means the same there."""
    text = words[place].text
    is_before_part = any(not BODY_PARTS.isdisjoint(word.bases) for word in words[place + 1 : place + 3])
    return str(generator.choice(ARTICLES)) if text in ARTICLES and is_before_part else text


def _is_subject(words: Sequence[Word]) -> bool:
    """Returns whether the words before a verb are a short subject and, at most, `is`."""
    others = (AUXILIARIES - {"is"}) | PREPOSITIONS | SIDES | {"not", "they", "we", "you", "i", "people"}
    texts = [word.text for word in words if word.text != "is"]
    return len(texts) <= LONGEST_SUBJECT and others.isdisjoint(texts)


def _clause(subject: Sequence[str], verb: str, generator: np.random.Generator) -> str:
    """Returns the given subject, or another, with a form of a verb; or the verb alone."""
    own = " ".join(word for word in subject if word != "is")
    who = own if own and generator.random() < 0.5 else str(generator.choice(PEOPLE))
    tag = str(generator.choice(("VBZ", "VBG", "VBG alone", "VB")))
    form = inflected(verb, tag.split()[0])
    return {"VBZ": f"{who} {form}", "VBG": f"{who} is {form}"}.get(tag, form)
