"""The camera of rendered pictures, which follows the figures smoothly, and may go around them."""

import math
from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from t2m_jax.export.render.scene import SceneFigure

FIELD_OF_VIEW = 0.6
"""Vertical angle of view in radians."""

PITCH = 0.22
"""Downward angle of the camera in radians."""

YAW = 0.5
"""Direction from which the camera sees one figure, in radians from +Z toward +X."""
YAW_OF_SEVERAL = 0.22
"""The same for several figures, which hide each other if they are seen from the side."""

STANDSTILL = 1.2
"""Meters. If the figures move less than this, the camera does not move."""

SMOOTHING_SECONDS = 0.6
"""Half width of the two moving averages that smooth the camera's path."""


Camera = Literal["follow", "turntable"]
"""Whether the camera only follows the figures, or also goes around them once, to the left."""


class View(NamedTuple):
    """A camera: its position, its axes (rows: right, down, back), and the pixels of one meter at one meter."""

    eye: Float[np.ndarray, " 3"]
    axes: Float[np.ndarray, "3 3"]
    focal: float
    width: int
    height: int
    middle: float
    """Row of the point that the camera looks at, in pixels from the top."""


def project(view: View, points: Float[np.ndarray, "*N 3"]) -> Float[np.ndarray, "*N 3"]:
    """Returns x and y in pixels, and the depth in meters, of world points."""
    seen = (points - view.eye) @ view.axes.T
    depth = np.maximum(-seen[..., 2], 0.05)
    scale = view.focal / depth
    return np.stack([view.width / 2 + scale * seen[..., 0], view.middle + scale * seen[..., 1], depth], axis=-1)


def smooth_path(path: Float[np.ndarray, "T K"], reach: int) -> Float[np.ndarray, "T K"]:
    """Returns the path after two moving averages over `reach` frames on each side. The ends are repeated as padding."""
    window = np.full(2 * reach + 1, 1 / (2 * reach + 1))
    # Twice the same box is a triangle, after which the velocity has no jumps.
    for _ in range(2):
        padded = np.pad(path, ((reach, reach), (0, 0)), mode="edge")
        path = np.stack([np.convolve(column, window, mode="valid") for column in padded.T], axis=-1)
    return path


def sample_figure(figure: SceneFigure, num_frames: int, fps: float) -> Float[np.ndarray, "T P 3"]:
    """Returns the figure's points at `num_frames` times, `1 / fps` apart. After its end, the figure does not move."""
    moments = np.minimum(np.arange(num_frames) / fps * figure.fps, len(figure.points) - 1)
    before = np.floor(moments + 1e-6).astype(int)
    after = np.minimum(before + 1, len(figure.points) - 1)
    # 1e-6 above: a moment on a frame may be rounded to just below it.
    weight = np.maximum(moments - before, 0).astype(np.float32)[:, None, None]
    return figure.points[before] * (1 - weight) + figure.points[after] * weight


def views_of_figures(
    figures: Sequence[SceneFigure],
    roots: Float[np.ndarray, "T N 3"],
    fps: float,
    size: tuple[int, int],
    *,
    camera: Camera = "follow",
) -> list[View]:
    """Returns one view per frame, which shows all figures and follows the mean of their roots.

    The lower 6 % of the picture are left for a caption.
    """
    count = len(roots)
    width, height = size
    middle = roots.mean(axis=1)
    low = middle.min(axis=0)
    high = middle.max(axis=0)
    if np.hypot(*(high - low)[[0, 2]]) < STANDSTILL:
        targets = np.broadcast_to((low + high) / 2, middle.shape)
    else:
        targets = smooth_path(middle, max(round(SMOOTHING_SECONDS * fps), 1))
    top = max(float(figure.points[..., 1].max()) for figure in figures)
    # How far figures get from the point that the camera follows, along X and Z.
    strays = np.abs(roots - targets[:, None])[..., [0, 2]].max(axis=(0, 1))
    half = math.tan(FIELD_OF_VIEW / 2)
    yaw = YAW if len(figures) == 1 else YAW_OF_SEVERAL
    turns = np.linspace(0, 2 * math.pi, count, endpoint=False) if camera == "turntable" else np.zeros(count)
    # A camera that goes around sees the figures from all sides, and none may leave the picture.
    wide, deep = strays if camera == "follow" else (np.linalg.norm(strays), np.linalg.norm(strays))
    across = float(wide * math.cos(yaw) + deep * math.sin(yaw)) + 0.65
    up = max(0.56 * top, 0.95) + 0.12 + 0.1 * float(deep)
    # The distance at which both the height and the width fit the angle of view.
    distance = max(up / half, across / (half * width / height)) + 0.3
    axes = [_axes(yaw + turn) for turn in turns]
    focal = height / (2 * half)
    centers = np.stack([targets[:, 0], np.full(len(targets), 0.46 * max(top, 1.5)), targets[:, 2]], axis=-1)
    return [
        View(center + distance * own[2], own, focal, width, height, 0.47 * height)
        for center, own in zip(centers, axes, strict=True)
    ]


def _axes(yaw: float) -> Float[np.ndarray, "3 3"]:
    """Returns the axes of a camera that looks down by `PITCH`: right, down and back."""
    back = np.array([math.sin(yaw) * math.cos(PITCH), math.sin(PITCH), math.cos(yaw) * math.cos(PITCH)])
    right = np.array([math.cos(yaw), 0.0, -math.sin(yaw)])
    return np.stack([right, np.cross(right, back), back])
