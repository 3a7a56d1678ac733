"""PNG pictures: one motion with its paths, several as a contact sheet."""

import numpy as np
import pytest
from PIL import Image

from t2m_jax import Motion
from t2m_jax.cli.main import main
from t2m_jax.data.importers.synthetic import make_motion
from t2m_jax.errors import UserError
from t2m_jax.export.png import render_trails, save_png
from t2m_jax.motion.formats import save_motions


def make(kind, **fields):
    return Motion(make_motion(kind, seed=2, num_frames=80), 20.0, **fields)


def limbs(picture):
    """Columns with the color of a limb."""
    pixels = np.asarray(picture)[: round(0.9 * picture.height)].astype(int)
    return ((np.ptp(pixels, axis=-1) > 40) & (pixels.max(axis=-1) > 180)).any(axis=0)


def test_a_figure_that_stays_is_drawn_once_and_one_that_goes_several_times():
    still, going = (render_trails(make(kind), height=120) for kind in ("wave-left-hand", "walk"))
    assert still.size == (120, 120) and going.width > 240
    for picture in (still, going):
        assert not limbs(picture)[[0, -1]].any()
    gaps = np.diff(limbs(going).astype(int))
    assert (gaps == 1).sum() >= 2


@pytest.mark.parametrize("kind", ["walk-turn-left", "walk-turn-right"])
def test_all_poses_of_a_curve_are_in_the_picture(kind):
    assert not limbs(render_trails(make(kind), height=120))[[0, -1]].any()


@pytest.mark.slow
def test_all_of_a_long_way_that_bends_is_in_the_picture():
    walk = Motion(make_motion("walk", seed=2, num_frames=300), 20.0)
    for points in ([(0, 0), (0, 2), (2, 4), (9, 4)], [(0, 0), (0, 2), (-2, 4), (-9, 4)]):
        assert not limbs(render_trails(walk.along(points), height=120))[[0, -1]].any()


def test_the_direction_in_which_a_motion_starts_does_not_matter():
    motion = make("walk")
    turned = Motion(motion.positions[..., [2, 1, 0]] * [1, 1, -1], 20.0)
    one, other = (np.asarray(render_trails(each, height=96)).astype(int) for each in (motion, turned))
    assert np.abs(one - other).mean() < 1


@pytest.mark.parametrize("count", [1, 3])
def test_files(tmp_path, count):
    save_motions(tmp_path / "a.png", [make("walk", caption="a person walks")] * count)
    with Image.open(tmp_path / "a.png") as picture:
        picture.load()
        assert picture.format == "PNG" and picture.mode == "RGB"
        assert picture.size[0] == (1800 if count == 1 else 8 * 192)


def test_a_motion_without_limbs_or_with_one_frame(kit_walk):
    assert render_trails(Motion(make("walk").positions[:1], 20.0), height=96).size == (96, 96)
    assert render_trails(kit_walk, height=96).height == 96


def test_a_sheet_of_too_many_motions_is_refused(tmp_path):
    with pytest.raises(UserError, match=r"101 motions are too many for a contact sheet; give at most 100"):
        save_png(tmp_path / "a.png", [make("walk")] * 101)
    with pytest.raises(UserError, match="there is no motion to draw"):
        save_png(tmp_path / "a.png", [])


def test_view_shows_several_files(tmp_path, capsys):
    for name in ("walk", "squat"):
        make(name, caption=name).save(tmp_path / f"{name}.npz")
    files = [f"{tmp_path / name}.npz" for name in ("walk", "squat")]
    assert main(["view", *files, "-o", f"{tmp_path / 'sheet.png'}", "-o", f"{tmp_path / 'both.html'}"]) == 0
    assert capsys.readouterr().out.split()[:2] == [f"{tmp_path / 'sheet.png'}", f"{tmp_path / 'both.html'}"]
    assert Image.open(tmp_path / "sheet.png").height > 2 * 192
    assert main(["view", *files, "-o", f"{tmp_path / 'both.bvh'}"]) == 2
    assert "holds exactly one motion, not 2" in capsys.readouterr().err
