"""Files of other programs, read as people: height of hips and feet, size, sides and length."""

from typing import NamedTuple

import numpy as np
import pytest

from t2m_jax.motion.formats import load_motion
from t2m_jax.motion.rig.orientation import left_is_left
from t2m_jax.motion.skeleton import HUMANML3D

INDEX = HUMANML3D.joint_names.index


class Right(NamedTuple):
    """What is right for a file, checked by hand."""

    frames: int
    fps: float
    hips: float
    """Median height of the hips in meters."""
    leg: float
    """Thigh and shin in meters."""


FILES = {
    "rokoko_jesse_dance": Right(1007, 100, 1.115, 0.865),  # somebody who jumps most of the time
    "fair_wave_hello": Right(839, 119.88, 0.957, 0.821),
    "cmu1_jumping_jacks": Right(125, 30, 0.997, 0.840),
    "mobu_8walk": Right(1064, 120, 0.851, 0.820),
    "mixamo_freebvh": Right(69, 30, 0.973, 0.827),
    "mocapbank": Right(455, 30, 0.868, 0.876),
    "walk01": Right(101, 24, 0.967, 0.925),
    "video2bvh_cxk": Right(900, 30, 0.922, 0.853),
    "geno_stance": Right(2, 60, 0.855, 0.781),
    "mass_backflip": Right(199, 120, 0.959, 0.859),
    "makehuman_dance1": Right(1, 24, 0.996, 0.787),
    "makehuman_tpose": Right(1, 24, 0.869, 0.812),
}


@pytest.mark.parametrize("name", FILES)
def test_files_of_other_programs_show_a_person_on_the_floor(shared_data, name):
    motion = load_motion(shared_data("foreign-files") / "foreign-files" / f"{name}.bvh")
    right, positions = FILES[name], motion.positions
    assert motion.num_frames == right.frames and motion.fps == pytest.approx(right.fps, rel=1e-4)
    assert np.median(positions[:, 0, 1]) == pytest.approx(right.hips, abs=0.01)
    lowest = positions[..., 1].min(axis=1)
    assert abs(np.quantile(lowest, 0.05)) <= 0.05 and lowest.min() > -0.055
    legs = [
        np.linalg.norm(np.diff(positions[:, line], axis=1), axis=-1).mean(axis=0) for line in ([1, 4, 7], [2, 5, 8])
    ]
    for leg in legs:
        assert leg.sum() == pytest.approx(right.leg, abs=0.02)
        assert 0.7 < leg[0] / leg[1] < 1.5
    assert left_is_left(positions).mean() > 0.97
    # Arms reach the hands, not a finger or a thumb.
    for side in ("left", "right"):
        places = positions[:, [INDEX(f"{side}_{name}") for name in ("shoulder", "elbow", "wrist")]]
        upper, lower = np.linalg.norm(np.diff(places, axis=1), axis=-1).mean(axis=0)
        assert 0.19 < upper < 0.36 and 0.19 < lower < 0.33


@pytest.mark.slow
@pytest.mark.parametrize("archive", ["accad", "berkeley-mhad"])
def test_recordings_of_two_archives_are_read_without_a_table(shared_data, archive):
    files = sorted(shared_data(archive).rglob("*.bvh"))
    for path in files[:: len(files) // 30]:
        positions = load_motion(path).positions
        assert left_is_left(positions).mean() > 0.5, path
        assert abs(np.quantile(positions[..., 1].min(axis=1), 0.05)) <= 0.05, path
        assert 0.7 < np.linalg.norm(np.diff(positions[:, [1, 4, 7]], axis=1), axis=-1).mean(axis=0).sum() < 0.95, path
