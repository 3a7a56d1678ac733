"""Measures loops of walks, runs and waves: how well both ends agree, and how much feet slide.

    python docs/measure/loops.py [--model demo] [--data data/bandai-namco]

With --data, the loops are those of motion capture, of clips of the test split. The velocities at the seam are
extrapolated from the three frames on either side of it.
"""

import argparse
from collections.abc import Iterator

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from t2m_jax.data import open_dataset
from t2m_jax.data.index import load_index
from t2m_jax.errors import UserError
from t2m_jax.evaluation import action_tests
from t2m_jax.metrics.quality import measure_quality
from t2m_jax.motion.features import positions_from_features
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.travel import above_origin
from t2m_jax.sampling import TextToMotion

CONTENTS = ("walk", "run", "wave-left-hand", "wave-right-hand", "wave-both-hands")
RATES = (20, 60)
"""Frames a second."""


def seam(positions: Float[np.ndarray, "T J 3"], fps: float) -> tuple[float, float]:
    """Returns the largest differences of a joint at the seam: of places in place in mm, and of velocities in m/s."""
    local = above_origin(positions)
    before, after = 3 * local[-1] - 4 * local[-2] + local[-3], -3 * local[0] + 4 * local[1] - local[2]
    apart, faster = (np.linalg.norm(ends, axis=-1).max() for ends in (local[-1] - local[0], before - after))
    return 1000 * float(apart), float(faster) * fps / 2


def sliding(motion: Motion) -> float:
    """Returns the mean speed of feet that touch the floor, in m/s."""
    mask = jnp.ones((1, motion.num_frames), bool)
    return float(measure_quality(jnp.asarray(motion.positions)[None], mask, skeleton=motion.skeleton).skating_speed[0])


def generated(name: str, count: int) -> Iterator[tuple[str, Motion]]:
    """Yields motions of a model with what they show."""
    model = TextToMotion.load(name)
    for test in action_tests():
        for seed in range(count if test.name in CONTENTS else 0):
            yield test.name, model.generate(test.sentences[seed % len(test.sentences)], seed=seed)[0]


def captured(folder: str, count: int) -> Iterator[tuple[str, Motion]]:
    """Yields clips of the test split with what they show."""
    dataset = open_dataset(folder)
    index, left = load_index(dataset.folder), dict.fromkeys(CONTENTS, count)
    for clip in dataset.clips("test"):
        content = ((index.label(clip.name) if index else None) or "").partition(", ")[0]
        if left.get(content, 0):
            left[content] -= 1
            positions = np.asarray(positions_from_features(clip.features, dataset.skeleton))
            yield content, Motion(positions, dataset.skeleton.fps, skeleton=dataset.skeleton)


def main() -> None:
    """Prints a line for each kind of motion and frame rate."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--model", default="demo")
    parser.add_argument("--data", help="measure motion capture")
    parser.add_argument("--count", type=int, default=16, help="motions of each content")
    options = parser.parse_args()
    source = captured(options.data, options.count) if options.data else generated(options.model, options.count)
    table: dict[tuple[str, int], list[tuple[float, ...]]] = {}
    for content, motion in source:
        for fps in RATES:
            try:
                moved = motion.resampled(fps)
                loop = moved.looped()
            except UserError:  # nothing in it repeats
                continue
            table.setdefault((content.partition("-")[0], fps), []).append(
                (*seam(loop.positions, fps), sliding(moved), sliding(loop))
            )
    for (kind, fps), found in sorted(table.items()):
        apart, faster, before, after = np.array(found).T
        print(  # noqa: T201
            f"{kind} at {fps} fps: {len(found)} loops, at most {apart.max():.3f} mm apart, velocities within "
            f"0.2 m/s in {np.sum(faster <= 0.2)}, at most {faster.max():.2f} m/s; feet slide at {after.mean():.2f} "
            f"m/s, before at {before.mean():.2f}"
        )


if __name__ == "__main__":
    main()
