"""The interface of text encoders."""

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

from jaxtyping import Array, Float


@runtime_checkable
class TextEncoder(Protocol):
    """A function from captions to embeddings, such as the trained caption encoder or CLIP."""

    def __call__(self, captions: Sequence[str]) -> Float[Array, "B E"]:
        """Returns one embedding per caption."""
