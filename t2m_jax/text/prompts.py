"""Checks of the captions that users type."""

import unicodedata

from t2m_jax.errors import UserError

MAX_PROMPT_LENGTH = 1000
"""Characters. The captions of the published data sets are far shorter."""

_QUOTES = dict.fromkeys("\u02bc\u2018\u2019\u201a\u201b", "'") | dict.fromkeys("\u201c\u201d\u201e\u201f", '"')
_STRAIGHT_QUOTES = str.maketrans(_QUOTES)
# Marks that are typed for an apostrophe, the sign of degrees, and characters that cannot be seen and say nothing.
_INVISIBLE = dict.fromkeys("\u00ad\u200b\u200c\u200d\u2060\ufeff", "")
_CLEANED = str.maketrans({"`": "'", "\u00b4": "'", "\u00b0": " degrees "} | _INVISIBLE)

_REFUSED_CATEGORIES = {
    "Cc": "a control character",
    "Cf": "an invisible formatting character",
    "Cs": "half of a character",
    "Co": "a character without a meaning",
    "Cn": "a character without a meaning",
    "So": "the emoji or symbol",
    "Sk": "the symbol",
}


def straighten_quotes(text: str) -> str:
    """Returns a text with straight quotes in place of curly ones, as the original's `ftfy.fix_text` does for CLIP."""
    return text.translate(_STRAIGHT_QUOTES)


def check_prompt(prompt: str, name: str = "prompt") -> str:
    """Returns the prompt with straight quotes and single spaces, `degrees` for `°`, and no zero-width characters.

    Args:
        prompt: What was typed.
        name: What errors call it.

    Raises:
        UserError: The prompt has no words, is longer than `MAX_PROMPT_LENGTH`, or contains characters that captions
            never have (control characters, emoji and other symbols).
    """
    prompt = straighten_quotes(prompt).translate(_CLEANED)
    if len(prompt) > MAX_PROMPT_LENGTH:
        raise UserError(f"{name}: {len(prompt):,} characters; describe the motion in at most {MAX_PROMPT_LENGTH:,}")
    for character in prompt:
        category = unicodedata.category(character)
        if category in _REFUSED_CATEGORIES and character not in "\t\n\r":
            kind = _REFUSED_CATEGORIES[category]
            shown = character if character.isprintable() else f"(U+{ord(character):04X})"
            raise UserError(f"{name}: {kind} {shown} cannot be read; leave it out and describe the motion in words")
    folded = " ".join(prompt.split())
    if not any(character.isalnum() for character in folded):
        raise UserError(f"{name}: {folded!r} has no words; describe the motion, e.g. 'a person walks forward'")
    return folded
