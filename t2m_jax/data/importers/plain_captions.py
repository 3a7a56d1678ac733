"""Captions from plain text, with their tokens and times."""

from t2m_jax.data.captioning.lexicon import tag_words
from t2m_jax.data.texts import Caption, parse_caption
from t2m_jax.errors import UserError


def tagged_caption(text: str, *, source: str, start: str = "", end: str = "") -> Caption:
    """Returns a caption with tokens from plain text.

    Raises:
        UserError: The text has a `#` or no words, a time is not a number, or the end is before the start.
    """
    if "#" in text:
        raise UserError(f"{source}: the caption has a '#', which the text format cannot store; remove it")
    text = " ".join(text.split())
    line = f"{text}#{' '.join(caption_tokens(text, source=source))}#{start.strip() or 0.0}#{end.strip() or 0.0}"
    return with_span(parse_caption(line, source=source), source=source)


def with_span(caption: Caption, *, source: str) -> Caption:
    """Returns a caption of a part of a motion or of all of it; an end of zero is the end of the motion.

    Raises:
        UserError: Its times are no part of a motion.
    """
    if caption.start < 0 or 0 != caption.end <= caption.start:
        raise UserError(
            f"{source}: {caption.start:g} to {caption.end:g} s: the start must be 0 or more, and the end after it"
        )
    return caption


def caption_tokens(text: str, *, source: str) -> tuple[str, ...]:
    """Returns the tokens of a caption.

    Raises:
        UserError: It has no words.
    """
    tokens = tag_words(text)
    if not tokens:
        raise UserError(f"{source}: the caption {text[:40]!r} has no words; say what the motion shows")
    return tokens
