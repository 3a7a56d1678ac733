"""What a text encoder is to the rest of the package."""

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

from jaxtyping import Array, Float


@runtime_checkable
class TextEncoder(Protocol):
    """Turns captions into embeddings; the trained caption encoder and CLIP both are one."""

    def __call__(self, captions: Sequence[str]) -> Float[Array, "B E"]:
        """Returns one embedding a caption."""
        ...
