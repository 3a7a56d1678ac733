"""Animated GIF: one palette for all frames, exact timing, endless."""

import pathlib
from collections.abc import Iterator, Sequence

import numpy as np
from PIL import Image

from t2m_jax.export.render.rendering import Film, render_film
from t2m_jax.export.writing import whole_file
from t2m_jax.motion.record import Motion

MAX_FPS = 100 / 3
"""GIF counts in hundredths of a second, and browsers slow down what is shown for less than two of them."""

PALETTE_SAMPLES = 8


def save_gif(path: pathlib.Path, motions: Sequence[Motion], *, height: int = 480) -> None:
    """Writes the motions side by side as a GIF that repeats for ever.

    Args:
        path: The file; replaced as a whole or not at all.
        motions: At least one.
        height: Of the picture, in pixels; one figure makes it square.
    """
    film = render_film(motions, height=height, max_fps=MAX_FPS)
    palette = _common_palette(film)

    def pictures() -> Iterator[Image.Image]:
        """Yields the frames in colours of the palette."""
        for frame in range(film.num_frames):
            yield film.draw_frame(frame).quantize(palette=palette, dither=Image.Dither.NONE)

    frames = pictures()
    first = next(frames)
    with whole_file(path) as part:
        first.save(
            part,
            format="GIF",
            save_all=True,
            append_images=frames,
            duration=frame_durations(film.num_frames, film.fps),
            loop=0,
            disposal=1,
            optimize=False,
        )


def frame_durations(num_frames: int, fps: float) -> list[int]:
    """Returns how long each frame is shown, in milliseconds: whole hundredths of a second that never drift apart."""
    ends = np.rint(np.arange(num_frames + 1) * 100 / fps).astype(int)
    return [10 * int(duration) for duration in np.diff(ends)]


def _common_palette(film: Film) -> Image.Image:
    """Returns a picture whose palette suits frames from all over the film."""
    chosen = np.unique(np.linspace(0, film.num_frames - 1, PALETTE_SAMPLES).astype(int))
    samples = [film.draw_frame(int(frame)) for frame in chosen]
    sheet = Image.new("RGB", (samples[0].width, samples[0].height * len(samples)))
    for number, sample in enumerate(samples):
        sheet.paste(sample, (0, number * sample.height))
    return sheet.quantize(255, method=Image.Quantize.MEDIANCUT)
