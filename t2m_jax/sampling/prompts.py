"""Prompts, with what the model knows of them."""

import warnings
from collections.abc import Sequence
from typing import NamedTuple

from t2m_jax.text.coverage import Knowledge, PromptWarning, check_coverage
from t2m_jax.text.encoder import CuttingTextEncoder, TextEncoder
from t2m_jax.text.prompts import check_prompt


class Prompt(NamedTuple):
    """A sentence for the text encoder."""

    text: str
    """What the encoder gets."""
    warning: str
    """Why the motion cannot be what the sentence says, in a line; empty if it may be."""
    unknown_words: tuple[str, ...]
    """Words that the model did not learn."""


def read_prompts(captions: Sequence[str] | str, knowledge: Knowledge, encoder: TextEncoder) -> list[Prompt]:
    """Returns the prompts of a single sentence or of several, cleaned and checked.

    Warns:
        PromptWarning: The model cannot know what a sentence asks for.

    Raises:
        UserError: A sentence cannot be used.
    """
    prompts = []
    for caption in [captions] if isinstance(captions, str) else captions:
        text = check_prompt(caption)
        read_part = encoder.read_part(text) if isinstance(encoder, CuttingTextEncoder) else text
        prompts.append(Prompt(text, *check_coverage(text, knowledge, read_part=read_part)))
    for warning in dict.fromkeys(prompt.warning for prompt in prompts):
        if warning:
            warnings.warn(warning, PromptWarning, stacklevel=4)
    return prompts
