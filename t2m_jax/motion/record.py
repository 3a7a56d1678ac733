"""`Motion`: one motion as users hold it, which saves itself in any known format."""

import dataclasses
import math
import os
from collections.abc import Sequence
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from t2m_jax.errors import UserError
from t2m_jax.motion.skeleton import HUMANML3D, Skeleton

# Writers and viewers register themselves under these names, so that this module need not know them.
_FORMATS = "t2m_jax.motion_formats"
_VIEWERS = "t2m_jax.motion_viewers"


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Motion:
    """A moving skeleton, with the features and codes it came from where they are known."""

    positions: Float[np.ndarray, "T J 3"]
    """Joints in metres, Y up; features put them over the origin, heading +Z at first."""
    fps: float
    """Frames a second."""
    _: dataclasses.KW_ONLY
    skeleton: Skeleton = HUMANML3D
    """What the joints are."""
    features: Float[np.ndarray, "T D"] | None = None
    """Raw features in the skeleton's unit, one row a frame."""
    codes: Int[np.ndarray, " N"] | Int[np.ndarray, "N R"] | None = None
    """Codebook indices, with one column a layer for residual codebooks."""
    caption: str = ""
    """What the motion shows, or the text it was made from."""
    seed: int | None = None
    """The seed it was sampled with."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "positions", np.asarray(self.positions, np.float32))
        object.__setattr__(self, "fps", float(self.fps))
        if self.features is not None:
            object.__setattr__(self, "features", np.asarray(self.features, np.float32))
        if self.codes is not None:
            object.__setattr__(self, "codes", np.asarray(self.codes))
        self._refuse_wrong_positions()
        self._refuse_wrong_extras()

    def _refuse_wrong_positions(self) -> None:
        shape, joints = self.positions.shape, self.skeleton.num_joints
        if len(shape) != 3 or shape[1:] != (joints, 3) or shape[0] == 0:
            raise UserError(
                f"positions have shape {shape}; skeleton {self.skeleton.name} needs [frames, {joints}, 3] with a frame"
            )
        if not np.isfinite(self.positions).all():
            frame = int(np.argwhere(~np.isfinite(self.positions))[0, 0])
            raise UserError(f"positions of frame {frame} are not finite numbers")
        if not (math.isfinite(self.fps) and self.fps > 0):
            raise UserError(f"fps is {self.fps}; give a number above zero")

    def _refuse_wrong_extras(self) -> None:
        expected = (self.num_frames, self.skeleton.feature_dim)
        if self.features is not None and self.features.shape != expected:
            raise UserError(f"features have shape {self.features.shape}; these positions need {list(expected)}")
        if self.codes is not None and (self.codes.ndim not in (1, 2) or self.codes.dtype.kind not in "iu"):
            raise UserError(f"codes have shape {self.codes.shape} and type {self.codes.dtype}; give whole numbers [N]")

    @property
    def num_frames(self) -> int:
        """Returns the number of frames."""
        return len(self.positions)

    @property
    def seconds(self) -> float:
        """Returns the duration: frames over frames a second."""
        return self.num_frames / self.fps

    def save(self, path: str | Path) -> None:
        """Writes the motion; the suffix chooses the format (see `motion_formats`).

        Raises:
            UserError: The suffix is unknown or the file cannot be written.
        """
        save_motions(path, [self])

    def __repr__(self) -> str:
        caption = f", {self.caption!r}" if self.caption else ""
        return f"Motion({self.num_frames} frames, {self.seconds:.2f} s, {self.skeleton.name}{caption})"

    def _repr_html_(self) -> str:
        """Returns an interactive viewer, for notebooks."""
        return _entry_points(_VIEWERS)["html"].load()([self], embed=True)


def _entry_points(group: str) -> dict[str, EntryPoint]:
    """Returns what installed packages registered in a group, by name.

    Raises:
        UserError: Nothing is registered, which happens when the source tree is used without an installation.
    """
    found = {point.name: point for point in entry_points(group=group)}
    if not found:
        raise UserError(f"nothing is registered as {group}; install the package (pip install -e . in a source tree)")
    return found


def motion_formats() -> tuple[str, ...]:
    """Returns the suffixes that motions can be saved under, without dots, sorted."""
    return tuple(sorted(_entry_points(_FORMATS)))


def check_output(path: str | Path) -> None:
    """Raises `UserError` where a motion could not be saved: so that it is said before the work is done."""
    path, formats = Path(path), motion_formats()
    if path.suffix.lower().removeprefix(".") not in formats:
        known = ", ".join(f".{name}" for name in formats)
        raise UserError(f"{path}: no motion format has the suffix {path.suffix!r}; use one of {known}")
    if not path.parent.is_dir():
        raise UserError(f"{path}: the folder {path.parent} does not exist; make it first")
    try:
        possible = not path.is_dir() and os.access(path if path.exists() else path.parent, os.W_OK)
    except OSError as error:
        raise UserError(f"{path}: cannot be written ({error.strerror}); choose another name") from error
    if not possible:
        raise UserError(f"{path}: cannot be written; choose another place")


def save_motions(path: str | Path, motions: Sequence[Motion]) -> None:
    """Writes motions into one file; the suffix chooses the format. Some formats hold exactly one motion.

    Raises:
        UserError: The suffix is unknown, the format does not hold that many, or the file cannot be written.
    """
    path = Path(path)
    check_output(path)
    save = _entry_points(_FORMATS)[path.suffix.lower().removeprefix(".")].load()
    try:
        save(path, motions)
    except OSError as error:
        raise UserError(f"{path}: cannot be written ({error})") from error
