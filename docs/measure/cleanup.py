"""Measures what the clean-up does to generated motion and to motion capture, and what it costs.

    python docs/measure/cleanup.py data/bandai-namco [--model demo]

The motions are for sentences of `t2m evaluate prompts`, ten for each action; the clips are of the test split.
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
from t2m_jax.motion.motion import Motion
from t2m_jax.sampling import TextToMotion

SPINE = ("spine1", "spine2", "spine3")
LONGEST = 400
"""Frames that all motions are padded to, so that one program fits them."""


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
    lines = [
        quality_row(f"{len(real)} real clips", real),
        quality_row(f"{len(decoded)} motions as decoded", decoded),
        quality_row("cleaned", cleaned),
        quality_row("cleaned, from BVH files", [through_bvh(motion) for motion in cleaned]),
        f"the clean-up moves joints of generated motion by {moved(decoded, cleaned)}",
        f"a second clean-up by {moved(cleaned, [clean(motion) for motion in cleaned])}",
        f"joints of real clips by {moved(real, [clean(motion) for motion in real])}",
        cost(model, [sentences[0] for sentences in asked]),
    ]
    print("\n".join(lines))  # noqa: T201


if __name__ == "__main__":
    main()
