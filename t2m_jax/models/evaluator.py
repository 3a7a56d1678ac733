"""The evaluator behind the metrics: motion and text in one space (Guo et al., CVPR 2022, their feature extractors).

Motion is normalized with the evaluator's own statistics and exactly zero behind its end: the last movement of a clip
sees three frames past it.
"""

import dataclasses

import flax.linen as nn
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from t2m_jax.config import check_limits, check_sizes
from t2m_jax.models.recurrent import BiGru

FRAMES_PER_MOVEMENT = 4
"""Frames that one movement stands for."""
NUM_CONTACTS = 4
"""Foot contacts, a frame's last features, which the evaluator does not look at."""
NEGATIVE_SLOPE = 0.2
"""Of every leaky ReLU."""

_XAVIER = nn.initializers.variance_scaling(1.0, "fan_avg", "normal")
_WORDS = nn.initializers.normal(0.4)
"""As wide as the numbers of GloVe's vectors."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class EvaluatorConfig:
    """Sizes of the evaluator; the defaults are the published HumanML3D model."""

    feature_dim: int = 263
    """Features a frame (D), foot contacts included."""
    movement_hidden: int = 512
    """Channels between the two convolutions of the movement encoder."""
    movement_dim: int = 512
    """Width of a movement: what four frames become."""
    motion_hidden: int = 1024
    """Width of the GRU over movements, each direction."""
    text_hidden: int = 512
    """Width of the GRU over words, each direction."""
    embedding_dim: int = 512
    """Width of the space in which motions and texts are compared (E)."""
    word_dim: int = 300
    """Width of a word vector."""
    num_words: int = 4199
    """Words of the vocabulary; training sets it to what its vocabulary has."""
    num_parts_of_speech: int = 15
    """Classes of words."""
    dropout: float = 0.2
    """Dropout rate in the movement encoder, when that is trained."""

    def __post_init__(self) -> None:
        check_sizes(self)
        check_limits(self, feature_dim=65_536, movement_hidden=65_536, movement_dim=65_536, motion_hidden=65_536)
        check_limits(self, text_hidden=65_536, embedding_dim=65_536, word_dim=65_536, num_words=1_000_000)
        check_limits(self, num_parts_of_speech=1000)
        if self.feature_dim <= NUM_CONTACTS:
            raise ValueError(f"feature_dim: {self.feature_dim} leaves nothing beside the {NUM_CONTACTS} foot contacts")
        if not 0 <= self.dropout < 1:
            raise ValueError(f"dropout: {self.dropout} is no rate from 0 to below 1")


class HalvingConv(nn.Module):
    """A convolution of width 4 and stride 2 with one zero at either end, as two products of pairs of frames.

    On a CPU its gradient takes a fraction of the time of a general convolution's.
    """

    features: int

    @nn.compact
    def __call__(self, inputs: Float[Array, "B T X"]) -> Float[Array, "B T//2 Y"]:
        """Returns every second position of the convolved sequence."""
        size, length, width = inputs.shape
        kernel = jnp.asarray(self.param("kernel", _XAVIER, (4, width, self.features)))
        bias = jnp.asarray(self.param("bias", nn.initializers.zeros, (self.features,)))
        num_pairs = length // 2 + 1
        padded = jnp.pad(inputs, ((0, 0), (1, 1), (0, 0)))[:, : 2 * num_pairs]
        pairs = padded.reshape(size, num_pairs, 2 * width)
        first, last = kernel.reshape(2, 2 * width, self.features)
        return pairs[:, :-1] @ first + pairs[:, 1:] @ last + bias[None, None]


class DoublingConv(nn.Module):
    """The transpose of a `HalvingConv`: twice as many positions, each pair from two neighbours."""

    features: int

    @nn.compact
    def __call__(self, inputs: Float[Array, "B N X"]) -> Float[Array, "B 2*N Y"]:
        """Returns the longer sequence."""
        size, length, width = inputs.shape
        kernel = jnp.asarray(self.param("kernel", _XAVIER, (4, self.features, width)))
        bias = jnp.asarray(self.param("bias", nn.initializers.zeros, (self.features,)))
        first, last = kernel.reshape(2, 2 * self.features, width)
        ahead, behind = (jnp.pad(inputs, ((0, 0), ends, (0, 0))) for ends in ((0, 1), (1, 0)))
        pairs = ahead @ first.T + behind @ last.T
        return pairs.reshape(size, 2 * (length + 1), self.features)[:, 1:-1] + bias[None, None]


class MovementEncoder(nn.Module):
    """Two convolutions that halve in time, then a projection. RNG stream `dropout` when training."""

    hidden: int
    features: int
    dropout: float

    @nn.compact
    def __call__(self, motion: Float[Array, "B T X"], *, train: bool) -> Float[Array, "B N M"]:
        """Returns the movements, N = T // 2 // 2; movement k sees the frames 4k-3 to 4k+6."""
        hidden = motion
        for layer, width in enumerate((self.hidden, self.features)):
            hidden = HalvingConv(width, name=f"conv_{layer}")(hidden)
            hidden = nn.Dropout(self.dropout, deterministic=not train)(hidden)
            hidden = nn.leaky_relu(hidden, NEGATIVE_SLOPE)
        return nn.Dense(self.features, kernel_init=_XAVIER, name="output")(hidden)


class MovementDecoder(nn.Module):
    """Movements back to motion, foot contacts included; for the training of the movement encoder alone."""

    hidden: int
    feature_dim: int

    @nn.compact
    def __call__(self, movements: Float[Array, "B N M"]) -> Float[Array, "B 4*N D"]:
        """Returns the motion, normalized."""
        hidden = movements
        for layer, width in enumerate((self.hidden, self.feature_dim)):
            hidden = nn.leaky_relu(DoublingConv(width, name=f"conv_{layer}")(hidden), NEGATIVE_SLOPE)
        return nn.Dense(self.feature_dim, kernel_init=_XAVIER, name="output")(hidden)


class SequenceEncoder(nn.Module):
    """A sequence to one embedding: projection, bidirectional GRU, two layers."""

    hidden: int
    embedding_dim: int

    @nn.compact
    def __call__(self, inputs: Float[Array, "B S X"], lengths: Int[Array, " B"]) -> Float[Array, "B E"]:
        """Returns the embedding of the first `lengths[b]` steps."""
        projected = nn.Dense(self.hidden, kernel_init=_XAVIER, name="input")(inputs)
        states = BiGru(self.hidden, name="gru")(projected, lengths)
        hidden = nn.Dense(self.hidden, kernel_init=_XAVIER, name="head")(states)
        hidden = nn.LayerNorm(epsilon=1e-5, use_fast_variance=False, name="head_norm")(hidden)
        hidden = nn.leaky_relu(hidden, NEGATIVE_SLOPE)
        return nn.Dense(self.embedding_dim, kernel_init=_XAVIER, name="output")(hidden)


class Evaluator(nn.Module):
    """Motions and captions as points of one space; the Euclidean distance is their only likeness.

    The networks run in full single precision on every device: the published numbers do not survive 19 bits.
    """

    config: EvaluatorConfig

    def setup(self) -> None:
        """Makes the parts."""
        config = self.config
        self.movement_encoder = MovementEncoder(config.movement_hidden, config.movement_dim, config.dropout)
        self.motion_encoder = SequenceEncoder(config.motion_hidden, config.embedding_dim)
        self.word_embedding = nn.Embed(config.num_words, config.word_dim, embedding_init=_WORDS)
        self.part_of_speech_projection = nn.Dense(config.word_dim, kernel_init=_XAVIER)
        self.text_encoder = SequenceEncoder(config.text_hidden, config.embedding_dim)

    def __call__(
        self,
        motion: Float[Array, "B T D"],
        lengths: Int[Array, " B"],
        words: Int[Array, "B S"],
        parts_of_speech: Int[Array, "B S"],
        text_lengths: Int[Array, " B"],
    ) -> tuple[Float[Array, "B E"], Float[Array, "B E"]]:
        """Returns the embeddings of texts and of motions."""
        return self.embed_text(words, parts_of_speech, text_lengths), self.embed_motion(motion, lengths)

    def movements(self, motion: Float[Array, "B T D"], *, train: bool) -> Float[Array, "B N M"]:
        """Returns what every four frames become."""
        with jax.default_matmul_precision("float32"):
            return self.movement_encoder(motion[..., :-NUM_CONTACTS], train=train)

    def embed_motion(self, motion: Float[Array, "B T D"], lengths: Int[Array, " B"]) -> Float[Array, "B E"]:
        """Returns one embedding a motion.

        Args:
            motion: Normalized, zero behind the end of each motion. A motion that fills the array to its last frame
                meets the convolution's own edge there and gets a slightly different embedding than in a longer array,
                so arrays of one protocol are equally long (196 frames).
            lengths: Frames; a rest that makes no four frames counts for no movement of its own. A motion below four
                frames has none, and its embedding is that of nothing.
        """
        movements = self.movements(motion, train=False)
        with jax.default_matmul_precision("float32"):
            return self.motion_encoder(movements, lengths // FRAMES_PER_MOVEMENT)

    def embed_text(
        self, words: Int[Array, "B S"], parts_of_speech: Int[Array, "B S"], text_lengths: Int[Array, " B"]
    ) -> Float[Array, "B E"]:
        """Returns one embedding a caption, read as `Vocabulary.vectorize` gives it."""
        with jax.default_matmul_precision("float32"):
            classes = jax.nn.one_hot(parts_of_speech, self.config.num_parts_of_speech)
            inputs = self.word_embedding(words) + self.part_of_speech_projection(classes)
            return self.text_encoder(inputs, text_lengths)


def evaluator_shapes(config: EvaluatorConfig) -> dict[str, dict]:
    """Returns the shapes of an evaluator's variables."""
    motion = jnp.zeros((1, FRAMES_PER_MOVEMENT, config.feature_dim))
    words, length = jnp.zeros((1, 1), jnp.int32), jnp.ones(1, jnp.int32)
    return jax.eval_shape(lambda: Evaluator(config).init(jax.random.key(0), motion, 4 * length, words, words, length))
