"""What a text-to-motion system consists of, and how its parts are found.

A system is a tokenizer and a generator. The tokenizer turns motion into codes and back. The generator turns a text
embedding into codes. Both are Linen modules with one field, `config`. Code outside `models` and outside the training of
a part uses only the interfaces on this page, so a new system needs no change there.

Codes are `[B, N, R]`: N rows in time, each with R codes (R is 1 for a plain VQ-VAE). A row covers `downsample` frames.

A package adds a part with an entry point of the group `t2m_jax.systems`. The name of the entry point is the part's
kind, and its value is a `Part`.
"""

import dataclasses
import functools
import importlib.metadata
from collections.abc import Callable
from typing import Any, ClassVar, Literal, Protocol, runtime_checkable

import flax.linen as nn
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key

from t2m_jax.errors import UserError
from t2m_jax.keys import new_key

GROUP = "t2m_jax.systems"
"""The entry-point group of parts."""

Role = Literal["tokenizer", "generator"]
Draw = Callable[[Float[Array, "B V"], Any], Int[Array, " B"]]
"""A sampling strategy: chooses one of the V classes for each row of logits; the key is consumed."""
Randomness = Key[Array, " B"] | Float[Array, "B R V"]
"""What a row is drawn with: keys, or noise that a strategy reads in place of keys (in programs without generators)."""


@runtime_checkable
class PartConfig(Protocol):
    """The fields that the configs of all tokenizers and generators have."""

    kind: ClassVar[str]
    """The name of the part's entry point."""

    @property
    def num_codes(self) -> int:
        """Codes in the codebook (K)."""

    @property
    def num_quantizers(self) -> int:
        """Codes per row (R)."""

    def __hash__(self) -> int:
        """Equal configs share what is compiled and found out for them."""


@runtime_checkable
class TokenizerConfig(PartConfig, Protocol):
    """The fields that the configs of all tokenizers have."""

    @property
    def feature_dim(self) -> int:
        """Features per frame (D)."""

    @property
    def downsample(self) -> int:
        """Frames per row."""

    @property
    def decoder_context(self) -> int:
        """Rows after a row that its frames depend on. Frames are final when that many more rows are known."""


@runtime_checkable
class Tokenizer(Protocol):
    """The methods of a tokenizer's module; motion is normalized, and masks are True where there is data."""

    def encode(self, motion: Float[Array, "B T D"], mask: Bool[Array, "B T"] | None = None) -> Int[Array, "B N R"]:
        """Returns the codes of a motion, 0 after its end."""

    def decode(self, codes: Int[Array, "B N R"], mask: Bool[Array, "B N"] | None = None) -> Float[Array, "B T D"]:
        """Returns the motion of codes, `T = N * downsample`; frames after the end have no meaning."""


@runtime_checkable
class GeneratorConfig(PartConfig, Protocol):
    """The fields that the configs of all generators have."""

    @property
    def text_dim(self) -> int:
        """Width of the text embedding (E)."""

    @property
    def max_codes(self) -> int:
        """Rows of the longest motion that can be generated."""

    @property
    def stop_rule(self) -> str:
        """Name of the rule that ends a motion, see `t2m_jax.sampling.stopping`."""

    @property
    def guidance_scale(self) -> float | None:
        """Strength of the guidance by the text if the user gives none; None without guidance."""


@runtime_checkable
class Generator(Protocol):
    """The methods of a generator's module that sampling uses.

    `context` is what the next row is drawn from, and `cache` is what the module remembers. Both are trees of arrays
    whose first axis is the batch, of a shape that does not change from step to step.
    """

    def begin(self, text_embedding: Float[Array, "B E"], guidance_scale: Any = None) -> tuple[Any, Any]:
        """Returns the context of the first row, and the cache; without a scale there is no guidance."""

    def draw(self, context: Any, keys: Randomness, strategy: Draw, *, may_stop: Bool[Array, ""]) -> Int[Array, "B R"]:
        """Returns the next row; a generator that ends motions by a code must not draw it unless `may_stop`."""

    def step(self, cache: Any, rows: Int[Array, "B R"]) -> tuple[Any, Float[Array, " B"], Any]:
        """Returns the context of the following row, the stop score of the row that was read, and the cache."""

    def log_likelihood(self, codes: Int[Array, "B N R"], text_embedding: Float[Array, "B E"]) -> Float[Array, "B N"]:
        """Returns the logarithm of the probability of each row after the text and the rows before it."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Part:
    """A tokenizer or a generator as the package finds it."""

    role: Role
    config: type
    """Its config class: a frozen dataclass with `kind: ClassVar[str]`."""
    module: Callable[[Any], nn.Module]
    """From a config to the module."""
    example: Callable[[Any], tuple[Any, ...]]
    """From a config to arguments of the module's `__call__` for `init`; the keyword `train` is added."""
    codebook: Callable[[Any, Any], Float[Array, "K C"]] | None = None
    """From a tokenizer's config and variables to the codes that generators may read; None if it has none."""
    has_latents: bool = False
    """Whether a tokenizer has `latents_of` and `decode_latents`, as `VqVae`, so that its motions can meet targets."""
    stop_threshold: Callable[[Any], float] = lambda config: 0.5
    """From a generator's config to the stop probability at which a motion ends, with the rule `threshold`."""


@functools.cache
def find_part(kind: str, role: Role | None = None) -> Part:
    """Returns the part of a kind; only its own package is imported.

    Raises:
        UserError: No installed package has such a part, or it has another role.
    """
    # Only the part of this name is loaded, so a broken package harms nobody else.
    points = importlib.metadata.entry_points(group=GROUP)
    if kind not in points.names:
        raise UserError(f"{kind!r} is not a part of any installed system; known: {', '.join(sorted(points.names))}")
    part: Part = points[kind].load()
    if role not in (None, part.role):
        raise UserError(f"{kind!r} is a {part.role}, but a {role} is needed")
    return part


def make_module(config: PartConfig) -> Any:
    """Returns the Linen module of a part's config."""
    return find_part(config.kind).module(config)


@functools.lru_cache
def variable_shapes(config: PartConfig) -> dict[str, Any]:
    """Returns the shapes of a part's variables by collection; they are shared, so nobody may change them."""
    return trace_init(config)


def trace_init(config: PartConfig) -> dict[str, Any]:
    """Initializes a part without computing anything, and returns the shapes of its variables by collection."""
    module = make_module(config)
    example = find_part(config.kind).example
    return jax.eval_shape(lambda: module.init(new_key(0), *example(config), train=False))


def draw_each(
    strategy: Draw, logits: Float[Array, "B V"], keys: Key[Array, " B"] | Float[Array, "B ... V"]
) -> Int[Array, " B"]:
    """Returns one choice for each row of logits, each with its own key, so that no row depends on the others."""
    return jax.vmap(lambda row, key: strategy(row[None], key)[0])(logits, keys).astype(jnp.int32)


def keys_of_depths(keys: Randomness, depth: int) -> Key[Array, "B R"] | Float[Array, "B R V"]:
    """Returns what each code of rows is drawn with: new keys (`keys` are consumed), or the noise that is given."""
    if not jnp.issubdtype(keys.dtype, jax.dtypes.prng_key):
        return keys
    return jax.vmap(lambda key: jax.random.split(key, depth))(keys)


def draw_depths(
    one_depth: Callable[..., tuple[Any, Array]], module: nn.Module, first: Any, keys: Randomness, *, depth: int
) -> Int[Array, "B R"]:
    """Returns the codes of rows, drawn depth after depth; `keys` are consumed.

    Args:
        one_depth: From the module, what the depth before passed on, and (number of the depth, keys) to what it passes
            on, and its codes.
        module: The generator.
        first: What the first depth gets.
        keys: For the rows.
        depth: Codes per row (R).
    """
    each = jnp.swapaxes(keys_of_depths(keys, depth), 0, 1)
    if each.ndim == 2:  # a scan: one program for any depth
        scan = nn.scan(one_depth, variable_broadcast=True, split_rngs={})
        return scan(module, first, (jnp.arange(depth), each))[1].T
    drawn = []
    for number in range(depth):  # noise is for programs that run elsewhere, where loops are slow or missing
        first, codes = one_depth(module, first, (jnp.asarray(number), each[number]))
        drawn.append(codes)
    return jnp.stack(drawn, axis=1)


def log_probabilities(logits: Float[Array, "*B V"], codes: Int[Array, "*B"]) -> Float[Array, "*B"]:
    """Returns the logarithm of the probability of each code."""
    return jnp.take_along_axis(jax.nn.log_softmax(logits), codes[..., None], axis=-1)[..., 0]
