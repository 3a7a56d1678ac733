"""Other paths over the ground for a motion: each frame is turned and moved as a whole, so its pose stays as it is."""

import functools
import logging
import math
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from t2m_jax.errors import UserError
from t2m_jax.field_checks import check_number
from t2m_jax.motion.cleanup import lock_feet
from t2m_jax.motion.joining import Clip
from t2m_jax.motion.rotations import turned_about_y
from t2m_jax.motion.skeleton import Skeleton
from t2m_jax.motion.travel import smooth_path

logger = logging.getLogger(__name__)

LOOK_AHEAD = 0.25
"""The direction of a path is taken from this far before a place to this far after it; meters."""
SHORTEST_PATH = 0.5
"""A motion that travels less has no path to change; meters."""
LARGEST_TURN = 720.0
"""Degrees. With more, a figure would spin."""
SHARPEST_CORNER = 135.0
"""Degrees by which a path may turn at one point; a figure cannot turn back on the spot while it walks."""
FARTHEST = 1000.0
"""Meters. A waypoint that is farther away is probably a mistake."""
REACHED = 0.95
"""A motion that travels this part of its path reaches the end."""
SPLINE_STEP = 0.01
"""Length of the pieces of a curve through waypoints; meters."""
REST_STEPS = 100
"""Pieces for each waypoint in which the part of a curve that is not needed is measured."""


Places = Float[np.ndarray, "_ 3"]
"""Places one after another, over the ground."""
Way = Float[np.ndarray, " _"]
"""A number for each place of a path, such as the way to it from the start in meters."""


class Route(NamedTuple):
    """Where each frame of a motion goes, over the ground."""

    old: Float[np.ndarray, "T 3"]
    """The smooth path of the motion as it is."""
    new: Float[np.ndarray, "T 3"]
    """The place of each frame on the new path."""
    turns: Float[np.ndarray, " T"]
    """Turn of each frame to the left, in radians."""


def check_turn(degrees: float | int) -> None:
    """Raises `UserError` if an angle is not a number between -`LARGEST_TURN` and `LARGEST_TURN`."""
    check_number("turn", degrees)
    if not abs(degrees) <= LARGEST_TURN:
        raise UserError(f"turn: {degrees} is not a number from -{LARGEST_TURN:.0f} to {LARGEST_TURN:.0f} degrees")


def check_waypoints(waypoints: Sequence[Sequence[float | int]]) -> Float[np.ndarray, "N 2"]:
    """Returns waypoints as an array.

    Raises:
        UserError: They are not at least two points of two finite numbers, or two in a row are the same, or the path
            turns back at one.
    """
    try:
        given = [tuple(point) for point in waypoints]
    except TypeError:  # a number, or a row of them
        raise UserError(f"path: {waypoints!r} is not points of two numbers, x and z in meters") from None
    for place, point in enumerate(given, start=1):
        if len(point) != 2:
            raise UserError(f"path: point {place} needs two numbers, x and z in meters, not {len(point)}")
    if len(given) < 2:
        raise UserError(
            f"path: {len(given)} point{'s' * (len(given) != 1)}; give two or more of two numbers, x and z in meters"
        )
    points = np.array([[check_number("path", number) for number in point] for point in given], np.float64)
    # `not <=` and not `>`, so that NaN is refused, too.
    if not (np.abs(points) <= FARTHEST).all():
        row = int(np.argmin((np.abs(points) <= FARTHEST).all(axis=1)))
        raise UserError(f"path: point {row + 1} is not within {FARTHEST:.0f} m of the origin")
    steps = np.diff(points, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    if (lengths < SPLINE_STEP).any():
        row = int(lengths.argmin())
        raise UserError(f"path: points {row + 1} and {row + 2} are at the same place; leave one of them out")
    cosines = np.sum(steps[1:] * steps[:-1], axis=1) / (lengths[1:] * lengths[:-1])
    if (cosines < math.cos(math.radians(SHARPEST_CORNER))).any():
        row = int(cosines.argmin())
        raise UserError(f"path: it turns back at point {row + 2}; add points around this corner, so that it is wider")
    return points


def turned_route(positions: Clip, degrees: float | int, *, fps: float) -> Route:
    """Returns the path of a motion, bent evenly over its length, so that its end is turned by an angle to the left.

    Raises:
        UserError: The angle is too large, or the motion does not travel.
    """
    check_turn(degrees)
    old, way = _smooth_path(positions, fps, field="turn")
    turns = math.radians(degrees) * way / way[-1]
    steps = turned_about_y(np.diff(old, axis=0), (turns[1:] + turns[:-1]) / 2)
    return Route(old, np.concatenate([old[:1], old[0] + np.cumsum(steps, axis=0)]), turns)


def route_along(positions: Clip, waypoints: Sequence[Sequence[float | int]], *, fps: float) -> Route:
    """Returns a path through waypoints, as far as the motion travels. After the last one, it goes straight on.

    A warning says how long a motion would have to be that does not reach the last one.

    Raises:
        UserError: The waypoints are not a path, or the motion does not travel.
    """
    points = check_waypoints(waypoints)
    old, way = _smooth_path(positions, fps, field="path")
    curve, curve_way, length = _curve(points, way[-1] + LOOK_AHEAD)
    if way[-1] < REACHED * length:
        seconds = len(positions) / fps * length / way[-1]
        logger.warning(
            "path: it is %.1f m long, and the motion travels %.1f m, so its end is not reached; a motion of about "
            "%.0f s would reach it",
            length,
            way[-1],
            seconds,
        )
    new = _at(curve, curve_way, way)
    headings = _headings(curve, curve_way, way)
    return Route(old, new, np.unwrap(headings - _headings(old, way, way)))


def follow(positions: Clip, route: Route, *, fps: float, skeleton: Skeleton) -> Clip:
    """Returns a motion on its new path. A foot that stands does not turn with the body: the legs bend instead."""
    moved = turned_about_y(positions - route.old[:, None], route.turns[:, None]) + route.new[:, None]
    locked = _locked(jnp.asarray(moved, jnp.float32), fps=fps, skeleton=skeleton)
    return np.asarray(locked)


@functools.partial(jax.jit, static_argnames=("fps", "skeleton"))
def _locked(positions: Float[jax.Array, "T J 3"], *, fps: float, skeleton: Skeleton) -> Float[jax.Array, "T J 3"]:
    return lock_feet(positions, jnp.asarray(len(positions)), skeleton, fps=fps)


def _smooth_path(positions: Clip, fps: float, *, field: str) -> tuple[Places, Way]:
    """Returns the path of the root over the ground without its sway, and the way from the start to each frame."""
    smooth = smooth_path(positions, fps=fps)
    way = _way(smooth)
    if way[-1] < SHORTEST_PATH:
        raise UserError(f"{field}: the motion travels {way[-1]:.2f} m; {SHORTEST_PATH} m or more are needed")
    return smooth, way


def _curve(points: Float[np.ndarray, "N 2"], length: float) -> tuple[Places, Way, float]:
    """Returns a smooth curve through points on the ground that is at least as long as `length`.

    If the points end before, it goes straight on. Also the way to each of its points, and the length up to the last of
    `points`.
    """
    from scipy.interpolate import CubicSpline  # here, because it takes long to import

    knots = _way(points)
    # Natural: it does not bend at its ends, and so continues smoothly into the straight line after the last point.
    spline = CubicSpline(knots, points, bc_type="natural")
    # What follows `length` is not needed, and may be too long to be sampled so finely. The way between two points is as
    # long as the line or longer, but up to a place between them it may be shorter.
    last = min(knots[-1], length)
    while True:
        flat = spline(np.linspace(0, last, max(2, round(last / SPLINE_STEP))))
        way = _way(flat)
        if way[-1] >= length or last == knots[-1]:
            break
        last = min(knots[-1], 1.2 * last)
    rest = _way(spline(np.linspace(last, knots[-1], REST_STEPS * len(points))))[-1]
    end = spline(last, 1)
    flat = np.append(flat, flat[-1:] + end / np.linalg.norm(end) * length, axis=0)
    return np.stack([flat[:, 0], 0 * flat[:, 0], flat[:, 1]], axis=1), _way(flat), float(way[-1] + rest)


def _way(places: Float[np.ndarray, "N D"]) -> Way:
    """Returns the way from the first place to each."""
    return np.append(0.0, np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1)))


def _at(path: Places, way: Way, wanted: Way) -> Places:
    """Returns places on a path by their way from its start."""
    return np.stack([np.interp(wanted, way, axis) for axis in path.T], axis=1)


def _headings(path: Places, way: Way, wanted: Way) -> Way:
    """Returns the direction of a path at some places, as an angle from +Z to +X in radians."""
    chords = _at(path, way, wanted + LOOK_AHEAD) - _at(path, way, wanted - LOOK_AHEAD)
    # The angle jumps by a whole turn where a path heads to -Z. A figure must not spin there.
    return np.unwrap(np.arctan2(chords[:, 0], chords[:, 2]))
