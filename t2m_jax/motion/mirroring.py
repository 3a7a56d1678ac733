"""Exchanging left and right, in positions and in captions."""

import re

import numpy as np
from jaxtyping import Float

from t2m_jax.motion.namespace import AnyArray, namespace_of
from t2m_jax.motion.skeleton import Skeleton

_TURNS = {"clockwise": "counterclockwise", "counterclockwise": "clockwise", "anticlockwise": "clockwise"}
_TURNS |= {"cw": "ccw", "ccw": "cw"}
_SIDES = {"left": "right", "right": "left", "l": "r", "r": "l"}
_LETTER = r"[^\W\d_]"
_NO_SIDE = (
    # But "to the right here".
    r"(?<!the )(?<!his )(?<!her )(?<!its )(?<!their )right (?:away|here|now|there)|right[-\s]angle[ds]?|all right|"
    r"(?:boy|girl|he|it|man|person|she|somebody|someone|they|who|woman) left (?:a|an|the|her|his|its|their)"
)
_WORD = re.compile(
    rf"(?<!{_LETTER})(?:(?P<kept>{_NO_SIDE})|(?P<side>left|right)(?P<ending>ward|wards|most|s|hand|handed)?"
    rf"|(?P<letter>(?-i:[LR]))(?=\.?[-\s](?:arm|hand|wrist|elbow|shoulder|fist|leg|foot|knee|ankle|hip|heel|side))"
    rf"|(?P<turn>(?:(?:counter|anti)[-\s]?)?clockwise|c?cw))(?!{_LETTER})",
    re.IGNORECASE,
)


def mirror_positions(positions: Float[AnyArray, "*batch J 3"], skeleton: Skeleton) -> Float[AnyArray, "*batch J 3"]:
    """Returns the mirrored motion, float32: x is negated, and left and right joints are exchanged.

    Raises:
        UserError: The number of joints is not the skeleton's.
    """
    skeleton.check_joints(positions)
    order = np.arange(skeleton.num_joints)
    for pair in skeleton.mirror_pairs:
        order[list(pair)] = pair[::-1]
    # Without the exchange of joints, the mirror image would walk with its left leg on the right side.
    xp = namespace_of(positions)
    mirrored = xp.asarray(positions, dtype=xp.float32)[..., order, :]
    return xp.concatenate([-mirrored[..., :1], mirrored[..., 1:]], axis=-1)


def mirror_caption(text: str) -> str:
    """Returns a caption with left and right, and clockwise and counterclockwise, exchanged.

    Only whole words change ("bright" does not), also in hyphenated words and in tagged tokens ("left/ADV"). The case is
    kept. "Anticlockwise" becomes "clockwise", which becomes "counterclockwise". "R hand" and "CCW" are known, too.
    """
    # One pass over the text: exchanging word after word would exchange back what was exchanged before.
    return _WORD.sub(_mirrored_word, text)


def _mirrored_word(match: re.Match[str]) -> str:
    """Returns the other side or turn for one that was found in a text."""
    if match["kept"]:  # "he left the stage"
        return match.group()
    if match["turn"]:
        return _like(match.group(), _TURNS[re.sub(r"[-\s]", "", match.group().lower())])
    side = match["side"] or match["letter"]
    return _like(side, _SIDES[side.lower()]) + (match["ending"] or "")


def _like(model: str, word: str) -> str:
    """Returns `word` with the capitals of `model`."""
    if model.isupper():
        return word.upper()
    return word.capitalize() if model[0].isupper() else word
