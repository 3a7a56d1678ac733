"""Solid limbs in NumPy: tapered capsules by exact intersection, one at a time, with depth buffer and soft edges."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, UInt8

SEAM_TOLERANCE = 0.0005
"""Metres by which a soft edge may lie behind what is drawn already and still be seen."""

TABLE_SIZE = 128
"""Normals are told apart this finely, left to right and top to bottom, when their shade is looked up."""

ShadeTables = Float[np.ndarray, "N 3"]
"""Colours, sRGB 0 to 255, of several tints one after the other, `TABLE_SIZE` squared rows each."""


class Ball(NamedTuple):
    """One end of a limb on the picture."""

    x: float
    """Pixels from the left edge."""

    y: float
    """Pixels from the top edge."""

    depth: float
    """Metres in front of the camera."""

    radius: float
    """Pixels."""


class Lighting(NamedTuple):
    """Light in view space (x right, y down, z towards the camera); strengths in linear light."""

    key_direction: Float[np.ndarray, " 3"]
    fill_direction: Float[np.ndarray, " 3"]
    sky_direction: Float[np.ndarray, " 3"]
    key: float
    fill: float
    sky: Float[np.ndarray, " 3"]
    ground: Float[np.ndarray, " 3"]


class Canvas(NamedTuple):
    """What each pixel shows; changed in place."""

    shades: Int[np.ndarray, "H W"]
    """Row of the shade tables, one table after the other; -1 where nothing has been drawn."""

    depths: Float[np.ndarray, "H W"]
    """Metres from the camera to what is seen there."""

    focal: float
    """Pixels that one metre takes at a distance of one metre."""


class Edge(NamedTuple):
    """Pixels that a limb covers in part."""

    places: Int[np.ndarray, " N"]
    """Row times width plus column."""

    cover: Float[np.ndarray, " N"]
    """Covered share."""

    depths: Float[np.ndarray, " N"]
    """Metres from the camera."""

    shades: Int[np.ndarray, " N"]
    """Rows of the shade tables."""


class _Hull(NamedTuple):
    """A limb in pixels: the second ball seen from the first, x right, y down, z towards the camera."""

    dx: float
    dy: float
    dz: float
    start_radius: float
    end_radius: float


def empty_canvas(size: tuple[int, int], focal: float) -> Canvas:
    """Returns a canvas of this width and height on which nothing has been drawn."""
    shape = (size[1], size[0])
    return Canvas(np.full(shape, -1, np.int32), np.full(shape, np.inf, np.float32), focal)


def make_shade_tables(tints: Float[np.ndarray, "K 3"], lighting: Lighting) -> ShadeTables:
    """Returns the colours of matt surfaces, linear colours `tints`, for every direction they can face."""
    light = _light_by_direction(lighting)
    return np.concatenate([255 * np.clip(light * tint, 0, 1) ** (1 / 2.2) for tint in tints]).astype(np.float32)


def _light_by_direction(lighting: Lighting) -> Float[np.ndarray, "N 3"]:
    """Returns what a white surface sends to the camera, by rows of a shade table."""
    steps = (np.arange(TABLE_SIZE) + 0.5) * (2 / TABLE_SIZE) - 1
    y, x = (grid.ravel() for grid in np.meshgrid(steps, steps, indexing="ij"))
    normals = np.stack([x, y, np.sqrt(np.maximum(1 - x * x - y * y, 0))], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    key = lighting.key * np.maximum(normals @ lighting.key_direction, 0)
    fill = lighting.fill * np.maximum(normals @ lighting.fill_direction, 0)
    upward = (0.5 + 0.5 * normals @ lighting.sky_direction)[:, None]
    # The darker rim sets limbs off from each other, as a draughtsman's outline would.
    rim = 0.62 + 0.38 * np.clip(2.6 * normals[:, 2:], 0, 1)
    return rim * ((key + fill)[:, None] + lighting.ground + (lighting.sky - lighting.ground) * upward)


def draw_capsule(canvas: Canvas, start: Ball, end: Ball, table: int) -> Edge | None:
    """Returns the soft edge of the hull of two balls after drawing its inside onto the canvas; None outside of it."""
    height, width = canvas.depths.shape
    left, right = _span(start.x, end.x, start.radius, end.radius, width)
    top, bottom = _span(start.y, end.y, start.radius, end.radius, height)
    if left >= right or top >= bottom:
        return None
    # Depth is measured in pixels at the limb's own distance, so that the limb keeps its proportions.
    pixels_a_metre = 2 * canvas.focal / (start.depth + end.depth)
    dz = (start.depth - end.depth) * pixels_a_metre
    hull = _Hull(end.x - start.x, end.y - start.y, dz, start.radius, end.radius)
    columns = np.arange(left, right, dtype=np.float32) + np.float32(0.5 - start.x)
    rows = np.arange(top, bottom, dtype=np.float32) + np.float32(0.5 - start.y)
    inside = _inside(columns[None, :], rows[:, None], hull)
    row, column = np.nonzero(inside > 0)
    cover = inside[row, column]
    relief, shades = _surface(columns[column], rows[row], hull)
    shades += table * TABLE_SIZE * TABLE_SIZE
    depths = start.depth - relief * np.float32(1 / pixels_a_metre)
    places = (row + top) * width + (column + left)
    flat_depths = canvas.depths.reshape(-1)
    solid = (cover >= 1) & (depths < flat_depths[places])
    flat_depths[places[solid]] = depths[solid]
    canvas.shades.reshape(-1)[places[solid]] = shades[solid]
    soft = np.flatnonzero(cover < 1)
    return Edge(places[soft], cover[soft], depths[soft], shades[soft])


def colour_picture(
    picture: UInt8[np.ndarray, "H W 3"], canvas: Canvas, edges: Sequence[Edge], tables: ShadeTables
) -> None:
    """Colours what has been drawn in the picture, then blends the edges in, in the order given (far ones first)."""
    colours = picture.reshape(-1, 3)
    shades = canvas.shades.reshape(-1)
    drawn = np.flatnonzero(shades >= 0)
    colours[drawn] = tables[shades[drawn]]
    depths = canvas.depths.reshape(-1)
    for edge in edges:
        seen = edge.depths <= depths[edge.places] + SEAM_TOLERANCE
        places = edge.places[seen]
        before = colours[places].astype(np.float32)
        colours[places] = before + edge.cover[seen, None] * (tables[edge.shades[seen]] - before)


def _span(start: float, end: float, start_radius: float, end_radius: float, size: int) -> tuple[int, int]:
    """Returns the pixels, first and one past the last, that the hull touches along one axis of the picture."""
    low = math.floor(min(start - start_radius, end - end_radius) - 1)
    high = math.ceil(max(start + start_radius, end + end_radius) + 1)
    return max(low, 0), min(high, size)


def _inside(x: Float[np.ndarray, "1 W"], y: Float[np.ndarray, "H 1"], hull: _Hull) -> Float[np.ndarray, "H W"]:
    """Returns pixels to the outline (both circles and the tangents between them) plus half, so 0 to 1 is the edge."""
    dx, dy, _, start_radius, end_radius = hull
    length = max(math.hypot(dx, dy), 1e-3)
    slope = min(max((start_radius - end_radius) / length, -0.999), 0.999)
    lean = slope / math.sqrt(1 - slope * slope)
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
    """Returns height towards the camera and row of the shade table, for pixels relative to the first ball.

    Seen in parallel along z: the cone between the balls where the sight hits it between the circles on which the balls
    touch it, else a ball.
    """
    dx, dy, dz, start_radius, end_radius = hull
    span = max(math.sqrt(dx * dx + dy * dy + dz * dz), 1e-3)
    ux, uy, uz = dx / span, dy / span, dz / span
    slope = min(max((start_radius - end_radius) / span, -0.98), 0.98)
    cosine2 = 1 - slope * slope
    quadratic = 1 - uz * uz / cosine2
    if quadratic < 1e-4:  # Seen down the axis, one ball hides the cone.
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
    """Returns height and row of the shade table of the ball in front; beside both, the rim of the nearer one."""
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
    """Returns the rows of a shade table for unit normals, of which x and y are given."""
    row, column = (
        np.clip(normal * (TABLE_SIZE / 2) + TABLE_SIZE / 2, 0, TABLE_SIZE - 1).astype(np.int32)
        for normal in (normal_y, normal_x)
    )
    row *= TABLE_SIZE
    row += column
    return row
