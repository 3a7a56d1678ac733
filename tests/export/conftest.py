"""Motions to write."""

import numpy as np
import pytest

from t2m_jax.motion.motion import Motion
from t2m_jax.motion.skeleton import HUMANML3D, KIT_ML

NASTY_CAPTION = (
    'a </script><img src=x onerror="alert(1)"> walks & "waves" <!-- 👋 \u2028 é \'quoted\' {{style}} /*{{data}}*/'
)


@pytest.fixture(scope="session")
def walk(golden_dir) -> Motion:
    """Returns 80 frames of synthetic walking."""
    with np.load(golden_dir / "motion" / "synth22_walk.npz") as arrays:
        positions = arrays["ground_positions"]
    return Motion(positions, HUMANML3D.fps, caption="a person walks", seed=7)


@pytest.fixture(scope="session")
def kit_walk(golden_dir) -> Motion:
    """Returns synthetic walking on KIT-ML's one-metre body."""
    with np.load(golden_dir / "motion" / "synth21_walk.npz") as arrays:
        positions = arrays["ground_positions"] * KIT_ML.metres_per_unit
    return Motion(positions, KIT_ML.fps, skeleton=KIT_ML, caption="a smaller person walks")


@pytest.fixture(scope="session")
def nasty(walk) -> Motion:
    """Returns the walk under a caption that tries to break out of HTML."""
    return Motion(walk.positions, walk.fps, caption=NASTY_CAPTION)
