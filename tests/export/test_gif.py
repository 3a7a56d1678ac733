import sys

import numpy as np
import pytest
from PIL import Image, ImageSequence

from t2m_jax.errors import UserError
from t2m_jax.export.gif import frame_durations, save_gif
from t2m_jax.export.mp4 import save_mp4
from t2m_jax.motion.motion import Motion


def test_gif_has_every_frame_at_its_time(tmp_path, walk):
    save_gif(tmp_path / "a.gif", [Motion(walk.positions[:41], 20.0, caption="a person walks")], height=96)
    with Image.open(tmp_path / "a.gif") as image:
        assert image.size == (96, 96) and image.n_frames == 41 and image.info["loop"] == 0
        assert [frame.info["duration"] for frame in ImageSequence.Iterator(image)] == [50] * 41
        frames = [np.asarray(frame.convert("RGB"), int) for frame in ImageSequence.Iterator(image)]
    assert np.mean(np.abs(frames[0] - frames[40]) > 12) > 0.03


def test_gif_looks_like_what_was_drawn(tmp_path, walk):
    from t2m_jax.export.render.rendering import render_film

    short = Motion(walk.positions[:12], 20.0, caption="a person walks")
    save_gif(tmp_path / "a.gif", [short], height=160)
    film = render_film([short], height=160, max_fps=34.0)
    with Image.open(tmp_path / "a.gif") as image:
        for number, frame in enumerate(ImageSequence.Iterator(image)):
            drawn = np.asarray(film.draw_frame(number), int)
            assert np.abs(np.asarray(frame.convert("RGB"), int) - drawn).mean() < 2.5


@pytest.mark.parametrize(("fps", "expected"), [(20.0, {50}), (12.5, {80}), (30.0, {30, 40}), (25.0, {40})])
def test_durations_do_not_drift(fps, expected):
    durations = frame_durations(301, fps)
    assert set(durations) == expected
    assert sum(durations) == pytest.approx(301_000 / fps, abs=5.1)


def test_a_single_frame_and_several_motions(tmp_path, walk, kit_walk):
    save_gif(tmp_path / "one.gif", [Motion(walk.positions[:1], 20.0)], height=64)
    save_gif(tmp_path / "two.gif", [Motion(walk.positions[:8], 20.0), Motion(walk.positions[:5], 20.0)], height=64)
    with Image.open(tmp_path / "one.gif") as one, Image.open(tmp_path / "two.gif") as two:
        assert one.size == (64, 64) and two.size == (96, 64)
        assert sum(frame.info["duration"] for frame in ImageSequence.Iterator(two)) == 8 * 50


# The reader of imageio-ffmpeg leaves its pipes to the garbage collector.
@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")
def test_mp4_plays(tmp_path, walk):
    ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="the extra `video` is not installed")
    save_mp4(tmp_path / "a.mp4", [Motion(walk.positions[:20], 20.0, caption="walks")], height=128)
    reader = ffmpeg.read_frames(str(tmp_path / "a.mp4"))
    facts = next(reader)
    frames = [np.frombuffer(frame, np.uint8) for frame in reader]
    assert facts["size"] == (128, 128) and facts["fps"] == 20 and len(frames) == 20
    assert np.std(frames[0].astype(float)) > 10 and np.any(frames[0] != frames[-1])


def test_mp4_without_the_extra_says_what_to_install(tmp_path, walk, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(UserError, match=r"pip install 't2m-jax\[video\]'"):
        save_mp4(tmp_path / "a.mp4", [walk])
    assert list(tmp_path.iterdir()) == []
