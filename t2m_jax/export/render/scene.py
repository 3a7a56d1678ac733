"""The scene that both renderers draw: figures on the ground y = 0, side by side if there are several."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from t2m_jax.errors import UserError
from t2m_jax.export.render.figure import BodyPart, body_from_skeleton, figure_points, figure_scale, is_mirrored
from t2m_jax.motion.motion import Motion

SOLE = 0.027
"""Meters between the joint centers of a standing foot and the ground."""

FLOOR_TOLERANCE = 0.1
"""Meters. If the lowest joint is farther than this from y = 0, the clip's floor is assumed to be at that joint."""

HUMAN_SCALES = (0.7, 1.4)
"""Figures outside this range, relative to the reference figure, are scaled to its size (KIT-ML's is 1 m tall)."""

CONTACT_HEIGHT = 0.09
"""A foot stands if its toes are lower than this; meters."""
CONTACT_SPEED = 0.35
"""And slower than this; meters per second."""
CONTACT_SECONDS = 0.1
"""For at least this time."""

LANE_WIDTHS = (1.3, 3.0)
"""Smallest and largest width of one figure's lane along X, in meters."""


class Contact(NamedTuple):
    """A foot that stands."""

    first: int
    """Frame."""
    last: int
    x: float
    """Place on the ground in meters."""
    z: float


class SceneFigure(NamedTuple):
    """One sample that is ready to draw, in meters, Y up."""

    points: Float[np.ndarray, "T P 3"]
    parts: tuple[BodyPart, ...]
    fps: float
    caption: str
    contacts: tuple[Contact, ...]
    lift: float
    """By how much the points are above those of the motion, in meters: soles, less a floor that is not at 0."""


def figures_from_motions(motions: Sequence[Motion]) -> list[SceneFigure]:
    """Returns the figures of all motions in a common space. A single figure keeps its place. Several get a lane each.

    Lanes go from left to right as seen from +Z, in rows of about six.
    """
    if not motions:
        raise UserError("there is no motion to draw; give at least one")
    figures = [figure_from_motion(motion) for motion in motions]
    if len(figures) == 1:
        return figures
    # Rows of 1.6 times as many figures as there are rows, which is about the shape of a picture.
    columns = len(figures) if len(figures) <= 6 else math.ceil(math.sqrt(1.6 * len(figures)))
    starts, ends = (np.array([bound(f.points[..., 0]) for f in figures]) for bound in (np.min, np.max))
    # A lane has room for the whole way of its figure, but a runner does not push the others out of the picture.
    widths = np.clip(ends - starts + 0.3, *LANE_WIDTHS)
    moved = []
    for row in range(0, len(figures), columns):
        lane_ends = np.cumsum(widths[row : row + columns])
        for column, figure in enumerate(figures[row : row + columns]):
            number = row + column
            center = lane_ends[column] - widths[number] / 2 - lane_ends[-1] / 2
            # All begin at the same depth; what they walk after that stays.
            x = center - (starts[number] + ends[number]) / 2
            z = -2.2 * (row // columns) - figure.points[0, 0, 2]
            moved.append(figure._replace(points=figure.points + np.array([x, 0.0, z], np.float32)))
    return moved


def figure_from_motion(motion: Motion) -> SceneFigure:
    """Returns the motion's figure in human size, with its floor at y = 0."""
    positions = np.asarray(motion.positions, np.float64)
    if is_mirrored(motion.skeleton):
        positions = positions * [-1.0, 1.0, 1.0]
    scale = figure_scale(positions, motion.skeleton)
    if not HUMAN_SCALES[0] <= scale <= HUMAN_SCALES[1]:
        positions = positions / scale
        scale = 1.0
    lowest = float(positions[..., 1].min())
    floor = lowest if abs(lowest) > FLOOR_TOLERANCE else 0.0
    points = figure_points(positions.astype(np.float32), motion.skeleton)
    lift = SOLE * scale - floor
    points[..., 1] += lift
    body = body_from_skeleton(motion.skeleton)
    parts = tuple(
        part._replace(start_radius=part.start_radius * scale, end_radius=part.end_radius * scale) for part in body.parts
    )
    feet = [foot[-1] for foot in (motion.skeleton.left_foot, motion.skeleton.right_foot)]
    contacts = [contact for foot in feet for contact in _contacts(points[:, foot], float(motion.fps), scale)]
    return SceneFigure(points, parts, float(motion.fps), motion.caption, tuple(contacts), lift)


def _contacts(foot: Float[np.ndarray, "T 3"], fps: float, scale: float) -> list[Contact]:
    """Returns when and where the toes of a foot are low and still."""
    speed = np.linalg.norm(np.gradient(foot, axis=0), axis=1) * fps if len(foot) > 1 else np.zeros(len(foot))
    # At the size of a person; a smaller figure has slower and lower feet.
    stands = (foot[:, 1] < CONTACT_HEIGHT * scale) & (speed < CONTACT_SPEED * scale)
    # Padding with False makes each run of True have a beginning and an end.
    edges = np.flatnonzero(np.diff(np.pad(stands.astype(int), 1)))
    spans = [(int(first), int(end)) for first, end in edges.reshape(-1, 2) if end - first >= CONTACT_SECONDS * fps]
    return [Contact(first, end - 1, *map(float, foot[first:end, [0, 2]].mean(axis=0))) for first, end in spans]
