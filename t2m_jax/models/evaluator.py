"""The evaluator that the metrics use: it embeds motion and text in one space (Guo et al., CVPR 2022).

Motion is normalized with the evaluator's own statistics, and must be exactly zero past its end, because the last
movement of a clip reads three frames past it.
"""

import dataclasses
import functools

import chex
import flax.linen as nn
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from t2m_jax.field_checks import check_limits, check_shares, check_sizes
from t2m_jax.keys import new_key
from t2m_jax.models.recurrent import BiGru

FRAMES_PER_MOVEMENT = 4
"""Frames per movement."""
NUM_CONTACTS = 4
"""Number of foot contacts. They are the last features of a frame, and the evaluator does not read them."""
NEGATIVE_SLOPE = 0.2
"""Slope of every leaky ReLU below zero."""

_XAVIER = nn.initializers.variance_scaling(1.0, "fan_avg", "normal")
_WORDS = nn.initializers.normal(0.4)
"""The standard deviation of the numbers in GloVe's vectors."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class EvaluatorConfig:
    """Sizes of the evaluator; the defaults are the published HumanML3D model."""

    feature_dim: int = 263
    """Features per frame (D), including the foot contacts."""
    movement_hidden: int = 512
    """Channels between the two convolutions of the movement encoder."""
    movement_dim: int = 512
    """Width of the embedding of a movement (four frames)."""
    motion_hidden: int = 1024
    """Width of the GRU over movements, for each direction."""
    text_hidden: int = 512
    """Width of the GRU over words, for each direction."""
    embedding_dim: int = 512
    """Width of the space in which motions and texts are compared (E)."""
    word_dim: int = 300
    """Width of a word vector."""
    num_words: int = 4199
    """Number of words of the vocabulary. Training sets this field to the size of its vocabulary."""
    num_parts_of_speech: int = 15
    """Number of parts of speech."""
    dropout: float = 0.2
    """Dropout rate in the movement encoder while it is trained."""

    def __post_init__(self) -> None:
        check_sizes(self)
        check_limits(self, feature_dim=65_536, movement_hidden=65_536, movement_dim=65_536, motion_hidden=65_536)
        check_limits(self, text_hidden=65_536, embedding_dim=65_536, word_dim=65_536, num_words=1_000_000)
        check_limits(self, num_parts_of_speech=1000)
        check_shares(self, "dropout", with_one=False)
        if self.feature_dim <= NUM_CONTACTS:
            raise ValueError(f"feature_dim: {self.feature_dim} is not more than the {NUM_CONTACTS} foot contacts")


class HalvingConv(nn.Module):
    """A convolution of width 4 and stride 2 with one zero at each end, computed as two products of pairs of frames.

    On a CPU, its gradient takes a fraction of the time that the gradient of a general convolution takes.
    """

    features: int

    @nn.compact
    def __call__(self, inputs: Float[Array, "B T X"]) -> Float[Array, "B T//2 Y"]:
        """Returns every second position of the convolved sequence."""
        size, length, width = inputs.shape
        kernel = jnp.asarray(self.param("kernel", _XAVIER, (4, width, self.features)))
        bias = jnp.asarray(self.param("bias", nn.initializers.zeros, (self.features,)))
        # Output i covers the frames 2i - 1 to 2i + 2, which are the pairs i and i + 1 of the padded frames.
        num_pairs = length // 2 + 1
        padded = jnp.pad(inputs, ((0, 0), (1, 1), (0, 0)))[:, : 2 * num_pairs]
        pairs = padded.reshape(size, num_pairs, 2 * width)
        first, last = kernel.reshape(2, 2 * width, self.features)
        return pairs[:, :-1] @ first + pairs[:, 1:] @ last + bias[None, None]


class DoublingConv(nn.Module):
    """The transpose of a `HalvingConv`. It doubles the positions; each pair depends on two neighbors."""

    features: int

    @nn.compact
    def __call__(self, inputs: Float[Array, "B N X"]) -> Float[Array, "B 2*N Y"]:
        """Returns the longer sequence."""
        size, length, width = inputs.shape
        kernel = jnp.asarray(self.param("kernel", _XAVIER, (4, self.features, width)))
        bias = jnp.asarray(self.param("bias", nn.initializers.zeros, (self.features,)))
        first, last = kernel.reshape(2, 2 * self.features, width)
        # A pair of outputs depends on the inputs before and after it. The first and last outputs are incomplete.
        ahead, behind = (jnp.pad(inputs, ((0, 0), ends, (0, 0))) for ends in ((0, 1), (1, 0)))
        pairs = ahead @ first.T + behind @ last.T
        return pairs.reshape(size, 2 * (length + 1), self.features)[:, 1:-1] + bias[None, None]


class MovementEncoder(nn.Module):
    """Two convolutions that halve in time, then a projection. Training uses the RNG stream `dropout`."""

    hidden: int
    features: int
    dropout: float

    @nn.compact
    def __call__(self, motion: Float[Array, "B T X"], *, train: bool) -> Float[Array, "B N M"]:
        """Returns N = T // 2 // 2 movements. Movement k depends on the frames 4k-3 to 4k+6."""
        hidden = motion
        for layer, width in enumerate((self.hidden, self.features)):
            hidden = HalvingConv(width, name=f"conv_{layer}")(hidden)
            # Before the activation, as in the original.
            hidden = nn.Dropout(self.dropout, deterministic=not train)(hidden)
            hidden = nn.leaky_relu(hidden, NEGATIVE_SLOPE)
        return nn.Dense(self.features, kernel_init=_XAVIER, name="output")(hidden)


class MovementDecoder(nn.Module):
    """Turns movements back into motion, including foot contacts. Only the training of the movement encoder uses it."""

    hidden: int
    feature_dim: int

    @nn.compact
    def __call__(self, movements: Float[Array, "B N M"]) -> Float[Array, "B 4*N D"]:
        """Returns normalized motion."""
        hidden = movements
        for layer, width in enumerate((self.hidden, self.feature_dim)):
            hidden = nn.leaky_relu(DoublingConv(width, name=f"conv_{layer}")(hidden), NEGATIVE_SLOPE)
        return nn.Dense(self.feature_dim, kernel_init=_XAVIER, name="output")(hidden)


class SequenceEncoder(nn.Module):
    """Turns a sequence into one embedding: a projection, a bidirectional GRU and two layers."""

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
    """Embeds motions and captions in one space, in which the Euclidean distance measures how well they match.

    The networks run in full single precision on every device. With the 19 bits that GPUs use by default (TF32), the
    metrics would differ from the published numbers.
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
        """Returns the embeddings of the texts and of the motions."""
        return self.embed_text(words, parts_of_speech, text_lengths), self.embed_motion(motion, lengths)

    def movements(self, motion: Float[Array, "B T D"], *, train: bool) -> Float[Array, "B N M"]:
        """Returns one embedding per four frames."""
        chex.assert_shape(motion, (None, None, self.config.feature_dim))
        with jax.default_matmul_precision("float32"):
            return self.movement_encoder(motion[..., :-NUM_CONTACTS], train=train)

    def embed_motion(self, motion: Float[Array, "B T D"], lengths: Int[Array, " B"]) -> Float[Array, "B E"]:
        """Returns one embedding per motion.

        Args:
            motion: Normalized motion, zero past the end of each motion. A motion that fills the array gets a slightly
                different embedding than in a longer array, because the convolutions see the edge of the array. All
                arrays of a protocol therefore have the same length (196 frames).
            lengths: Number of frames. Remaining frames that do not fill a movement of four frames are ignored. All
                motions of fewer than four frames have the same embedding.
        """
        chex.assert_shape(lengths, motion.shape[:1])
        movements = self.movements(motion, train=False)
        with jax.default_matmul_precision("float32"):
            return self.motion_encoder(movements, lengths // FRAMES_PER_MOVEMENT)

    def embed_text(
        self, words: Int[Array, "B S"], parts_of_speech: Int[Array, "B S"], text_lengths: Int[Array, " B"]
    ) -> Float[Array, "B E"]:
        """Returns one embedding per caption, for words and parts of speech from `Vocabulary.vectorize`."""
        chex.assert_rank(words, 2)
        chex.assert_equal_shape([words, parts_of_speech])
        chex.assert_shape(text_lengths, words.shape[:1])
        with jax.default_matmul_precision("float32"):
            # The same as a table of vectors; the original has the matrix of a linear layer.
            classes = jax.nn.one_hot(parts_of_speech, self.config.num_parts_of_speech)
            inputs = self.word_embedding(words) + self.part_of_speech_projection(classes)
            return self.text_encoder(inputs, text_lengths)


@functools.lru_cache
def evaluator_shapes(config: EvaluatorConfig) -> dict[str, dict]:
    """Returns the shapes and dtypes of an evaluator's variables; they are shared, so nobody may change them."""
    motion = jnp.zeros((1, FRAMES_PER_MOVEMENT, config.feature_dim))
    words = jnp.zeros((1, 1), jnp.int32)
    length = jnp.ones(1, jnp.int32)
    return jax.eval_shape(lambda: Evaluator(config).init(new_key(0), motion, 4 * length, words, words, length))
