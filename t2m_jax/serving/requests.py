"""What users ask the server for: one request is one motion, or several samples of it."""

import base64
import binascii
import dataclasses
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

from t2m_jax.config import check_seed, config_from_dict
from t2m_jax.errors import UserError
from t2m_jax.text.prompts import check_prompt

MAX_CAPTIONS = 20
"""Sentences of a chain."""
MAX_SAMPLES = 8
"""Motions of a request, so that no user fills the batches of the others."""
MAX_SECONDS = 60.0
"""For a sentence."""
MAX_TOTAL_SECONDS = 600.0
"""Of all samples of a request, if it says how long they are, and of a file."""
MAX_BODY = 16 * 2**20
"""Bytes of a request: a motion of ten minutes."""

MAX_GUIDANCE_SCALE = 20.0

Variety = Literal["normal", "low", "greedy"]
TEMPERATURES: Mapping[str, float] = {"normal": 1.0, "low": 0.7, "greedy": 0.0}
"""A few, because each is a program of its own."""
INPUT_FORMATS = ("npz", "bvh", "glb")


@dataclasses.dataclass(frozen=True, kw_only=True)
class MotionRequest:
    """The fields of `POST /motions`."""

    captions: tuple[str, ...]
    """Sentences; several become one motion that shows them in turn."""
    seed: int | None = None
    """From 0 to 2**32 - 1; by default a random one."""
    num_samples: int = 1
    """Motions to make."""
    seconds: float | None = None
    """Length for each sentence; by default the model decides."""
    variety: Variety = "normal"
    """How surprising the codes are that the model chooses."""
    guidance_scale: float | None = None
    """Strength of the text; by default the model's own."""
    edit: Literal["continue", "redo", "vary"] | None = None
    """What to do with `motion`."""
    motion: str | None = None
    """A motion file in base64."""
    motion_format: Literal["npz", "bvh", "glb"] = "npz"
    """The format of `motion`."""
    span: tuple[float, float] | None = None
    """Seconds to replace, for `redo`."""
    strength: float = 0.3
    """Share of the codes that are sampled again, for `vary`."""

    def __post_init__(self) -> None:
        if not 1 <= len(self.captions) <= MAX_CAPTIONS:
            raise UserError(f"captions: give 1 to {MAX_CAPTIONS} sentences, not {len(self.captions)}")
        object.__setattr__(self, "captions", tuple(check_prompt(caption) for caption in self.captions))
        if self.seed is not None:
            check_seed(self.seed)
        if not 1 <= self.num_samples <= MAX_SAMPLES:
            raise UserError(f"num_samples: {self.num_samples} is not a whole number from 1 to {MAX_SAMPLES}")
        if self.guidance_scale is not None and not 0 <= self.guidance_scale <= MAX_GUIDANCE_SCALE:
            raise UserError(f"guidance_scale: {self.guidance_scale:g} is not a number from 0 to {MAX_GUIDANCE_SCALE:g}")
        if not 0 <= self.strength <= 1:
            raise UserError(f"strength: {self.strength:g} is not a number from 0 to 1")
        self._check_length()
        self._check_edit()

    def _check_length(self) -> None:
        if self.seconds is None:
            return
        if not 0 < self.seconds <= MAX_SECONDS:
            raise UserError(f"seconds: {self.seconds:g} is not a number above 0, up to {MAX_SECONDS:g}")
        if self.seconds * len(self.captions) * self.num_samples > MAX_TOTAL_SECONDS:
            raise UserError(f"seconds: all motions together would be longer than {MAX_TOTAL_SECONDS:g} seconds")

    def _check_edit(self) -> None:
        if (self.edit is None) != (self.motion is None):
            raise UserError("edit: goes together with motion, the file that is changed")
        if (self.edit == "redo") != (self.span is not None):
            raise UserError("span: goes together with the edit 'redo', the part that is replaced")
        if self.edit in ("redo", "vary") and (len(self.captions) > 1 or self.seconds is not None):
            raise UserError(f"edit: {self.edit!r} takes one sentence and no length")

    @property
    def is_plain(self) -> bool:
        """Whether it is one sentence, which is generated in a batch with those of other users."""
        return len(self.captions) == 1 and self.seconds is None and self.edit is None


def request_from_json(data: Any) -> MotionRequest:
    """Returns the request in the body of `POST /motions`.

    Raises:
        UserError: A field is unknown, missing, or has a value that cannot be used.
    """
    if not isinstance(data, dict):
        raise UserError("request: expected an object with captions")
    return config_from_dict(MotionRequest, data, source="request")


def decode_base64(text: str) -> bytes:
    """Returns the bytes of a text in base64.

    Raises:
        UserError: It is not base64.
    """
    try:
        return base64.b64decode(text, validate=True)
    except (binascii.Error, ValueError):
        raise UserError("motion: is not base64") from None


@contextmanager
def motion_file(data: bytes, suffix: str) -> Iterator[Path]:
    """Writes a motion of a user into a file, whose name the user does not choose; it is deleted after the block."""
    with tempfile.TemporaryDirectory(prefix="t2m-") as folder:
        path = Path(folder) / f"motion.{suffix}"
        path.write_bytes(data)
        yield path
