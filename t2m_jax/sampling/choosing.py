"""Of several samples, the one that does what its sentence says.

That is how often something is done ("kicks twice"), how fast, with which side, or with legs and arms at once.
"""

import itertools
import math
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Key

from t2m_jax.motion.at_once import GAIT_SPEEDS, LEGS, arms_do
from t2m_jax.motion.facts import measure
from t2m_jax.motion.repetitions import COUNTED_ACTIONS, side_lead
from t2m_jax.motion.skeleton import HUMANML3D
from t2m_jax.sampling.decode import Codes, decode_motions
from t2m_jax.sampling.model import ModelParts
from t2m_jax.text.at_once import SaidAtOnce, in_plain_words
from t2m_jax.text.counts import SaidSide, Times
from t2m_jax.text.paces import SaidPace

Wanted = Times | SaidPace | SaidSide | SaidAtOnce
"""What a sample is chosen by."""
_CANDIDATE_STREAM = 2**30 + 2
"""In place of a sample's number, in keys for the candidates of a motion."""
COUNT_CANDIDATES = 16
"""Samples to choose from by a count."""
AT_ONCE_CANDIDATES = 8
"""Samples to choose from by what legs and arms do at once, the second half of them for a sentence in plain words."""
FEW_CANDIDATES = 4
"""Samples to choose from by their pace or side."""
CLEAR_LEAD = 0.15
"""Meters by which a leg or an arm does more than the other if it is the one that does it."""
SLOWEST_SHARE = 0.4
"""Of the median speed of the candidates. A slower one hardly shows its action."""
SHORTEST_SECONDS = 1.2
"""Shortest motion that is made by ending one."""


def candidate_keys(key: Key[jax.Array, ""], wanted: Wanted) -> Key[jax.Array, " C"]:
    """Returns the keys of the candidates for a motion. The first one is the motion without a choice."""
    stream = jax.random.fold_in(key, _CANDIDATE_STREAM)
    counts = {Times: COUNT_CANDIDATES, SaidAtOnce: AT_ONCE_CANDIDATES}
    count = counts.get(type(wanted), FEW_CANDIDATES)
    return jnp.stack([key, *(jax.random.fold_in(stream, number) for number in range(1, count))])


def candidate_texts(text: str, wanted: Wanted, count: int) -> list[str]:
    """Returns the sentences of `count` candidates: that of the motion, and in plain words where few samples show it."""
    plain = in_plain_words(wanted) if isinstance(wanted, SaidAtOnce) else ""
    own = count // 2 if plain else count
    return [text] * own + [plain] * (count - own)


def choose(model: ModelParts, candidates: Sequence[Codes], wanted: Wanted, *, most_rows: int) -> Codes:
    """Returns the codes of the candidate that does what is wanted; see `choose_by_count` and others."""
    if isinstance(wanted, Times):
        return choose_by_count(model, candidates, wanted, most_rows=most_rows)
    if isinstance(wanted, SaidSide):
        return choose_by_side(model, candidates, wanted)
    if isinstance(wanted, SaidAtOnce):
        return choose_at_once(model, candidates, wanted)
    return choose_by_pace(model, candidates, wanted)


def choose_by_count(model: ModelParts, candidates: Sequence[Codes], times: Times, *, most_rows: int) -> Codes:
    """Returns the codes of the first motion that shows an action as often as asked for, or nearest to that.

    If none does, they are cut after the last time, or one time is repeated up to `most_rows`; 0 keeps their lengths.
    """
    shown = _decoded(model, candidates)
    best, misses = _nearest(times, shown)
    if not misses or not most_rows:
        return candidates[best]
    sizes = {"downsample": model.config.tokenizer.downsample, "most_rows": most_rows}
    fitted = [fit_count(codes, times, positions, **sizes) for codes, positions in zip(candidates, shown, strict=True)]
    other, fewer = _nearest(times, _decoded(model, fitted))
    return fitted[other] if fewer < misses else candidates[best]


def choose_by_pace(model: ModelParts, candidates: Sequence[Codes], pace: SaidPace) -> Codes:
    """Returns the codes of the slowest motion, or of the fastest one, among those of the gait that is asked for."""
    shown = _decoded(model, candidates)
    slowest, fastest = GAIT_SPEEDS.get(pace.gait, (0.0, math.inf))
    speeds = [mean_speed(positions[:, :1]) * model.skeleton.fps for positions in shown]
    motions = list(map(mean_speed, shown))
    moving = [number for number, motion in enumerate(motions) if motion >= SLOWEST_SHARE * np.median(motions)]
    fitting = [number for number in moving if slowest <= speeds[number] <= fastest]
    best = (min if pace.is_slow else max)(fitting or moving, key=lambda number: motions[number])
    return candidates[best]


def choose_by_side(model: ModelParts, candidates: Sequence[Codes], wanted: SaidSide) -> Codes:
    """Returns the codes of the first motion in which the side that is asked for clearly does it, or the nearest."""
    leads = [side_lead(wanted.action, wanted.side, positions) for positions in _decoded(model, candidates)]
    clear = (number for number, lead in enumerate(leads) if lead >= CLEAR_LEAD)
    return candidates[next(clear, int(np.argmax(leads)))]


def choose_at_once(model: ModelParts, candidates: Sequence[Codes], wanted: SaidAtOnce) -> Codes:
    """Returns the codes of the first motion in which legs and arms do what is asked for, or else of the nearest."""
    scores = [_shown(wanted, positions, fps=model.skeleton.fps) for positions in _decoded(model, candidates)]
    return candidates[int(np.argmax(scores))]


def _shown(wanted: SaidAtOnce, positions: Float[np.ndarray, "T 22 3"], *, fps: float) -> float:
    """Returns how much of what is asked for is shown: 1 by legs and 1 by arms; nothing by one frame."""
    if len(positions) < 2:
        return 0.0
    legs_do = not wanted.legs or LEGS[wanted.legs](measure(positions, fps=fps))
    return legs_do + arms_do(wanted.arms, wanted.hands, positions)


def mean_speed(positions: Float[np.ndarray, "T J 3"]) -> float:
    """Returns how far joints go from frame to frame on average, in meters; 0 for one frame."""
    steps = np.linalg.norm(np.diff(positions, axis=0), axis=-1)
    return float(steps.mean()) if len(steps) else 0.0


def _decoded(model: ModelParts, candidates: Sequence[Codes]) -> list[Float[np.ndarray, "_ J 3"]]:
    # With one length and one batch for all requests, there is one program for all.
    size = model.config.generator.max_codes
    options: dict[str, Any] = {"skeleton": model.skeleton, "size": size, "batch": len(candidates)}
    return [np.asarray(motion.positions) for motion in decode_motions(model.tokenizer, candidates, **options)]


def _nearest(times: Times, shown: Sequence[Float[np.ndarray, "_ 22 3"]]) -> tuple[int, int]:
    """Returns which motion is nearest to a count, and by how many times it misses it."""
    misses = [abs(count_shown(times, positions) - times.number) for positions in shown]
    # The first of equals is taken, so that the motion without a choice stays if it is as good.
    best = int(np.argmin(misses))
    return best, misses[best]


def fit_count(
    codes: Codes, times: Times, positions: Float[np.ndarray, "T 22 3"], *, downsample: int, most_rows: int
) -> Codes:
    """Returns the codes of a motion cut after the last time, or with one time repeated, so that the count is right.

    They stay as they are if the motion cannot stop there, if it shows less than two times, or if it would be too long.

    Args:
        codes: Of the motion.
        times: How often something is asked for.
        positions: The motion.
        downsample: Frames of a row of codes.
        most_rows: Rows of the longest motion.
    """
    count = count_shown(times, positions)
    if count > times.number:
        rows = _rows_until(times, positions, downsample=downsample)
        return codes[:rows] if rows else codes
    if count < times.number:
        first, last = _one_time(times, positions, downsample=downsample)
        repeated = [codes[first:last]] * (times.number - count)
        longer = np.concatenate([codes[:last], *repeated, codes[last:]])
        return longer if len(longer) <= most_rows else codes
    return codes


def _rows_until(times: Times, positions: Float[np.ndarray, "T 22 3"], *, downsample: int) -> int:
    """Returns how many rows of codes show an action as often as asked for, 0 if none do or it cannot stop there."""
    ends = range(math.ceil(SHORTEST_SECONDS * HUMANML3D.fps / downsample), len(positions) // downsample)
    is_fitting = COUNTED_ACTIONS[times.action].can_stop
    fitting = [end for end in ends if is_fitting and count_shown(times, positions[: end * downsample]) == times.number]
    # In the middle, the last time is over, and the next one has not begun.
    return fitting[len(fitting) // 2] if fitting else 0


def _one_time(times: Times, positions: Float[np.ndarray, "T 22 3"], *, downsample: int) -> tuple[int, int]:
    """Returns the rows from one time to the next, at the ends of which the pose is most alike; none if there is one."""
    peaks = COUNTED_ACTIONS[times.action].peaks(positions, times.sides)
    rows = sorted({round(peak / downsample) for peak in peaks})
    poses = positions - positions[:, :1]

    def change(pair: tuple[int, int]) -> float:
        begin, end = (min(row * downsample, len(poses) - 1) for row in pair)
        return float(np.abs(poses[begin] - poses[end]).sum())

    return min(itertools.pairwise(rows), key=change, default=(0, 0))


def count_shown(times: Times, positions: Float[np.ndarray, "T 22 3"]) -> int:
    """Returns how often a motion shows an action."""
    return COUNTED_ACTIONS[times.action].count(positions, times.sides)


def missed_count(times: Times, positions: Float[np.ndarray, "T 22 3"], *, sentence: str) -> str:
    """Returns in a line that a motion shows an action more or less often than its sentence says, if it does."""
    shown = count_shown(times, positions)
    return "" if shown == times.number else f"{sentence!r}: {times.action} is counted {shown} times; try another seed"
