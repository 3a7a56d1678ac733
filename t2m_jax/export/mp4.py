"""MP4 (H.264) through imageio-ffmpeg, which the extra `video` installs."""

import pathlib
import types
from collections.abc import Sequence

import numpy as np

from t2m_jax.errors import UserError
from t2m_jax.export.render.rendering import render_film
from t2m_jax.export.writing import whole_file
from t2m_jax.motion.record import Motion

MAX_FPS = 60.0


def save_mp4(path: pathlib.Path, motions: Sequence[Motion], *, height: int = 720) -> None:
    """Writes the motions side by side as a video.

    Args:
        path: The file; replaced as a whole or not at all.
        motions: At least one.
        height: Of the picture, in pixels; one figure makes it square.

    Raises:
        UserError: The extra `video` is not installed.
    """
    ffmpeg = _load_ffmpeg(path)
    film = render_film(motions, height=height, max_fps=MAX_FPS)
    with whole_file(path) as part:
        size = film.draw_frame(0).size
        # yuv420p and a quality near the eye's limit: what every player and browser takes.
        writer = ffmpeg.write_frames(
            str(part),
            size,
            fps=film.fps,
            codec="libx264",
            pix_fmt_out="yuv420p",
            macro_block_size=2,
            ffmpeg_log_level="error",
            output_params=["-crf", "20", "-preset", "veryfast", "-movflags", "+faststart", "-f", "mp4"],
        )
        writer.send(None)
        try:
            for frame in range(film.num_frames):
                writer.send(np.ascontiguousarray(film.draw_frame(frame)))
        finally:
            writer.close()


def _load_ffmpeg(path: pathlib.Path) -> types.ModuleType:
    """Returns the module that runs the encoder."""
    try:
        import imageio_ffmpeg
    except ImportError as error:
        raise UserError(f"{path}: writing MP4 needs the extra `video`: pip install 't2m-jax[video]'") from error
    return imageio_ffmpeg
