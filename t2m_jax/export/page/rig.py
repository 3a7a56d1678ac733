"""How the page fits a rigid figure to joints, as plain data, so that its program has no sizes of its own."""

from typing import Any

from t2m_jax.motion.bvh.writer import END_SITES, FLAT_SHARE, STEEPEST
from t2m_jax.motion.cleanup import CONTACT_HEIGHT
from t2m_jax.motion.inverse_kinematics import ARMS, CHEST, LEGS, PELVIS, REST_DIRECTIONS, RIGID_SWEEPS
from t2m_jax.motion.rig.rigs import rig_joint_names
from t2m_jax.motion.skeleton import HUMANML3D
from t2m_jax.motion.twist import HALF_TRUST, MAX_DEGREES_PER_SECOND, NATURAL_WEIGHT, NUM_ANGLES, SMOOTHNESS


def rig_record() -> dict[str, Any]:
    """Returns what the rig of the 22 HumanML3D joints is; `web/rig.js` and `web/bvh.js` read it."""
    joints = HUMANML3D.joint_names
    return {
        "names": list(rig_joint_names("lafan1")),
        "directions": [list(map(float, REST_DIRECTIONS.get(name, (0, 0, 0)))) for name in joints],
        "ends": [END_SITES.get(name, 0.0) for name in joints],
        "flat": {"height": CONTACT_HEIGHT, "share": FLAT_SHARE, "steepest": STEEPEST},
        "hubs": [list(PELVIS), list(CHEST)],
        "spine": [joints.index(name) for name in ("spine1", "spine2")],
        "limbs": [
            {"start": limb.start, "hinge": limb.hinge, "axis": list(map(float, limb.hinge_axis))}
            for limb in (*LEGS, *ARMS)
        ],
        "ankles": [leg.end for leg in LEGS],
        "sweeps": RIGID_SWEEPS,
        "twist": {
            "angles": NUM_ANGLES,
            "speed": MAX_DEGREES_PER_SECOND,
            "trust": HALF_TRUST,
            "natural": NATURAL_WEIGHT,
            "smoothness": SMOOTHNESS,
        },
    }
