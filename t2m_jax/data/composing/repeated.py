"""Training motions in which something is done once to five times, counted by the peaks of a height or a distance."""

import itertools
import random
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from t2m_jax.data.captioning.lexicon import read_words
from t2m_jax.data.composing.pieces import LONGEST, LabeledPiece, Library, join_at
from t2m_jax.errors import UserError
from t2m_jax.motion.features import positions_from_features
from t2m_jax.motion.joining import OVERLAP
from t2m_jax.motion.skeleton import HUMANML3D

MOST = 5
COUNT_WEIGHTS = (1, 3, 3, 2, 1)
"""How often motions of one to five times are made; most clips show a thing once or many times already."""
TRIES = 100
SLACK = 4
"""Frames around the lowest point between two times at which a join may be."""
SHARE = 0.4
"""Part of the range of a signal that a peak must have, so that the small swing after a jump does not count."""
APART = 0.3
"""Meters between the wrists from which on it does not matter how far apart they are."""


class CountedContent(NamedTuple):
    """How a content is counted."""

    signal: str
    """What has a peak each time."""
    least: float
    """Height of the smallest peak, in meters."""
    weight: float
    """How often motions of it are made."""


def counted_contents() -> dict[str, CountedContent]:
    """Returns the contents that can be counted."""
    return {name: CountedContent(**entry) for name, entry in read_words(__package__, "composed")["repeated"].items()}


def signal_of(positions: Float[np.ndarray, "T J 3"], signal: str) -> Float[np.ndarray, " T"]:
    """Returns the height or the distance, in meters, that has a peak each time that something is done."""
    joint = {name: positions[:, place] for place, name in enumerate(HUMANML3D.joint_names)}
    height = {name: place[:, 1] for name, place in joint.items()}
    wrists = [joint[f"{side}_wrist"] - joint[f"{side}_shoulder"] for side in ("left", "right")]
    apart = np.linalg.norm(joint["left_wrist"] - joint["right_wrist"], axis=-1)
    return {
        "rise": height["pelvis"],
        "dip": -height["pelvis"],
        "nod": height["pelvis"] - height["head"],
        "foot": np.maximum(height["left_ankle"], height["right_ankle"]),
        # Hanging arms are farther apart than hands between two claps, which would then be too small to count.
        "hands meet": -np.minimum(apart, APART),
        "reach": np.max([np.linalg.norm(wrist[:, ::2], axis=-1) for wrist in wrists], axis=0),
        "left wrist": wrists[0][:, 1],
        "right wrist": wrists[1][:, 1],
        "both wrists": np.minimum(wrists[0][:, 1], wrists[1][:, 1]),
    }[signal]


def find_peaks(values: Float[np.ndarray, " T"], *, least: float) -> list[int]:
    """Returns the frames of the peaks of a signal that stand out by `least`, and are not much smaller than others."""
    size = max(least, SHARE * float(np.ptp(values)))
    peaks = []
    # A peak counts when the signal has come up to it and goes down from it, so that it may be flat. One at an end of
    # the clip counts by its one flank.
    low = float(values.min())
    high = -np.inf
    place = 0
    rising = True
    for frame, value in enumerate(map(float, values)):
        if rising and value > high:
            high = value
            place = frame
        elif rising and value < high - size:
            if high > low + size:
                peaks.append(place)
            rising = False
            low = value
        elif not rising:
            low = min(low, value)
            rising = value > low + size
            high = value
            place = frame
    if rising and high > low + size:
        peaks.append(place)
    return peaks


def count_times(positions: Float[np.ndarray, "T J 3"], content: str) -> int:
    """Returns how often a content that can be counted is done."""
    how = counted_contents()[content]
    return len(find_peaks(signal_of(positions, how.signal), least=how.least))


def borders(positions: Float[np.ndarray, "T J 3"], content: str) -> list[int]:
    """Returns the frames between which something is done once: the first, the lowest between two peaks, the end."""
    how = counted_contents()[content]
    values = signal_of(positions, how.signal)
    peaks = find_peaks(values, least=how.least)
    between = [one + int(values[one:other].argmin()) for one, other in itertools.pairwise(peaks)]
    return [0, *between, len(values)]


def draw_repeated(library: Library, generator: random.Random) -> tuple[LabeledPiece, int]:
    """Returns a motion in which something is done as often as the number says.

    Raises:
        UserError: There are no clips of which one can be made.
    """
    weights = {content: how.weight for content, how in counted_contents().items()}
    for _ in range(TRIES):
        piece = library.draw_clip(weights, generator)
        if piece is None:
            break
        content = piece.labels.content
        times = generator.choices(range(1, MOST + 1), COUNT_WEIGHTS)[0]
        features = repeat(piece.features, content, times)
        if features is None or len(features) > LONGEST:
            continue
        made = piece._replace(features=features)
        # Who counts again must find the same number: joins may have taken or made one.
        if count_times(made.positions, content) == times:
            return made, times
    raise UserError(f"{library.folder}: no training clips can be repeated; compose without them")


def repeat(features: Float[np.ndarray, "T D"], content: str, times: int) -> Float[np.ndarray, "U D"] | None:
    """Returns a motion that does what a clip shows a number of times; None if the clip does not lend itself to it.

    It begins and ends as the clip. In between, times are left out or done again.
    """
    places = borders(np.asarray(positions_from_features(features, HUMANML3D)), content)
    shown = len(places) - 1
    if shown == times:
        return features
    if shown == 1:
        whole = features
        for _ in range(times - 1):
            whole = join_at(whole, features, slack=SLACK)
        return whole
    # Of the times before and after the join; each side has one at least, as many as the clip shows at most.
    before = (times + 1) // 2
    after = times - before
    if not (after >= 1 and before < shown and after < shown):
        return None
    half = OVERLAP // 2 + SLACK
    first = features[: places[before] + half]
    second = features[max(places[shown - after] - half, 0) :]
    return join_at(first, second, slack=2 * SLACK)
