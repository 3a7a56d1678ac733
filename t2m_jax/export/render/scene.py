"""What both renderers draw: figures in one common space, standing on the ground y = 0, side by side if several."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from t2m_jax.errors import UserError
from t2m_jax.export.render.figure import BodyPart, body_from_skeleton, figure_points, figure_scale, is_mirrored
from t2m_jax.motion.record import Motion

SOLE = 0.027
"""Metres between the joint centres of a standing foot and the ground."""

FLOOR_TOLERANCE = 0.1
"""A lowest joint farther than this from y = 0, metres, means that the clip does not have its floor there."""

HUMAN_SCALES = (0.7, 1.4)
"""Figures outside this range, relative to the reference figure, are drawn at its size (KIT-ML's is 1 m tall)."""

LANE_WIDTHS = (1.3, 3.0)
"""Least and greatest room along X for one figure among several, metres."""


class Figure(NamedTuple):
    """One sample ready to draw; metres, Y up."""

    points: Float[np.ndarray, "T P 3"]
    parts: tuple[BodyPart, ...]
    head: int
    fps: float
    caption: str


class Scene(NamedTuple):
    """Figures in common space, in the order of the samples."""

    figures: tuple[Figure, ...]
    seconds: float
    """Length of the longest, one frame counting as 1 / fps."""


def scene_from_motions(motions: Sequence[Motion]) -> Scene:
    """Returns the figures of all motions; a single one keeps its place, several get a lane each."""
    if not motions:
        raise UserError("there is no motion to draw: give at least one")
    figures = [figure_from_motion(motion) for motion in motions]
    if len(figures) > 1:
        figures = _in_lanes(figures)
    return Scene(tuple(figures), max(len(figure.points) / figure.fps for figure in figures))


def figure_from_motion(motion: Motion) -> Figure:
    """Returns the motion's figure at human size, its floor at y = 0."""
    positions = np.asarray(motion.positions, np.float64)
    if is_mirrored(motion.skeleton):
        positions = positions * [-1.0, 1.0, 1.0]
    scale = figure_scale(positions, motion.skeleton)
    if not HUMAN_SCALES[0] <= scale <= HUMAN_SCALES[1]:
        positions, scale = positions / scale, 1.0
    lowest = float(positions[..., 1].min())
    floor = lowest if abs(lowest) > FLOOR_TOLERANCE else 0.0
    points = figure_points(positions.astype(np.float32), motion.skeleton)
    points[..., 1] += SOLE * scale - floor
    body = body_from_skeleton(motion.skeleton)
    parts = tuple(
        part._replace(start_radius=part.start_radius * scale, end_radius=part.end_radius * scale) for part in body.parts
    )
    return Figure(points, parts, body.head, float(motion.fps), motion.caption)


def _in_lanes(figures: Sequence[Figure]) -> list[Figure]:
    """Returns the figures moved apart: from left to right as seen from +Z, in rows of at most about six."""
    columns = len(figures) if len(figures) <= 6 else math.ceil(math.sqrt(1.6 * len(figures)))
    starts, ends = (np.array([bound(f.points[..., 0]) for f in figures]) for bound in (np.min, np.max))
    widths = np.clip(ends - starts + 0.3, *LANE_WIDTHS)
    moved = []
    for row in range(0, len(figures), columns):
        lane_ends = np.cumsum(widths[row : row + columns])
        for column, figure in enumerate(figures[row : row + columns]):
            number = row + column
            centre = lane_ends[column] - widths[number] / 2 - lane_ends[-1] / 2
            shift = [
                centre - (starts[number] + ends[number]) / 2,
                0.0,
                -2.2 * (row // columns) - figure.points[0, 0, 2],
            ]
            moved.append(figure._replace(points=figure.points + np.asarray(shift, np.float32)))
    return moved
