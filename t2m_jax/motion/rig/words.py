"""What the names of joints say: the side, and the parts of a body that a name may mean."""

import dataclasses
import functools
import re
import unicodedata
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

from t2m_jax.yaml_file import load_yaml

MOST = 0.6
"""A word in more than this share of the names says nothing of a joint, such as `Bip01` or `mixamorig`."""
MAX_NAME = 200
"""Letters of a name that are read, after its namespace. What follows in a longer one says nothing of a joint."""
MAX_BEGINNING = 40
"""Longest beginning that is searched."""
MIN_FUSED = 4
"""Letters of the shortest word for a side that is also found without a sign between it and others."""
_MARKS = ("helper", "end", "animal")
"""What `words.yaml` has beside the parts of a person."""
_UPPER, _LOWER = "A-ZÀ-ÖØ-ÞА-ЯЁ", "a-zß-öø-ÿа-яё"
_WORD = re.compile(rf"[{_UPPER}]?[{_LOWER}]+|[{_UPPER}]+(?![{_LOWER}])|\d+|[^\W\d_{_UPPER}{_LOWER}]+")
"""A word of a name: `Left`, `Arm`, `IK`, `01`, `左足`."""


@dataclasses.dataclass(frozen=True)
class JointWords:
    """What one name says."""

    side: str
    """`left`, `right`, or nothing."""
    parts: Mapping[str, float]
    """Parts of the body -> how clearly the name means them, up to 2."""
    is_helper: bool
    """Whether it is no joint of the 22: a finger, a twist, an eye, a control."""
    is_end: bool
    """Whether it is where a bone ends: a tip, or the last joint of a numbered limb."""
    is_animal: bool
    """Whether people do not have it: a tail, a wing."""


@functools.cache
def _vocabulary() -> dict[str, dict[str, float]]:
    """Returns what each word means: parts with weights, from `words.yaml`."""
    found: dict[str, dict[str, float]] = {}
    for part, weights in load_yaml(Path(__file__).with_name("words.yaml")).data["parts"].items():
        for weight, words in weights.items():
            for word in str(words).split():
                found.setdefault(word, {})[part] = float(weight)
    return found


@functools.cache
def _sides(section: str = "sides") -> dict[str, str]:
    """Returns the side that each word for a side means, from `words.yaml`."""
    table = load_yaml(Path(__file__).with_name("words.yaml")).data[section]
    return {word: side for side, words in table.items() for word in words.split()}


def read_names(joint_names: Sequence[str]) -> list[JointWords]:
    """Returns what each name says. Words and beginnings that most names share are left out."""
    # Namespaces are before a colon, as in `mixamorig:Hips`.
    short = _without_shared_beginning([name.rpartition(":")[2][:MAX_NAME] for name in joint_names])
    # With full-width letters as others, and accents as parts of letters.
    words = [[word.lower() for word in _WORD.findall(unicodedata.normalize("NFKC", name))] for name in short]
    uses = Counter(word for parts in words for word in set(parts))
    if not uses.keys() & _sides().keys():
        words = [[_sides("initials").get(word, word) for word in parts] for parts in words]
    # The hands of a figure with all fingers are in most names, too.
    common = (
        {word for word, count in uses.items() if count > MOST * len(words)} - _sides().keys() - _vocabulary().keys()
    )
    return [_read(tuple(word for word in parts if word not in common) or tuple(parts)) for parts in words]


def _without_shared_beginning(names: Sequence[str]) -> list[str]:
    """Returns names without what most of them begin with, up to a digit or a sign (`Bip01`, `Character1_`)."""
    counts = Counter(
        name[:length]
        for name in names
        for length in range(1, min(len(name), MAX_BEGINNING))
        if not name[length - 1].isalpha()
    )
    shared = max((text for text, count in counts.items() if count > MOST * len(names)), key=len, default="")
    return [name.removeprefix(shared) for name in names]


@functools.lru_cache(maxsize=4096)
def _read(words: tuple[str, ...]) -> JointWords:
    """Returns what a name of these words says; sides are words, or the beginning or the end of the whole name."""
    known = _vocabulary()
    letters = tuple(word for word in words if not word.isdigit())
    sides = [_sides()[word] for word in letters if word in _sides()]
    rest = tuple(word for word in letters if word not in _sides())
    side = sides[0] if sides else ""
    # `LFArm` is a left forearm, although `LF` is a side in other files.
    if letters and (not side or (len(letters[0]) == 2 and "".join(letters)[1:] in known)):
        side, rest = _fused_side(letters)
    parts: dict[str, float] = {}
    whole = "".join(rest)
    meanings = [known.get(word, {}) for word in (whole, *rest)]
    # The whole name says most (`upperleg`), then its last two words (`my_lower_arm`), its last, and any other.
    for text, weight in ((whole, 1.0), ("".join(rest[-2:]), 0.8), (rest[-1] if rest else "", 0.7)):
        parts = parts or _parts(known.get(text, {}), weight)
    parts = parts or {part: value for meaning in meanings for part, value in _parts(meaning, 0.5).items()}
    # Also if a part is known: `hand_twist` is a helper.
    marks = {mark for meaning in meanings for mark in meaning if mark in _MARKS}
    is_helper = "helper" in marks
    return JointWords(side, parts, is_helper, "end" in marks and not is_helper, "animal" in marks and not is_helper)


def _parts(meaning: Mapping[str, float], weight: float) -> dict[str, float]:
    """Returns the parts of the body that a word may mean, with weights."""
    return {part: value * weight for part, value in meaning.items() if part not in _MARKS}


def _fused_side(words: tuple[str, ...]) -> tuple[str, tuple[str, ...]]:
    """Returns the side in a name without signs, such as `leftarm`, `lthigh` or `armR`, and the words without it."""
    known = _vocabulary()
    whole = "".join(words)
    # Such as `leg`, which does not begin with an l for left. Without another side, `larm` is the left arm.
    if whole in known and whole[1:] not in known:
        return "", words
    for word, side in _sides().items():
        for end, others in (
            (0, (words[0].removeprefix(word), *words[1:])),
            (-1, (*words[:-1], words[-1].removesuffix(word))),
        ):
            # `leftarm` and `左腕`. Short words are often the beginning of others, so the rest must be known: `lthigh`.
            is_sure = len(word) >= MIN_FUSED or word > "\u3000"
            is_known = word in ("l", "r") and (others[end] in known or "".join(others) in known)
            if others != words and all(others) and (is_sure or is_known):
                return side, others
    return "", words
