"""MP4 (H.264) by imageio-ffmpeg, which the extra `video` installs."""

import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from t2m_jax.errors import UserError
from t2m_jax.export.render.rendering import render_film
from t2m_jax.export.render.view import Camera
from t2m_jax.files.writing import atomic_file
from t2m_jax.motion.motion import Motion

MAX_FPS = 60.0


def save_mp4(path: Path, motions: Sequence[Motion], *, height: int = 720, camera: Camera = "follow") -> None:
    """Writes the motions side by side as a video.

    Args:
        path: The file.
        motions: At least one.
        height: Height of the picture in pixels. One figure makes a square picture.
        camera: Whether it only follows the figures, or also goes around them once.

    Raises:
        UserError: The extra `video` is not installed.
    """
    try:
        import imageio_ffmpeg
    except ImportError as error:
        raise UserError(f"{path}: writing MP4 needs the extra `video`: pip install 't2m-jax[video]'") from error
    film = render_film(motions, height=height, max_fps=MAX_FPS, camera=camera)
    with atomic_file(path) as partial:
        # Every player and browser supports yuv420p. A quality of 20 is close to what eyes can distinguish.
        writer = imageio_ffmpeg.write_frames(
            str(partial),
            film.draw_frame(0).size,
            fps=film.fps,
            codec="libx264",
            pix_fmt_out="yuv420p",
            macro_block_size=2,
            ffmpeg_log_level="error",
            output_params=["-crf", "20", "-preset", "veryfast", "-movflags", "+faststart", "-f", "mp4"],
        )
        with warnings.catch_warnings():
            # JAX warns because its threads may hold locks. The child of this fork only becomes the encoder.
            warnings.filterwarnings("ignore", message=r"os\.fork\(\) was called")
            writer.send(None)  # starts the encoder
        try:
            for frame in range(film.num_frames):
                writer.send(np.ascontiguousarray(film.draw_frame(frame)))
        finally:
            writer.close()
