"""Sentences that say how often something is done ("kicks twice"): of several samples, the one that does it so often."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Key

from t2m_jax.motion.repetitions import COUNTED_ACTIONS
from t2m_jax.sampling.decode import Codes, decode_motions
from t2m_jax.sampling.model import ModelParts
from t2m_jax.text.quantities import Times

_CANDIDATE_STREAM = 2**30 + 2
"""In place of a sample's number, in keys for the candidates of a motion."""


CANDIDATES = 16
"""Samples to choose from."""


def candidate_keys(key: Key[jax.Array, ""]) -> Key[jax.Array, " C"]:
    """Returns the keys of the candidates for a motion. The first one is the motion without a choice."""
    stream = jax.random.fold_in(key, _CANDIDATE_STREAM)
    return jnp.stack([key, *(jax.random.fold_in(stream, number) for number in range(1, CANDIDATES))])


def choose_by_count(model: ModelParts, candidates: Sequence[Codes], times: Times) -> Codes:
    """Returns the codes of the first motion that shows an action as often as asked for, or nearest to that."""
    # With one length and one batch for all requests, there is one program for all.
    motions = decode_motions(
        model.tokenizer,
        candidates,
        skeleton=model.skeleton,
        size=model.config.generator.max_codes,
        batch=len(candidates),
    )
    # The first of equals is taken, so that the motion without a choice stays if it is as good.
    misses = [abs(count_shown(times, np.asarray(motion.positions)) - times.number) for motion in motions]
    return candidates[int(np.argmin(misses))]


def count_shown(times: Times, positions: Float[np.ndarray, "T 22 3"]) -> int:
    """Returns how often a motion shows an action."""
    return COUNTED_ACTIONS[times.action].count(positions, times.sides)


def missed_count(times: Times, positions: Float[np.ndarray, "T 22 3"], *, sentence: str) -> str:
    """Returns in a line that a motion shows an action more or less often than its sentence says, if it does."""
    shown = count_shown(times, positions)
    return "" if shown == times.number else f"{sentence!r}: {times.action} is counted {shown} times; try another seed"
