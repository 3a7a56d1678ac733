"""Checks of the fields of configs, for their `__post_init__`."""

import dataclasses
import math
import reprlib
from numbers import Integral, Real
from typing import Any

from t2m_jax.errors import UserError


def is_number(value: Any, kind: type = Real) -> bool:
    """Returns whether a value is a number of a kind; True and False are none."""
    return isinstance(value, kind) and not isinstance(value, bool)


def check_number(name: str, value: float | int, kind: type = Real) -> float | int:
    """Returns the number of an argument or a field.

    Raises:
        UserError: It is of another type.
    """
    if not is_number(value, kind):
        whole = "whole " if kind is Integral else ""
        raise UserError(f"{name.replace('_', '-')}: {value!r} is not a {whole}number")
    return value


def check_sizes(config: Any, *names: str) -> None:
    """Raises `ValueError` if a whole number in one of the fields (without names: in any field) is below 1.

    Call it in `__post_init__`. The functions that read configs add the file and the section to the message.
    """
    for name in names or (field.name for field in dataclasses.fields(config)):
        value = getattr(config, name)
        if type(value) is int and value < 1:
            raise ValueError(f"{name}: {value} is not a whole number above 0")


def check_amounts(config: Any, *names: str) -> None:
    """Raises `ValueError` if a number in one of the fields is negative or not finite, like `check_sizes`."""
    for name in names:
        if not 0 <= (value := getattr(config, name)) < math.inf:
            raise ValueError(f"{name}: {value} is not a number from 0 up")


def check_shares(config: Any, *names: str, with_one: bool = True) -> None:
    """Raises `ValueError` if a number in one of the fields is not from 0 to 1 (or to below 1), like `check_sizes`."""
    for name in names:
        value = getattr(config, name)
        if not (0 <= value < 1 or (with_one and value == 1)):
            raise ValueError(f"{name}: {value} is not a number from 0 to {'' if with_one else 'below '}1")


def check_seed(seed: int, name: str = "seed") -> None:
    """Raises `UserError` if a seed, or another number that makes a key, is not a whole number from 0 to 2**32 - 1.

    Keys of JAX ignore the bits above.
    """
    check_number(name, seed, Integral)
    if not 0 <= seed < 2**32:
        raise UserError(f"{name}: {seed} is not between 0 and {2**32 - 1}")


def check_limits(config: Any, **limits: int) -> None:
    """Raises `ValueError` if a field is above its limit.

    The config alone decides how much memory and time it takes to build a model, and it may come from a stranger. Limits
    are far above any real model and far below what would exhaust a machine.
    """
    for name, limit in limits.items():
        value = getattr(config, name)
        if value > limit:
            raise ValueError(f"{name}: {reprlib.repr(value)} is more than {limit}, the most that is allowed")


def check_transformer(config: Any, **limits: int) -> None:
    """Raises `ValueError` if a field is above its limit (see `check_limits`) or the heads do not divide the width."""
    check_limits(config, embed_dim=16_384, num_layers=64, **limits)
    if config.embed_dim % config.num_heads:
        raise ValueError(f"num_heads: {config.num_heads} does not divide embed_dim {config.embed_dim}")
