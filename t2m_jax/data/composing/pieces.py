"""Pieces of labeled clips, and how they are joined."""

import functools
import random
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from t2m_jax.data.captioning.captions import Labels
from t2m_jax.data.captioning.lexicon import read_words
from t2m_jax.data.files import FEATURES
from t2m_jax.motion.facts import WALKING_SPEED, Facts, measure
from t2m_jax.motion.features import features_from_positions, local_positions, positions_from_features
from t2m_jax.motion.joining import OVERLAP, find_cut, join_features
from t2m_jax.motion.skeleton import HUMANML3D

LONGEST = HUMANML3D.max_frames
SLACK = 20
"""Frames that may be given up at each side of a join at which the poses are more alike."""
REACH = 0.22
"""Meters that the joints of two poses may be apart on average for one clip to follow another. A person who sits is
about 0.35 from one who stands, and the two ends of a stride are 0.2 apart."""
FEW_CLIPS = 20
"""Clips of a content that is drawn as often as one with the weight 1."""
MOST_WEIGHT = 2.0


class LabeledPiece(NamedTuple):
    """A piece of a clip, and the labels of the clip."""

    labels: Labels
    features: Float[np.ndarray, "T D"]
    name: str = ""
    """Of the clip."""

    @property
    def facts(self) -> Facts:
        """Measurements of it."""
        return measure(self.positions, fps=HUMANML3D.fps)

    @property
    def positions(self) -> Float[np.ndarray, "T J 3"]:
        """Its joints; it begins above the origin and faces +Z."""
        return np.asarray(positions_from_features(self.features, HUMANML3D))

    @property
    def travels(self) -> bool:
        """Whether it goes somewhere."""
        steps = np.linalg.norm(self.features[:, HUMANML3D.layout.root_velocity], axis=1)
        return bool(steps.mean() * HUMANML3D.fps > WALKING_SPEED)


class Library(NamedTuple):
    """The training clips that pieces are taken from."""

    folder: Path
    """Of the data set."""
    clips: Mapping[str, Sequence[tuple[str, str]]]
    """Content -> names and styles."""

    weights: Mapping[str, float] = {}
    """Content -> how often it is drawn."""
    reach: float = float("inf")
    """Meters that the joints may be apart on average where one clip follows another."""

    def draw_clip(self, weights: Mapping[str, float], generator: random.Random) -> LabeledPiece | None:
        """Returns a clip of one of the contents, drawn by their weights; None if there are no clips of any."""
        known = [content for content in weights if self.clips.get(content)]
        if not known:
            return None
        content = generator.choices(known, [weights[one] for one in known])[0]
        return self.piece(content, *generator.choice(self.clips[content]))

    def piece(self, content: str, name: str, style: str) -> LabeledPiece:
        """Returns a whole clip."""
        return LabeledPiece(Labels(content, style), np.load(self.folder / FEATURES / f"{name}.npy"), name)

    def following(self, content: str, before: LabeledPiece | None) -> Sequence[tuple[str, str]]:
        """Returns the clips of a content that begin in about the pose in which a piece ends."""
        clips = self.clips[content]
        if before is None or np.isinf(self.reach):
            return clips
        starts = np.stack([first_pose(self.folder / FEATURES / f"{name}.npy") for name, _ in clips])
        distances = np.linalg.norm(starts - local_positions(before.features[-1], HUMANML3D), axis=-1).mean(axis=-1)
        return [clip for clip, distance in zip(clips, distances, strict=True) if distance < self.reach]


def make_library(folder: Path, labels: Mapping[str, Labels], *, weights: Mapping[str, float], reach: float) -> Library:
    """Returns the clips that compositions are made of, by their contents."""
    clips: dict[str, list[tuple[str, str]]] = {}
    for name, label in labels.items():
        clips.setdefault(label.content, []).append((name, label.style))
    return Library(folder, clips, weights, reach)


def drawn_weights(contents: Iterable[str]) -> dict[str, float]:
    """Returns how often each content is drawn; those that the table does not have, by the number of their clips.

    Args:
        contents: The content of each clip.
    """
    table = read_words(__package__, "composed")
    known = table["weights"] | table["more_weights"]
    counts = Counter(contents).items()
    return {content: known.get(content, min(count / FEW_CLIPS, MOST_WEIGHT)) for content, count in counts}


@functools.cache
def first_pose(path: Path) -> Float[np.ndarray, "J 3"]:
    """Returns the first pose of a file of features."""
    return local_positions(np.load(path, mmap_mode="r")[0], HUMANML3D)


def join_pieces(pieces: Sequence[LabeledPiece]) -> Float[np.ndarray, "T J 3"]:
    """Returns the joint positions of pieces, each joined to the one before where the poses are most alike."""
    whole = pieces[0].features
    for piece in pieces[1:]:
        whole = join_at(whole, piece.features, slack=SLACK)
    return np.asarray(positions_from_features(whole, HUMANML3D))


def join_at(
    first: Float[np.ndarray, "T D"], second: Float[np.ndarray, "U D"], *, slack: int
) -> Float[np.ndarray, "S D"]:
    """Returns raw features of one clip after another, joined where the poses are most alike.

    Args:
        first: Clip that is joined to its beginning.
        second: Clip that follows.
        slack: Frames that each of them may give up at most; a quarter of a short clip.
    """
    earliest = len(first) - min(slack, len(first) // 4)
    latest = min(slack, len(second) // 4)
    cut = find_cut(
        first,
        second,
        ends=range(max(earliest, OVERLAP), len(first) + 1),
        starts=range(min(latest, len(second) - OVERLAP) + 1),
        skeleton=HUMANML3D,
    )
    # A join does not keep the bones of the template; this does, and takes the last frame.
    positions = positions_from_features(join_features(first, second, cut), HUMANML3D)
    return features_from_positions(positions, HUMANML3D)
