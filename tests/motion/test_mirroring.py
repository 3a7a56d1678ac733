import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax.errors import UserError
from t2m_jax.motion.features import features_from_positions
from t2m_jax.motion.mirroring import mirror_caption, mirror_positions
from t2m_jax.motion.skeleton import HUMANML3D, KIT_ML

in_both_libraries = pytest.mark.parametrize("asarray", [np.asarray, jnp.asarray], ids=["numpy", "jax"])


@in_both_libraries
@pytest.mark.parametrize("joints", [22, 24, 52])
def test_like_the_reference(golden_dir, joints, asarray):
    reference = np.load(golden_dir / "motion" / "mirror.npz")
    body = asarray(reference[f"joints{joints}"][:, :22])
    mirrored = mirror_positions(body, HUMANML3D)
    np.testing.assert_array_equal(mirrored, reference[f"mirrored{joints}"][:, :22])
    assert isinstance(mirrored, np.ndarray) == (asarray is np.asarray)


@pytest.mark.parametrize("skeleton", [HUMANML3D, KIT_ML], ids=lambda skeleton: skeleton.name)
def test_a_mirrored_mirror_image_is_the_original(skeleton):
    positions = np.random.default_rng(0).normal(size=(2, 5, skeleton.num_joints, 3)).astype(np.float32)
    mirrored = mirror_positions(positions, skeleton)
    assert not np.allclose(mirrored, positions)
    np.testing.assert_array_equal(mirror_positions(mirrored, skeleton), positions)


def test_mirrored_motion_mirrors_its_features(golden_dir):
    # On the template's bones and facing ahead already, since one leg of the template, which is uneven, sets the scale.
    positions = np.load(golden_dir / "motion" / "synth21_walk.npz")["ground_positions"]
    features, mirrored = (features_from_positions(p, KIT_ML) for p in (positions, mirror_positions(positions, KIT_ML)))
    layout = KIT_ML.layout
    assert np.abs(features[1:, layout.root_yaw]).max() > 1e-3
    np.testing.assert_allclose(mirrored[:, layout.root_yaw], -features[:, layout.root_yaw], atol=1e-5)
    np.testing.assert_allclose(
        mirrored[:, layout.root_velocity], features[:, layout.root_velocity] * [-1, 1], atol=5e-3
    )
    np.testing.assert_array_equal(mirrored[:, layout.contacts], features[:, layout.contacts][:, [2, 3, 0, 1]])


def test_other_joints_are_refused():
    with pytest.raises(UserError, match="positions have 24 joints, but skeleton humanml3d has 22"):
        mirror_positions(np.zeros((4, 24, 3), np.float32), HUMANML3D)


@pytest.mark.parametrize(
    ("caption", "mirrored"),
    [
        ("a person waves with the left hand.", "a person waves with the right hand."),
        ("left foot, then right foot", "right foot, then left foot"),
        ("Left! RIGHT; Right", "Right! LEFT; Left"),
        ("a left-handed throw to the right/left", "a right-handed throw to the left/right"),
        ("he turns clockwise", "he turns counterclockwise"),
        ("he turns counterclockwise", "he turns clockwise"),
        ("Counter-clockwise, then anti-clockwise", "Clockwise, then clockwise"),
        ("turn anticlockwise", "turn clockwise"),
        ("steps to the right here, then to his left now", "steps to the left here, then to his right now"),
        ("right now, a right-angled turn at a right angle", "right now, a right-angled turn at a right angle"),
        ("a/DET left/ADJ step/NOUN clockwise/ADV", "a/DET right/ADJ step/NOUN counterclockwise/ADV"),
        ("walks rightwards, leftmost first", "walks leftwards, rightmost first"),
        ("left_arm", "right_arm"),
        ("L arm up, R. leg down, turn CCW, l arm", "R arm up, L. leg down, turn CW, l arm"),
        ("he left the stage right away and turned right", "he left the stage right away and turned left"),
        ("the man left his left shoe, all right", "the man left his right shoe, all right"),
        ("he raised the left, then left of the box", "he raised the right, then right of the box"),
        ("size L shirt, vitamin R, LR hands", "size L shirt, vitamin R, LR hands"),
        ("bright leftovers upright copyright", "bright leftovers upright copyright"),
        ("walks like clockwork", "walks like clockwork"),
        ("", ""),
    ],
)
def test_captions_change_sides(caption, mirrored):
    assert mirror_caption(caption) == mirrored


@pytest.mark.parametrize("caption", ["turn Left, then clockwise, right-hand up", "counterclockwise on the LEFT foot"])
def test_captions_come_back(caption):
    assert mirror_caption(caption) != caption
    assert mirror_caption(mirror_caption(caption)) == caption
