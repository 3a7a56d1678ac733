"""Counts how many real clips keep the rules of `t2m evaluate prompts --group paces`, before and after the tokenizer.

    python docs/measure/paces.py data/bandai-namco [--model demo]

The second figure is about what a generator of the model's codes can reach.
"""

import argparse
from collections.abc import ItemsView

import numpy as np

import t2m_jax
from t2m_jax import Motion
from t2m_jax.data import open_dataset
from t2m_jax.data.index import load_index
from t2m_jax.evaluation.prompts.groups import PACED, pace_tests
from t2m_jax.evaluation.prompts.sentences import Pace, held_out_paces
from t2m_jax.motion.facts import measure
from t2m_jax.motion.features import positions_from_features


def clips_with(pace: Pace, clips: list[tuple[float, Motion]]) -> list[Motion]:
    """Returns the clips of one content, given with their speeds, that have a pace."""
    speeds = np.array([speed for speed, _ in clips])
    limit = np.quantile(speeds, pace.share)
    chosen = speeds < limit if pace.is_slow else speeds > limit
    return [motion for (_, motion), is_chosen in zip(clips, chosen, strict=True) if is_chosen]


def clips_by_content(folder: str) -> ItemsView[str, list[tuple[float, Motion]]]:
    """Returns the training clips that show each paced content, with their speeds in m/s."""
    dataset = open_dataset(folder)
    index = load_index(dataset.folder)
    found: dict[str, list[tuple[float, Motion]]] = {content: [] for content in PACED}
    for clip in dataset.clips("train", min_frames=2):
        content = ((index.label(clip.name) if index else None) or "").partition(",")[0]
        if content in found:
            positions = np.asarray(positions_from_features(clip.features, dataset.skeleton))
            motion = Motion(positions, dataset.skeleton.fps)
            found[content].append((measure(positions, fps=motion.fps).speed, motion))
    return found.items()


def main() -> None:
    """Prints a line for each content and pace."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data")
    parser.add_argument("--model", default="demo")
    parser.add_argument("--count", type=int, default=16, help="most clips of each content and pace")
    options = parser.parse_args()
    model = t2m_jax.load(options.model)
    tests = {test.name: test for test in pace_tests(open_dataset(options.data))}
    random, total = np.random.default_rng(0), np.zeros(3, int)
    for content, clips in clips_by_content(options.data):
        for pace in held_out_paces():
            chosen, test = clips_with(pace, clips), tests[f"{content} {pace.name}"]
            motions = [chosen[number] for number in random.permutation(len(chosen))[: options.count]]
            decoded = [model.decode(model.encode(motion)) for motion in motions]
            counts = len(motions), sum(map(test.holds, motions)), sum(map(test.holds, decoded))
            total += counts
            print(f"{test.name}: real {counts[1]} of {counts[0]}, after the tokenizer {counts[2]}")  # noqa: T201
    print(f"all: real {total[1]} of {total[0]}, after the tokenizer {total[2]}")  # noqa: T201


if __name__ == "__main__":
    main()
