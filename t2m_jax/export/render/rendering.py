"""Pictures of figures without a browser or a graphics card, for GIF and MP4 files and posters."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image, ImageColor, ImageDraw

from t2m_jax.export.render import rasterizer
from t2m_jax.export.render.figure import TINTS, Tint
from t2m_jax.export.render.ground import ACCENTS, KEY_LIGHT, SKY_TOP, add_shadows, add_trail, draw_ground, make_ground
from t2m_jax.export.render.labels import make_label
from t2m_jax.export.render.scene import SceneFigure, figures_from_motions
from t2m_jax.export.render.view import Camera, View, project, sample_figure, smooth_path, views_of_figures
from t2m_jax.motion.motion import Motion

TINT_COLORS: dict[Tint, str] = {"body": "#e4ddd2", "left": "#8dbfd2", "right": "#eeb08d", "face": "#27303c"}
FILL_LIGHT = np.array([-0.6, 0.35, -0.7]) / np.linalg.norm([-0.6, 0.35, -0.7])


class Film(NamedTuple):
    """Pictures that are drawn on demand."""

    draw_frame: Callable[[int], Image.Image]
    num_frames: int
    fps: float


class _FilmedFigure(NamedTuple):
    """One figure at the times of the film, with its trail and its label."""

    figure: SceneFigure
    points: Float[np.ndarray, "T P 3"]
    path: Float[np.ndarray, "T 3"]
    label: Image.Image | None


def picture_size(num_motions: int, height: int) -> tuple[int, int]:
    """Returns width and height, both even as video encoders require. One figure makes a square, several are wider."""
    width = height * min(1 + 0.5 * (num_motions - 1), 2.5)
    return round(width / 2) * 2, round(height / 2) * 2


def render_film(motions: Sequence[Motion], *, height: int, max_fps: float, camera: Camera = "follow") -> Film:
    """Returns pictures of the motions side by side, at the frame rate of the longest or an integer fraction of it.

    Args:
        motions: At least one.
        height: Height of the pictures in pixels.
        max_fps: Faster motions are shown at 1/2, 1/3, … of their rate.
        camera: Whether it only follows, or also goes around the figures once.
    """
    figures = figures_from_motions(motions)
    longest = max(figures, key=lambda figure: len(figure.points) / figure.fps)
    stride = int(np.ceil(longest.fps / max_fps - 1e-6)) if longest.fps > max_fps else 1
    fps = longest.fps / stride
    num_frames = -(-len(longest.points) // stride)
    count = len(figures)
    width, height = size = picture_size(count, height)
    # A single caption gets the foot of the picture; several captions share its width.
    letters, lines = (round(height / 27), 3) if count == 1 else (max(round(height / 34), 10), 2)
    room = round((0.94 if count == 1 else 0.86) * width / min(count, 6))
    tracks = []
    for figure in figures:
        points = sample_figure(figure, num_frames, fps)
        path = smooth_path(points[:, 0].astype(np.float64), max(round(0.12 * fps), 1))
        label = make_label(figure.caption, size=letters, width=room, max_lines=lines)
        tracks.append(_FilmedFigure(figure, points, path, label))
    roots = np.stack([track.points[:, 0] for track in tracks], axis=1)
    views = views_of_figures(figures, roots, fps, size, camera=camera)
    ground = make_ground(views[0])  # which looks the same from all directions
    tables = shade_tables(views[0])

    def draw_frame(frame: int) -> Image.Image:
        picture = draw_ground(ground, views[frame])
        for number, track in enumerate(tracks):
            add_trail(picture, views[frame], track.path[: frame + 1], ACCENTS[number % len(ACCENTS)])
        shades = tables if camera == "follow" else shade_tables(views[frame])
        picture = draw_figures(picture, views[frame], [(t.figure, t.points[frame]) for t in tracks], shades)
        _draw_labels(picture, views[frame], tracks, frame)
        # The bar along the lower edge shows how much of the film has passed.
        thickness = max(height // 120, 2)
        # At least one pixel wide: in a long film, the share of the first frames rounds to nothing.
        bar = (0, height - thickness, max(round((frame + 1) / num_frames * width), 1) - 1, height - 1)
        ImageDraw.Draw(picture).rectangle(bar, fill=ACCENTS[0])
        return picture

    return Film(draw_frame, num_frames, fps)


def render_poster(motions: Sequence[Motion], *, num_poses: int = 6, height: int = 192) -> UInt8[np.ndarray, "H W 3"]:
    """Returns one still picture with a row of poses per motion, at equal time steps from the first to the last frame.

    Args:
        motions: At least one.
        num_poses: Number of poses per motion.
        height: Height, and width, of the picture of one pose in pixels.
    """
    rows = []
    for motion in motions:
        film = render_film([dataclasses.replace(motion, caption="")], height=height, max_fps=motion.fps)
        frames = np.linspace(0, film.num_frames - 1, num_poses).round().astype(int).tolist()
        poses = np.concatenate([np.asarray(film.draw_frame(frame)) for frame in frames], axis=1)
        size = max(round(height / 12), 12)
        text = f"{motion.caption} ({motion.seconds:.1f} s)".strip()
        label = make_label(text, size=size, width=poses.shape[1] - 4, max_lines=2)
        assert label is not None, "the text has at least a duration"
        band = Image.new("RGB", (poses.shape[1], label.height + 4), SKY_TOP)
        band.paste(label, (2, 2), label)
        rows += [np.asarray(band), poses]
    return np.concatenate(rows)


def shade_tables(view: View) -> rasterizer.ShadeTables:
    """Returns the colors of all tints, with the light as the camera sees it."""
    # The tables are computed in linear light, so the sRGB colors are decoded with a gamma of 2.2.
    tints = [[(level / 255) ** 2.2 for level in ImageColor.getrgb(TINT_COLORS[tint])] for tint in TINTS]
    lights = (view.axes @ direction for direction in (KEY_LIGHT, FILL_LIGHT, np.array([0.0, 1.0, 0.0])))
    return rasterizer.make_shade_tables(np.array(tints), *lights)


def draw_figures(
    picture: Image.Image,
    view: View,
    figures: Sequence[tuple[SceneFigure, Float[np.ndarray, "_ 3"]]],
    tables: rasterizer.ShadeTables,
) -> Image.Image:
    """Returns a picture of the ground with figures at given points, and their shadows."""
    add_shadows(picture, view, figures)
    capsules = []
    for figure, points in figures:
        spots = project(view, points).tolist()
        for part in figure.parts:
            ends = []
            for point, radius in ((part.start, part.start_radius), (part.end, part.end_radius)):
                x, y, depth = spots[point]
                ends.append(rasterizer.Ball(x, y, depth, max(radius * view.focal / depth, 0.5)))
            capsules.append((ends[0], ends[1], TINTS.index(part.tint)))
    # Far limbs are drawn first, so that soft edges blend with the limbs behind them.
    capsules.sort(key=lambda capsule: -capsule[0].depth - capsule[1].depth)
    canvas = rasterizer.empty_canvas(picture.size, view.focal)
    edges = [rasterizer.draw_capsule(canvas, start, end, tint) for start, end, tint in capsules]
    pixels = np.array(picture)
    rasterizer.color_picture(pixels, canvas, [edge for edge in edges if edge is not None], tables)
    return Image.fromarray(pixels)


def _draw_labels(picture: Image.Image, view: View, tracks: Sequence[_FilmedFigure], frame: int) -> None:
    """Draws a single caption at the foot of the picture, and several captions above their figures without overlap."""
    placed = []
    for track in tracks:
        label = track.label
        if label is None:
            continue
        if len(tracks) == 1:
            left = (picture.width - label.width) / 2
            top = 0.97 * picture.height - label.height
        else:
            x, y, _ = project(view, track.path[frame] * [1, 0, 1] + [0, 2.0, 0]).tolist()
            left = x - label.width / 2
            top = y - label.height
        placed.append((left, top, label))
    edges: list[tuple[float, float]] = []
    for left, top, label in sorted(placed, key=lambda place: place[0]):
        beside = [edge for height, edge in edges if abs(height - top) < label.height]
        left = min(max([left, 2.0, *beside]), picture.width - label.width - 2.0)
        top = min(max(top, 2.0), picture.height - label.height - 2.0)
        edges.append((top, left + label.width + 3))
        picture.paste(label, (round(left), round(top)), label)
