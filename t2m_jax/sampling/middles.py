"""New middles of a motion, and how they are moved to targets."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from t2m_jax.motion.joining import place_positions, replace_middle
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.targets import Target, check_targets, move_target
from t2m_jax.sampling.batches import round_up
from t2m_jax.sampling.decode import ROW_BUCKET, Codes
from t2m_jax.sampling.directing import approach_targets, check_latents, cost_of
from t2m_jax.sampling.model import ModelParts
from t2m_jax.sampling.request import MotionRequest


class Span(NamedTuple):
    """Rows of codes, or frames."""

    first: int
    last: int
    """The one after them."""


class Middle(NamedTuple):
    """A candidate for the middle of a motion."""

    positions: Float[np.ndarray, "T J 3"]
    """Its frames, between some of the head's and the tail's, in meters."""
    first: int
    """First frame of the middle."""
    last: int
    """Frame after the middle."""
    codes: Codes
    """Of all frames."""


def check_middle_targets(model: ModelParts, motion: Motion, frames: Span, targets: Sequence[Target]) -> None:
    """Raises `UserError` if targets do not fit the model, or nobody could meet them in a new middle.

    Args:
        model: With which the middle is made.
        motion: Whose frames before the middle stay.
        frames: Of the new middle.
        targets: In the seconds and meters of the motion.
    """
    check_latents(model)
    for target in targets:
        times = target.frames(motion.fps)
        if times[0] < frames.first or times[-1] >= frames.last:
            begin, end = frames.first / motion.fps, frames.last / motion.fps
            raise target.error(f"is not in the part that is made again, {begin:g} to {end:g} s")
        if target.exact:
            raise target.error("cannot be exact in a part that is made again: it would change what stays")
    root = motion.positions[frames.first - 1, 0].tolist() if frames.first else (0.0, 0.0, 0.0)
    check_targets(targets, model.skeleton, start=(frames.first / motion.fps, root[0], root[2]))


def move_middles(
    model: ModelParts, motion: Motion, middles: Sequence[Middle], frames: Span, request: MotionRequest
) -> list[Middle]:
    """Returns the middles that are nearest to the targets of a request, moved to them."""
    windows = [_Window(motion, middle, frames, request.targets) for middle in middles]
    windows.sort(key=lambda window: cost_of(window.targets, window.joined(window.alone)))
    clean = not request.options.raw
    return [window.moved(model, clean=clean) for window in windows[: request.num_samples]]


class _Window:
    """A middle as it was decoded, with targets and parts of the head and the tail where the decoder has put them."""

    def __init__(self, motion: Motion, middle: Middle, frames: Span, targets: Sequence[Target]):
        self.middle = middle
        self.alone = Motion(middle.positions, motion.fps, skeleton=motion.skeleton, codes=middle.codes)
        self.head = motion.positions[frames.first - middle.first : frames.first]
        self.tail = motion.positions[frames.last :][: len(middle.positions) - middle.last]
        self.targets = list(targets)
        if middle.first:
            pose, place = self.head[-1], middle.positions[middle.first - 1]
            later = (middle.first - frames.first) / motion.fps
            skeleton = motion.skeleton
            self.targets = [move_target(target, later, pose, place, skeleton=skeleton) for target in targets]
            self.head = place_positions(self.head, pose, place, skeleton=skeleton)

    def joined(self, window: Motion) -> Motion:
        """Returns a window with the motion's own head and tail, which decides where the joints of the middle are."""
        first, last = self.middle.first, self.middle.last
        positions = replace_middle(
            self.head, window.positions, self.tail, first=first, last=last, fps=window.fps, skeleton=window.skeleton
        )
        # The window may be longer than the motion. Its frames after the end keep the length that `finish` must return.
        rest = window.positions[len(positions) :]
        return Motion(np.concatenate([positions, rest]), window.fps, skeleton=window.skeleton)

    def moved(self, model: ModelParts, *, clean: bool) -> Middle:
        """Returns the middle, moved to the targets."""
        size = round_up(len(self.middle.codes), ROW_BUCKET)
        found = approach_targets(model, self.alone, self.targets, size=size, clean=clean, finish=self.joined)
        return self.middle._replace(positions=found.positions)
