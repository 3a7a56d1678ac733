"""What reads the captions of a model: a pretrained encoder, a network that is trained with the generator, or both.

A pretrained encoder is found by its name, compared, and copied into bundles.
"""

import dataclasses
from pathlib import Path
from typing import Any, ClassVar

from t2m_jax.checkpoints.clip import TrainedClip, load_clip, save_clip
from t2m_jax.checkpoints.encoder_files import PACKAGED_ENCODERS
from t2m_jax.checkpoints.sentence import TrainedSentenceEncoder, load_sentence_encoder, save_sentence_encoder
from t2m_jax.errors import UserError
from t2m_jax.files.arrays import fingerprint
from t2m_jax.models.caption_encoder import CaptionEncoderConfig, NetworkConfig, StateEncoderConfig

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


@dataclasses.dataclass(frozen=True, kw_only=True)
class SentenceStatesConfig:
    """A sentence encoder that is not trained with a model, and a network that is, which reads its token states."""

    kind: ClassVar[str] = "sentence_states"

    encoder: SentenceReference = SentenceReference(name=PACKAGED_ENCODERS[0])
    """The sentence encoder."""
    network: StateEncoderConfig = StateEncoderConfig()
    """Sizes of the network."""


TextEncoderConfig = CaptionEncoderConfig | Reference | SentenceStatesConfig
"""The section `text_encoder` of a model's config."""


def find_text_encoder_config(kind: str) -> type:
    """Returns the config class of a kind of text encoder.

    Raises:
        UserError: The kind is unknown.
    """
    known = (CaptionEncoderConfig, ClipReference, SentenceReference, SentenceStatesConfig)
    schemas: dict[str, type] = {schema.kind: schema for schema in known}
    if kind not in schemas:
        raise UserError(f"{kind!r} is not a text encoder; known: {', '.join(schemas)}")
    return schemas[kind]


def trained_network(config: TextEncoderConfig) -> NetworkConfig | None:
    """Returns the sizes of the network that is trained with the generator, None if there is none."""
    if isinstance(config, SentenceStatesConfig):
        return config.network
    return config if isinstance(config, CaptionEncoderConfig) else None


def pretrained_reference(config: TextEncoderConfig) -> Reference | None:
    """Returns which encoder is not trained, None if there is none."""
    if isinstance(config, SentenceStatesConfig):
        return config.encoder
    return config if isinstance(config, Reference) else None


def with_encoder_name(config: Any, name: str) -> Any:
    """Returns the config of a text encoder whose pretrained encoder is found by another name."""
    if isinstance(config, SentenceStatesConfig):
        return dataclasses.replace(config, encoder=dataclasses.replace(config.encoder, name=name))
    return dataclasses.replace(config, name=name)


def is_packaged(reference: Reference) -> bool:
    """Returns whether an encoder is part of the package. Models do not contain a copy of it."""
    return isinstance(reference, SentenceReference) and reference.name in PACKAGED_ENCODERS


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
    name = reference.name
    is_clip = isinstance(reference, ClipReference)
    encoder: PretrainedEncoder = load_clip(name) if is_clip else load_sentence_encoder(name)
    width = encoder.config.text_dim
    if text_dim not in (None, width):
        wanted = f"the generator reads {text_dim} (model.text_dim)"
        raise UserError(f"{name}: has embeddings of {width} numbers, but {wanted}")
    if reference.identity and reference.identity != encoder_identity(encoder):
        raise UserError(
            f"{name}: is not the text encoder that the model was trained with; its files have changed. "
            "Give the old files, or name their revision (owner/name@revision)"
        )
    return encoder


def included_encoder(config: TextEncoderConfig) -> PretrainedEncoder | None:
    """Returns the encoder that a complete bundle of a model contains; None if there is none, or it is packaged.

    Raises:
        UserError: It cannot be loaded.
    """
    reference = pretrained_reference(config)
    return None if reference is None or is_packaged(reference) else load_pretrained(reference)


def save_pretrained(folder: Path, encoder: PretrainedEncoder) -> None:
    """Writes the files of an encoder into a new folder."""
    if isinstance(encoder, TrainedClip):
        save_clip(folder, encoder)
    else:
        save_sentence_encoder(folder, encoder)
