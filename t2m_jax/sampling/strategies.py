"""How the next token is chosen from its logits: frozen dataclasses, called with logits and a key."""

import dataclasses
from typing import Protocol, runtime_checkable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, PRNGKeyArray

from t2m_jax.errors import UserError


@runtime_checkable
class Strategy(Protocol):
    """Chooses one token a sequence. Hashable, so that it can be a static argument of a jitted function."""

    def __call__(self, logits: Float[Array, "B V"], key: PRNGKeyArray) -> Int[Array, " B"]:
        """Returns one token a sequence; `key` is consumed."""
        ...


def _check_temperature(temperature: float) -> None:
    if not 0.0 < temperature < float("inf"):
        raise UserError(f"temperature: {temperature} is not a number above 0")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Greedy:
    """Takes the likeliest token."""

    def __call__(self, logits: Float[Array, "B V"], key: PRNGKeyArray) -> Int[Array, " B"]:
        """Returns one token a sequence; `key` is not used."""
        del key
        return jnp.argmax(logits, axis=-1)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Temperature:
    """Samples among all tokens, from flattened (above 1) or sharpened (below 1) probabilities."""

    temperature: float = 1.0

    def __post_init__(self) -> None:
        _check_temperature(self.temperature)

    def __call__(self, logits: Float[Array, "B V"], key: PRNGKeyArray) -> Int[Array, " B"]:
        """Returns one token a sequence; `key` is consumed."""
        return jax.random.categorical(key, logits / self.temperature)


@dataclasses.dataclass(frozen=True, kw_only=True)
class TopK:
    """Samples among the `k` likeliest tokens."""

    k: int
    temperature: float = 1.0

    def __post_init__(self) -> None:
        _check_temperature(self.temperature)
        if self.k < 1:
            raise UserError(f"top-k: {self.k} is not a whole number above 0")

    def __call__(self, logits: Float[Array, "B V"], key: PRNGKeyArray) -> Int[Array, " B"]:
        """Returns one token a sequence; `key` is consumed."""
        values, tokens = jax.lax.top_k(logits, min(self.k, logits.shape[-1]))
        choice = jax.random.categorical(key, values / self.temperature)
        return jnp.take_along_axis(tokens, choice[:, None], axis=-1)[:, 0]


@dataclasses.dataclass(frozen=True, kw_only=True)
class TopP:
    """Samples among the fewest tokens whose probabilities reach `p` together (nucleus sampling, arXiv 1904.09751)."""

    p: float
    temperature: float = 1.0

    def __post_init__(self) -> None:
        _check_temperature(self.temperature)
        if not 0.0 < self.p <= 1.0:
            raise UserError(f"top-p: {self.p} is not a probability above 0 and at most 1")

    def __call__(self, logits: Float[Array, "B V"], key: PRNGKeyArray) -> Int[Array, " B"]:
        """Returns one token a sequence; `key` is consumed."""
        values, tokens = jax.lax.top_k(logits / self.temperature, logits.shape[-1])
        probabilities = jax.nn.softmax(values)
        before = jnp.cumsum(probabilities, axis=-1) - probabilities
        choice = jax.random.categorical(key, jnp.where(before < self.p, values, -jnp.inf))
        return jnp.take_along_axis(tokens, choice[:, None], axis=-1)[:, 0]


def make_strategy(
    temperature: float = 1.0, top_k: int | None = None, *, top_p: float | None = None
) -> Greedy | Temperature | TopK | TopP:
    """Returns the strategy these numbers describe; a temperature of 0 is greedy.

    Raises:
        UserError: if a number is out of range, or `top_k` and `top_p` are both given.
    """
    if top_k is not None and top_p is not None:
        raise UserError("top-k and top-p exclude each other; give one")
    if temperature == 0.0:
        return Greedy()
    if top_k is not None:
        return TopK(k=top_k, temperature=temperature)
    if top_p is not None:
        return TopP(p=top_p, temperature=temperature)
    return Temperature(temperature=temperature)
