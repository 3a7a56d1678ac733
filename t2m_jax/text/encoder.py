"""The interface of text encoders."""

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

from jaxtyping import Array, Float


@runtime_checkable
class TextEncoder(Protocol):
    """A function from captions to embeddings, such as the trained caption encoder or CLIP."""

    def __call__(self, captions: Sequence[str]) -> Float[Array, "B E"]:
        """Returns one embedding per caption."""


@runtime_checkable
class CuttingTextEncoder(TextEncoder, Protocol):
    """A text encoder that can say which part of a long caption it reads."""

    def read_part(self, caption: str) -> str:
        """Returns the caption up to its last subword that is read."""
