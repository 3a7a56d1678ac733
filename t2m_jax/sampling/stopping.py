"""When a generated motion ends: frozen rules over the stop scores of its rows.

A generator gives a stop score for every row that it reads (`Generator.step`). What the score means depends on the rule.
"""

import dataclasses
from typing import ClassVar, Protocol, runtime_checkable

import chex
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key

from t2m_jax.errors import UserError
from t2m_jax.models.system import GeneratorConfig, find_part


@runtime_checkable
class StopRule(Protocol):
    """Finds the end of a motion. Hashable, so that it can be a static argument of a jitted function."""

    keeps_last: ClassVar[bool]
    """Whether the row that ends a motion is part of it."""
    ends_early: ClassVar[bool]
    """Whether a motion can end before the longest length was sampled."""

    def draw(self, scores: Float[Array, " B"], keys: Key[Array, " B"]) -> Float[Array, " B"]:
        """Returns the scores of a row for `ends` and `count`, after what is random in the rule; `keys` are consumed."""
        # Most rules are not random. The argument is for those that are.
        del keys
        return scores

    def ends(self, scores: Float[Array, "*shape"]) -> Bool[Array, "*shape"]:
        """Returns whether sampling of a motion can end after a row with this score."""
        ...

    def count(self, scores: Float[Array, "B N"]) -> Int[Array, " B"]:
        """Returns how many rows a motion keeps: up to its first end, or all. Rows that were not sampled have -inf."""
        chex.assert_rank(scores, 2)
        ends = self.ends(scores)
        # argmax returns the first True, and 0 if there is none: then all rows are kept.
        kept = jnp.argmax(ends, axis=1) + self.keeps_last
        return jnp.where(jnp.any(ends, axis=1), kept, ends.shape[1]).astype(jnp.int32)


@dataclasses.dataclass(frozen=True, kw_only=True)
class StopAtEnd(StopRule):
    """Stops at the row that is End, which is not kept; the score of End is 1, that of other rows 0 (T2M-GPT)."""

    keeps_last: ClassVar[bool] = False
    ends_early: ClassVar[bool] = True

    def ends(self, scores: Float[Array, "*shape"]) -> Bool[Array, "*shape"]:
        """Returns whether a row is End."""
        # Between the two scores, so that rounding does not matter.
        return scores > 0.5


@dataclasses.dataclass(frozen=True, kw_only=True)
class StopAtThreshold(StopRule):
    """Stops at the first row whose stop probability reaches a threshold; the score is a logit."""

    keeps_last: ClassVar[bool] = True
    ends_early: ClassVar[bool] = True
    threshold: float = 0.5
    """From 0 to 1."""

    def ends(self, scores: Float[Array, "*shape"]) -> Bool[Array, "*shape"]:
        """Returns whether the probability of a row reaches the threshold."""
        return jax.nn.sigmoid(scores) >= self.threshold


@dataclasses.dataclass(frozen=True, kw_only=True)
class StopAtHighest(StopRule):
    """Samples the longest motion, then cuts it after the (first) row with the highest score."""

    keeps_last: ClassVar[bool] = True
    ends_early: ClassVar[bool] = False

    def ends(self, scores: Float[Array, "*shape"]) -> Bool[Array, "*shape"]:
        """Returns False: later rows may have a higher score."""
        return jnp.zeros(scores.shape, bool)

    def count(self, scores: Float[Array, "B N"]) -> Int[Array, " B"]:
        """Returns the number of rows up to and including the one with the highest score."""
        chex.assert_rank(scores, 2)
        return (jnp.argmax(scores, axis=1) + 1).astype(jnp.int32)


@dataclasses.dataclass(frozen=True, kw_only=True)
class StopAtRandom(StopRule):
    """Stops after each row with its stop probability, so that motions are as long as those of training.

    The score is a logit. Logistic noise added to it is above 0 with the probability of the logit.
    """

    keeps_last: ClassVar[bool] = True
    ends_early: ClassVar[bool] = True

    def draw(self, scores: Float[Array, " B"], keys: Key[Array, " B"]) -> Float[Array, " B"]:
        """Returns the logits with noise."""
        # A key for each motion, so that its end does not depend on what it is sampled with.
        return scores + jax.vmap(lambda key: jax.random.logistic(key))(keys)

    def ends(self, scores: Float[Array, "*shape"]) -> Bool[Array, "*shape"]:
        """Returns whether a row was drawn to be the last."""
        return scores > 0


STOP_RULES: dict[str, type[StopRule]] = {
    "end": StopAtEnd,
    "threshold": StopAtThreshold,
    "argmax": StopAtHighest,
    "sampled": StopAtRandom,
}
"""Rules by the name that a generator's config gives."""
LOGIT_RULES = ("threshold", "argmax", "sampled")
"""Rules that read logits, and can stand in for each other."""


def make_stop_rule(name: str, *, threshold: float = 0.5) -> StopRule:
    """Returns the rule of a name; `threshold` is for the rule of that name.

    Raises:
        UserError: There is no such rule.
    """
    if name not in STOP_RULES:
        raise UserError(f"stop_rule: {name!r} is unknown; known: {', '.join(STOP_RULES)}")
    return StopAtThreshold(threshold=threshold) if name == "threshold" else STOP_RULES[name]()


def find_stop_rule(config: GeneratorConfig, name: str | None = None) -> StopRule:
    """Returns the stop rule of a generator, or another one that reads the same scores.

    Raises:
        UserError: The generator's scores do not fit the rule.
    """
    own = config.stop_rule
    if name is not None and name != own and not {name, own} <= set(LOGIT_RULES):
        known = LOGIT_RULES if own in LOGIT_RULES else (own,)
        raise UserError(f"stop-rule: {name!r} does not fit this model; use {' or '.join(known)}")
    return make_stop_rule(name or own, threshold=find_part(config.kind).stop_threshold(config))
