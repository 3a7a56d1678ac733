"""Motions that are moved to their targets."""

import dataclasses

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from t2m_jax import Motion, load
from t2m_jax.data.importers.synthetic import make_motion
from t2m_jax.errors import UserError
from t2m_jax.models.system import find_part
from t2m_jax.motion.features import bone_vectors, features_from_positions, ground_positions
from t2m_jax.motion.normalizer import Normalizer
from t2m_jax.motion.skating import skating
from t2m_jax.motion.skeleton import HUMANML3D
from t2m_jax.motion.targets import distances, read_target, targets_from_text
from t2m_jax.sampling import MotionRequest, directing
from t2m_jax.sampling.directing import (
    FIT_WEIGHT,
    Attempt,
    approach_goals,
    goal_loss,
    make_goals,
    points_at,
    report_targets,
)
from tests import tiny
from tests.conftest import REPOSITORY
from tests.documents import code_blocks

pytestmark = pytest.mark.slow

CAPTION = tiny.CAPTIONS[1]


@pytest.fixture(scope="module")
def walk():
    return Motion(ground_positions(make_motion("walk", seed=1, num_frames=40), HUMANML3D), 20.0)


@pytest.fixture
def director(model, monkeypatch):
    """A model that takes few rounds: its random decoder meets no target however many there are."""
    monkeypatch.setattr(directing, "ROUNDS", 2)
    return model


def targets_of(motion, frame):
    """Targets that a motion meets."""
    seconds = frame / motion.fps
    place = ",".join(map(str, motion.positions[frame, 20]))
    x, _, z = motion.positions[frame, 0]
    return [f"{seconds} left_wrist={place}", f"{seconds} root={x},{z}", (seconds, motion[frame : frame + 1])]


def test_points_are_where_distances_say(walk):
    targets = [read_target(target) for target in targets_of(walk, 12)]
    targets += [read_target("0.6 left_wrist+=0.2,1,0.1"), read_target("0.3:0.5 root=0,0"), read_target("0 facing=0")]
    goals = make_goals(targets, HUMANML3D)
    apart = np.asarray(points_at(jnp.asarray(walk.positions), goals, HUMANML3D)) - goals.places
    apart = np.linalg.norm(apart * (goals.weights > 0), axis=-1)
    expected = distances(walk, targets)
    rows = [1, 1, HUMANML3D.num_joints, 1, 5, 1]
    found = np.split(apart[: sum(rows)], np.cumsum(rows)[:-1])
    np.testing.assert_allclose([found[0][0], found[1][0], found[2].mean(), found[3][0]], expected[:4], atol=1e-5)
    np.testing.assert_allclose([found[4].max(), found[5].max()], expected[4:], atol=1e-5)
    joints = np.sqrt(HUMANML3D.num_joints)
    ground = 4 + joints + np.sqrt(5)
    np.testing.assert_allclose(goals.weights.sum(axis=0), [ground, 2 + joints, ground], rtol=1e-5)
    assert not goals.weights[sum(rows) :].any()


def test_gradients_are_those_of_finite_differences(walk):
    texts = "1 left_wrist=0.3,1,0.4; 0.5 right_foot+=0,0.3,0.1; 1 facing=40"
    goals = make_goals(targets_from_text(texts), HUMANML3D)
    before = jnp.asarray(walk.positions)
    moved = 0.01 * jax.random.normal(jax.random.key(0), before.shape)

    @jax.jit
    def loss(moved):
        return goal_loss(before + moved, moved, jnp.arange(len(moved)) < 30, goals, HUMANML3D) / FIT_WEIGHT

    check_grads(loss, (moved,), order=1, modes=["rev"], atol=2e-2, rtol=2e-2, eps=1e-3)


def test_only_low_and_fast_feet_skate(walk):
    before = jnp.asarray(walk.positions)
    frames = jnp.ones(len(before), bool)
    still = jnp.broadcast_to(before[:1], before.shape)
    sliding = still + jnp.array([[[1.0, 0, 0]]]) * (jnp.arange(len(still)) / 20)[:, None, None]
    assert skating(still, still, frames, HUMANML3D) == 0 < skating(sliding, still, frames, HUMANML3D)
    assert skating(sliding + jnp.array([[[0, 0.3, 0]]]), still, frames, HUMANML3D) < 1e-6


class Features(nn.Module):
    """A tokenizer whose latents are the normalized features of one frame."""

    def latents_of(self, codes):
        return jnp.sin(codes[..., :1] + jnp.arange(HUMANML3D.feature_dim)[None, None])

    def decode_latents(self, latents, mask):
        del mask
        return latents


def test_steps_lead_to_the_goals(walk):
    # Random weights of a decoder hardly move a joint, so here the features themselves are changed.
    mean = features_from_positions(walk.positions, HUMANML3D).mean(axis=0)
    normalizer = Normalizer(jnp.asarray(mean, jnp.float32), jnp.full(len(mean), 0.3))
    targets = targets_from_text("1 left_wrist=0.4,1.4,0.5; 1.5 root=0.3,0.5; 0.5 facing=40; 1.2 head+=0.1,1.5,0.1")
    codes = jnp.arange(40)[None, :, None]
    attempt = Attempt(codes, jnp.array([40]), jnp.zeros((1, 40, HUMANML3D.feature_dim)))
    goals = make_goals(targets, HUMANML3D)
    apart = []
    for _ in range(3):
        moved = approach_goals({}, normalizer, attempt, goals, tokenizer=Features(), skeleton=HUMANML3D)
        attempt = attempt._replace(change=moved.change)
        apart.append(distances(Motion(np.asarray(moved.positions), 20.0), targets))
    assert max(np.array(apart[-1]) / [1, 1, 100, 1]) < 0.05, apart


@pytest.mark.release
def test_a_seed_gives_the_same_motion_again(director):
    options = {"seed": 2, "num_candidates": 2}
    first, again = (director.direct(CAPTION, ["0.3 root=0.05,0.05"], **options)[0] for _ in range(2))
    np.testing.assert_array_equal(again.positions, first.positions)
    assert again.features is not None and again.caption == CAPTION


@pytest.mark.release
def test_other_requests_do_not_change_it(director):
    common = {"captions": (CAPTION,), "targets": targets_from_text("0.3 root=0.1,0.1"), "candidates": 2}
    requests = [MotionRequest(seed=seed, **common) for seed in (1, 2)]
    plain = MotionRequest(captions=(CAPTION,), seed=1)
    together = list(director.make(plain, *requests))
    np.testing.assert_array_equal(together[0].positions, next(director.make(plain)).positions)
    np.testing.assert_array_equal(together[2].positions, next(director.make(requests[1])).positions)


def test_no_motion_ends_before_its_last_target(director, monkeypatch):
    monkeypatch.setattr(directing, "ROUNDS", 0)  # a round leaves the length as it is
    size = director.config.tokenizer.downsample
    longest = director.config.generator.max_codes * size / 20.0
    for seconds in (0.1, longest / 2, longest - 0.25):
        (motion,) = director.direct(CAPTION, [f"{seconds} root=0,0"], num_candidates=2, raw=True)
        assert motion.seconds >= seconds + 0.2
    with pytest.raises(UserError, match=rf"the longest motion for a sentence has {longest:.1f} s"):
        director.direct(CAPTION, [f"{longest} root=0,0"])


def test_missed_targets_are_said(director):
    apart = ["0.3 left_wrist=0.6,1,0", "0.3 left_elbow=-0.6,1,0"]  # farther than any forearm is long
    compiled = approach_goals._cache_size()
    (motion,) = director.direct(CAPTION, apart, num_candidates=2)
    assert "left_wrist at 0.3 s by " in motion.warning
    assert approach_goals._cache_size() <= compiled + 1, "both rounds have one program"


def test_a_target_is_said_to_which_no_body_comes_in_time():
    standing = np.repeat(make_motion("walk", seed=4, num_frames=10)[:1], 21, axis=0)
    low = standing[0, 0, 1] - 0.1
    way = low * (1 - np.abs(np.arange(21) / 10 - 1))[:, None, None] ** 6 * np.array([0.0, 1.0, 0.0])
    target = f"0.5 pelvis={','.join(map(str, standing[0, 0] - [0, low, 0]))}"
    said = report_targets(Motion(standing - way, 20.0), targets_from_text(target)).warning
    assert said.startswith("faster than people are: pelvis at 0.5 s: the root goes up or down near the floor by ")


def test_exact_targets_are_met_at_the_end(director):
    text = "0.3 root=0.1,0.05 exact"
    (motion,) = director.direct(CAPTION, [text], num_candidates=2)
    assert distances(motion, targets_from_text(text))[0] < 1e-5 and motion.codes is None
    with pytest.raises(UserError, match=r"head at 0.3 s: cannot be exact; these can: root, "):
        director.direct(CAPTION, ["0.3 head=0,1.5,0 exact"])


def test_bones_stay_as_long(director):
    (motion,) = director.direct(CAPTION, ["0.3 left_wrist=0.3,1.2,0.2"], num_candidates=2)
    lengths = np.linalg.norm(bone_vectors(motion.positions, HUMANML3D), axis=-1)
    assert lengths.std(axis=0).max() < 0.01


@pytest.mark.parametrize(
    ("fields", "says"),
    [
        ({"captions": ("a", "b")}, "leave out a second sentence"),
        (
            {"seconds": 2.0},
            "a span to redo; leave out a length in seconds",
        ),
        ({"num_samples": 4, "candidates": 3}, "4 motions cannot be chosen from 3"),
        ({"candidates": 0}, "candidates: 0 is not"),
    ],
)
def test_what_does_not_go_together(fields, says):
    with pytest.raises(UserError, match=says):
        MotionRequest(**{"captions": ("a",), "targets": (read_target("1 root=0,0"),)} | fields)


def test_a_stream_of_targets_is_refused(model):
    with pytest.raises(UserError, match="stream: "):
        model.make_pieces(MotionRequest(captions=(CAPTION,), targets=(read_target("0.2 root=0,0"),)))


def test_a_tokenizer_without_latents_is_refused(model, monkeypatch):
    kind = model.config.tokenizer.kind
    part = dataclasses.replace(find_part(kind), has_latents=False)
    monkeypatch.setattr("t2m_jax.sampling.directing.find_part", lambda _: part)
    with pytest.raises(UserError, match=f"a tokenizer of the kind {kind} cannot meet them"):
        model.direct(CAPTION, ["0.2 root=0,0"])


@pytest.mark.release
@pytest.mark.parametrize("name", ["demo", "demo-t2m-gpt"])
def test_packaged_models_meet_reachable_targets(name):
    """Places that another sample of the sentence has."""
    model = load(name)
    caption = "a person waves with the left hand"
    wanted = targets_of(model.generate(caption, seed=5)[0], 40)[:2]
    (motion,) = model.direct(caption, wanted, seed=1)
    targets = [read_target(target) for target in wanted]
    assert motion.warning == "" and max(distances(motion, targets)) < 0.03


@pytest.mark.release
def test_the_code_of_the_page_runs():
    ((_, code),) = code_blocks(REPOSITORY / "docs" / "targets.md", "python")
    names = {}
    exec(code, names)  # noqa: S102 - the page's code is run as it is
    assert names["again"].warning == "" and names["part"].warning == ""
