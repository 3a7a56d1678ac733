"""Training motions of two actions at once: what the arms of one clip do, on the legs of another."""

import random

import numpy as np
from jaxtyping import Float

from t2m_jax.data.captioning.lexicon import read_words
from t2m_jax.data.composing.lasting import with_length
from t2m_jax.data.composing.pieces import LONGEST, LabeledPiece, Library
from t2m_jax.errors import UserError
from t2m_jax.motion.features import bone_vectors, heading_quaternions, positions_from_bones
from t2m_jax.motion.rotations import quaternion_inverse, quaternion_multiply, rotate_vectors
from t2m_jax.motion.skeleton import HUMANML3D

LEGS = tuple(
    joint
    for joint, name in enumerate(HUMANML3D.joint_names)
    if any(part in name for part in ("hip", "knee", "ankle", "foot"))
)
"""Joints whose bones are those of the clip with the legs; the hips are bones of the pelvis."""

SHORTEST = 36
"""Frames of the shortest motion of two actions at once."""
MOST_TURN = 60.0
"""Degrees that a person with the arms may turn: the legs lead."""
MOST_TRAVEL = 0.7
"""Meters that they may travel."""
TRIES = 100


def draw_at_once(
    library: Library, generator: random.Random
) -> tuple[LabeledPiece, LabeledPiece, Float[np.ndarray, "T J 3"]]:
    """Returns a piece with legs, one with arms, and their motion together.

    Raises:
        UserError: There are no clips that fit.
    """
    words = read_words(__package__, "composed")
    for _ in range(TRIES):
        legs = library.draw_clip(words["legs"], generator)
        arms = library.draw_clip(words["arms"], generator)
        if legs is None or arms is None:
            break
        fitted = _fit(legs, arms, generator)
        if fitted is None:
            continue
        legs, arms = fitted
        if abs(arms.facts.turn) < MOST_TURN and arms.facts.travel < MOST_TRAVEL:
            return legs, arms, put_on_legs(arms.positions, legs.positions)
    raise UserError("at-once: no training clips have legs and arms that fit; leave it out")


def _fit(legs: LabeledPiece, arms: LabeledPiece, generator: random.Random) -> tuple[LabeledPiece, LabeledPiece] | None:
    """Returns both pieces with one length; None if one of them would be cut where it must not be."""
    count = min(len(legs.features), LONGEST)
    # Arms begin and end as in their clip. Of legs that only go on, any part will do; turns and jumps are whole.
    if len(arms.features) < count and legs.travels and "turn" not in legs.labels.content:
        count = len(arms.features)
    if count < SHORTEST:
        return None
    features = with_length(arms.features, count)
    lasting = read_words(__package__, "composed")["lasting_contents"]
    # Once is once: what is not done again and again must not be cut.
    if features is None or (len(arms.features) != count and arms.labels.content not in lasting):
        return None
    first = generator.randint(0, len(legs.features) - count)
    return legs._replace(features=legs.features[first : first + count]), arms._replace(features=features)


def put_on_legs(arms: Float[np.ndarray, "T J 3"], legs: Float[np.ndarray, "T J 3"]) -> Float[np.ndarray, "T J 3"]:
    """Returns the path, pelvis and legs of one motion with spine, head and arms of another one of the same length.

    Spine and arms keep their directions relative to the heading. So who bows or waves does it to where the legs go.
    """
    leading = heading_quaternions(legs, HUMANML3D)
    turn = np.array(quaternion_multiply(quaternion_inverse(leading), heading_quaternions(arms, HUMANML3D)))
    # The heading of the first frame is not smoothed.
    turn[0] = turn[1]
    bones = np.array(bone_vectors(legs, HUMANML3D))
    upper = [joint - 1 for joint in range(1, HUMANML3D.num_joints) if joint not in LEGS]
    bones[:, upper] = rotate_vectors(turn[:, None], bone_vectors(arms, HUMANML3D)[:, upper])
    return positions_from_bones(legs[:, 0], bones, HUMANML3D)
