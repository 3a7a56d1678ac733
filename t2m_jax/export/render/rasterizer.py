"""A renderer in NumPy for tapered capsules, with exact surfaces, a depth buffer and soft edges."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, UInt8

SEAM_TOLERANCE = 0.0005
"""Meters. A soft edge is visible if it is at most this far behind the surface that is drawn already."""

TABLE_SIZE = 128
"""Number of steps, horizontally and vertically, into which surface normals are divided for shading."""

# Strengths in linear light.
KEY = 0.72
FILL = 0.16
SKY = np.array([0.42, 0.46, 0.53])
GROUND = np.array([0.24, 0.225, 0.21])

ShadeTables = Float[np.ndarray, "N 3"]
"""Colors in sRGB, 0 to 255. Each tint has `TABLE_SIZE` squared rows."""


class Ball(NamedTuple):
    """One end of a limb in the picture."""

    x: float
    """Pixels from the left edge."""

    y: float
    """Pixels from the top edge."""

    depth: float
    """Meters in front of the camera."""

    radius: float
    """Pixels."""


class Canvas(NamedTuple):
    """What each pixel shows. It is changed in place."""

    shades: Int[np.ndarray, "H W"]
    """Row in the shade tables; -1 where nothing was drawn."""

    depths: Float[np.ndarray, "H W"]
    """Meters from the camera to the surface."""

    focal: float
    """Size of one meter at a distance of one meter, in pixels."""


class Edge(NamedTuple):
    """Pixels that a limb covers partly."""

    places: Int[np.ndarray, " N"]
    """Row times picture width plus column."""

    cover: Float[np.ndarray, " N"]
    """Covered fraction."""

    depths: Float[np.ndarray, " N"]
    """Meters from the camera."""

    shades: Int[np.ndarray, " N"]
    """Rows in the shade tables."""


class _Hull(NamedTuple):
    """A limb in pixels, with the second ball relative to the first (x right, y down, z toward the camera)."""

    dx: float
    dy: float
    dz: float
    start_radius: float
    end_radius: float


def empty_canvas(size: tuple[int, int], focal: float) -> Canvas:
    """Returns an empty canvas with this width and height."""
    shape = (size[1], size[0])
    return Canvas(np.full(shape, -1, np.int32), np.full(shape, np.inf, np.float32), focal)


def make_shade_tables(
    tints: Float[np.ndarray, "K 3"],
    key_light: Float[np.ndarray, " 3"],
    fill_light: Float[np.ndarray, " 3"],
    up: Float[np.ndarray, " 3"],
) -> ShadeTables:
    """Returns the colors of matte surfaces for all directions.

    Args:
        tints: Linear colors.
        key_light: Direction toward the main light, as the camera sees it: x right, y down, z toward the camera.
        fill_light: Direction toward the second light.
        up: Direction toward the sky.
    """
    steps = (np.arange(TABLE_SIZE) + 0.5) * (2 / TABLE_SIZE) - 1
    y, x = (grid.ravel() for grid in np.meshgrid(steps, steps, indexing="ij"))
    normals = np.stack([x, y, np.sqrt(np.maximum(1 - x * x - y * y, 0))], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    key = KEY * np.maximum(normals @ key_light, 0)
    fill = FILL * np.maximum(normals @ fill_light, 0)
    upward = (0.5 + 0.5 * normals @ up)[:, None]
    # A darker rim separates limbs from each other, like an outline in a drawing.
    rim = 0.62 + 0.38 * np.clip(2.6 * normals[:, 2:], 0, 1)
    light = rim * ((key + fill)[:, None] + GROUND + (SKY - GROUND) * upward)
    return np.concatenate([255 * np.clip(light * tint, 0, 1) ** (1 / 2.2) for tint in tints]).astype(np.float32)


def draw_capsule(canvas: Canvas, start: Ball, end: Ball, table: int) -> Edge | None:
    """Draws the inside of the hull of two balls and returns its soft edge, or None if it is outside the picture."""
    height, width = canvas.depths.shape
    left, right = _span(start.x, end.x, start.radius, end.radius, width)
    top, bottom = _span(start.y, end.y, start.radius, end.radius, height)
    if left >= right or top >= bottom:
        return None
    # Depth is measured in pixels at the limb's distance, so that the limb keeps its proportions.
    pixels_per_meter = 2 * canvas.focal / (start.depth + end.depth)
    dz = (start.depth - end.depth) * pixels_per_meter
    hull = _Hull(end.x - start.x, end.y - start.y, dz, start.radius, end.radius)
    columns = np.arange(left, right, dtype=np.float32) + np.float32(0.5 - start.x)
    rows = np.arange(top, bottom, dtype=np.float32) + np.float32(0.5 - start.y)
    inside = _inside(columns[None, :], rows[:, None], hull)
    row, column = np.nonzero(inside > 0)
    cover = inside[row, column]
    relief, shades = _surface(columns[column], rows[row], hull)
    shades += table * TABLE_SIZE * TABLE_SIZE
    depths = start.depth - relief * np.float32(1 / pixels_per_meter)
    places = (row + top) * width + (column + left)
    flat_depths = canvas.depths.reshape(-1)
    solid = (cover >= 1) & (depths < flat_depths[places])
    flat_depths[places[solid]] = depths[solid]
    canvas.shades.reshape(-1)[places[solid]] = shades[solid]
    # Edges are blended after all limbs are drawn, when it is known what is behind them.
    soft = np.flatnonzero(cover < 1)
    return Edge(places[soft], cover[soft], depths[soft], shades[soft])


def color_picture(
    picture: UInt8[np.ndarray, "H W 3"], canvas: Canvas, edges: Sequence[Edge], tables: ShadeTables
) -> None:
    """Colors the picture where the canvas was drawn on. Then blends the edges in the given order (far ones first)."""
    colors = picture.reshape(-1, 3)
    shades = canvas.shades.reshape(-1)
    drawn = np.flatnonzero(shades >= 0)
    colors[drawn] = tables[shades[drawn]]
    depths = canvas.depths.reshape(-1)
    for edge in edges:
        seen = edge.depths <= depths[edge.places] + SEAM_TOLERANCE
        places = edge.places[seen]
        before = colors[places].astype(np.float32)
        colors[places] = before + edge.cover[seen, None] * (tables[edge.shades[seen]] - before)


def _span(start: float, end: float, start_radius: float, end_radius: float, size: int) -> tuple[int, int]:
    """Returns the first pixel, and one past the last, that the hull touches along one axis of the picture."""
    low = math.floor(min(start - start_radius, end - end_radius) - 1)
    high = math.ceil(max(start + start_radius, end + end_radius) + 1)
    return max(low, 0), min(high, size)


def _inside(x: Float[np.ndarray, "1 W"], y: Float[np.ndarray, "H 1"], hull: _Hull) -> Float[np.ndarray, "H W"]:
    """Returns the distance to the outline in pixels plus 0.5, so that 0 to 1 is the edge and more is inside.

    The outline consists of both circles and the tangents between them.
    """
    dx, dy, _, start_radius, end_radius = hull
    length = max(math.hypot(dx, dy), 1e-3)
    slope = min(max((start_radius - end_radius) / length, -0.999), 0.999)
    lean = slope / math.sqrt(1 - slope * slope)
    # In place from here on, because it runs for every limb of every frame.
    share = np.abs(x * (dy / length) - y * (dx / length))
    share *= -lean / length
    share += x * (dx / length**2) + y * (dy / length**2)
    np.clip(share, 0, 1, out=share)
    distance = np.square(x - share * dx)
    distance += np.square(y - share * dy)
    np.sqrt(distance, out=distance)
    share *= end_radius - start_radius
    share += start_radius + 0.5
    share -= distance
    return share


def _surface(
    x: Float[np.ndarray, " N"], y: Float[np.ndarray, " N"], hull: _Hull
) -> tuple[Float[np.ndarray, " N"], Int[np.ndarray, " N"]]:
    """Returns the height toward the camera and the row of the shade table, for pixels relative to the first ball.

    The projection is parallel to z. A pixel shows the cone between the two circles at which it touches the balls, and
    otherwise a ball.
    """
    dx, dy, dz, start_radius, end_radius = hull
    span = max(math.sqrt(dx * dx + dy * dy + dz * dz), 1e-3)
    ux, uy, uz = (length / span for length in (dx, dy, dz))
    slope = min(max((start_radius - end_radius) / span, -0.98), 0.98)
    cosine2 = 1 - slope * slope
    quadratic = 1 - uz * uz / cosine2
    if quadratic < 1e-4:  # along its axis, the cone is hidden by a ball
        return _ball_surface(x, y, hull)
    projected = x * ux + y * uy
    reach = start_radius - slope * projected
    half = reach * (slope * uz / cosine2) - projected * uz
    rest = np.square(x) + np.square(y) - np.square(projected) - np.square(reach) * (1 / cosine2)
    root = np.square(half) - quadratic * rest
    relief = (np.sqrt(np.maximum(root, 0)) - half) * (1 / quadratic)
    position = projected + relief * uz
    inverse = cosine2 / np.maximum(start_radius - slope * position, 1e-3)
    shades = _shade_rows((x - ux * position) * inverse + ux * slope, (y - uy * position) * inverse + uy * slope)
    on_ball = np.flatnonzero((position < start_radius * slope) | (position > span + end_radius * slope))
    relief[on_ball], shades[on_ball] = _ball_surface(x[on_ball], y[on_ball], hull)
    return relief, shades


def _ball_surface(
    x: Float[np.ndarray, " N"], y: Float[np.ndarray, " N"], hull: _Hull
) -> tuple[Float[np.ndarray, " N"], Int[np.ndarray, " N"]]:
    """Returns height and row of the shade table of the ball in front. Pixels next to both balls get the nearer rim."""
    dx, dy, dz, start_radius, end_radius = hull
    start_square = start_radius**2 - np.square(x) - np.square(y)
    end_square = end_radius**2 - np.square(x - dx) - np.square(y - dy)
    start_height = np.sqrt(np.maximum(start_square, 0))
    end_height = np.sqrt(np.maximum(end_square, 0)) + dz
    nothing = (start_square <= 0) & (end_square <= 0)
    in_front = np.where(end_square > 0, end_height, -1e6) > np.where(start_square > 0, start_height, -1e6)
    at_end = np.where(nothing, end_square / end_radius**2 > start_square / start_radius**2, in_front)
    normal_x = np.where(at_end, (x - dx) / end_radius, x / start_radius)
    normal_y = np.where(at_end, (y - dy) / end_radius, y / start_radius)
    return np.where(at_end, end_height, start_height), _shade_rows(normal_x, normal_y)


def _shade_rows(normal_x: Float[np.ndarray, " N"], normal_y: Float[np.ndarray, " N"]) -> Int[np.ndarray, " N"]:
    """Returns the rows of a shade table for unit normals, given by x and y."""
    row, column = (
        np.clip(normal * (TABLE_SIZE / 2) + TABLE_SIZE / 2, 0, TABLE_SIZE - 1).astype(np.int32)
        for normal in (normal_y, normal_x)
    )
    row *= TABLE_SIZE
    row += column
    return row
