import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax.errors import UserError
from t2m_jax.motion.skeleton import HUMANML3D, KIT_ML, make_layout, skeleton_from_feature_dim, skeleton_from_name

both_skeletons = pytest.mark.parametrize("skeleton", [HUMANML3D, KIT_ML], ids=lambda skeleton: skeleton.name)


@both_skeletons
def test_template_is_the_references(skeleton, golden_dir):
    golden = np.load(golden_dir / "motion" / "skeletons.npz")
    joints = skeleton.num_joints
    np.testing.assert_array_equal(skeleton.parents, golden[f"parents{joints}"])
    np.testing.assert_array_equal(skeleton.rest_axes, golden[f"raw_offsets{joints}"])
    np.testing.assert_array_equal(skeleton.offsets, golden[f"tgt_offsets{joints}"])
    assert skeleton.offsets.dtype == np.float32


@both_skeletons
def test_chains_hold_every_bone_once(skeleton):
    bones = [bone for chain in skeleton.chains for bone in itertools.pairwise(chain)]
    assert sorted(bones, key=lambda bone: bone[1]) == list(enumerate_bones(skeleton))
    assert len(skeleton.joint_names) == len(skeleton.rest_axes) == len(skeleton.bone_lengths) == skeleton.num_joints


def enumerate_bones(skeleton):
    return ((parent, joint) for joint, parent in enumerate(skeleton.parents) if joint)


@both_skeletons
def test_mirror_keeps_the_tree(skeleton):
    twin = dict(skeleton.mirror_pairs) | {right: left for left, right in skeleton.mirror_pairs}
    for parent, joint in enumerate_bones(skeleton):
        assert skeleton.parents[twin.get(joint, joint)] == twin.get(parent, parent)


@pytest.mark.parametrize(("joints", "feature_dim"), [(22, 263), (21, 251)])
def test_groups_are_all_columns_in_order(joints, feature_dim):
    layout = make_layout(joints)
    columns = [column for group in layout for column in range(group.start, group.stop)]
    assert columns == list(range(feature_dim)) == list(range(layout.feature_dim))
    named = (layout.root_yaw, layout.root_velocity, layout.root_height, layout.positions)
    assert layout == (*named, layout.rotations, layout.velocities, layout.contacts)


def test_published_columns():
    layout = HUMANML3D.layout
    assert (layout.positions, layout.rotations) == (slice(4, 67), slice(67, 193))
    assert (layout.velocities, layout.contacts) == (slice(193, 259), slice(259, 263))


@both_skeletons
def test_skeletons_are_found_by_name_and_width(skeleton):
    assert skeleton_from_name(skeleton.name) is skeleton
    assert skeleton_from_feature_dim(skeleton.feature_dim) is skeleton


def test_unknown_skeletons_are_refused():
    with pytest.raises(UserError, match=r"'smplx'; use one of: humanml3d, kit_ml"):
        skeleton_from_name("smplx")
    with pytest.raises(UserError, match=r"width 264; known widths: 263 \(humanml3d\), 251 \(kit_ml\)"):
        skeleton_from_feature_dim(264)


def test_a_skeleton_is_a_static_argument():
    assert hash(HUMANML3D) != hash(KIT_ML)
    double = jax.jit(lambda x, skeleton: x * skeleton.num_joints, static_argnums=1)
    assert double(jnp.ones(()), KIT_ML) == 21
