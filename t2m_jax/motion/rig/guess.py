"""The best guess of a table for a rig that is not known by name."""

import difflib
import re
from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from t2m_jax.errors import UserError
from t2m_jax.motion.rig.clip import RigClip
from t2m_jax.motion.rig.orientation import left_is_left
from t2m_jax.motion.rig.retarget import retarget
from t2m_jax.motion.rig.rigs import OPTIONAL_JOINTS, Rig
from t2m_jax.motion.rig.tables import RIGS
from t2m_jax.motion.skeleton import HUMANML3D

ENOUGH = 0.5
"""Names that are less alike than this are not taken for the same joint (`difflib.SequenceMatcher.ratio`)."""
MOST = 0.6
"""A word in more than this share of the names says nothing of a joint, such as `Bip01` or `mixamorig`."""
_SPINE = ("spine1", "spine2", "spine3")
_SIDES = {"l": "left", "left": "left", "lft": "left", "r": "right", "right": "right", "rgt": "right", "rt": "right"}


class RigGuess(NamedTuple):
    """A table from HumanML3D's joints to those of a file, to be checked by a person."""

    table: dict[str, str]
    similar_to: str
    """Name of the known rig with the most similar names."""
    likeness: float
    """How similar they are on average, up to 1."""


def guess_rig(joint_names: Sequence[str]) -> RigGuess:
    """Returns the table that results from the known rig whose joint names are most similar.

    A third of the likeness is that to the rig, the rest is that to the most similar name in any rig.
    """
    words = _names(joint_names)
    # A file may call its arms as one rig does and its legs as another, so all rigs have a say in each joint.
    each = {rig.name: _likeness(rig, words) for rig in RIGS.values()}
    best = np.max(list(each.values()), axis=0)
    return max(
        (_assign(name, (own + 2 * best) / 3, joint_names) for name, own in each.items()), key=lambda g: g.likeness
    )


def _names(joint_names: Sequence[str]) -> list[tuple[str, str]]:
    """Returns side ("left", "right" or "") and name of each joint in small letters, without words that most have."""
    words = [re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|\d+", name.rpartition(":")[2]) for name in joint_names]
    # Which words are common is only known for all names, and a side is never left out.
    lower = [[word.lower() for word in parts] for parts in words]
    uses = Counter(word for parts in lower for word in set(parts))
    common = {word for word, count in uses.items() if count > MOST * len(lower)} - _SIDES.keys()
    short = [[word for word in parts if word not in common] or parts for parts in lower]
    whole = {"".join(parts) for parts in short}
    return [_side(parts, whole) for parts in short]


def _side(parts: Sequence[str], whole: set[str]) -> tuple[str, str]:
    """Returns the side and the rest of a name. `lfemur` is left if there is an `rfemur`, too."""
    for word in parts:
        if word in _SIDES:
            return _SIDES[word], "".join(part for part in parts if part != word)
    name = "".join(parts)
    for letter, other in ("lr", "rl"):
        if name.startswith(letter) and other + name[1:] in whole:
            return _SIDES[letter], name[1:]
    return "", name


def _likeness(rig: Rig, words: Sequence[tuple[str, str]]) -> Float[np.ndarray, "22 S"]:
    """Returns how similar the names of a rig's joints are to those of a file's; 0 on another side."""
    sources = dict(rig.sources)
    likeness = np.zeros((len(HUMANML3D.joint_names), len(words)))
    for joint, (side, name) in zip(sources, _names([names[0] for names in sources.values()]), strict=True):
        row = HUMANML3D.joint_names.index(joint)
        for column, (other_side, other) in enumerate(words):
            if side == other_side:
                likeness[row, column] = difflib.SequenceMatcher(None, name, other).ratio()
    return likeness


def _assign(name: str, likeness: Float[np.ndarray, "22 S"], joint_names: Sequence[str]) -> RigGuess:
    """Returns the table in which the names are most similar. Joints of the spine keep their order in the file."""
    from scipy.optimize import linear_sum_assignment  # here, because it takes long to import

    pairs = list(zip(*linear_sum_assignment(likeness, maximize=True), strict=True))
    found = {HUMANML3D.joint_names[row]: int(column) for row, column in pairs if likeness[row, column] >= ENOUGH}
    # Names of spines are alike (Spine, Spine1, ...), so an assignment may exchange them.
    spine = [joint for joint in _SPINE if joint in found]
    found |= dict(zip(spine, sorted(found[joint] for joint in spine), strict=True))
    total = float(sum(likeness[pair] for pair in pairs))
    return RigGuess({joint: joint_names[at] for joint, at in found.items()}, name, total / len(HUMANML3D.joint_names))


def rig_table_text(clip: RigClip, *, source: str) -> str:
    """Returns the guess for a clip as the text of a table with a line for each of the 22 joints, for `--rig`.

    Args:
        clip: The clip; its motion is used to check that left is left.
        source: Its file, for the comment at the beginning.
    """
    names = clip.with_end_sites().joint_names
    guess = guess_rig(names)
    lines = [
        f"# Joints of HumanML3D and those of {source}: a guess from the names, which are most similar to the rig",
        f"# {guess.similar_to} ({guess.likeness:.0%}). Check each line, then import with --rig and this file.",
        f"# {_check_sides(clip, guess)}",
    ]
    for joint in HUMANML3D.joint_names:
        if joint in guess.table:
            lines.append(f'{joint}: "{guess.table[joint]}"')
        else:
            needed = "may be missing" if joint in OPTIONAL_JOINTS else "NEEDED, none was similar"
            lines.append(f"# {joint}:  # {needed}")
    unused = [name for name in names if name not in guess.table.values() and not name.endswith("End Site")]
    return "\n".join([*lines, f"# Other joints of the file: {', '.join(unused)}"]) + "\n"


def _check_sides(clip: RigClip, guess: RigGuess) -> str:
    """Returns a sentence about left and right."""
    try:
        right = float(np.mean(left_is_left(retarget(clip, rig=guess.table, up="y").positions)))
    except UserError as error:
        return f"Left and right were not checked: {error}"
    if right > 0.5:
        return f"Left is left in {right:.0%} of the frames, as the knees bend and the feet point."
    return f"LEFT AND RIGHT ARE EXCHANGED in {1 - right:.0%} of the frames, as the knees bend and the feet point."
