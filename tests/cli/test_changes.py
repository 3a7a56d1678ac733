"""The changes of motion that `t2m generate` and `t2m view` make: every field of `Changes`."""

import numpy as np
import pytest

from t2m_jax import Motion
from t2m_jax.cli.main import main
from t2m_jax.data.importers.synthetic import make_motion
from t2m_jax.motion.skeleton import KIT_ML


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
    assert np.abs(loop.positions[:, 0, [0, 2]]).max() < 0.1
    assert loop.caption == "a person walks"


def test_a_loop_has_at_least_60_frames_a_second_without_a_rate(walk, tmp_path):
    fast = tmp_path / "fast.npz"
    Motion.load(walk).resampled(120).save(fast)
    for path, fps in ((walk, 60), (fast, 120)):
        assert main(["view", f"{path}", "-o", f"{tmp_path / 'loop.npz'}", "--loop"]) == 0
        loop = Motion.load(tmp_path / "loop.npz")
        assert loop.fps == fps
        np.testing.assert_allclose(loop.positions, Motion.load(path).resampled(fps).looped().positions, atol=1e-5)


def test_no_file_is_written_if_one_cannot_have_all_motions(refusal, walk, tmp_path):
    said = refusal("view", walk, walk, "-o", tmp_path / "two.glb", "-o", tmp_path / "two.bvh")
    assert "two.bvh: a .bvh file holds exactly one motion, not 2" in said and not (tmp_path / "two.glb").exists()
    assert main(["view", f"{walk}", f"{walk}", "--join", "-o", f"{tmp_path / 'two.bvh'}"]) == 0


@pytest.mark.slow
def test_a_recording_is_cleaned(tmp_path):
    noise = 0.004 * np.random.default_rng(0).standard_normal((60, 22, 3))
    Motion(make_motion("wave-left-hand", seed=0, num_frames=60) + noise, 20.0).save(tmp_path / "take.bvh")
    assert main(["view", f"{tmp_path / 'take.bvh'}", "--clean", "-o", f"{tmp_path / 'calm.npz'}"]) == 0
    take, calm = Motion.load(tmp_path / "take.bvh"), Motion.load(tmp_path / "calm.npz")
    np.testing.assert_allclose(calm.positions, take.cleaned().positions, atol=1e-5)
    before, after = (np.abs(np.diff(motion.positions, n=3, axis=0)).mean() for motion in (take, calm))
    assert after < 0.7 * before and calm.num_frames == take.num_frames


def test_without_options_nothing_changes(walk, tmp_path):
    assert main(["view", f"{walk}", "-o", f"{tmp_path / 'same.npz'}"]) == 0
    np.testing.assert_array_equal(Motion.load(tmp_path / "same.npz").positions, Motion.load(walk).positions)


@pytest.mark.parametrize("fps", ["0", "-20", "nan", "1e9"])
def test_a_rate_that_no_motion_has_is_refused_first(refusal, bundle_folder, walk, tmp_path, fps):
    assert "fps: " in refusal("view", tmp_path / "no-such-file.npz", "-o", tmp_path / "a.npz", f"--fps={fps}")
    assert "fps: " in refusal("generate", "a person walks", "--model", bundle_folder, f"--fps={fps}")


def test_options_of_formats_that_are_not_written_are_refused(refusal, bundle_folder, walk, tmp_path):
    for option in (["--names", "vrm"], ["--units", "cm"], ["--root-bone"]):
        said = refusal("view", walk, "-o", tmp_path / "a.html", *option)
        assert f"{option[0]}: is for .bvh and .glb files, and none is written" in said
        assert "none is written" in refusal("generate", "a person walks", "--model", bundle_folder, *option)
    said = refusal("view", walk, "-o", tmp_path / "a.glb", "--camera", "turntable")
    assert "--camera: is for .gif and .mp4 files, and none is written; add -o FILE.mp4" in said


def test_a_name_of_joints_is_for_the_formats_that_have_it(refusal, walk, tmp_path):
    view, glb = ["view", f"{walk}", "-o", f"{tmp_path / 'b.npz'}"], tmp_path / "b.glb"
    assert "--names: is for .bvh and .glb files" in refusal(*view, "--names", "vrm")
    assert main([*view, "-o", f"{glb}", "--names", "smpl"]) == 0
    assert "poses" in np.load(tmp_path / "b.npz") and b'"L_Hip"' in glb.read_bytes()
    assert main([*view, "-o", f"{glb}", "--names", "vrm"]) == 0
    assert "positions" in np.load(tmp_path / "b.npz") and b'"leftUpperLeg"' in glb.read_bytes()


@pytest.mark.slow
def test_speed_and_path_change_before_the_rate(walk, tmp_path):
    motion, written = Motion.load(walk), tmp_path / "b.npz"
    assert main(["view", f"{walk}", "-o", f"{written}", "--speed", "2", "--turn", "-90", "--fps", "40"]) == 0
    expected = motion.at_speed(2).turned(-90).resampled(40)
    np.testing.assert_allclose(Motion.load(written).positions, expected.positions, atol=1e-5)
    assert main(["view", f"{walk}", "-o", f"{written}", "--path", "-1,0 1,2 3,2"]) == 0
    np.testing.assert_allclose(
        Motion.load(written).positions, motion.along([(-1, 0), (1, 2), (3, 2)]).positions, atol=1e-5
    )


@pytest.mark.parametrize(
    ("option", "message"),
    [
        *((f"--speed={value}", "speed: ") for value in ("0", "-1", "nan", "inf", "1e9")),
        *((f"--turn={value}", "turn: ") for value in ("nan", "inf", "1e9")),
        ("--path=", "path: 0 points"),
        ("--path=0,0", "argument --path: 1 point; give two or more"),
        ("--path=0,0 1,1 1,1", "path: points 2 and 3 are at the same place"),
        ("--path=0,0 1,1,1", "path: point 2 needs two numbers, x and z in meters, not 3"),
        ("--path=0,0 inf,1", "path: point 2 is not within"),
        ("--path=0,0;1,1", "path: '0,0;1,1' is not points of two numbers"),
    ],
)
def test_speeds_and_paths_that_no_motion_has_are_refused_first(refusal, bundle_folder, tmp_path, option, message):
    assert message in refusal("view", tmp_path / "no-such-file.npz", "-o", tmp_path / "a.npz", option)
    assert message in refusal("generate", "a person walks", "--model", bundle_folder, option)


def test_a_path_and_a_turn_exclude_each_other(refusal, walk, tmp_path):
    said = refusal("view", walk, "-o", tmp_path / "a.npz", "--turn", "90", "--path", "0,0 1,1")
    assert "--turn: excludes --path, which" in said


@pytest.mark.parametrize(
    ("trim", "begin", "end"), [("1:3", 1.0, 3.0), ("1.5:", 1.5, None), (":2", None, 2.0), (":", None, None)]
)
def test_a_part_is_kept_and_mirrored(walk, tmp_path, trim, begin, end):
    written = tmp_path / "part.npz"
    assert main(["view", f"{walk}", "-o", f"{written}", f"--trim={trim}", "--mirror"]) == 0
    expected = Motion.load(walk).trimmed(begin, end).mirrored()
    np.testing.assert_allclose(Motion.load(written).positions, expected.positions, atol=1e-6)


@pytest.mark.parametrize(
    ("trim", "message"),
    [
        ("2", "'2' is not BEGIN:END in seconds"),
        ("a:b", "'a:b' is not BEGIN:END in seconds"),
        ("3:2", "--trim: 2 s is not after 3 s, where the motion begins"),
        ("-1:2", "--trim: -1 is not a number of seconds from 0"),
    ],
)
def test_a_part_that_is_none_is_refused(refusal, walk, tmp_path, trim, message):
    assert message in refusal("view", walk, "-o", tmp_path / "a.npz", f"--trim={trim}")


@pytest.mark.slow
def test_generated_motion_is_changed_too(bundle_folder, tmp_path):
    command = ["generate", "a person walks", "--model", f"{bundle_folder}", "-o", f"{tmp_path / 'a.npz'}"]
    assert main([*command, "--fps", "40", "--in-place"]) == 0
    motion = Motion.load(tmp_path / "a.npz")
    assert motion.fps == 40
    np.testing.assert_allclose(motion.positions[:, 0, [0, 2]], 0, atol=0.1)


def test_what_cannot_be_a_loop_is_refused(refusal, walk, tmp_path):
    Motion.load(walk)[:8].save(tmp_path / "short.npz")
    said = refusal("view", tmp_path / "short.npz", "-o", tmp_path / "loop.npz", "--loop")
    assert "loop: the motion has 0.4 s" in said and not (tmp_path / "loop.npz").exists()


def test_two_files_become_one_motion(walk, tmp_path, capsys):
    first, second, written = Motion.load(walk), tmp_path / "second.npz", tmp_path / "both.npz"
    first.trimmed(0.5, 2.0).resampled(30).save(second)
    assert main(["view", f"{walk}", f"{second}", "--join", "--trim", "1:", "-o", f"{written}"]) == 0
    expected = (first + Motion.load(second).resampled(first.fps)).trimmed(1.0, None)
    assert expected.num_frames > first.num_frames
    np.testing.assert_allclose(Motion.load(written).positions, expected.positions, atol=1e-6)
    assert f"next: t2m view {written} -o motion.html" in capsys.readouterr().err


def test_files_of_two_skeletons_are_not_joined(refusal, walk, tmp_path):
    Motion(np.zeros((4, 21, 3)), 12.5, skeleton=KIT_ML).save(tmp_path / "kit.npz")
    said = refusal("view", walk, tmp_path / "kit.npz", "--join", "-o", tmp_path / "both.npz")
    assert f"{tmp_path / 'kit.npz'}: its skeleton is kit_ml, that of {walk} is humanml3d; they cannot be joined" in said
