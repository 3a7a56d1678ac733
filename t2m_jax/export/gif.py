"""Animated GIFs: one palette for all frames, exact timing, endless."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from t2m_jax.export.render.rendering import render_film
from t2m_jax.export.render.view import Camera
from t2m_jax.files.writing import atomic_file
from t2m_jax.motion.motion import Motion

MAX_FPS = 100 / 3
"""GIF counts in hundredths of a second, and browsers slow down frames that are shorter than two of them."""

PALETTE_SAMPLES = 8


def save_gif(path: Path, motions: Sequence[Motion], *, height: int = 480, camera: Camera = "follow") -> None:
    """Writes the motions side by side as a GIF that repeats forever.

    Args:
        path: The file.
        motions: At least one.
        height: Height of the picture in pixels. One figure makes a square picture.
        camera: Whether it only follows the figures, or also goes around them once.
    """
    film = render_film(motions, height=height, max_fps=MAX_FPS, camera=camera)
    # A palette per frame would flicker, so one palette is made from frames of the whole film.
    chosen = np.unique(np.linspace(0, film.num_frames - 1, PALETTE_SAMPLES).astype(int))
    samples = np.concatenate([np.asarray(film.draw_frame(int(frame))) for frame in chosen])
    palette = Image.fromarray(samples).quantize(255, method=Image.Quantize.MEDIANCUT)
    pictures = map(film.draw_frame, range(film.num_frames))
    frames = (picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures)
    first = next(frames)
    with atomic_file(path) as partial:
        first.save(
            partial,
            format="GIF",
            save_all=True,
            append_images=frames,
            duration=frame_durations(film.num_frames, film.fps),
            loop=0,
            disposal=1,
            optimize=False,
        )


def frame_durations(num_frames: int, fps: float) -> list[int]:
    """Returns how long each frame is shown in milliseconds: whole hundredths of a second whose sum does not drift."""
    ends = np.rint(np.arange(num_frames + 1) * 100 / fps).astype(int)
    return [10 * int(duration) for duration in np.diff(ends)]
