"""Measures chains of sentences: how often each is followed, and how much joints accelerate where sentences meet.

    python docs/measure/chains.py --model demo [--seconds 6]

Each chain has one held-out sentence for each of ten actions, in random order. The same sentences are generated alone.
"""

import argparse

import numpy as np
from jaxtyping import Float

from t2m_jax.evaluation import action_tests
from t2m_jax.motion.motion import Motion
from t2m_jax.sampling import TextToMotion

SEAM_SECONDS = 0.25
"""Frames that are nearer to a seam belong to it."""


def accelerations(motion: Motion) -> Float[np.ndarray, " T"]:
    """Returns the mean acceleration of the joints in each frame but the first and the last, in m/s²."""
    return np.linalg.norm(np.diff(motion.positions, n=2, axis=0), axis=-1).mean(axis=-1) * motion.fps**2


def seam_ratio(motion: Motion) -> float:
    """Returns the mean acceleration at the seams over that elsewhere."""
    found = accelerations(motion)
    distance = np.abs(np.arange(1, len(found) + 1)[:, None] - np.array(motion.part_starts[1:])[None]).min(axis=1)
    at_seam = distance <= SEAM_SECONDS * motion.fps
    return float(found[at_seam].mean() / found[~at_seam].mean())


def main() -> None:
    """Prints the figures of one model."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--model", default="demo")
    parser.add_argument("--seconds", type=float, help="of each sentence; by default the model decides")
    parser.add_argument("--chains", type=int, default=48)
    options = parser.parse_args()
    model = TextToMotion.load(options.model)
    tests = [test for test in action_tests() if test.name != "stand"]
    chained, alone, ratios = [], [], []
    for seed in range(options.chains):
        order = np.random.default_rng(seed).permutation(len(tests))
        chain = [tests[number] for number in order]
        sentences = [test.sentences[seed % len(test.sentences)] for test in chain]
        (motion,) = model.generate_chain(sentences, seed=seed, seconds=options.seconds)
        ends = [*motion.part_starts[1:], motion.num_frames]
        parts = [motion[first:last] for first, last in zip(motion.part_starts, ends, strict=True)]
        chained += [test.holds(part) for test, part in zip(chain, parts, strict=True)]
        single = [model.generate_chain([text], seed=seed, seconds=options.seconds)[0] for text in sentences]
        alone += [test.holds(motion) for test, motion in zip(chain, single, strict=True)]
        ratios.append(seam_ratio(motion))
    print(  # noqa: T201
        f"{options.model}: followed in chains {np.mean(chained):.1%}, alone {np.mean(alone):.1%} "
        f"({len(chained)} sentences); acceleration at seams {np.mean(ratios):.2f}, up to {np.max(ratios):.2f}"
    )


if __name__ == "__main__":
    main()
