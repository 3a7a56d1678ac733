"""A root bone on the floor that carries the travel, in BVH and GLB files."""

import numpy as np
import pytest

from t2m_jax import Motion
from t2m_jax.cli.main import main
from t2m_jax.data.importers.synthetic import make_motion
from t2m_jax.errors import UserError
from t2m_jax.motion.bvh import load_bvh
from t2m_jax.motion.gltf import load_gltf_animation
from t2m_jax.motion.inverse_kinematics import fit_rig
from t2m_jax.motion.kinematics import forward_kinematics
from t2m_jax.motion.skeleton import HUMANML3D

NAMES = ("lafan1", "humanml3d", "mixamo", "vrm", "unreal")
FORMATS = {"bvh": load_bvh, "glb": load_gltf_animation}


@pytest.fixture(scope="module")
def motion():
    """A walk around a corner of a figure with rigid bones, which BVH files can hold."""
    walk = Motion(make_motion("walk", seed=4, num_frames=60), 20.0).turned(120)
    rig = fit_rig(walk.positions, fps=20.0)
    return Motion(forward_kinematics(rig.rotations, rig.translations, HUMANML3D.parents).positions, 20.0)


@pytest.mark.parametrize("names", NAMES)
@pytest.mark.parametrize("suffix", FORMATS)
def test_a_file_with_a_root_bone_gives_the_motion_back(tmp_path, motion, suffix, names):
    motion.save(tmp_path / f"a.{suffix}", names=names, root_bone=True, units="cm")
    np.testing.assert_allclose(Motion.load(tmp_path / f"a.{suffix}").positions, motion.positions, atol=1e-4)
    clip = FORMATS[suffix](tmp_path / f"a.{suffix}")
    assert len(clip.joint_names) == 23 and clip.joint_names[0] == {"unreal": "root", "humanml3d": "root"}.get(
        names, "Root"
    )


@pytest.mark.parametrize("suffix", FORMATS)
def test_the_root_bone_has_the_travel_and_the_hips_their_sway(tmp_path, motion, suffix):
    motion.save(tmp_path / f"a.{suffix}", root_bone=True)
    clip = FORMATS[suffix](tmp_path / f"a.{suffix}")
    hips = clip.joint_names.index("Hips")
    assert clip.parents[0] == -1 and clip.parents[hips] == 0
    np.testing.assert_array_equal(clip.positions[:, 0, 1], 0)
    np.testing.assert_allclose(clip.rotations[:, 0, 1], np.tile([0, 1, 0], (60, 1)), atol=1e-6)  # about Y only
    assert np.linalg.norm(np.ptp(clip.positions[:, 0], axis=0)) > 1.0
    assert np.abs(clip.translations[:, hips, ::2]).max() < 0.1
    ahead = clip.rotations[:, 0, :, 2]
    assert ahead[0] @ ahead[-1] < -0.2  # it turns with the figure


def test_bytes_without_a_root_bone_do_not_have_one(tmp_path, motion):
    for suffix in FORMATS:
        motion.save(tmp_path / f"a.{suffix}")
        motion.save(tmp_path / f"b.{suffix}", root_bone=False)
        assert (tmp_path / f"a.{suffix}").read_bytes() == (tmp_path / f"b.{suffix}").read_bytes()
        assert b'Root"' not in (tmp_path / f"a.{suffix}").read_bytes()


def test_the_command_writes_a_root_bone_where_the_format_has_one(tmp_path, motion):
    motion.save(tmp_path / "a.npz")
    outputs = [tmp_path / "b.glb", tmp_path / "b.npz"]
    assert main(["view", f"{tmp_path / 'a.npz'}", "--root-bone", "-o", f"{outputs[0]}", "-o", f"{outputs[1]}"]) == 0
    assert "Root" in load_gltf_animation(outputs[0]).joint_names
    with pytest.raises(UserError, match=r"root_bone: 'no' is unknown; known is False, True"):
        motion.save(tmp_path / "c.bvh", root_bone="no")
