"""Pictures of figures without a browser or a graphics card: what GIF and MP4 files are made of."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from PIL import Image, ImageDraw

from t2m_jax.export.render.figure import TINTS, Tint
from t2m_jax.export.render.ground import ACCENTS, KEY_LIGHT, Ground, add_shadows, add_trail, draw_ground, make_ground
from t2m_jax.export.render.labels import make_label
from t2m_jax.export.render.rasterizer import (
    Ball,
    Lighting,
    ShadeTables,
    colour_picture,
    draw_capsule,
    empty_canvas,
    make_shade_tables,
)
from t2m_jax.export.render.scene import Figure, Scene, scene_from_motions
from t2m_jax.export.render.view import View, project, sample_figure, smooth_path, views_of_scene
from t2m_jax.motion.record import Motion

TINT_COLOURS: dict[Tint, str] = {"body": "#e4ddd2", "left": "#8dbfd2", "right": "#eeb08d", "face": "#27303c"}
FILL_LIGHT = np.array([-0.6, 0.35, -0.7]) / np.linalg.norm([-0.6, 0.35, -0.7])


class Film(NamedTuple):
    """Pictures that are drawn when they are asked for."""

    draw_frame: Callable[[int], Image.Image]
    num_frames: int
    fps: float


class _Track(NamedTuple):
    """One figure at the moments of the film, with what is drawn for it besides its body."""

    figure: Figure
    points: Float[np.ndarray, "T P 3"]
    path: Float[np.ndarray, "T 3"]
    label: Image.Image | None


def picture_size(num_motions: int, height: int) -> tuple[int, int]:
    """Returns width and height, both even: square for one figure, wider for several."""
    width = height * min(1 + 0.5 * (num_motions - 1), 2.5)
    return round(width / 2) * 2, round(height / 2) * 2


def render_film(motions: Sequence[Motion], *, height: int, max_fps: float) -> Film:
    """Returns the pictures of the motions side by side, at the rate of the longest or the nearest even share of it.

    Args:
        motions: At least one.
        height: Of the pictures, in pixels.
        max_fps: Faster motions are shown at half, a third, … of their rate.
    """
    scene = scene_from_motions(motions)
    longest = max(scene.figures, key=lambda figure: len(figure.points) / figure.fps)
    stride = int(np.ceil(longest.fps / max_fps - 1e-6)) if longest.fps > max_fps else 1
    fps = longest.fps / stride
    num_frames = -(-len(longest.points) // stride)
    size = picture_size(len(scene.figures), height)
    tracks = _tracks(scene, num_frames, fps, size)
    views = views_of_scene(scene, np.stack([track.points[:, 0] for track in tracks], axis=1), fps, size)
    ground = make_ground(views[0])
    tables = make_shade_tables(_linear_tints(), _lighting(views[0]))

    def draw_frame(frame: int) -> Image.Image:
        """Returns the picture of one moment."""
        picture = _draw_figures(ground, views[frame], tracks, frame, tables)
        _draw_labels(picture, views[frame], tracks, frame)
        _draw_progress(picture, (frame + 1) / num_frames)
        return picture

    return Film(draw_frame, num_frames, fps)


def _tracks(scene: Scene, num_frames: int, fps: float, size: tuple[int, int]) -> list[_Track]:
    """Returns every figure at the moments of the film."""
    width, height = size
    count = len(scene.figures)
    tracks = []
    for figure in scene.figures:
        points = sample_figure(figure, num_frames, fps)
        path = smooth_path(points[:, 0].astype(np.float64), max(round(0.12 * fps), 1))
        alone = count == 1
        room = round((0.94 if alone else 0.86) * width / min(count, 6))
        letters = round(height / 27) if alone else max(round(height / 34), 10)
        label = make_label(figure.caption, size=letters, width=room, max_lines=3 if alone else 2)
        tracks.append(_Track(figure, points, path, label))
    return tracks


def _linear_tints() -> Float[np.ndarray, "K 3"]:
    """Returns the colours of `TINTS` in linear light, 0 to 1."""
    return np.array([[(int(TINT_COLOURS[tint][i : i + 2], 16) / 255) ** 2.2 for i in (1, 3, 5)] for tint in TINTS])


def _lighting(view: View) -> Lighting:
    """Returns the light as the camera sees it."""
    up = np.array([0.0, 1.0, 0.0])
    key, fill, sky = (view.axes @ direction for direction in (KEY_LIGHT, FILL_LIGHT, up))
    return Lighting(
        key_direction=key,
        fill_direction=fill,
        sky_direction=sky,
        key=0.72,
        fill=0.16,
        sky=np.array([0.42, 0.46, 0.53]),
        ground=np.array([0.24, 0.225, 0.21]),
    )


def _draw_figures(ground: Ground, view: View, tracks: Sequence[_Track], frame: int, tables: ShadeTables) -> Image.Image:
    """Returns the scene without text."""
    picture = draw_ground(ground, view)
    for number, track in enumerate(tracks):
        add_trail(picture, view, track.path[: frame + 1], ACCENTS[number % len(ACCENTS)])
    add_shadows(picture, view, [(track.figure, track.points[frame]) for track in tracks])
    canvas = empty_canvas(picture.size, view.focal)
    # Far limbs first, so that soft edges blend with what is behind them.
    capsules = sorted(_capsules(view, tracks, frame), key=lambda capsule: -capsule[0].depth - capsule[1].depth)
    edges = [draw_capsule(canvas, start, end, TINTS.index(tint)) for start, end, tint in capsules]
    pixels = np.array(picture)
    colour_picture(pixels, canvas, [edge for edge in edges if edge is not None], tables)
    return Image.fromarray(pixels)


def _capsules(view: View, tracks: Sequence[_Track], frame: int) -> list[tuple[Ball, Ball, Tint]]:
    """Returns all limbs as the camera sees them."""
    capsules = []
    for track in tracks:
        spots = project(view, track.points[frame]).tolist()
        for part in track.figure.parts:
            ends = []
            for point, radius in ((part.start, part.start_radius), (part.end, part.end_radius)):
                x, y, depth = spots[point]
                ends.append(Ball(x, y, depth, max(radius * view.focal / depth, 0.5)))
            capsules.append((ends[0], ends[1], part.tint))
    return capsules


def _draw_labels(picture: Image.Image, view: View, tracks: Sequence[_Track], frame: int) -> None:
    """Draws a single caption at the foot of the picture, several above their figures and beside each other."""
    placed = []
    for track in tracks:
        label = track.label
        if label is None:
            continue
        if len(tracks) == 1:
            left, top = (picture.width - label.width) / 2, 0.97 * picture.height - label.height
        else:
            x, y, _ = project(view, track.path[frame] * [1, 0, 1] + [0, 2.0, 0]).tolist()
            left, top = x - label.width / 2, y - label.height
        placed.append((left, top, label))
    edges: list[tuple[float, float]] = []
    for left, top, label in sorted(placed, key=lambda place: place[0]):
        beside = [edge for height, edge in edges if abs(height - top) < label.height]
        left = min(max([left, 2.0, *beside]), picture.width - label.width - 2.0)
        top = min(max(top, 2.0), picture.height - label.height - 2.0)
        edges.append((top, left + label.width + 3))
        picture.paste(label, (round(left), round(top)), label)


def _draw_progress(picture: Image.Image, share: float) -> None:
    """Draws a thin bar along the lower edge, as long as the share of the film that has passed."""
    thickness = max(picture.height // 120, 2)
    bar = (0, picture.height - thickness, round(share * picture.width) - 1, picture.height - 1)
    ImageDraw.Draw(picture).rectangle(bar, fill=ACCENTS[0])
