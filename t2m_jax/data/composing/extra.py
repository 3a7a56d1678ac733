"""More for training than the recordings: captions of the slowest and fastest, and motion that is slower or still."""

import itertools
import random
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from t2m_jax.data.captioning.captions import CAPTIONS, Labels, compose, says_pace, tagged_captions, true_wordings
from t2m_jax.data.captioning.grammar import Manner
from t2m_jax.data.captioning.wordings import load_wordings
from t2m_jax.data.composing.standing import STAND, STAND_FRAMES, find_stillness, stand_still
from t2m_jax.data.files import MIRROR_PREFIX, POSITIONS, TEXTS
from t2m_jax.data.texts import Caption, load_captions, save_captions
from t2m_jax.data.writer import mirror, write_twins
from t2m_jax.motion.facts import Facts, measure
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.skeleton import HUMANML3D

EXTREMES = {"very_slow": 0.1, "slow": 0.2, "fast": 0.8, "very_fast": 0.9}
"""Share of a content's clips that are slower than the limit of each extreme. A model is tested with the same limits."""
MARGIN = 0.05
"""Part of a limit by which a clip must be slower or faster than it, so that what a model learns lies inside."""
FEWEST = 50
"""Clips of a content that can be compared by speed."""
PACE_MARKS = ("pace", "steady")
"""Parts of wordings that say how fast already, besides those of `says_pace`."""
SLOWED_TO = (0.75, 0.93)
"""Speed of a clip that is played more slowly, as a part of the limit of "very slow", drawn between two values."""
SLOWED_BY = 0.75
"""Smallest factor that the speed of a clip is multiplied with."""
SLOW_VARIANTS = 2
"""Motions that are made of a clip by playing it more slowly."""
SLOW_CAPTIONS = {"very_slow": 16, "slow": 8}
"""Captions of each of them."""
MORE_CAPTIONS = 12
"""Captions of each extreme, and of the style, that a training clip gets besides its own."""
MOST_OF_A_STYLE = 12
"""Clips of a style from which motions of standing still are made."""
VARIANTS = 4
"""Motions of standing still that are made of each."""
EXTRA_PREFIXES = frozenset(
    f"{kind}{number + 1}" for kind, count in ((STAND, VARIANTS), ("slow", SLOW_VARIANTS)) for number in range(count)
)
"""What the names of such clips begin with."""


class Composed(NamedTuple):
    """A motion that is made of clips."""

    label: str
    positions: Float[np.ndarray, "T J 3"]
    captions: Sequence[Caption]
    origins: Sequence[str]
    """Names of the clips."""


class NewClip(NamedTuple):
    """A clip that was written."""

    name: str
    label: str
    num_frames: int
    origins: tuple[str, ...]
    """Clips of which it is made."""


def _measure_clips(folder: Path, names: Iterable[str]) -> dict[str, Facts]:
    """Returns the measurements of clips of a data set in the making."""
    return {name: measure(np.load(folder / POSITIONS / f"{name}.npy"), fps=HUMANML3D.fps) for name in names}


def _speed_limits(facts: Mapping[str, Facts], labels: Mapping[str, Labels]) -> dict[str, dict[str, float]]:
    """Returns content -> extreme -> speed in m/s. Few clips cannot be compared, so their contents are left out."""
    speeds = defaultdict(list)
    for name, label in labels.items():
        speeds[label.content].append(facts[name].speed)
    return {
        content: {extreme: float(np.quantile(values, share)) for extreme, share in EXTREMES.items()}
        for content, values in speeds.items()
        if len(values) >= FEWEST
    }


def _find_extremes(facts: Facts, limits: Mapping[str, float] | None) -> list[str] | None:
    """Returns the extremes that a clip shows by a margin; None without limits."""
    if limits is None:
        return None
    slow = [name for name in EXTREMES if "slow" in name and facts.speed < limits[name] * (1 - MARGIN)]
    return slow + [name for name in EXTREMES if "fast" in name and facts.speed > limits[name] * (1 + MARGIN)]


def _is_true_pace(caption: Caption, extremes: Sequence[str] | None) -> bool:
    """Returns whether a caption does not call a clip slow or fast that is not."""
    # Without limits of its content, nothing speaks against what a caption says.
    if extremes is None:
        return True
    # Tokens have no typing mistakes.
    text = " ".join(token.partition("/")[0] for token in caption.tokens)
    return all(pace in extremes or not says_pace(text, pace) for pace in ("slow", "fast"))


def _shows_pace(content: str, facts: Facts) -> bool:
    """Returns whether a clip does enough for a sentence that says no more of it than how fast it is."""
    return facts.waves >= 2 or not content.startswith("wave")


def write_more_captions(folder: Path, labels: Mapping[str, Labels]) -> None:
    """Adds captions to training clips: how fast they are among the clips of their content, and their style.

    Captions that call a clip slow or fast, as those of some styles do, are removed if it is not.
    """
    facts = _measure_clips(folder, labels)
    limits = _speed_limits(facts, labels)
    for name, label in labels.items():
        extremes = _find_extremes(facts[name], limits.get(label.content))
        if extremes and not _shows_pace(label.content, facts[name]):
            extremes = []
        typing = random.Random(f"typing of {name}")
        # Each kind of caption has its own generator, so that none changes when another kind is added.
        generator = random.Random(f"speed of {name}")
        manners = [one for extreme in extremes or () for one in [load_wordings().extremes[extreme]] * MORE_CAPTIONS]
        texts = [_say(label, facts[name], generator, manners=one) for one in manners]
        if label.style != "normal":
            generator = random.Random(f"style of {name}")
            texts += [_say(label, facts[name], generator) for _ in range(MORE_CAPTIONS)]
        said = tagged_captions(texts, typing)
        for twin, more in ((name, said), (MIRROR_PREFIX + name, [mirror(caption) for caption in said])):
            path = folder / TEXTS / f"{twin}.txt"
            save_captions(path, [one for one in (*load_captions(path), *more) if _is_true_pace(one, extremes)])


def _say(labels: Labels, facts: Facts, generator: random.Random, *, manners: tuple[Manner, ...] = ()) -> str:
    """Returns a sentence with one of the given manners; without any, with one of the clip's style."""
    wordings = true_wordings(labels, facts)
    # Strolls are slow, strides are fast, and their wordings need it.
    plain = [one for one in wordings if one.needs not in ("not_fast", "not_slow") and not one.nominal_form]
    plain = [one for one in plain if not says_pace(one.predicate)]
    plain = [one for one in plain if not any(mark in one.predicate for mark in PACE_MARKS)]
    wording = generator.choice(plain or wordings)
    return compose(labels, wording, facts=facts, style_share=1.0, generator=generator, manners=manners)


def write_stand_clips(folder: Path, labels: Mapping[str, Labels]) -> list[NewClip]:
    """Writes motions of standing still for training clips that have a stretch of it, and returns them.

    Of each style, only the clips with the longest stretches are used, because some styles have many more than others.
    """
    stretches = defaultdict(list)
    for name, label in labels.items():
        still = find_stillness(np.load(folder / POSITIONS / f"{name}.npy", mmap_mode="r"))
        if still is not None:
            # The negative length sorts the longest first, and equally long ones by name.
            stretches[label.style].append((still.start - still.stop, name, still))
    chosen = [found for style in stretches.values() for found in sorted(style)[:MOST_OF_A_STYLE]]
    return [
        _write_stand_clip(folder, name, number, still, labels[name].style)
        for _, name, still in chosen
        for number in range(1, VARIANTS + 1)
    ]


def _write_stand_clip(folder: Path, name: str, number: int, still: slice, style: str) -> NewClip:
    generator = random.Random(f"stillness {number} of {name}")
    labels = Labels(STAND, style)
    positions = np.load(folder / POSITIONS / f"{name}.npy")[still]
    motion = stand_still(positions, num_frames=generator.randint(*STAND_FRAMES))
    facts = measure(motion, fps=HUMANML3D.fps)
    wordings = load_wordings().contents[STAND].wordings
    texts = [
        compose(labels, generator.choice(wordings), facts=facts, style_share=0.3, generator=generator)
        for _ in range(CAPTIONS)
    ]
    captions = tagged_captions(texts, generator)
    return write_new_clip(folder, f"{STAND}{number}_{name}", Composed(", ".join(labels), motion, captions, [name]))


def write_slow_clips(folder: Path, labels: Mapping[str, Labels]) -> list[NewClip]:
    """Writes training clips that are slow already once more, played so slowly that they are clearly very slow.

    A content's very slow clips are few, and many of them are just below its limit.
    """
    facts = _measure_clips(folder, labels)
    limits = _speed_limits(facts, labels)
    new = []
    for (name, label), number in itertools.product(labels.items(), range(1, SLOW_VARIANTS + 1)):
        content = label.content
        generator = random.Random(f"slowness {number} of {name}")
        # No factor makes a still clip slower.
        if content in limits and _shows_pace(content, facts[name]) and facts[name].speed > 0:
            factor = generator.uniform(*SLOWED_TO) * limits[content]["very_slow"] / facts[name].speed
            if SLOWED_BY <= factor < 1:
                new.append(_write_slow_clip(folder, name, label, number=number, factor=factor))
    return new


def _write_slow_clip(folder: Path, name: str, labels: Labels, *, number: int, factor: float) -> NewClip:
    generator = random.Random(f"slow captions {number} of {name}")
    motion = Motion(np.load(folder / POSITIONS / f"{name}.npy"), HUMANML3D.fps).at_speed(factor).positions
    facts = measure(motion, fps=HUMANML3D.fps)
    manners = [load_wordings().extremes[extreme] for extreme, count in SLOW_CAPTIONS.items() for _ in range(count)]
    texts = [_say(labels, facts, generator, manners=one) for one in manners]
    captions = tagged_captions(texts, generator)
    return write_new_clip(folder, f"slow{number}_{name}", Composed(", ".join(labels), motion, captions, [name]))


def write_new_clip(folder: Path, name: str, made: Composed) -> NewClip:
    """Writes a motion that is made of clips, and its twin."""
    num_frames = write_twins(folder, name, made.positions, captions=made.captions, skeleton=HUMANML3D)
    return NewClip(name, made.label, num_frames, tuple(made.origins))
