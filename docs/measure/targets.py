"""Measures how well motions meet targets that real clips meet: a wrist, a place of the root, and a pose.

    python docs/measure/targets.py data/bandai-namco [--model demo] [--count 100] [--best-of 16 64] [--between]

Each request has the sentence of a test clip and three targets at random times of it. It is compared with the first
sample of the sentence, with this sample after inverse kinematics alone, with the best of 16 and of 64 samples, and with
the same motion after exact targets of wrist and root. With `--between`, requests have two poses of a clip, one to three
seconds apart, each with its place and direction, all exact, and the motion is compared with the clip.
"""

import argparse
import dataclasses
import sys
import time
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from t2m_jax.data import open_dataset
from t2m_jax.errors import UserError
from t2m_jax.evaluation.inbetween import gap_figures, interpolate_gap
from t2m_jax.evaluation.prompts.following import RULES, follows
from t2m_jax.evaluation.prompts.recognition import load_index
from t2m_jax.metrics.quality import measure_quality
from t2m_jax.motion.features import ground_positions, positions_from_features
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.reaching import Clip, reach_exactly
from t2m_jax.motion.targets import (
    EXACT_TOLERANCE,
    JOINT_TOLERANCE,
    POSE,
    TOLERANCES,
    Target,
    distances,
    facing_degrees,
    read_target,
)
from t2m_jax.sampling import TextToMotion

KINDS = ("wrist", "root", "pose")
LIMITS = (JOINT_TOLERANCE, TOLERANCES["root"], TOLERANCES["pose"])
GAP_TOLERANCE = 0.02
"""Up to here, the motion between two poses begins and ends at them; meters, mean over the joints."""
SECONDS = (1.0, 9.5)
"""Shortest and longest clip that is used."""


class Trial(NamedTuple):
    """A sentence, what its clip shows, and the clip."""

    sentence: str
    action: str
    motion: Motion
    targets: tuple[Target, ...]
    """Those that the clip meets."""


def trials(data: str, count: int) -> Iterator[Trial]:
    """Yields trials from the test clips of the ten actions."""
    dataset = open_dataset(data)
    index = load_index(dataset.folder)
    generator = np.random.default_rng(0)
    if index is None:
        raise UserError(f"{data}: its clips have no labels")
    clips = list(dataset.clips("test", min_frames=2))
    for number in generator.permutation(len(clips)):
        clip = clips[number]
        action = (index.label(clip.name) or "").partition(",")[0]
        motion = Motion(np.asarray(positions_from_features(clip.features, dataset.skeleton)), dataset.skeleton.fps)
        if action in RULES and SECONDS[0] <= motion.seconds <= SECONDS[1] and follows(action, motion) and count:
            count -= 1
            yield Trial(clip.captions[0].text, action, motion, tuple(targets_of(motion, generator)))


def targets_of(motion: Motion, generator: np.random.Generator) -> Iterator[Target]:
    """Yields a target of each kind that a motion meets, at three times."""
    first, second, third = generator.choice(np.arange(5, motion.num_frames - 5), 3, replace=False)
    wrist = str(generator.choice(["left_wrist", "right_wrist"]))
    place = motion.positions[first, motion.skeleton.joint_names.index(wrist)]
    x, _, z = motion.positions[second, 0]
    yield read_target(f"{first / motion.fps} {wrist}={','.join(map(str, place))}")
    yield read_target(f"{second / motion.fps} root={x},{z}")
    yield read_target((third / motion.fps, motion[third : third + 1]))


def best_of(motions: Sequence[Motion], targets: Sequence[Target]) -> Motion:
    """Returns the motion that is nearest to the targets, each in its tolerance."""

    def cost(motion: Motion) -> float:
        return sum((far / limit) ** 2 for far, limit in zip(distances(motion, targets), LIMITS, strict=True))

    return min(motions, key=cost)


def motions_of(trial: Trial, motion: Motion, samples: Sequence[Motion], sizes: Sequence[int]) -> dict[str, Motion]:
    """Returns the motions of a trial, each under the name of its row.

    Args:
        trial: Whose targets are met.
        motion: With the targets.
        samples: Of the same sentence without them.
        sizes: Of how many samples the best one is taken.
    """
    exact = [dataclasses.replace(target, exact=target.joint != POSE) for target in trial.targets]
    return {
        "first sample": samples[0],
        "inverse kinematics alone": reach_exactly(samples[0], exact),
        **{f"best of {size}": best_of(samples[:size], trial.targets) for size in sizes},
        "with targets": motion,
        "with exact targets": reach_exactly(motion, exact),  # as `direct` does it at its end
    }


def row(name: str, found: Sequence[tuple[Trial, Motion]]) -> str:
    """Returns a row of the table."""
    apart = np.array([distances(motion, trial.targets) for trial, motion in found])
    pairs = zip(apart.T, LIMITS, strict=True)
    met = [f"{np.mean(own <= limit):.0%} ({100 * np.median(own):.1f} cm)" for own, limit in pairs]
    followed = np.mean([follows(trial.action, motion) for trial, motion in found])
    qualities = []
    for _, motion in found:
        padded = np.pad(motion.positions, ((0, 200 - motion.num_frames), (0, 0), (0, 0)), mode="edge")[None]
        mask = (np.arange(200) < motion.num_frames)[None]
        qualities.append(measure_quality(jnp.asarray(padded), jnp.asarray(mask), skeleton=motion.skeleton))
    jerk, skating = (np.mean([float(getattr(one, part)[0]) for one in qualities]) for part in ("jerk", "skating_ratio"))
    exact = [f"{np.mean(own <= EXACT_TOLERANCE):.0%}" for own in apart.T[:2]]
    cells = [name, *met, *exact, f"{followed:.0%}", f"{jerk:.1f}", f"{skating:.2%}"]
    return f"| {' | '.join(cells)} |"


class Gap(NamedTuple):
    """A part of a clip, and the motion between its two ends."""

    real: Clip
    """From the first pose to the frame after the second one, above the origin and facing +z."""
    size: int
    """Frame of the second pose."""
    filled: Motion
    """From the first pose on; may go on after the second one."""


def fill_gap(model: TextToMotion, trial: Trial, seed: int) -> Gap:
    """Returns a motion between two poses of a clip that are one to three seconds apart."""
    clip, fps = trial.motion, trial.motion.fps
    generator = np.random.default_rng(seed)
    longest = min(3 * fps, clip.num_frames - 2)
    size = int(generator.integers(min(fps, longest), longest + 1))
    first = int(generator.integers(0, clip.num_frames - size - 1))
    real = ground_positions(clip.positions[first : first + size + 2], clip.skeleton)
    targets = []
    for frame in (0, size):
        time = frame / fps
        x, _, z = real[frame, 0]
        (degrees,) = facing_degrees(real[frame : frame + 1], clip.skeleton)
        pose = Motion(real[frame : frame + 1], fps)
        targets += [f"{time} root={x},{z} exact", f"{time} facing={degrees} exact", (time, pose, "exact")]
    (motion,) = model.direct(trial.sentence, targets, seed=seed)
    return Gap(real, size, motion)


def measure_gap(gap: Gap) -> list[float]:
    """Returns how far start and end are off, and the errors of the acceleration: ours, and in a straight line."""
    skeleton, fps = gap.filled.skeleton, gap.filled.fps
    ours = gap.filled.positions[: gap.size + 2]
    apart = np.linalg.norm(ours - gap.real, axis=-1).mean(axis=-1)
    straight = interpolate_gap(gap.real, 1, gap.size, skeleton=skeleton)
    errors = [gap_figures(one, gap.real, 1, gap.size, fps=fps).acceleration_error for one in (ours, straight)]
    return [float(apart[0]), float(apart[gap.size]), *errors]


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data")
    parser.add_argument("--model", default="demo")
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--best-of", type=int, nargs="*", default=[16, 64], help="numbers of samples to choose from")
    parser.add_argument("--between", action="store_true", help="measure motions between two poses")
    args = parser.parse_args()
    model = TextToMotion.load(args.model)
    if args.between:
        found_trials = enumerate(trials(args.data, args.count))
        rows = np.array([measure_gap(fill_gap(model, trial, number)) for number, trial in found_trials])
        start, end, ours, straight = np.median(rows, axis=0)
        sys.stdout.write(f"start {100 * start:.1f} cm, end {100 * end:.1f} cm (medians of the mean over the joints)\n")
        sys.stdout.write(f"error of the acceleration {ours:.2f}, in a straight line {straight:.2f} m/s^2 (medians)\n")
        near = (rows[:, :2] <= GAP_TOLERANCE).all(axis=1)
        half = rows[:, 2] <= rows[:, 3] / 2
        sys.stdout.write(
            f"{len(rows)} gaps: ends within 2 cm in {near.sum()}, half of the error or less in {half.sum()}\n"
        )
        return
    found: dict[str, list[tuple[Trial, Motion]]] = {}
    times = []
    for number, trial in enumerate(trials(args.data, args.count)):
        # Whole, because targets are of one sentence, too.
        samples = model.generate(trial.sentence, seed=number, num_samples=max([1, *args.best_of]), whole=True)
        start = time.process_time()
        (directed,) = model.direct(trial.sentence, trial.targets, seed=number)
        times.append(time.process_time() - start)
        for name, motion in motions_of(trial, directed, samples, args.best_of).items():
            found.setdefault(name, []).append((trial, motion))
    lines = [
        "| motions | wrist | root | pose | wrist within 5 mm | root within 5 mm | action | jerk | skating |",
        "| --- | --- | --- | --- | ---: | ---: | ---: | ---: | ---: |",
        *(row(name, own) for name, own in found.items()),
        f"processor time of a motion with targets: {np.median(times):.1f} s (median)",
    ]
    sys.stdout.write("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
