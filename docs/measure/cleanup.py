"""Measures what the clean-up does to generated motion and to motion capture, and what it costs.

    python docs/measure/cleanup.py data/demo [--model demo]

The motions are for sentences of `t2m evaluate prompts`, ten for each action, and for `SENTENCES`; the clips are of the
test split.
"""

import argparse
import itertools
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from t2m_jax.data import open_dataset
from t2m_jax.evaluation import action_tests
from t2m_jax.export.formats import save_bvh_file
from t2m_jax.metrics.quality import measure_quality
from t2m_jax.motion.cleanup import clean_positions
from t2m_jax.motion.features import positions_from_features
from t2m_jax.motion.legs import WINDOW_SECONDS, knee_bends
from t2m_jax.motion.motion import Motion
from t2m_jax.sampling import TextToMotion

SPINE = ("spine1", "spine2", "spine3")
SENTENCES = (
    "a person walks forward",
    "a person waves with the left hand",
    "a person kicks with the right foot",
    "a person walks in a circle to the left",
)
LONGEST = 400
"""Frames that all motions are padded to, so that one program fits them."""
POP = 60.0
"""A knee pops if it turns this much faster than before; degrees per second."""


def clean(motion: Motion) -> Motion:
    """Returns a motion after the clean-up."""
    padded = np.pad(motion.positions, ((0, LONGEST - motion.num_frames), (0, 0), (0, 0)))[None]
    cleaned = clean_positions(padded, np.array([motion.num_frames], np.int32), skeleton=motion.skeleton)
    return Motion(np.asarray(cleaned)[0, : motion.num_frames], motion.fps, skeleton=motion.skeleton)


def through_bvh(motion: Motion) -> Motion:
    """Returns a motion as it comes back from a BVH file."""
    with tempfile.TemporaryDirectory() as folder:
        save_bvh_file(Path(folder) / "motion.bvh", [motion])
        return Motion.load(Path(folder) / "motion.bvh")


def spine_speed(motion: Motion) -> Float[np.ndarray, " S"]:
    """Returns the root mean square speed of the spine's rotations in the rig, in degrees per second."""
    spine = motion.rotations[:, [motion.skeleton.joint_names.index(name) for name in SPINE]]
    turns = np.einsum("tjab,tjcb->tjac", spine[1:], spine[:-1])
    angles = np.arccos(np.clip((np.trace(turns, axis1=2, axis2=3) - 1) / 2, -1, 1))
    return np.rad2deg(np.sqrt(np.mean(angles**2, axis=0))) * motion.fps


def knee_speeds(motion: Motion) -> Float[np.ndarray, "S 2"]:
    """Returns how fast the bends of both knees change from each frame to the next, in degrees per second."""
    parents = motion.skeleton.parents
    legs = [
        (parents[parents[ankle]], parents[ankle], ankle)
        for ankle in (motion.skeleton.left_foot[0], motion.skeleton.right_foot[0])
    ]
    bends = [knee_bends(*jnp.moveaxis(jnp.asarray(motion.positions[:, leg]), 1, 0)) for leg in legs]
    return np.rad2deg(np.abs(np.diff(np.stack(bends, axis=1), axis=0))) * motion.fps


def faster_knees(before: Sequence[Motion], after: Sequence[Motion]) -> str:
    """Returns how much faster knees became than they were in the 0.1 s around, as words."""
    excess = []
    for old, new in zip(before, after, strict=True):
        reach = round(WINDOW_SECONDS * old.fps)
        padded = np.pad(knee_speeds(old), ((reach, reach), (0, 0)))
        near = np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1, axis=0).max(axis=-1)
        excess.append((knee_speeds(new) - near).ravel())
    steps = np.concatenate(excess)
    pops = np.sum(steps > POP) / sum(motion.seconds / 60 for motion in before)
    fastest = [np.mean([knee_speeds(motion).max() for motion in motions]) for motions in (before, after)]
    return (
        f"knees are faster by {max(0.0, steps.max()):.1f} degrees/s at most, and pop {pops:.1f} times a minute; the "
        f"fastest of a motion turns by {fastest[0]:.0f} degrees/s before and {fastest[1]:.0f} after, on average"
    )


def quality_row(name: str, motions: Sequence[Motion]) -> str:
    """Returns the figures of motions as a line."""
    table = []
    for motion in motions:
        padded = np.pad(motion.positions, ((0, LONGEST - motion.num_frames), (0, 0), (0, 0)))[None]
        mask = (np.arange(LONGEST) < motion.num_frames)[None]
        quality = measure_quality(jnp.asarray(padded), jnp.asarray(mask), skeleton=motion.skeleton)
        table.append([float(value[0]) for value in quality])
    bones, jerk, skating, speed, floating, penetration = np.mean(table, axis=0)
    spine = " ".join(f"{value:.0f}" for value in np.mean([spine_speed(motion) for motion in motions], axis=0))
    return (
        f"{name}: bone variation {bones:.2%}, jerk {jerk:.0f} m/s3, skating {skating:.1%} at {speed:.2f} m/s, floating "
        f"{floating:.1%}, penetration {penetration:.1%}, spine {spine} degrees/s"
    )


def moved(before: Sequence[Motion], after: Sequence[Motion]) -> str:
    """Returns by how much joints were moved, as words."""
    steps = [
        np.linalg.norm(new.positions - old.positions, axis=-1).ravel() for old, new in zip(before, after, strict=True)
    ]
    distances, means = 1000 * np.concatenate(steps), [1000 * float(step.mean()) for step in steps]
    quantile = np.quantile(distances, 0.99)
    return (
        f"{distances.mean():.1f} mm on average, {max(means):.1f} mm in the worst motion, 99 % below {quantile:.0f} mm"
    )


def seconds(action: Callable[[], object]) -> float:
    """Returns the shortest time of five calls, after a first one that compiles."""
    action()
    times = []
    for _ in range(5):
        start = time.perf_counter()
        action()
        times.append(time.perf_counter() - start)
    return min(times)


def cost_alone(motion: Motion) -> str:
    """Returns how long the clean-up of 10 s takes, as words."""
    clip = np.resize(motion.positions, (1, 200, *motion.positions.shape[1:])).astype(np.float32)
    lengths = np.array([200], np.int32)
    taken = seconds(lambda: np.asarray(clean_positions(clip, lengths, skeleton=motion.skeleton)))
    return f"the clean-up of a motion of 10 s takes {1000 * taken:.1f} ms"


def cost(model: TextToMotion, texts: Sequence[str]) -> str:
    """Returns what the clean-up adds to the time of generating motions, as words."""
    cleaned, raw = (seconds(lambda raw=raw: model.generate(texts, seed=0, raw=raw)) for raw in (False, True))
    return f"{len(texts)} motions take {cleaned:.3f} s, without clean-up {raw:.3f} s ({cleaned / raw - 1:.1%} more)"


def main() -> None:
    """Prints a line for each figure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data")
    parser.add_argument("--model", default="demo")
    parser.add_argument("--count", type=int, default=10, help="motions of each action")
    options = parser.parse_args()
    model, dataset = TextToMotion.load(options.model), open_dataset(options.data)
    asked = [test.sentences for test in action_tests() if test.name != "stand"]
    decoded = [
        model.generate(sentences[seed % len(sentences)], seed=seed, raw=True)[0]
        for sentences in asked
        for seed in range(options.count)
    ]
    real = [
        Motion(np.asarray(positions_from_features(clip.features, dataset.skeleton)), dataset.skeleton.fps)
        for clip in itertools.islice(dataset.clips("test"), 0, None, 8)
        if len(clip.features) <= LONGEST
    ]
    cleaned = [clean(motion) for motion in decoded]
    few = [model.generate(text, seed=seed, raw=True)[0] for text in SENTENCES for seed in range(8)]
    few_cleaned = [clean(motion) for motion in few]
    real_cleaned = [clean(motion) for motion in real]
    lines = [
        quality_row(f"{len(real)} real clips", real),
        quality_row(f"{len(decoded)} motions as decoded", decoded),
        quality_row("cleaned", cleaned),
        quality_row("cleaned, from BVH files", [through_bvh(motion) for motion in cleaned]),
        f"the clean-up moves joints of generated motion by {moved(decoded, cleaned)}",
        f"a second clean-up by {moved(cleaned, [clean(motion) for motion in cleaned])}",
        quality_row("real clips, cleaned", real_cleaned),
        f"joints of real clips by {moved(real, real_cleaned)}",
        f"generated motion: {faster_knees(decoded, cleaned)}",
        f"real clips: {faster_knees(real, real_cleaned)}",
        quality_row(f"{len(few)} motions for four sentences, as decoded", few),
        quality_row("cleaned", few_cleaned),
        f"these: {faster_knees(few, few_cleaned)}",
        cost_alone(real[0]),
        cost(model, [sentences[0] for sentences in asked]),
    ]
    print("\n".join(lines))  # noqa: T201


if __name__ == "__main__":
    main()
