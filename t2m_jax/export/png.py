"""PNG pictures of motion."""

from collections.abc import Sequence
from pathlib import Path

from PIL import Image

from t2m_jax.errors import UserError
from t2m_jax.export.render.rendering import render_poster
from t2m_jax.export.render.trails import render_trails
from t2m_jax.files.writing import atomic_file
from t2m_jax.motion.motion import Motion

MAX_ROWS = 100
"""Motions that a contact sheet has room for; pictures of more are too high for many viewers."""
NUM_POSES = 8


def save_png(path: Path, motions: Sequence[Motion]) -> None:
    """Writes a picture. One motion is drawn with the paths of its hands and feet, several as a contact sheet.

    A contact sheet has a row of poses per motion, at equal time steps.

    Raises:
        UserError: There are more than `MAX_ROWS` motions.
    """
    if len(motions) > MAX_ROWS:
        raise UserError(f"{path}: {len(motions)} motions are too many for a contact sheet; give at most {MAX_ROWS}")
    # A single motion has room for its paths, which tell more than a row of poses.
    if len(motions) == 1:
        picture = render_trails(motions[0])
    else:
        picture = Image.fromarray(render_poster(motions, num_poses=NUM_POSES))
    with atomic_file(path) as partial:
        picture.save(partial, format="PNG", optimize=True)
