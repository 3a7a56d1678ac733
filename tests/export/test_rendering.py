import importlib.util
import itertools
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from t2m_jax.export.render import labels
from t2m_jax.export.render.ground import draw_ground, make_ground
from t2m_jax.export.render.labels import make_label, wrap
from t2m_jax.export.render.rasterizer import (
    TABLE_SIZE,
    Ball,
    color_picture,
    draw_capsule,
    empty_canvas,
    make_shade_tables,
)
from t2m_jax.export.render.rendering import picture_size, render_film, render_poster
from t2m_jax.export.render.view import View, project, sample_figure, smooth_path
from t2m_jax.motion.motion import Motion

FOCAL = 1000.0


def brute_force_depths(start: Ball, end: Ball, size: int) -> np.ndarray:
    """Returns depths of a thousand balls between both, seen in parallel."""
    scale = 2 * FOCAL / (start.depth + end.depth)
    y, x = np.mgrid[0:size, 0:size] + 0.5
    nearest = np.full((size, size), np.inf)
    for share in np.linspace(0, 1, 1001):
        mix = [a + share * (b - a) for a, b in zip(start, end, strict=True)]
        square = mix[3] ** 2 - (x - mix[0]) ** 2 - (y - mix[1]) ** 2
        height = np.where(square > 0, np.sqrt(np.maximum(square, 0)), -np.inf)
        nearest = np.minimum(nearest, mix[2] - height / scale)
    return nearest


@pytest.mark.parametrize(
    ("start", "end"),
    [
        (Ball(20.0, 20.0, 4.0, 9.0), Ball(44.0, 40.0, 4.0, 9.0)),
        (Ball(20.0, 45.0, 4.0, 14.0), Ball(44.0, 20.0, 4.1, 5.0)),
        (Ball(30.0, 20.0, 4.1, 6.0), Ball(34.0, 44.0, 3.95, 12.0)),
        (Ball(30.0, 30.0, 4.1, 12.0), Ball(34.0, 31.0, 3.9, 8.0)),
        (Ball(32.0, 32.0, 4.0, 12.0), Ball(32.0, 32.0, 4.0, 12.0)),
        (Ball(32.0, 32.0, 4.0, 12.0), Ball(33.0, 32.0, 4.0, 4.0)),
    ],
)
def test_capsule_is_the_hull_of_its_balls(start, end):
    canvas = empty_canvas((64, 64), FOCAL)
    edge = draw_capsule(canvas, start, end, 0)
    expected = brute_force_depths(start, end, 64)
    drawn = np.isfinite(canvas.depths)
    assert np.all(np.isfinite(expected[drawn]))
    assert np.abs(canvas.depths[drawn] - expected[drawn]).max() < 5e-4
    covered = drawn.sum() + edge.cover.sum()
    assert covered == pytest.approx(np.isfinite(expected).sum(), rel=0.03)


def test_normals_select_the_shade_of_a_sphere():
    canvas = empty_canvas((64, 64), FOCAL)
    draw_capsule(canvas, Ball(32.0, 32.0, 4.0, 20.0), Ball(32.0, 32.0, 4.0, 20.0), 0)
    row, column = np.divmod(canvas.shades, TABLE_SIZE)
    y, x = np.nonzero(canvas.shades >= 0)
    np.testing.assert_allclose((column[y, x] + 0.5) * 2 / TABLE_SIZE - 1, (x + 0.5 - 32) / 20, atol=1.01 / TABLE_SIZE)
    np.testing.assert_allclose((row[y, x] + 0.5) * 2 / TABLE_SIZE - 1, (y + 0.5 - 32) / 20, atol=1.01 / TABLE_SIZE)


AHEAD = np.array([0, 0, 1.0])


def test_the_nearer_limb_hides_the_farther_in_either_order():
    tables = make_shade_tables(np.array([[1.0, 0, 0], [0, 1.0, 0]]), AHEAD, AHEAD, np.array([0, -1.0, 0]))
    near, far = Ball(32.0, 32.0, 3.0, 10.0), Ball(32.0, 32.0, 5.0, 20.0)
    pictures = []
    for order in ([(far, 1), (near, 0)], [(near, 0), (far, 1)]):
        canvas = empty_canvas((64, 64), FOCAL)
        edges = [draw_capsule(canvas, ball, ball, table) for ball, table in order]
        edges.sort(key=lambda edge: -edge.depths.mean())
        picture = np.full((64, 64, 3), 255, np.uint8)
        color_picture(picture, canvas, edges, tables)
        pictures.append(picture)
    np.testing.assert_array_equal(*pictures)
    assert pictures[0][32, 32, 0] > 100 and pictures[0][32, 32, 1] == 0
    assert pictures[0][32, 48, 1] > 100 and tuple(pictures[0][2, 2]) == (255, 255, 255)


def test_what_lies_outside_the_picture_is_not_drawn():
    canvas = empty_canvas((64, 64), FOCAL)
    assert draw_capsule(canvas, Ball(-100.0, 30.0, 4.0, 10.0), Ball(-80.0, 30.0, 4.0, 10.0), 0) is None
    assert draw_capsule(canvas, Ball(-100.0, 30.0, 4.0, 10.0), Ball(80.0, 30.0, 4.0, 10.0), 0) is not None
    assert (canvas.shades[:, 0] >= 0).any() and (canvas.shades[:, -1] >= 0).any()


def test_ground_lines_meet_where_they_should():
    back = np.array([0.0, np.sin(0.3), np.cos(0.3)])
    axes = np.stack([[1.0, 0, 0], np.cross([1.0, 0, 0], back), back])
    view = View(4 * back, axes, 400.0, 240, 240, 120.0)
    picture = np.asarray(draw_ground(make_ground(view), view)).astype(int).sum(axis=2)
    corner = np.rint(project(view, np.zeros(3))[:2]).astype(int)
    empty = np.rint(project(view, np.array([0.25, 0, 0.25]))[:2]).astype(int)
    assert picture[corner[1], corner[0]] < picture[empty[1], empty[0]] - 60


def test_film_shows_the_figure_moving(walk):
    film = render_film([walk], height=120, max_fps=100.0)
    assert (film.num_frames, film.fps) == (80, 20.0)
    first, later = film.draw_frame(0), film.draw_frame(40)
    assert first.size == (120, 120)
    assert np.mean(np.abs(np.asarray(first, int) - np.asarray(later, int)) > 12) > 0.03
    np.testing.assert_array_equal(first, film.draw_frame(0))
    # Both tints of the sides are there: bluish and reddish pixels that the grey ground does not have.
    red, _, blue = (np.asarray(first, int)[..., channel] for channel in range(3))
    assert np.sum(blue - red > 40) > 50 and np.sum(red - blue > 40) > 50


def test_a_camera_on_a_turntable_sees_the_back(walk):
    still = Motion(np.repeat(walk.positions[:1], 8, axis=0), 20.0)
    film = render_film([still], height=120, max_fps=100.0, camera="turntable")
    pictures = [np.asarray(film.draw_frame(frame), int) for frame in range(8)]
    sides = []
    for picture in pictures:
        red, _, blue = (picture[:-2, :, channel] for channel in range(3))  # without the bar
        sides.append(np.mean(np.nonzero(blue - red > 40)[1]) - np.mean(np.nonzero(red - blue > 40)[1]))
    assert sides[0] * sides[4] < 0 and min(abs(sides[0]), abs(sides[4])) > 5
    assert all((a != b).any() for a, b in itertools.pairwise(pictures))
    ahead = np.asarray(render_film([still], height=120, max_fps=100.0).draw_frame(0), int)
    assert np.mean(np.abs(ahead - pictures[0]) > 12) < 0.02


def test_fast_motions_are_thinned_out_evenly(walk):
    film = render_film([Motion(walk.positions, 120.0)], height=60, max_fps=33.4)
    assert (film.num_frames, film.fps) == (20, 30.0)
    figure = Motion(walk.positions, 20.0)
    from t2m_jax.export.render.scene import figure_from_motion

    points = sample_figure(figure_from_motion(figure), 159, 40.0)
    np.testing.assert_allclose(points[::2], figure_from_motion(figure).points)
    np.testing.assert_allclose(points[1], (points[0] + points[2]) / 2, atol=1e-6)


def test_smoothing_keeps_a_straight_path():
    line = np.linspace(0, 9, 50)[:, None] * [[1.0, 2.0]]
    np.testing.assert_allclose(smooth_path(line, 3)[6:-6], line[6:-6])
    assert smooth_path(np.ones((1, 2)), 5).shape == (1, 2)


@pytest.mark.parametrize("count", [1, 2, 3, 9])
def test_any_number_side_by_side(walk, kit_walk, count):
    film = render_film([walk, kit_walk][:count] * (1 if count < 2 else count // 2), height=100, max_fps=30.0)
    picture = film.draw_frame(film.num_frames - 1)
    assert isinstance(picture, Image.Image) and picture.size[0] % 2 == 0
    assert picture_size(count, 101)[1] % 2 == 0


def test_captions_wrap_and_end():
    assert wrap("one two three", len, width=7.0, max_lines=3) == ["one two", "three"]
    assert wrap("", len, width=7.0, max_lines=3) == []
    assert wrap("abcdefghij", len, width=4.0, max_lines=9) == ["abcd", "efgh", "ij"]
    assert wrap("one two three four", len, width=5.0, max_lines=2) == ["one", "two…"]
    assert wrap("tab\tnew\nline\x07bell", len, width=99.0, max_lines=2) == ["tab new line bell"]
    lines = wrap("word " * 2000, len, width=20.0, max_lines=3)
    assert len(lines) == 3 and lines[-1].endswith("…")
    assert make_label(" \n ", size=12, width=100, max_lines=2) is None
    assert make_label("x" * 10_000, size=12, width=100, max_lines=2).width <= 100


@pytest.fixture
def fonts(monkeypatch):
    """Returns a function that sets which fonts of this machine may be used."""
    labels.find_font.cache_clear()
    yield lambda *names: monkeypatch.setattr(labels, "FONTS", names)
    labels.find_font.cache_clear()


def test_captions_keep_characters_that_a_font_of_this_machine_has(fonts, caplog):
    matplotlib = Path(importlib.util.find_spec("matplotlib").origin).parent
    fonts("no such font.ttf", f"{matplotlib / 'mpl-data' / 'fonts' / 'ttf' / 'DejaVuSans.ttf'}")
    assert labels.find_font("a person waves", 20)[0].getname()[0] == "Aileron"  # Pillow's, the same everywhere
    for text, expected in {"Zoe\u0308 grüßt": "Zoë grüßt", "Зоя машет": "Зоя машет"}.items():
        font, shown = labels.find_font(text, 20)
        assert (font.getname()[0], shown) == ("DejaVu Sans", expected)
    assert not caplog.text
    plain, accents = (np.asarray(make_label(text, size=20, width=400, max_lines=1)) for text in ("Zoe", "Zoë"))
    assert plain.shape != accents.shape or (plain != accents).any()


def test_a_caption_that_no_font_can_show_is_said_once(fonts, caplog):
    fonts()
    for _ in range(2):
        assert labels.find_font("Zoë 走路", 20)[1] == "Zoe 走路"
    assert caplog.messages == ["captions in pictures: no font on this machine has 走路; install Noto Sans CJK"]


def test_a_poster_has_a_row_of_poses_and_a_caption_per_motion(walk, kit_walk):
    walk = Motion(walk.positions[:41], 20.0, caption="a person walks")
    poster = render_poster([walk, kit_walk], num_poses=3, height=96)
    assert poster.dtype == np.uint8 and poster.shape[1:] == (3 * 96, 3)
    band = (len(poster) - 2 * 96) // 2
    assert 12 <= band <= 40
    film = render_film([Motion(walk.positions, 20.0)], height=96, max_fps=20.0)
    for number, frame in enumerate((0, 20, 40)):
        pose = poster[band : band + 96, 96 * number : 96 * (number + 1)]
        np.testing.assert_array_equal(pose, np.asarray(film.draw_frame(frame)))
    # Captions are dark text on a light panel. The second one is longer.
    dark = [(poster[top + 2 : top + band - 2].max(axis=-1) < 100).any(axis=0) for top in (0, band + 96)]
    assert 60 < np.flatnonzero(dark[0]).max() < np.flatnonzero(dark[1]).max() - 20


def test_figures_on_a_poster_are_not_cut(walk):
    lying = Motion(walk.positions[:41, :, [1, 0, 2]], 20.0)
    for motion in (walk, lying):
        poster = render_poster([motion], num_poses=4, height=96)
        cells = poster[-96:].reshape(96, 4, 96, 3).swapaxes(0, 1)
        # Limbs are the only saturated colors besides the trail and the bar, which are darker.
        limbs = (np.ptp(cells.astype(int), axis=-1) > 40) & (cells.max(axis=-1) > 180)
        assert limbs.any(axis=(1, 2)).all()
        assert not limbs[:, 0].any() and not limbs[:, :, [0, -1]].any()
