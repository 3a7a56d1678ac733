"""Which pretrained encoder reads the captions of a model: found by its name, compared, and copied into bundles."""

import dataclasses
from pathlib import Path
from typing import ClassVar

from t2m_jax.checkpoints.clip import TrainedClip, load_clip, save_clip
from t2m_jax.checkpoints.sentence import TrainedSentenceEncoder, load_sentence_encoder, save_sentence_encoder
from t2m_jax.errors import UserError
from t2m_jax.files.arrays import fingerprint

CLIP_NAME = "openai/clip-vit-base-patch32"
"""The CLIP of T2M-GPT on the Hugging Face hub."""
SENTENCE_NAME = "sentence-transformers/all-MiniLM-L6-v2"
"""A small sentence encoder on the Hugging Face hub: 23 M parameters, embeddings of 384 numbers."""

PretrainedEncoder = TrainedClip | TrainedSentenceEncoder

_PROBE = "A person walks 3 steps forward, then turns to the left. ¿Qué? 跳"
"""Its tokens tell tokenizers apart."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class ClipReference:
    """A CLIP that reads the captions of a model and is not trained with it."""

    kind: ClassVar[str] = "clip"

    name: str = CLIP_NAME
    """Folder, or name on the Hugging Face hub. A folder `clip` in the bundle is used first."""
    identity: str = dataclasses.field(default="", repr=False)
    """The `encoder_identity` of the encoder that the model was trained with; empty if it is not known."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class SentenceReference:
    """A sentence encoder that reads the captions of a model and is not trained with it."""

    kind: ClassVar[str] = "sentence"

    name: str = SENTENCE_NAME
    """Folder, or name on the Hugging Face hub. A folder `sentence` in the bundle is used first."""
    identity: str = dataclasses.field(default="", repr=False)
    """The `encoder_identity` of the encoder that the model was trained with; empty if it is not known."""


Reference = ClipReference | SentenceReference


def encoder_identity(encoder: PretrainedEncoder) -> str:
    """Returns what identifies an encoder in files.

    The encoder's `fingerprint` is for caches: it changes with versions of this package and of `tokenizers`.
    """
    config = encoder.config
    tokens = encoder.tokenizer.encode(_PROBE, add_special_tokens=False).ids
    how = "" if isinstance(encoder, TrainedClip) else f"{encoder.config.pooling} {encoder.config.normalize}"
    return fingerprint(f"{tokens} {config.max_length} {how}", encoder.variables)


def load_pretrained(reference: Reference, *, text_dim: int | None = None) -> PretrainedEncoder:
    """Returns the encoder that a model refers to.

    Args:
        reference: The encoder.
        text_dim: Width of the embeddings that the generator reads.

    Raises:
        UserError: It cannot be found, is damaged, has another width, or is not the one of the model's training.
    """
    encoder: PretrainedEncoder
    if isinstance(reference, ClipReference):
        encoder = load_clip(reference.name, text_dim=text_dim)
    else:
        encoder = load_sentence_encoder(reference.name, text_dim=text_dim)
    if reference.identity and reference.identity != encoder_identity(encoder):
        raise UserError(
            f"{reference.name}: is not the text encoder that the model was trained with; its files have changed. "
            "Give the old files, or name their revision (owner/name@revision)"
        )
    return encoder


def save_pretrained(folder: Path, encoder: PretrainedEncoder) -> None:
    """Writes the files of an encoder into a new folder."""
    if isinstance(encoder, TrainedClip):
        save_clip(folder, encoder)
    else:
        save_sentence_encoder(folder, encoder)
