"""A contact sheet: one HTML page with some poses of each clip of a data set, to see at a glance what is in it."""

import html
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from t2m_jax.data.files import MIRROR_PREFIX, SPLITS
from t2m_jax.data.folder import Dataset
from t2m_jax.errors import UserError
from t2m_jax.export.render.figure import Roles, is_mirrored, roles_from_skeleton
from t2m_jax.files.template import fill_template
from t2m_jax.files.writing import save_text
from t2m_jax.motion.features import positions_from_features
from t2m_jax.motion.skeleton import Skeleton
from t2m_jax.motion.travel import above_origin

MAX_CLIPS = 200
"""Most clips on a sheet; browsers are slow with more. Of a larger data set, they are evenly spread over the names."""
NUM_POSES = 7
CAMERA_TURN = np.deg2rad(30.0)
"""The camera is in front of the first pose, turned to its left side."""
CAMERA_DROP = 0.22
"""It looks down a little: centimeters that a centimeter of depth is lower in the picture."""


def save_contact_sheet(
    path: Path, dataset: Dataset, *, notes: Sequence[str] = (), left_out: Mapping[str, str] | None = None
) -> None:
    """Writes the page.

    Args:
        path: The page.
        dataset: The data set; mirrored twins are not shown.
        notes: What an import reported.
        left_out: Clip name -> why an import left it out.

    Raises:
        UserError: A list of clips or a clip cannot be read, or the page cannot be written.
    """
    homes = {name: split for split in SPLITS for name in dataset.names(split) if not name.startswith(MIRROR_PREFIX)}
    roles = roles_from_skeleton(dataset.skeleton)
    names = sorted(homes)
    count = min(len(names), MAX_CLIPS)
    # Evenly over the sorted names, so that each kind of clip is there.
    shown = [names[place] for place in np.linspace(0, len(names) - 1, count).round().astype(int)]
    lines = [*notes, *(f"{name}: left out: {reason}" for name, reason in (left_out or {}).items())]
    parts = {
        "title": html.escape(f"{dataset.info.name or dataset.folder.name}: {len(names)} clips"),
        "shown": "" if count == len(names) else f"{count} of them are shown.",
        "notes": "".join(f"<li>{html.escape(line)}</li>" for line in lines),
        "clips": "".join(_card(dataset, name, split=homes[name], roles=roles) for name in shown),
    }
    save_text(path, fill_template("t2m_jax.export", "contact_sheet.html", parts))


def _card(dataset: Dataset, name: str, *, split: str, roles: Roles) -> str:
    """Returns the poses, the name and the captions of a clip."""
    features = dataset.features(name)
    if not len(features):
        raise UserError(f"{dataset.folder}: clip {name} has no frames; remove it from the lists of the splits")
    seconds = len(features) / dataset.info.fps
    captions = "".join(f"<li>{html.escape(caption.text)}</li>" for caption in dataset.captions(name)[:3])
    frames = np.linspace(0, len(features) - 1, NUM_POSES).round().astype(int)
    positions = positions_from_features(features, dataset.skeleton)[frames] * dataset.skeleton.metres_per_unit
    return (
        f"<article><h2>{html.escape(name)}</h2><p>{split}, {seconds:.1f} s</p>"
        f"{_drawing(_on_screen(positions, dataset.skeleton), roles)}<ul>{captions}</ul></article>"
    )


def _on_screen(positions: Float[np.ndarray, "P J 3"], skeleton: Skeleton) -> Float[np.ndarray, "P J 2"]:
    """Returns poses side by side in centimeters, x to the right and y down, the floor at 0."""
    x, y, z = np.moveaxis(above_origin(positions), -1, 0)
    if is_mirrored(skeleton):
        x = -x
    across = x * np.cos(CAMERA_TURN) - z * np.sin(CAMERA_TURN)
    depth = x * np.sin(CAMERA_TURN) + z * np.cos(CAMERA_TURN)
    places = 100 * np.arange(len(positions))[:, None]
    return np.stack([100 * across + places, -100 * (y - CAMERA_DROP * depth)], axis=-1)


def _drawing(points: Float[np.ndarray, "P J 2"], roles: Roles) -> str:
    """Returns a drawing in which left and right limbs have their own colors."""
    limbs = {
        "spine": [roles.spine],
        "right": [roles.right_arm, roles.right_leg],
        "left": [roles.left_arm, roles.left_leg],
    }
    lines = []
    for pose in points:
        # Shoulders and hips are no chain of the skeleton, so lines across connect the limbs.
        girdle = (roles.left_arm[0], roles.right_arm[0]), (roles.left_leg[0], roles.right_leg[0])
        for kind, chains in (("spine", girdle), *limbs.items()):
            for chain in chains:
                path = " ".join(f"{x:.0f},{y:.0f}" for x, y in pose[list(chain)])
                lines.append(f'<polyline class="{kind}" points="{path}"/>')
        x, y = pose[roles.spine[-1]]
        lines.append(f'<circle class="spine" cx="{x:.0f}" cy="{y - 6:.0f}" r="8"/>')
    low = points.min(axis=(0, 1)) - 25  # more than below, because the head is above its joint
    size = points.max(axis=(0, 1)) + 15 - low
    box = f"{low[0]:.0f} {low[1]:.0f} {size[0]:.0f} {size[1]:.0f}"
    return f'<svg viewBox="{box}" role="img" aria-label="{len(points)} poses">{"".join(lines)}</svg>'
