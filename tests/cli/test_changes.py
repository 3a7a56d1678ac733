"""`--fps`, `--loop` and `--in-place` of `t2m generate` and `t2m view`."""

import numpy as np
import pytest

from t2m_jax import Motion
from t2m_jax.cli.main import main
from t2m_jax.data.importers.synthetic import make_motion


@pytest.fixture
def walk(tmp_path):
    path = tmp_path / "walk.npz"
    Motion(make_motion("walk", seed=3, num_frames=100), 20.0, caption="a person walks").save(path)
    return path


def test_a_loop_in_place_at_another_rate(walk, tmp_path):
    command = ["view", f"{walk}", "-o", f"{tmp_path / 'loop.npz'}", "-o", f"{tmp_path / 'loop.bvh'}"]
    assert main([*command, "--fps", "24", "--loop", "--in-place"]) == 0
    loop, bvh = Motion.load(tmp_path / "loop.npz"), Motion.load(tmp_path / "loop.bvh")
    assert loop.fps == 24 and bvh.fps == pytest.approx(24, rel=1e-6) and 14 < loop.num_frames == bvh.num_frames < 119
    np.testing.assert_allclose(loop.positions[-1], loop.positions[0], atol=1e-3)
    np.testing.assert_array_equal(loop.positions[:, 0, [0, 2]], 0)
    assert loop.caption == "a person walks"


def test_without_options_nothing_changes(walk, tmp_path):
    assert main(["view", f"{walk}", "-o", f"{tmp_path / 'same.npz'}"]) == 0
    np.testing.assert_array_equal(Motion.load(tmp_path / "same.npz").positions, Motion.load(walk).positions)


@pytest.mark.parametrize("fps", ["0", "-20", "nan", "1e9"])
def test_a_rate_that_no_motion_has_is_refused_first(refusal, bundle_folder, walk, tmp_path, fps):
    assert "fps: " in refusal("view", tmp_path / "no-such-file.npz", "-o", tmp_path / "a.npz", f"--fps={fps}")
    assert "fps: " in refusal("generate", "a person walks", "--model", bundle_folder, f"--fps={fps}")


def test_options_of_formats_that_are_not_written_are_refused(refusal, bundle_folder, walk, tmp_path):
    for option in (["--names", "vrm"], ["--units", "cm"]):
        said = refusal("view", walk, "-o", tmp_path / "a.html", *option)
        assert f"{option[0]}: is for .bvh and .glb files, and none is written" in said
        assert "none is written" in refusal("generate", "a person walks", "--model", bundle_folder, *option)


def test_generated_motion_is_changed_too(bundle_folder, tmp_path):
    command = ["generate", "a person walks", "--model", f"{bundle_folder}", "-o", f"{tmp_path / 'a.npz'}"]
    assert main([*command, "--fps", "40", "--in-place"]) == 0
    motion = Motion.load(tmp_path / "a.npz")
    assert motion.fps == 40
    np.testing.assert_array_equal(motion.positions[:, 0, [0, 2]], 0)


def test_what_cannot_be_a_loop_is_refused(refusal, walk, tmp_path):
    Motion.load(walk)[:8].save(tmp_path / "short.npz")
    said = refusal("view", tmp_path / "short.npz", "-o", tmp_path / "loop.npz", "--loop")
    assert "loop: the motion has 0.4 s" in said and not (tmp_path / "loop.npz").exists()
