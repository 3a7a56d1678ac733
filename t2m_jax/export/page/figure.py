"""How the page draws a figure around joints, as plain data, so that its program has no sizes of its own."""

from typing import Any

from t2m_jax.export.page.rig import rig_record
from t2m_jax.export.render.figure import (
    REFERENCE_LEG,
    TINTS,
    body_from_skeleton,
    is_mirrored,
    roles_from_skeleton,
)
from t2m_jax.export.render.scene import (
    CONTACT_HEIGHT,
    CONTACT_SECONDS,
    CONTACT_SPEED,
    FLOOR_TOLERANCE,
    HUMAN_SCALES,
    SOLE,
)
from t2m_jax.motion.skeleton import HUMANML3D, Skeleton


def figure_record(skeleton: Skeleton) -> dict[str, Any]:
    """Returns points, parts, joints and sizes of the figure of a skeleton; `web/figure.js` reads it.

    Also the rig of the skeleton that files of animation programs are written for.
    """
    body = body_from_skeleton(skeleton)
    roles = roles_from_skeleton(skeleton)
    _, neck, tip = roles.spine[-3:]
    return {
        "weights": [[round(float(weight), 6) for weight in row] for row in body.weights],
        "parts": [[*part[:4], TINTS.index(part.tint)] for part in body.parts],
        "head": body.head,
        "mirrored": is_mirrored(skeleton),
        "rig": rig_record() if skeleton == HUMANML3D else None,
        "roles": {
            "neck": neck,
            "tip": tip,
            "leftShoulder": roles.left_arm[0],
            "rightShoulder": roles.right_arm[0],
            "legs": [roles.left_leg[:3], roles.right_leg[:3]],
            "feet": [skeleton.left_foot[-1], skeleton.right_foot[-1]],
        },
        "sizes": {
            "leg": REFERENCE_LEG,
            "human": HUMAN_SCALES,
            "sole": SOLE,
            "floor": FLOOR_TOLERANCE,
            "contact": [CONTACT_HEIGHT, CONTACT_SPEED, CONTACT_SECONDS],
        },
    }
