"""Motions that meet targets: the best of some samples, whose latents are then changed by gradients.

The decoder is a differentiable function. So a motion can be moved to its targets by gradient steps on what the decoder
reads, the latents of its codes, without training. Latents near those of codes that the generator chose keep the motion
natural. DNO (Karunratanakul et al., CVPR 2024) and MaskControl (Pinyoanuntapong et al., ICCV 2025) do so with the noise
or the logits of other systems.
"""

import dataclasses
import functools
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Bool, Float, Int

from t2m_jax.devices import put_everywhere
from t2m_jax.errors import UserError
from t2m_jax.masks import mask_from_lengths
from t2m_jax.models.system import find_part
from t2m_jax.motion.cleanup import clean_positions
from t2m_jax.motion.features import facing, positions_from_features
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.normalizer import Normalizer
from t2m_jax.motion.reaching import check_exact, reach_exactly
from t2m_jax.motion.rotations import unit_vectors
from t2m_jax.motion.skating import skating
from t2m_jax.motion.skeleton import Skeleton
from t2m_jax.motion.targets import (
    FACING,
    ROOT,
    Target,
    check_targets,
    distances,
    missed_targets,
    rushed_targets,
    seen_from_root,
)
from t2m_jax.sampling.batches import round_up
from t2m_jax.sampling.decode import pad_codes
from t2m_jax.sampling.loop import Sampling
from t2m_jax.sampling.model import ModelParts
from t2m_jax.sampling.prompts import Prompt, Sample
from t2m_jax.sampling.request import MotionRequest

STEPS = 60
"""Gradient steps of a round."""
ROUNDS = 8
"""Most rounds. After each, targets are moved by what the clean-up has moved the joints."""
MET = 0.15
"""No further round begins when targets are met up to this share of their tolerances (root mean square)."""
STEP_SIZE = 0.03
"""Of Adam, in standard deviations of the motion's latents."""
FIT_WEIGHT = 1000.0
"""Weight of a squared distance to a target; per square meter."""
LATENT_WEIGHT = 2.5
"""Weight of the mean squared change of the latents, in standard deviations."""
SMOOTH_WEIGHT = 0.1
"""Weight of the mean squared change of the accelerations; per m^2/s^4."""
SKATING_WEIGHT = 40.0
"""Weight of the mean square of the speed of low feet that skate (`t2m_jax.motion.skating`); per m^2/s^2."""
FACING_METERS = 0.3
"""A direction counts as a point so far ahead of the root."""
GOAL_BUCKET = 64
"""Goals are padded to this many, or twice, four times, ... as many, so that few programs are compiled."""
SECONDS_AFTER = 0.25
"""Least time from the last target to the end."""
ROW_STEP = 4
"""Shortest lengths are multiples of so many rows, because each of them is a program of its own."""


class Goals(NamedTuple):
    """Targets as points at frames. Behind the joints there are two more points: under the root, and ahead of it."""

    frames: Int[Array, " Q"]
    points: Int[Array, " Q"]
    places: Float[Array, "Q 3"]
    """In meters."""
    weights: Float[Array, "Q 3"]
    """0 for coordinates that are free, and for padding."""
    relative: Bool[Array, " Q"]
    """Whether a place is seen from the root."""


def make_goals(targets: Sequence[Target], skeleton: Skeleton) -> Goals:
    """Returns targets as points. With more frames or joints, each weighs less, but together they weigh more."""
    rows = [row for target in targets for row in _rows_of(target, skeleton)]
    size = GOAL_BUCKET * 2 ** max(0, math.ceil(math.log2(len(rows) / GOAL_BUCKET)))
    rows += [(0, 0, np.zeros(3), np.zeros(3), False)] * (size - len(rows))
    frames, points, places, weights, relative = zip(*rows, strict=True)
    return Goals(
        jnp.asarray(frames, jnp.int32),
        jnp.asarray(points, jnp.int32),
        jnp.asarray(np.stack(places), jnp.float32),
        jnp.asarray(np.stack(weights), jnp.float32),
        jnp.asarray(relative, bool),
    )


def _rows_of(target: Target, skeleton: Skeleton) -> list[tuple[int, int, Any, Any, bool]]:
    frames = target.frames(skeleton.fps)
    ground = np.array([1.0, 0.0, 1.0])
    if target.pose is not None:
        pose = seen_from_root(target.pose[None].astype(np.float64), skeleton)[0]
        weight = np.ones(3) / math.sqrt(len(frames) * skeleton.num_joints)
        return [(frame, joint, place, weight, True) for frame in frames for joint, place in enumerate(pose)]
    if target.joint == ROOT:
        x, z = target.place
        point, place, weight = skeleton.num_joints, np.array([x, 0.0, z]), ground
    elif target.joint == FACING:
        angle = math.radians(target.place[0])
        ahead = FACING_METERS * np.array([math.sin(angle), 0.0, math.cos(angle)])
        point, place, weight = skeleton.num_joints + 1, ahead, ground
    else:
        point, place, weight = skeleton.joint_names.index(target.joint), np.array(target.place), np.ones(3)
    return [(frame, point, place, weight / math.sqrt(len(frames)), target.relative) for frame in frames]


def points_at(positions: Float[Array, "T J 3"], goals: Goals, skeleton: Skeleton) -> Float[Array, "Q 3"]:
    """Returns the points of goals in a motion, in meters."""
    ground = positions[:, :1] * jnp.array([[[1.0, 0.0, 1.0]]])
    ahead = FACING_METERS * unit_vectors(facing(positions, skeleton))[:, None]
    world = jnp.concatenate([positions, ground, ahead], axis=1)
    seen = jnp.concatenate([seen_from_root(positions, skeleton), ground, ahead], axis=1)  # only joints are relative
    place = goals.frames, goals.points
    return jnp.where(goals.relative[:, None], seen[place], world[place])


class Attempt(NamedTuple):
    """Codes, and how far the latents are from theirs."""

    codes: Int[Array, "1 N R"]
    code_lengths: Int[Array, " 1"]
    change: Float[Array, "1 N C"]
    """In standard deviations of the latents."""


class Approach(NamedTuple):
    """A motion on its way to the targets."""

    change: Float[Array, "1 N C"]
    """Of the latents, in their standard deviations."""
    features: Float[Array, "T D"]
    positions: Float[Array, "T J 3"]
    """As decoded, in meters."""


@functools.partial(jax.jit, static_argnames=("tokenizer", "skeleton", "num_steps"))
def approach_goals(
    variables: Any,
    normalizer: Normalizer,
    attempt: Attempt,
    goals: Goals,
    *,
    tokenizer: Any,
    skeleton: Skeleton,
    num_steps: int = STEPS,
) -> Approach:
    """Returns a motion that is nearer to its goals, after `num_steps` steps of Adam."""
    mask = mask_from_lengths(attempt.code_lengths, attempt.codes.shape[1])
    latents = tokenizer.apply(variables, attempt.codes, method="latents_of")
    deviation = jnp.std(latents, where=mask[..., None])

    def decode(change: Float[Array, "1 N C"]) -> tuple[Float[Array, "T D"], Float[Array, "T J 3"]]:
        decoded = tokenizer.apply(variables, latents + deviation * change, mask, method="decode_latents")
        features = normalizer.denormalize(decoded)
        return features[0], positions_from_features(features, skeleton)[0] * skeleton.metres_per_unit

    _, before = decode(jnp.zeros_like(latents))

    def loss(change: Float[Array, "1 N C"]) -> Float[Array, ""]:
        _, positions = decode(change)
        frames = jnp.repeat(mask[0], len(positions) // mask.shape[1])
        distance = goal_loss(positions, positions - before, frames, goals, skeleton)
        return distance + LATENT_WEIGHT * jnp.sum(jnp.square(change)) / mask.sum()

    optimizer = optax.adam(STEP_SIZE)

    def step(carry: Any, _: None) -> tuple[Any, None]:
        change, state = carry
        updates, state = optimizer.update(jax.grad(loss)(change), state)
        return (optax.apply_updates(change, updates), state), None

    (last, _), _ = jax.lax.scan(step, (attempt.change, optimizer.init(attempt.change)), None, length=num_steps)
    return Approach(last, *decode(last))


def goal_loss(
    positions: Float[Array, "T J 3"],
    moved: Float[Array, "T J 3"],
    frames: Bool[Array, " T"],
    goals: Goals,
    skeleton: Skeleton,
) -> Float[Array, ""]:
    """Returns how far a motion is from its goals, how much it jolts more than before, and how much feet skate.

    Args:
        positions: Of the motion, in meters.
        moved: How far the joints were moved.
        frames: Whether a frame is one of the motion.
        goals: Where it should be.
        skeleton: Of the motion.
    """
    apart = points_at(positions, goals, skeleton) - goals.places
    jolts = jnp.diff(moved, n=2, axis=0) * skeleton.fps**2
    smoothness = jnp.mean(jnp.square(jolts), where=frames[2:, None, None])
    distance = FIT_WEIGHT * jnp.sum(goals.weights * jnp.square(apart)) + SMOOTH_WEIGHT * smoothness
    return distance + SKATING_WEIGHT * skating(positions, positions - moved, frames, skeleton)


def direct(model: ModelParts, request: MotionRequest, prompt: Prompt) -> list[Motion]:
    """Returns motions that meet the targets of a request, those of the best samples first.

    Raises:
        UserError: A target does not fit the model, or the tokenizer has no latents.
    """
    check_latents(model)
    check_targets(request.targets, model.skeleton)
    check_exact(request.targets, model.skeleton)
    # Steps bring all targets as near as any; those that are exact are then met by inverse kinematics.
    rough = [dataclasses.replace(target, exact=False) for target in request.targets]
    sampling = _long_enough(model, request)
    samples = [Sample(prompt, request.seed, number) for number in range(request.candidates)]
    candidates = model.make_samples(samples, sampling, request.options)
    ranked = sorted(candidates, key=functools.partial(cost_of, rough))
    # The steps take most of the time, so only the samples that are near already are moved.
    moved = [
        approach_targets(model, one, rough, size=sampling.max_codes, clean=not request.options.raw)
        for one in ranked[: request.num_samples]
    ]
    return [report_targets(motion, request.targets) for motion in moved]


def check_latents(model: ModelParts) -> None:
    """Raises `UserError` if there are no latents that gradients could change."""
    if not find_part(model.config.tokenizer.kind).has_latents:
        raise UserError(f"targets: a tokenizer of the kind {model.config.tokenizer.kind} cannot meet them")


def _long_enough(model: ModelParts, request: MotionRequest) -> Sampling:
    """Returns how codes are sampled, so that no motion ends before its last target.

    Raises:
        UserError: An option or the time of a target does not fit the model.
    """
    rate = model.skeleton.fps / model.config.tokenizer.downsample
    longest = request.options.max_codes or model.config.generator.max_codes
    last = max(request.targets, key=lambda target: target.until or target.seconds)
    seconds = (last.until or last.seconds) + SECONDS_AFTER
    if seconds * rate > longest:
        raise last.error(f"the longest motion for a sentence has {longest / rate:.1f} s")
    sampling = model.sampling(request.options)
    least = min(round_up(math.ceil(seconds * rate), ROW_STEP), sampling.max_codes)
    return sampling._replace(min_codes=max(sampling.min_codes, least))


def cost_of(targets: Sequence[Target], motion: Motion) -> float:
    """Returns how far a motion is from all targets together, each in its tolerance."""
    found = zip(distances(motion, targets), targets, strict=True)
    return math.fsum((far / target.tolerance) ** 2 for far, target in found)


def approach_targets(
    model: ModelParts,
    motion: Motion,
    targets: Sequence[Target],
    *,
    size: int,
    clean: bool,
    finish: Callable[[Motion], Motion] = lambda motion: motion,
) -> Motion:
    """Returns a motion moved to its targets: the nearest of the rounds.

    Args:
        model: Whose decoder is used.
        motion: With its codes.
        targets: Of the motion.
        size: The codes are padded to so many rows.
        clean: Whether decoded positions are cleaned.
        finish: What will be done to the motion later, which has to meet the targets then.
    """
    assert motion.codes is not None
    codes, code_lengths = map(jnp.asarray, pad_codes([motion.codes], size=size))
    read = functools.partial(model.tokenizer.module.apply, method="latents_of")
    latents = jax.eval_shape(read, model.tokenizer.variables, codes)
    # Zeros and not None, so that all rounds have one program.
    attempt = Attempt(codes, code_lengths, put_everywhere(jnp.zeros(latents.shape)))
    goals = wanted = make_goals(targets, model.skeleton)
    best, least = motion, cost_of(targets, finish(motion))
    for _ in range(ROUNDS):
        own, change = _round(model, motion, attempt, goals, clean=clean)
        attempt = attempt._replace(change=change)
        finished = finish(own)
        cost = cost_of(targets, finished)
        if cost < least:
            best, least = own, cost
        if least < len(targets) * MET**2:
            break
        # The clean-up and the other terms of the loss hold joints back a little, so the next round aims as far beyond.
        padding = ((0, model.config.tokenizer.downsample * size - motion.num_frames), (0, 0), (0, 0))
        reached = points_at(jnp.asarray(np.pad(finished.positions, padding)), wanted, model.skeleton)
        goals = goals._replace(places=goals.places + wanted.places - reached)
    return best


def _round(
    model: ModelParts, motion: Motion, attempt: Attempt, goals: Goals, *, clean: bool
) -> tuple[Motion, Float[Array, "1 N C"]]:
    """Returns a motion after some gradient steps, and how far its latents are then from those of its codes."""
    tokenizer = model.tokenizer
    moved = approach_goals(
        put_everywhere(tokenizer.variables),
        tokenizer.normalizer,
        attempt,
        goals,
        tokenizer=tokenizer.module,
        skeleton=model.skeleton,
    )
    positions = moved.positions
    if clean:
        positions = clean_positions(positions[None], np.array([motion.num_frames]), skeleton=model.skeleton)[0]
    own = dataclasses.replace(
        motion,
        positions=np.asarray(positions)[: motion.num_frames],
        positions_raw=np.asarray(moved.positions)[: motion.num_frames] if clean else None,
        features=np.asarray(moved.features)[: motion.num_frames],
        codes=None,  # its latents are between codes
    )
    return own, moved.change


def report_targets(motion: Motion, targets: Sequence[Target]) -> Motion:
    """Returns a motion whose exact targets are met, and that says which it misses, and which no body could meet."""
    exact = reach_exactly(motion, targets)
    found = exact.warning, missed_targets(exact, targets), rushed_targets(exact, targets)
    return dataclasses.replace(exact, warning="; ".join(filter(None, found)))
