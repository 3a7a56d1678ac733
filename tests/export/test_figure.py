import numpy as np
import pytest

from t2m_jax.errors import UserError
from t2m_jax.export.render.figure import body_from_skeleton, figure_points, figure_scale
from t2m_jax.export.render.scene import SOLE, figure_from_motion, figures_from_motions
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.skeleton import HUMANML3D, KIT_ML


@pytest.mark.parametrize("skeleton", [HUMANML3D, KIT_ML])
def test_points_are_affine_blends_that_begin_with_the_joints(skeleton):
    body = body_from_skeleton(skeleton)
    np.testing.assert_array_equal(body.weights[: skeleton.num_joints], np.eye(skeleton.num_joints))
    np.testing.assert_allclose(body.weights.sum(axis=1), 1, atol=1e-5)
    drawn = {part.start for part in body.parts} | {part.end for part in body.parts}
    assert max(drawn) == len(body.weights) + 1
    assert {part.tint for part in body.parts} == {"body", "left", "right", "face"}


def test_the_body_moves_with_the_joints(walk):
    points = figure_points(walk.positions, HUMANML3D)
    turn = np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]], np.float32)
    moved = figure_points(walk.positions @ turn.T + np.float32([1, 2, 3]), HUMANML3D)
    np.testing.assert_allclose(moved, points @ turn.T + [1, 2, 3], atol=1e-4)


def test_the_face_looks_ahead(walk, kit_walk):
    for motion in (walk, kit_walk):
        figure = figure_from_motion(motion)
        body = body_from_skeleton(motion.skeleton)
        face = figure.points[:, len(body.weights) :].mean(axis=1) - figure.points[:, body.head]
        sides = {part.tint: figure.points[:, part.end] for part in reversed(figure.parts)}
        across = (sides["left"] - sides["right"])[0] * [1, 0, 1]
        assert np.linalg.norm(face, axis=-1) == pytest.approx(0.067, abs=0.03)
        # The left is on the left of where it looks, also on KIT-ML's mirrored skeleton.
        assert np.cross(across, [0, 1, 0]) @ face[0] > 0


def test_small_figures_are_drawn_at_human_size(walk, kit_walk):
    assert figure_scale(walk.positions, HUMANML3D) == pytest.approx(1.0, abs=0.01)
    assert figure_scale(kit_walk.positions, KIT_ML) == pytest.approx(0.6, abs=0.02)
    kit = figure_from_motion(kit_walk)
    assert 1.3 < np.ptp(kit.points[0, :, 1]) < 2.0
    assert kit.parts[0].start_radius == body_from_skeleton(KIT_ML).parts[0].start_radius


def test_feet_stand_on_the_ground(walk):
    assert figure_from_motion(walk).points[:, :22, 1].min() == pytest.approx(SOLE, rel=0.02)
    lifted = Motion(walk.positions + np.float32([0, 3, 0]), 20.0)
    np.testing.assert_allclose(figure_from_motion(lifted).points, figure_from_motion(walk).points, atol=1e-4)


def test_several_figures_keep_apart_in_order(walk, kit_walk):
    alone = figures_from_motions([walk])[0]
    np.testing.assert_array_equal(alone.points, figure_from_motion(walk).points)
    three = figures_from_motions([walk, kit_walk, walk])
    middles = [np.ptp(f.points[..., 0]) / 2 + f.points[..., 0].min() for f in three]
    assert np.all(np.diff(middles) > 1.0)
    many = figures_from_motions([walk] * 12)
    starts = np.array([figure.points[0, 0, [0, 2]] for figure in many])
    assert min(np.linalg.norm(a - b) for i, a in enumerate(starts) for b in starts[:i]) > 1.0
    with pytest.raises(UserError, match="at least one"):
        figures_from_motions([])
