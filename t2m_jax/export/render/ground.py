"""The ground of rendered pictures: sky, a grid in perspective, soft shadows and the trails of the roots."""

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from PIL import Image, ImageChops, ImageDraw, ImageFilter

from t2m_jax.export.render.scene import SceneFigure
from t2m_jax.export.render.view import View, project

SKY_TOP = (226, 232, 240)
SKY_LOW = (247, 249, 251)
GROUND = (242, 245, 248)
LINES = (178, 189, 203)
ACCENTS = ((31, 127, 156), (192, 98, 47), (91, 127, 43), (122, 79, 163))
SHADOW = 0.36
"""Opacity of the middle of a shadow."""

KEY_LIGHT = np.array([0.42, 1.0, 0.38]) / np.linalg.norm([0.42, 1.0, 0.38])
"""Direction toward the main light."""

FINE_LINES = 110
"""Opacity, of 255, of the lines at half meters. The lines at whole meters have 255."""


class Ground(NamedTuple):
    """The parts of the ground that do not change while the camera moves without turning."""

    empty: Image.Image
    """Sky and ground without lines."""

    fade: Image.Image
    """Visibility of lines: 255 near the figures, 0 toward the horizon."""

    reach: float
    """Radius around the figures in which lines are drawn, in meters."""


def make_ground(view: View) -> Ground:
    """Returns the ground for the height and the direction of `view`."""
    right, down, back = view.axes
    columns = (np.arange(view.width) + 0.5 - view.width / 2) / view.focal
    rows = (np.arange(view.height) + 0.5 - view.middle) / view.focal
    rays = columns[None, :, None] * right + rows[:, None, None] * down - back
    falling = np.maximum(-rays[..., 1], 1e-3)
    spots = rays * (view.eye[1] / falling)[..., None]
    center = -back * (view.eye[1] / max(float(back[1]), 0.05))
    reach = 1.8 * float(np.linalg.norm(center))
    share = np.clip(1.15 - np.linalg.norm((spots - center)[..., [0, 2]], axis=-1) / reach, 0, 1)
    fade = share * share * (3 - 2 * share) * (rays[..., 1] < -1e-3)
    horizon = float(np.clip(np.sum(rays[:, 0, 1] >= 0), 1, view.height))
    mix = np.clip(np.arange(view.height) / horizon, 0, 1)[:, None, None]
    sky = np.asarray(SKY_TOP) * (1 - mix) + np.asarray(SKY_LOW) * mix
    empty = sky + fade[..., None] * (np.asarray(GROUND) - sky)
    picture, mask = (Image.fromarray(np.rint(levels).astype(np.uint8)) for levels in (empty, 255 * fade))
    return Ground(picture, mask, reach)


def draw_ground(ground: Ground, view: View) -> Image.Image:
    """Returns the empty scene: the sky, and the ground with lines every half meter, stronger at whole meters."""
    back = view.axes[2]
    center = view.eye - back * (view.eye[1] / max(float(back[1]), 0.05))
    middle = np.round(center)
    offsets = np.arange(-math.ceil(ground.reach), math.ceil(ground.reach) + 0.25, 0.5)
    offsets = np.concatenate([offsets[1::2], offsets[::2]])
    # Each line ends at the circle in which lines are visible.
    span = np.sqrt(np.maximum(ground.reach**2 - offsets**2, 0)) + 1
    lines = np.zeros((2, 2, len(offsets), 3))  # along x or z, start or end, line, coordinate
    for family, (along, across) in zip(lines, ((0, 2), (2, 0)), strict=True):
        family[:, :, across] = middle[across] + offsets
        family[0, :, along] = middle[along] - span
        family[1, :, along] = middle[along] + span
    # Lines are cut half a meter in front of the camera. Those that are completely behind it become points.
    depths = -(lines - view.eye) @ back
    change = depths[:, 1] - depths[:, 0]
    crossing = np.clip((0.5 - depths[:, 0]) / np.where(np.abs(change) < 1e-9, 1e-9, change), 0, 1)[..., None]
    cuts = lines[:, 0] + crossing * (lines[:, 1] - lines[:, 0])
    spots = 2 * project(view, np.where((depths < 0.5)[..., None], cuts[:, None], lines))[..., :2]
    # Pillow's lines have hard edges; they become smooth when the mask is made smaller by two.
    mask = Image.new("L", (2 * view.width, 2 * view.height))
    draw = ImageDraw.Draw(mask)
    thickness = max(round(view.height / 300), 1)
    num_fine = len(offsets) // 2
    for fine in (True, False):
        for family in spots[:, :, :num_fine] if fine else spots[:, :, num_fine:]:
            for line in np.concatenate(family, axis=-1):
                draw.line(line.tolist(), fill=FINE_LINES if fine else 255, width=thickness + (not fine))
    seen = ImageChops.multiply(mask.reduce(2), ground.fade)
    return Image.composite(Image.new("RGB", seen.size, LINES), ground.empty, seen)


def add_shadows(
    picture: Image.Image, view: View, figures: Sequence[tuple[SceneFigure, Float[np.ndarray, "_ 3"]]]
) -> None:
    """Darkens the picture in the shadows of the figures."""
    # Shadows are soft, so half of the size is enough.
    mask = Image.new("L", (view.width // 2, view.height // 2))
    draw = ImageDraw.Draw(mask)
    for figure, points in figures:
        height = np.maximum(points[:, 1:2], 0)
        spots = points - height / KEY_LIGHT[1] * KEY_LIGHT
        spots = project(view, np.concatenate([spots[:, :1], np.zeros_like(height), spots[:, 2:]], axis=1)) / [2, 2, 1]
        places = spots.tolist()
        for part in figure.parts:
            _draw_shadow(draw, places[part.start], places[part.end], (part.start_radius, part.end_radius), view)
    mask = mask.filter(ImageFilter.GaussianBlur(view.height / 260)).resize(picture.size, Image.Resampling.BILINEAR)
    picture.paste((18, 24, 34), (0, 0), mask.point([round(SHADOW * level) for level in range(256)]))


def _draw_shadow(
    draw: ImageDraw.ImageDraw, start: list[float], end: list[float], radii: tuple[float, float], view: View
) -> None:
    """Draws the hull of two flat discs, at half of the picture's size."""
    flat = max(float(view.axes[2, 1]), 0.1)
    ends = []
    for (x, y, depth), radius in zip((start, end), radii, strict=True):
        size = 0.45 * radius * view.focal / depth
        draw.ellipse((x - size, y - size * flat, x + size, y + size * flat), fill=255)
        ends.append((x, y / flat, size))
    (x0, y0, r0), (x1, y1, r1) = ends
    length = math.hypot(x1 - x0, y1 - y0)
    if length < 1e-3:
        return
    nx, ny = (y1 - y0) / length, (x0 - x1) / length
    corners = [(x0, y0, r0), (x1, y1, r1), (x1, y1, -r1), (x0, y0, -r0)]
    draw.polygon([(x + r * nx, (y + r * ny) * flat) for x, y, r in corners], fill=255)


def add_trail(picture: Image.Image, view: View, path: Float[np.ndarray, "T 3"], accent: tuple[int, int, int]) -> None:
    """Draws `path` on the ground. Older parts are fainter."""
    places = (2 * project(view, path * [1, 0, 1])[:, :2]).tolist()
    mask = Image.new("L", (2 * view.width, 2 * view.height))
    draw = ImageDraw.Draw(mask)
    for number, (start, end) in enumerate(itertools.pairwise(places)):
        level = round(70 + 120 * math.exp((number - len(places)) / 30))
        draw.line([*start, *end], fill=level, width=max(round(view.height / 75), 2))
    picture.paste(accent, (0, 0), mask.reduce(2))
