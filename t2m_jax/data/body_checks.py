"""Whether the joints of a clip can be those of a person: sides, sizes, movement, and that all parts of it agree.

Also whether one clip mirrors another, and whether two splits have the same motion.

A clip is looked at in facing coordinates, which its features have: the root is above the origin, x is left of the
heading. Left and right are found by anatomy and not by the heading, which is smoothed and wrong in quick turns.
"""

import itertools
from collections import defaultdict
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import scipy.spatial
from jaxtyping import Float

from t2m_jax.motion.features import bone_vectors
from t2m_jax.motion.mirroring import mirror_positions
from t2m_jax.motion.rotations import turned_about_y, unit_vectors
from t2m_jax.motion.skeleton import Skeleton

NUM_POSES = 8
"""Poses of a clip that are compared with those of another."""
BONE_FACTOR = 1.15
"""Largest factor between the bones of a clip and those of its skeleton. Imports make them equal."""
STILL_METERS = 2e-3
"""Joints of a person who stands still move more: those of 29,000 imported clips by 5 mm or more."""
TWIN_METERS = 0.06
"""Largest distance of the joints of a twin from those of the mirrored clip, after a turn. In 14,000 pairs it was 4 cm:
the legs of the skeleton are not equally long."""
JOINTS_METERS = 0.05
"""Largest distance of the joints in a file from those of the features."""
STEP_SHARE = 0.5
"""Largest difference of the velocities in features and of the steps of joints, as a share of these steps. It is 2 if
the rows of a clip are in reverse order."""
BEND_WEIGHT = 1.7
"""Weight of the bend of the knees beside the direction of the feet. Their sum was 0.5 or more in 29,000 clips, and so
-0.5 or less with left and right exchanged."""

EQUAL_METERS = 2e-3
"""Largest distance of the joints of equal motions, also if one was rounded or encoded again. The nearest two different
motions of 4,448 clips have 20 mm."""
NUM_KEYS = 12
"""Coordinates of a clip by which similar ones are found; only these are compared completely."""


class ClipBody(NamedTuple):
    """What is compared of a clip."""

    num_frames: int
    poses: Float[np.ndarray, "P J 3"]
    """Some poses in meters, in facing coordinates."""
    turn: float
    """Degrees to the left, from the first frame to the last."""
    ahead: float
    """Mean speed in meters per second along the heading."""
    left: float
    """Mean speed in meters per second to the left of the heading."""
    speed: float
    """Length of the root's path on the ground per second, in meters."""
    fastest: float
    """Distance on the ground in the fastest second, in meters."""
    hands: tuple[float, float]
    """Paths of the left and the right hand relative to the root, in meters."""


def measure_body(features: Float[np.ndarray, "T D"], local: Float[np.ndarray, "T J 3"], skeleton: Skeleton) -> ClipBody:
    """Returns the measures of a clip from its features and their `local_positions` in meters."""
    steps = features[:-1, skeleton.layout.root_velocity] * skeleton.metres_per_unit
    left, ahead = steps.mean(axis=0) * skeleton.fps
    shoulders = skeleton.face_joints[3], skeleton.face_joints[2]
    hands = [next(chain[-1] for chain in skeleton.chains if shoulder in chain) for shoulder in shoulders]
    paths = np.linalg.norm(np.diff(local[:, hands], axis=0), axis=-1).sum(axis=0)
    return ClipBody(
        num_frames=len(local),
        poses=local[np.linspace(0, len(local) - 1, NUM_POSES).astype(int)],
        turn=float(-np.degrees(2 * features[:-1, skeleton.layout.root_yaw].sum())),
        ahead=float(ahead),
        left=float(left),
        speed=float(np.linalg.norm(steps, axis=-1).mean() * skeleton.fps),
        fastest=_fastest_second(steps, skeleton.fps),
        hands=(float(paths[0]), float(paths[1])),
    )


def _fastest_second(steps: Float[np.ndarray, "S 2"], fps: float) -> float:
    """Returns the longest distance of a second; of a shorter clip, the speed."""
    size = max(1, min(round(fps), len(steps)))
    places = np.cumsum(np.pad(steps, ((1, 0), (0, 0))), axis=0)
    return float(np.linalg.norm(places[size:] - places[:-size], axis=-1).max(initial=0.0) * fps / size)


def check_body(features: Float[np.ndarray, "T D"], local: Float[np.ndarray, "T J 3"], skeleton: Skeleton) -> list[str]:
    """Returns what of a clip cannot be a person who moves."""
    problems = []
    if _side_score(local, skeleton) < 0:
        problems.append("its knees and feet bend back; left and right are exchanged, or one axis is mirrored")
    lengths = np.median(np.linalg.norm(bone_vectors(local, skeleton), axis=-1), axis=0)
    factor = float(np.median(lengths / (np.array(skeleton.bone_lengths[1:]) * skeleton.metres_per_unit)))
    if not 1 / BONE_FACTOR < factor < BONE_FACTOR:
        problems.append(f"its bones have {factor:.2f} times the lengths of its skeleton; the unit is wrong")
    layout = skeleton.layout
    path = np.abs(features[:-1, layout.root_velocity]).sum() * skeleton.metres_per_unit
    if max(float(np.ptp(local, axis=0).max()), float(path)) < STILL_METERS:
        problems.append("nothing moves")
    # Heights only, because they do not depend on the heading.
    steps = np.diff(local[..., 1], axis=0)
    told = features[:-1, layout.velocities].reshape(len(steps), -1, 3)[..., 1] * skeleton.metres_per_unit
    if np.abs(told - steps).mean() > STEP_SHARE * np.abs(steps).mean() + 1e-4:
        problems.append("its velocities are not those of its joints; time is reversed, or frames are missing")
    return problems


def _side_score(local: Float[np.ndarray, "T J 3"], skeleton: Skeleton) -> float:
    """Returns a number that is above 0 if knees bend and feet point to the front, where left is left of it."""
    right_hip, left_hip, *shoulders = skeleton.face_joints
    across = unit_vectors(local[:, left_hip] - local[:, right_hip])
    front = unit_vectors(np.cross(across, local[:, shoulders].mean(axis=1) - local[:, 0]))
    bends, ahead = [], []
    for hip, (ankle, toe) in ((left_hip, skeleton.left_foot), (right_hip, skeleton.right_foot)):
        chain = next(chain for chain in skeleton.chains if hip in chain)
        thigh, shin = (unit_vectors(np.diff(local[:, chain[first : first + 2]], axis=1)[:, 0]) for first in (1, 2))
        bends.append(np.sum(np.cross(thigh, shin) * across, axis=-1))
        ahead.append(np.sum(unit_vectors(local[:, toe] - local[:, ankle]) * front, axis=-1))
    return float(np.median(ahead) + BEND_WEIGHT * np.mean(bends))


def check_joints(stored: Float[np.ndarray, "U J 3"], positions: Float[np.ndarray, "T J 3"]) -> list[str]:
    """Returns whether the joints in a file differ from those of the features; both in meters.

    HumanML3D's files have one frame more than the features.
    """
    if not 0 <= len(stored) - len(positions) <= 1:
        return [f"has {len(stored)} frames, the features {len(positions)}"]
    far = float(np.abs(stored[: len(positions)] - positions).max())
    return [] if far <= JOINTS_METERS else [f"its joints are {far:.2f} m from those of the features; import again"]


def check_twin(original: ClipBody, twin: ClipBody, skeleton: Skeleton) -> list[str]:
    """Returns whether a clip is not the mirror image of another, however each is turned."""
    if original.num_frames != twin.num_frames:
        return [f"has {twin.num_frames} frames, the clip that it mirrors {original.num_frames}"]
    image = mirror_positions(original.poses, skeleton)
    # The turn about Y that is best for each pose, as the smoothed headings of the two may differ.
    real = np.sum(image[..., ::2] * twin.poses[..., ::2], axis=(1, 2))
    cross = image[..., 2] * twin.poses[..., 0] - image[..., 0] * twin.poses[..., 2]
    angle = np.arctan2(cross.sum(axis=1), real)[:, None]
    far = float(np.linalg.norm(turned_about_y(image, angle) - twin.poses, axis=-1).max())
    return [] if far <= TWIN_METERS else [f"is not the mirror image of the clip, but up to {far:.2f} m from it"]


def check_copies(bodies: Mapping[str, ClipBody], homes: Mapping[str, str]) -> list[str]:
    """Returns clips whose motion a clip of another split has.

    Args:
        bodies: What is compared of each clip; mirrored twins are clips of their own.
        homes: The split of each clip.
    """
    names = defaultdict(list)
    for name in bodies:
        names[homes[name]].append(name)
    # Their poses, and that they are equally long.
    flat = {name: np.append(body.poses.ravel(), np.float32(body.num_frames)) for name, body in bodies.items()}
    pairs = {}
    for first, second in itertools.combinations(names, 2):
        points = [np.stack([flat[name] for name in names[split]]) for split in (first, second)]
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
