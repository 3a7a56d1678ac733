"""Sampling strategies: they choose the next token from its logits and a key."""

import dataclasses
from typing import Protocol, runtime_checkable

import chex
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, PRNGKeyArray

from t2m_jax.errors import UserError


@runtime_checkable
class Strategy(Protocol):
    """Chooses one token per sequence. It is hashable, so that it can be a static argument of a jitted function."""

    def __call__(self, logits: Float[Array, "B V"], key: PRNGKeyArray) -> Int[Array, " B"]:
        """Returns one token per sequence; `key` is consumed."""


def _check_temperature(temperature: float) -> None:
    if not 0.0 < temperature < float("inf"):
        raise UserError(f"temperature: {temperature} is not a number above 0")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Greedy:
    """Takes the likeliest token."""

    def __call__(self, logits: Float[Array, "B V"], key: PRNGKeyArray) -> Int[Array, " B"]:
        """Returns one token per sequence; `key` is not used."""
        chex.assert_rank(logits, 2)
        del key
        return jnp.argmax(logits, axis=-1)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Temperature:
    """Samples among all tokens. A temperature above 1 flattens the probabilities, below 1 it sharpens them."""

    temperature: float = 1.0

    def __post_init__(self) -> None:
        _check_temperature(self.temperature)

    def __call__(self, logits: Float[Array, "B V"], key: PRNGKeyArray) -> Int[Array, " B"]:
        """Returns one token per sequence; `key` is consumed."""
        chex.assert_rank(logits, 2)
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
        """Returns one token per sequence; `key` is consumed."""
        chex.assert_rank(logits, 2)
        # More tokens than there are is no mistake: then this is `Temperature`.
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
        """Returns one token per sequence; `key` is consumed."""
        chex.assert_rank(logits, 2)
        values, tokens = jax.lax.top_k(logits / self.temperature, logits.shape[-1])  # sorts all tokens
        probabilities = jax.nn.softmax(values)
        # A token is kept if the likelier ones do not reach `p` without it. The likeliest token is always kept.
        before = jnp.cumsum(probabilities, axis=-1) - probabilities
        choice = jax.random.categorical(key, jnp.where(before < self.p, values, -jnp.inf))
        return jnp.take_along_axis(tokens, choice[:, None], axis=-1)[:, 0]


def make_strategy(temperature: float = 1.0, top_k: int | None = None, *, top_p: float | None = None) -> Strategy:
    """Returns the strategy for these numbers. A temperature of 0 means the likeliest token.

    Raises:
        UserError: A number is out of range, or both `top_k` and `top_p` are given.
    """
    if top_k is not None and top_p is not None:
        raise UserError("top-k and top-p exclude each other; give one of them")
    # The limit of a temperature toward 0, at which logits cannot be divided.
    if temperature == 0.0:
        return Greedy()
    if top_k is not None:
        return TopK(k=top_k, temperature=temperature)
    if top_p is not None:
        return TopP(p=top_p, temperature=temperature)
    return Temperature(temperature=temperature)
