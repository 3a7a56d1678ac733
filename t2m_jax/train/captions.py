"""How the captions of a data set are read for the training of a generator, once for all: by subwords, or pretrained."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from tokenizers import Tokenizer

from t2m_jax.checkpoints.bundle import Bundle, load_bundle_config
from t2m_jax.checkpoints.encoder_files import find_encoder
from t2m_jax.checkpoints.model import load_model
from t2m_jax.checkpoints.sentence import SENTENCE_FILES, read_sentence_config
from t2m_jax.checkpoints.text_encoder import (
    ClipReference,
    Reference,
    SentenceReference,
    SentenceStatesConfig,
    TextEncoderConfig,
    encoder_identity,
    load_pretrained,
    pretrained_reference,
    trained_network,
)
from t2m_jax.data.banks.codes import Captions
from t2m_jax.data.cache import STATES_NAME, cache_places
from t2m_jax.errors import UserError
from t2m_jax.models.caption_encoder import StateEncoderConfig
from t2m_jax.sampling.text_encoders import PretrainedTextEncoder, SentenceStates, make_text_encoder
from t2m_jax.text.bpe import largest_token, load_bpe, tokenize_captions, train_bpe
from t2m_jax.text.caption_states import open_state_table
from t2m_jax.text.embedding_cache import EmbeddingCache
from t2m_jax.text.encoder import TextEncoder
from t2m_jax.train.tokenize import CodedMotion


class OpenedEncoder(NamedTuple):
    """The text encoder of a training."""

    config: TextEncoderConfig
    """Of the bundle."""
    encoder: PretrainedTextEncoder | None = None
    """Gives embeddings that stay as they are."""
    states: SentenceStates | None = None
    """Gives the states that the trained network reads."""


class CaptionReader(NamedTuple):
    """How captions are read for training."""

    read: Callable[[Sequence[str]], Captions]
    """From captions to tokens or token states, for the network that is trained, or to embeddings."""
    bpe: Tokenizer | None
    """Subwords of the caption encoder; None without one."""
    make_encoder: Callable[[Bundle], TextEncoder]
    """From a model with the weights of now to its text encoder."""


def state_width(config: Any, *, resume: bool) -> int:
    """Returns the width of the token states of a training's sentence encoder, or of the run that it resumes.

    Raises:
        UserError: The encoder cannot be found, or is of another family.
    """
    # A run knows the width, so one that goes on looks for no encoder here.
    if resume:
        network = trained_network(load_bundle_config(config.run).text_encoder)
        return network.state_dim if isinstance(network, StateEncoderConfig) else config.state_encoder.state_dim
    return read_sentence_config(find_encoder(config.sentence, SENTENCE_FILES)).text_dim


def open_text_encoder(config: Any, *, resume: bool) -> OpenedEncoder:
    """Returns the text encoder that the config of a generator's training names.

    Raises:
        UserError: It cannot be found, has another width than the generator reads, or is not the one of the run.
    """
    if config.text_encoder == "caption_encoder":
        return OpenedEncoder(config.caption_encoder)
    reads_states = config.text_encoder == "sentence_states"
    reference: Reference = ClipReference(name=config.clip)
    if reads_states or config.text_encoder == "sentence":
        reference = SentenceReference(name=config.sentence)
    reference = dataclasses.replace(reference, identity=_known_identity(config, resume=resume))
    width = config.state_encoder.state_dim if reads_states else config.model.text_dim
    if isinstance(reference, SentenceReference) and reads_states:
        states = SentenceStates(reference, state_dim=width)
        reference = dataclasses.replace(reference, identity=encoder_identity(states.encoder))
        return OpenedEncoder(SentenceStatesConfig(encoder=reference, network=config.state_encoder), states=states)
    encoder = load_pretrained(reference, text_dim=width)
    reference = dataclasses.replace(reference, identity=encoder_identity(encoder))
    return OpenedEncoder(reference, encoder=PretrainedTextEncoder(encoder, cache=EmbeddingCache()))


def _known_identity(config: Any, *, resume: bool) -> str:
    """Returns the identity of the pretrained encoder that must be used, empty if any may be."""
    known = None
    # A run goes on only with the encoder that it began with.
    if resume:
        known = load_bundle_config(config.run).text_encoder
    # What starts from a model reads the embeddings or the states that it has learned to read.
    elif config.init is not None and config.init_parts == "all":
        known = load_model(config.init).config.text_encoder
    reference = None if known is None else pretrained_reference(known)
    return "" if reference is None else reference.identity


def make_caption_reader(
    config: Any, motions: Sequence[CodedMotion], opened: OpenedEncoder, *, resume: bool
) -> CaptionReader:
    """Returns what reads the captions: the opened encoder, or the subwords of the run or of `init`, or new ones."""
    encoder = opened.encoder
    states = opened.states
    # A pretrained encoder reads text, and the model refers to it, so no subwords are kept.
    if encoder is not None:
        return CaptionReader(encoder, None, lambda bundle: encoder)
    if states is not None:
        places = cache_places(config.data, STATES_NAME)
        length = config.state_encoder.max_length
        return CaptionReader(
            lambda captions: open_state_table(places, states.fingerprint, captions, states.read_all, max_length=length),
            None,
            lambda bundle: make_text_encoder(bundle, states=states),
        )
    sizes = config.caption_encoder
    # Tokens are rows of a trained table: a model that goes on must read the same subwords.
    bpe = load_bpe(config.run) if resume else None if config.init is None else load_model(config.init).bpe
    if bpe is not None and (count := largest_token(bpe) + 1) > sizes.vocabulary_size:
        field = f"caption_encoder.vocabulary_size: {sizes.vocabulary_size}"
        raise UserError(f"{field} is less than the {count} subwords of {config.run if resume else config.init}")
    if bpe is None:
        captions = [caption.text for motion in motions for caption in motion.captions]
        bpe = train_bpe(captions, vocabulary_size=sizes.vocabulary_size)
    return CaptionReader(
        lambda captions: tokenize_captions(bpe, captions, max_length=sizes.max_length), bpe, make_text_encoder
    )
