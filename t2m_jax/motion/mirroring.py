"""Left and right exchanged, in positions and in the captions that describe them."""

import re

import numpy as np
from jaxtyping import Float

from t2m_jax.errors import UserError
from t2m_jax.motion.namespace import AnyArray, namespace_of
from t2m_jax.motion.skeleton import Skeleton

_TURNS = {"clockwise": "counterclockwise", "counterclockwise": "clockwise", "anticlockwise": "clockwise"}
_SIDES = {"left": "right", "right": "left"}
_LETTER = r"[^\W\d_]"
_WORD = re.compile(
    rf"(?<!{_LETTER})(?:(?P<side>left|right)(?P<ending>ward|wards|most|s|hand|handed)?"
    rf"|(?P<turn>(?:(?:counter|anti)[-\s]?)?clockwise))(?!{_LETTER})",
    re.IGNORECASE,
)


def mirror_positions(positions: Float[AnyArray, "*batch J 3"], skeleton: Skeleton) -> Float[AnyArray, "*batch J 3"]:
    """Returns the motion seen in a mirror: x negated, left and right joints exchanged; float32.

    Raises:
        UserError: The joints are not the skeleton's.
    """
    if positions.shape[-2] != skeleton.num_joints:
        raise UserError(
            f"positions have {positions.shape[-2]} joints, but skeleton {skeleton.name} has {skeleton.num_joints}; "
            "choose the joints of the skeleton, in its order"
        )
    order = np.arange(skeleton.num_joints)
    for left, right in skeleton.mirror_pairs:
        order[left], order[right] = right, left
    xp = namespace_of(positions)
    mirrored = xp.asarray(positions, dtype=xp.float32)[..., order, :]
    return xp.concatenate([-mirrored[..., :1], mirrored[..., 1:]], axis=-1)


def mirror_caption(text: str) -> str:
    """Returns a caption with left and right, clockwise and counterclockwise exchanged.

    Whole words only ("bright" stays), also inside hyphens and in tagged tokens ("left/ADV"); capitals are kept.
    "Anticlockwise" becomes "clockwise", which becomes "counterclockwise".
    """
    return _WORD.sub(_mirrored_word, text)


def _mirrored_word(match: re.Match[str]) -> str:
    """Returns what stands in the mirrored caption for one word."""
    word = match.group()
    if match["turn"]:
        return _like(word, _TURNS[re.sub(r"[-\s]", "", word.lower())])
    side = match["side"]
    return _like(side, _SIDES[side.lower()]) + (match["ending"] or "")


def _like(model: str, word: str) -> str:
    """Returns `word` with the capitals of `model`."""
    if model.isupper():
        return word.upper()
    return word.capitalize() if model[0].isupper() else word
