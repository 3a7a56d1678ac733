"""PNG pictures: some poses of one motion with the paths of its hands and feet, or several motions in rows."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from PIL import Image, ImageDraw

from t2m_jax.errors import UserError
from t2m_jax.export.render.figure import roles_from_skeleton
from t2m_jax.export.render.ground import ACCENTS, add_trail, draw_ground, make_ground
from t2m_jax.export.render.labels import make_label
from t2m_jax.export.render.rendering import draw_figures, picture_size, render_poster, shade_tables
from t2m_jax.export.render.scene import SceneFigure, figure_from_motion
from t2m_jax.export.render.view import YAW_OF_SEVERAL, View, project, views_of_figures
from t2m_jax.files.writing import atomic_file
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.rotations import matrix_from_euler

MAX_ROWS = 100
"""Motions that a contact sheet has room for; pictures of more are too high for many viewers."""
NUM_POSES = 8
"""Poses of each motion of a contact sheet."""
MOST_POSES = 6
"""Poses that are drawn if the figure goes far enough."""
APART = 0.7
"""Least distance in meters from one pose to the next, so that figures do not hide each other."""

MARGIN = 0.06
"""Least distance of joints and paths from the edges, relative to the height of the picture."""

MOST_STEPS = 100
"""Steps of the camera away from a motion, each by 3 % of the distance."""

BEND = 0.2
"""Distance in meters of a path from the straight way, on average, from which it counts as a curve."""


def save_png(path: Path, motions: Sequence[Motion]) -> None:
    """Writes a picture. One motion is drawn with the paths of its hands and feet, several as a contact sheet.

    A contact sheet has a row of poses per motion, at equal time steps.

    Raises:
        UserError: There are no motions, or more than `MAX_ROWS`.
    """
    if not motions:
        raise UserError(f"{path}: there is no motion to draw; give at least one")
    if len(motions) > MAX_ROWS:
        raise UserError(f"{path}: {len(motions)} motions are too many for a contact sheet; give at most {MAX_ROWS}")
    # A single motion has room for its paths, which tell more than a row of poses.
    if len(motions) == 1:
        picture = render_trails(motions[0])
    else:
        picture = Image.fromarray(render_poster(motions, num_poses=NUM_POSES))
    with atomic_file(path) as partial:
        picture.save(partial, format="PNG", optimize=True)


def render_trails(motion: Motion, *, height: int = 720) -> Image.Image:
    """Returns a picture of a motion. A figure that travels is shown several times, and seen from its side.

    Args:
        motion: The motion.
        height: Height of the picture in pixels. A figure that stays makes a square picture.
    """
    figure = _from_the_side(figure_from_motion(motion))
    frames = _poses(figure.points[:, 0])
    size = picture_size(len(frames), height)
    poses = [figure._replace(points=figure.points[[frame]]) for frame in frames]
    (view,) = views_of_figures(poses, figure.points[frames, 0][None].astype(np.float64), figure.fps, size)
    paths = figure.points[:, [limb[2] for limb in roles_from_skeleton(motion.skeleton)[1:]]]  # of wrists and ankles
    view = _with_all(view, np.concatenate([part.reshape(-1, 3) for part in (figure.points[frames], paths)]))
    picture = draw_ground(make_ground(view), view)
    add_trail(picture, view, figure.points[:, 0], ACCENTS[0])
    _draw_paths(picture, view, paths)
    picture = draw_figures(picture, view, [(figure, figure.points[frame]) for frame in frames], shade_tables(view))
    label = make_label(motion.caption, size=round(height / 27), width=round(0.94 * size[0]), max_lines=3)
    if label is not None:
        picture.paste(label, ((size[0] - label.width) // 2, round(0.97 * height) - label.height), label)
    return picture


def _with_all(view: View, points: Float[np.ndarray, "N 3"]) -> View:
    """Returns a view that is moved sideways, and away, until all points are in the picture."""
    margin = MARGIN * view.height
    for _ in range(MOST_STEPS):
        spots = project(view, points)
        left, top, depth = spots.min(axis=0)
        right, bottom, _ = spots.max(axis=0)
        # Sideways first: a motion that is not in the middle needs less distance after it.
        aside = (left + right - view.width) / 2 * spots[:, 2].mean() / view.focal
        view = view._replace(eye=view.eye + aside * view.axes[0])
        if right - left <= view.width - 2 * margin and top >= margin and bottom <= view.height - margin:
            break
        view = view._replace(eye=view.eye + 0.03 * depth * view.axes[2])
    return view


def _from_the_side(figure: SceneFigure) -> SceneFigure:
    """Returns the figure, turned so that it goes across the picture, if it travels. A curve bends away from the eye."""
    path = figure.points[:, 0]
    way = path[-1] - path[0]
    middle = path.mean(axis=0) - path[0]
    length = math.hypot(way[0], way[2])
    if length < APART:
        return figure
    # The cross product of the way and the mean place: its sign is the side to which the path bends.
    bends_to_the_eye = way[0] * middle[2] - way[2] * middle[0] > BEND * length
    angle = math.atan2(way[2], way[0]) + YAW_OF_SEVERAL + math.pi * bends_to_the_eye
    turn = matrix_from_euler(np.array([angle, 0.0, 0.0]), "YXZ")
    return figure._replace(points=(figure.points @ turn.T).astype(np.float32))


def _poses(path: Float[np.ndarray, "T 3"]) -> list[int]:
    """Returns the frames to draw: the middle one of a figure that stays, else some at equal parts of its way."""
    steps = np.linalg.norm(np.diff(path[:, [0, 2]], axis=0), axis=-1)
    length = float(np.linalg.norm((path[-1] - path[0])[[0, 2]]))
    count = min(1 + int(length / APART), MOST_POSES)
    if count == 1:
        return [len(path) // 2]
    # At equal parts of the path, not of the time, so that figures do not crowd where the motion is slow.
    gone = np.concatenate([[0.0], np.cumsum(steps)])
    return np.searchsorted(gone, np.linspace(0, gone[-1], count)).clip(0, len(path) - 1).tolist()


def _draw_paths(picture: Image.Image, view: View, paths: Float[np.ndarray, "T K 3"]) -> None:
    """Draws paths in the air, of left limbs in the first accent color and of right ones in the second."""
    spots = 2 * project(view, paths)[..., :2]
    for side in (0, 1):
        mask = Image.new("L", (2 * picture.width, 2 * picture.height))
        draw = ImageDraw.Draw(mask)
        for path in spots[:, side::2].swapaxes(0, 1):
            draw.line(path.ravel().tolist(), fill=150, width=max(round(view.height / 120), 2), joint="curve")
        picture.paste(ACCENTS[side], (0, 0), mask.reduce(2))
