"""Clips of different splits that have the same motion."""

import itertools
from collections import defaultdict
from collections.abc import Mapping

import numpy as np
import scipy.spatial

from t2m_jax.data.body_checks import ClipBody

EQUAL_METERS = 2e-3
"""Largest distance of the joints of equal motions, also if one was rounded or encoded again. The nearest two different
motions of 4,448 clips have 20 mm."""
NUM_KEYS = 12
"""Coordinates of a clip by which similar ones are found; only these are compared completely."""


def check_copies(bodies: Mapping[str, ClipBody], homes: Mapping[str, str]) -> list[str]:
    """Returns clips whose motion a clip of another split has.

    Args:
        bodies: What is compared of each clip; mirrored twins are clips of their own.
        homes: The split of each clip.
    """
    names = defaultdict(list)
    for name in bodies:
        names[homes[name]].append(name)
    pairs = {}
    for first, second in itertools.combinations(names, 2):
        points = [np.stack([_flat(bodies[name]) for name in names[split]]) for split in (first, second)]
        places = np.linspace(0, points[0].shape[1] - 1, NUM_KEYS).astype(int)
        tree = scipy.spatial.cKDTree(points[0][:, places])
        # Only the nearest one, so that the lines of many equal clips are as many as the clips.
        _, near = tree.query(points[1][:, places], p=np.inf, distance_upper_bound=EQUAL_METERS)
        for place in np.flatnonzero(near < len(tree.data)):
            if np.abs(points[0][near[place]] - points[1][place]).max() < EQUAL_METERS:
                pairs[names[second][place]] = names[first][near[place]]
    return [
        f"{homes[copy]}.txt: {copy} has the motion of {one}, which is in {homes[one]}.txt"
        for copy, one in pairs.items()
    ]


def _flat(body: ClipBody) -> np.ndarray:
    """Returns the frames and the coordinates of some poses of a clip."""
    return np.append(body.poses.ravel(), np.float32(body.num_frames))
