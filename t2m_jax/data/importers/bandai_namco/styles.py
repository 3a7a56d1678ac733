"""How people put the styles of the Bandai-Namco data set into words: adverbs, phrases, adjectives and who moves so."""

from typing import NamedTuple

from t2m_jax.data.importers.bandai_namco.grammar import Subject


class Style(NamedTuple):
    """Ways of saying how a style moves."""

    adverbs: tuple[str, ...] = ()
    """before the verb or at the end"""
    phrases: tuple[str, ...] = ()
    """at the end"""
    adjectives: tuple[str, ...] = ()
    """of the subject"""
    subjects: tuple[Subject, ...] = ()
    """who typically moves so"""


SUBJECTS = (
    Subject("a person", "their"),
    Subject("a person", "his"),
    Subject("a person", "the"),
    Subject("the person", "their"),
    Subject("someone", "their"),
    Subject("somebody", "their"),
    Subject("a man", "his"),
    Subject("the man", "his"),
    Subject("a woman", "her"),
    Subject("he", "his"),
    Subject("she", "her"),
    Subject("a figure", "its"),
    Subject("the figure", "its"),
    Subject("a human", "their"),
    Subject("a character", "their"),
    Subject("an adult", "their"),
    Subject("a guy", "his"),
)
"""Subjects that say nothing about the style; "a person" three times because most people write it."""

_WOMEN = (Subject("a woman", "her"), Subject("a lady", "her"), Subject("a girl", "her"), Subject("she", "her"))
_MEN = (Subject("a man", "his"), Subject("a guy", "his"), Subject("a gentleman", "his"), Subject("he", "his"))
_OLD = (
    Subject("an old man", "his"),
    Subject("an old woman", "her"),
    Subject("an elderly person", "their"),
    Subject("a senior", "their"),
    Subject("a grandmother", "her"),
    Subject("a grandfather", "his"),
)
_ELDERLY = Style(
    ("slowly", "carefully", "stiffly", "weakly"),
    ("like an old person", "like an elderly man", "like an elderly woman", "like a senior", "like an aged person",
     "as if very old", "in an elderly way"),
    ("old", "elderly", "aged"),
    _OLD,
)  # fmt: skip
_TIRED = Style(
    ("tiredly", "wearily", "sluggishly", "heavily"),
    ("as if exhausted", "like a very tired person", "with no energy", "without any energy", "in a tired way",
     "like someone who is exhausted", "as if worn out"),
    ("tired", "exhausted", "weary"),
)  # fmt: skip
_MASCULINE = Style(
    ("firmly", "strongly", "boldly"),
    ("like a man", "in a masculine way", "like a tough guy", "in a manly way", "like a strong man"),
    ("masculine", "manly", "strong", "tough"),
    _MEN,
)

STYLES: dict[str, Style] = {
    "normal": Style(
        ("normally", "calmly"), ("in a normal way", "at a normal pace", "in a relaxed way", "in the usual way")
    ),
    "active": Style(
        ("energetically", "actively", "briskly", "vigorously"),
        ("with a lot of energy", "in an active way", "full of energy", "in a lively way", "with vigor"),
        ("energetic", "active", "lively"),
    ),
    "elderly": _ELDERLY,
    "old": _ELDERLY,
    "exhausted": _TIRED,
    "tired": _TIRED,
    "feminine": Style(
        ("gracefully", "elegantly", "gently"),
        ("like a woman", "in a feminine way", "like a lady", "in a graceful way", "in an elegant manner"),
        ("feminine", "elegant", "graceful"),
        _WOMEN,
    ),
    "masculine": _MASCULINE,
    "masculinity": _MASCULINE,
    "youthful": Style(
        ("youthfully", "lightly"),
        ("like a young person", "in a youthful way", "like a teenager", "with youthful energy", "like a student"),
        ("young", "youthful"),
        (Subject("a teenager", "their"), Subject("a young person", "their"), Subject("a student", "their")),
    ),
    "angry": Style(
        ("angrily", "furiously"),
        ("in anger", "like an angry person", "in an angry way", "full of anger", "as if angry"),
        ("angry", "furious"),
    ),
    "childish": Style(
        ("childishly", "playfully"),
        ("like a child", "like a little kid", "in a childish way", "like a small child"),
        ("childish", "playful"),
        (Subject("a child", "their"), Subject("a kid", "their")),
    ),
    "chimpira": Style(
        (),
        ("like a gangster", "like a thug", "with a swagger", "like a street punk", "like a tough gangster"),
        ("tough",),
        (Subject("a gangster", "his"), Subject("a thug", "his")),
    ),
    "giant": Style(
        ("heavily",),
        ("like a giant", "like a huge monster", "with heavy movements", "like a giant monster"),
        ("giant", "huge"),
        (Subject("a giant", "its"), Subject("a huge monster", "its")),
    ),
    "happy": Style(
        ("happily", "cheerfully", "joyfully"),
        ("in a good mood", "like a happy person", "full of joy", "in a happy way", "as if very happy"),
        ("happy", "cheerful"),
    ),
    "musical": Style(
        ("theatrically", "dramatically"),
        ("as if on stage", "like an actor in a musical", "in a theatrical way", "like a performer on stage"),
        ("theatrical",),
        (Subject("an actor", "their"), Subject("a performer", "their")),
    ),
    "not-confident": Style(
        ("shyly", "timidly", "hesitantly", "nervously"),
        ("without confidence", "like a shy person", "in a shy way", "as if not confident"),
        ("shy", "timid", "nervous"),
    ),
    "proud": Style(
        ("proudly", "confidently"),
        ("with pride", "like a proud person", "in a proud way", "full of pride"),
        ("proud", "confident"),
    ),
    "sad": Style(
        ("sadly", "gloomily"),
        ("in a sad mood", "like a sad person", "in a sad way", "as if very sad", "full of sadness"),
        ("sad", "unhappy"),
    ),
}
"""Style label -> ways of saying it."""
