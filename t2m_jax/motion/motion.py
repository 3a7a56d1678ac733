"""`Motion`: one motion with its features, codes and caption. It can save itself in every registered format."""

import dataclasses
import itertools
import math
import tempfile
from collections.abc import Callable, Sequence
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from t2m_jax.errors import UserError
from t2m_jax.field_checks import check_number
from t2m_jax.motion.cleanup import clean_motion
from t2m_jax.motion.formats import load_motion, notebook_frame, save_motions
from t2m_jax.motion.inverse_kinematics import fit_rig
from t2m_jax.motion.joining import join_positions
from t2m_jax.motion.looping import close_loop, find_loop
from t2m_jax.motion.mirroring import mirror_caption, mirror_positions
from t2m_jax.motion.part_captions import fields_within, part_fields
from t2m_jax.motion.paths import Route, follow, route_along, turned_route
from t2m_jax.motion.resampling import check_speed, resample_positions
from t2m_jax.motion.skeleton import HUMANML3D, Skeleton
from t2m_jax.motion.travel import keep_in_place

MAX_METERS = 1e6
"""Largest coordinate. Farther joints would jump in single precision, and their squares would overflow."""


def _without_halves(text: str) -> str:
    """Returns a text with a mark in place of half characters (lone surrogates), which files cannot hold.

    JSON and NumPy's arrays can have them, as can names of files.
    """
    return text.encode("utf-16", "surrogatepass").decode("utf-16", "replace")


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Motion:
    """A moving skeleton. Features and codes are optional."""

    positions: Float[np.ndarray, "T J 3"]
    """Joints in meters, Y up. Positions of features start above the origin and face +Z."""
    fps: float
    """Frames per second."""
    _: dataclasses.KW_ONLY
    positions_raw: Float[np.ndarray, "T J 3"] | None = None
    """Joints as a decoder gave them, if `positions` were cleaned (see `t2m_jax.motion.cleanup`)."""
    skeleton: Skeleton = HUMANML3D
    """Names and hierarchy of the joints."""
    features: Float[np.ndarray, "T D"] | None = None
    """Raw features in the skeleton's unit, as a decoder gave them."""
    codes: Int[np.ndarray, " N"] | Int[np.ndarray, "N R"] | None = None
    """Codebook indices. Residual codebooks have one column per layer."""
    caption: str = ""
    """What the motion shows, or the text that it was generated from."""
    seed: int | None = None
    """The seed that it was sampled with."""
    warning: str = ""
    """Why the motion cannot be what the caption says, if the model that made it warned."""
    unknown_words: tuple[str, ...] = ()
    """Words of the caption that the model had not learned."""
    part_starts: tuple[int, ...] = ()
    """First frame of each sentence, of a motion that was generated from several."""
    part_captions: tuple[str, ...] = ()
    """These sentences."""

    def __post_init__(self) -> None:
        # What becomes an array is taken. The record is frozen, so fields are set as dataclasses set them.
        object.__setattr__(self, "fps", float(self.fps))
        for name, dtype in (("positions", "f4"), ("positions_raw", "f4"), ("features", "f4"), ("codes", None)):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, np.asarray(getattr(self, name), dtype))
        for name in ("caption", "warning"):
            object.__setattr__(self, name, _without_halves(getattr(self, name)))
        for name in ("unknown_words", "part_captions"):
            object.__setattr__(self, name, tuple(map(_without_halves, getattr(self, name))))
        self._check_positions("positions", self.positions)
        if self.positions_raw is not None:
            self._check_positions("positions_raw", self.positions_raw)
            if len(self.positions_raw) != self.num_frames:
                raise UserError(f"positions_raw have {len(self.positions_raw)} frames, positions {self.num_frames}")
        if not (math.isfinite(self.fps) and self.fps > 0):
            raise UserError(f"fps is {self.fps}; give a number above zero")
        expected = (self.num_frames, self.skeleton.feature_dim)
        if self.features is not None and self.features.shape != expected:
            raise UserError(f"features have shape {self.features.shape}; these positions need {list(expected)}")
        if self.codes is not None and (self.codes.ndim not in (1, 2) or self.codes.dtype.kind not in "iu"):
            raise UserError(f"codes have shape {self.codes.shape} and type {self.codes.dtype}; give whole numbers [N]")
        self._check_parts()

    def _check_parts(self) -> None:
        starts = [*self.part_starts, self.num_frames]
        if len(self.part_starts) != len(self.part_captions):
            counts = f"{len(self.part_starts)} part_starts and {len(self.part_captions)} part_captions"
            raise UserError(f"there are {counts}")
        if starts[0] < 0 or any(first >= after for first, after in itertools.pairwise(starts)):
            raise UserError(f"part_starts {list(self.part_starts)} do not rise from 0 to below {self.num_frames}")

    def _check_positions(self, name: str, positions: Float[np.ndarray, "..."]) -> None:
        shape = positions.shape
        joints = self.skeleton.num_joints
        if len(shape) != 3 or shape[1:] != (joints, 3) or shape[0] == 0:
            skeleton = self.skeleton.name
            raise UserError(f"{name} have shape {shape}; skeleton {skeleton} needs [frames, {joints}, 3] with a frame")
        if not np.isfinite(positions).all():
            frame = int(np.argwhere(~np.isfinite(positions))[0, 0])
            raise UserError(f"{name} of frame {frame} are not finite numbers")
        if (farthest := float(np.abs(positions).max())) > MAX_METERS:
            raise UserError(
                f"{name} are up to {farthest:.3g} m from the origin; at most {MAX_METERS:,.0f} m are allowed"
            )

    @property
    def num_frames(self) -> int:
        """Number of frames."""
        return len(self.positions)

    @property
    def seconds(self) -> float:
        """Duration in seconds."""
        return self.num_frames / self.fps

    @property
    def _parts(self) -> dict[int, str]:
        """First frame and text of each sentence, also if there is one for the whole motion."""
        parts = dict(zip(self.part_starts, self.part_captions, strict=True))
        return parts or ({0: self.caption} if self.caption else {})

    @property
    def rotations(self) -> Float[np.ndarray, "T J 3 3"]:
        """Rotation of each joint relative to its parent, whose rest pose is a T-pose, as BVH files have them.

        Raises:
            UserError: The skeleton is not HumanML3D's.
        """
        if self.skeleton.joint_names != HUMANML3D.joint_names:
            raise UserError(f"rotations: there are some for the skeleton {HUMANML3D.name}, not {self.skeleton.name}")
        return fit_rig(self.positions, fps=self.fps).rotations

    # Motions have no `__len__`: with one, `np.array(motions, dtype=object)` asks each for `motion[0]`.
    def __getitem__(self, frames: Any) -> "Motion":
        """Returns some frames, such as `motion[20:60]`, without codes: these stand for several frames each."""
        if not isinstance(frames, slice) or frames.step not in (None, 1):
            raise UserError(f"motion[{frames}]: give a range of frames, such as motion[20:60]")
        parts = {name: getattr(self, name) for name in ("positions", "positions_raw", "features")}
        cut = {name: part[frames] for name, part in parts.items() if part is not None}
        if not len(cut["positions"]):
            raise UserError(f"motion[{frames.start}:{frames.stop}]: has no frames; the motion has {self.num_frames}")
        first, last, _ = frames.indices(self.num_frames)
        return dataclasses.replace(self, **cut, codes=None, **fields_within(self._parts, first, last))

    def trimmed(self, begin: float | None = None, end: float | None = None) -> "Motion":
        """Returns the motion from one time to another in seconds, without codes; None is its own begin or end.

        Raises:
            UserError: No frame is between these times.
        """
        start = 0.0 if begin is None else check_number("begin", begin)
        stop = self.seconds if end is None else min(check_number("end", end), self.seconds)
        # The first comparison finds NaN, which cannot be rounded.
        if not (0 <= start < stop and round(start * self.fps) < round(stop * self.fps)):
            raise UserError(f"begin: {start:g} to {stop:g} s has no frame; the motion has {self.seconds:.2f} s")
        return self[round(start * self.fps) : round(stop * self.fps)]

    def cleaned(self) -> "Motion":
        """Returns the motion with less trembling, constant bones and feet that stand still (`t2m_jax.motion.cleanup`).

        Bones get the medians of their lengths. The positions before are `positions_raw`, unless the motion has some.
        """
        positions = clean_motion(self.positions, fps=self.fps, skeleton=self.skeleton)
        raw = self.positions if self.positions_raw is None else self.positions_raw
        return dataclasses.replace(self, positions=positions, positions_raw=raw)

    def resampled(self, fps: float | int) -> "Motion":
        """Returns the same motion at another frame rate, without features and codes (`resampling.resample_positions`).

        Raises:
            UserError: The rate is not a number above 0, or is too large.
        """
        new_fps = float(check_number("fps", fps))
        # Features and codes belong to one frame rate, so they are dropped.
        result = self._edited(
            lambda old: resample_positions(old, fps=self.fps, new_fps=new_fps, skeleton=self.skeleton), fps=new_fps
        )
        starts = [round(first * new_fps / self.fps) for first in self.part_starts]
        pairs = zip(starts, self.part_captions, strict=True)
        # Of sentences that begin at the same frame of a slow rate, the last one stays.
        parts = {first: text for first, text in pairs if first < result.num_frames}
        return dataclasses.replace(result, part_starts=tuple(parts), part_captions=tuple(parts.values()))

    def at_speed(self, factor: float | int) -> "Motion":
        """Returns the motion faster (or slower, below 1) at the same frame rate, without features and codes.

        Raises:
            UserError: The factor is not a number from 0.1 to 10.
        """
        check_speed(factor)
        starts = [round(start / factor) for start in self.part_starts]
        fast = self._edited(lambda old: resample_positions(old, fps=float(factor), new_fps=1.0, skeleton=self.skeleton))
        # Fast short sentences may fall on one frame, and a part without a frame is not allowed.
        if any(first >= after for first, after in itertools.pairwise([*starts, fast.num_frames])):
            return fast
        return dataclasses.replace(fast, part_starts=tuple(starts), part_captions=self.part_captions)

    def turned(self, degrees: float | int) -> "Motion":
        """Returns the motion on a path that turns evenly by an angle to the left, without features and codes.

        Raises:
            UserError: The angle is too large, or the motion hardly travels.
        """
        return self._moved(turned_route(self.positions, degrees, fps=self.fps))

    def along(self, waypoints: Sequence[Sequence[float | int]]) -> "Motion":
        """Returns the motion on a smooth path through points on the ground, without features and codes.

        It begins at the first point and travels as far as before: after the last point, it goes straight on.

        Args:
            waypoints: Two or more, each x and z in meters. A generated motion faces +z at first, with +x at its left.

        Raises:
            UserError: The points are too few, too far, at one place or turn back, or the motion hardly travels.
        """
        return self._moved(route_along(self.positions, waypoints, fps=self.fps))

    def mirrored(self) -> "Motion":
        """Returns the motion with left and right exchanged, also in its caption, without features and codes."""
        texts: Any = {"caption": mirror_caption(self.caption), "part_starts": self.part_starts}
        texts["part_captions"] = tuple(map(mirror_caption, self.part_captions))
        return self._edited(lambda positions: mirror_positions(positions, self.skeleton), **texts)

    def in_place(self) -> "Motion":
        """Returns the motion without travel: the hips sway around the origin. Features and codes are dropped."""
        parts = {"part_starts": self.part_starts, "part_captions": self.part_captions}
        return self._edited(lambda old: keep_in_place(old, fps=self.fps), **parts)

    def looped(self) -> "Motion":
        """Returns the best part of the motion to play again and again, without features and codes.

        Its last frame has the pose and the velocities of its first, at the place where the motion has come to.

        Raises:
            UserError: The motion is too short, or no part of it repeats.
        """
        loop = find_loop(self.positions, fps=self.fps)
        parts = fields_within(self._parts, loop.start, loop.end + 1)
        return self._edited(lambda old: close_loop(old, loop, fps=self.fps, skeleton=self.skeleton), **parts)

    def __add__(self, other: "Motion") -> "Motion":
        """Returns this motion and then another, which is turned and moved to where this one ends; see `join_positions`.

        Raises:
            UserError: They have different skeletons or frame rates.
        """
        if not isinstance(other, Motion):
            return NotImplemented
        if other.skeleton != self.skeleton:
            names = f"{self.skeleton.name} and {other.skeleton.name}"
            raise UserError(f"motions of different skeletons ({names}) cannot be joined")
        if other.fps != self.fps:
            raise UserError(
                f"{self.fps:g} and {other.fps:g} frames a second cannot be joined; use `resampled` for the same rate"
            )
        options: Any = {"fps": self.fps, "skeleton": self.skeleton}
        positions = join_positions(self.positions, other.positions, **options)
        raw = None
        if self.positions_raw is not None and other.positions_raw is not None:
            raw = join_positions(self.positions_raw, other.positions_raw, **options)
        later = {self.num_frames - 1 + start: text for start, text in other._parts.items()}
        return Motion(positions, positions_raw=raw, **options, **part_fields(self._parts | later))

    def _moved(self, route: Route) -> "Motion":
        parts = {"part_starts": self.part_starts, "part_captions": self.part_captions}
        return self._edited(lambda old: follow(old, route, fps=self.fps, skeleton=self.skeleton), **parts)

    def _edited(self, edit: Callable[[np.ndarray], np.ndarray], **fields: Any) -> "Motion":
        """Returns the motion with other positions, without what does not fit them."""
        # What a decoder gave is changed in the same way, so that both remain comparable.
        raw = None if self.positions_raw is None else edit(self.positions_raw)
        return dataclasses.replace(
            self,
            positions=edit(self.positions),
            positions_raw=raw,
            **{"features": None, "codes": None, "part_starts": (), "part_captions": ()} | fields,
        )

    @classmethod
    def load(cls, path: str | Path) -> "Motion":
        """Returns the motion of a file in any readable format (see `formats.load_motion`).

        Raises:
            UserError: The file does not contain one motion.
        """
        return load_motion(path)

    def save(self, path: str | Path, **options: Any) -> None:
        """Writes the motion. The suffix selects the format (see `motion_formats`).

        Args:
            path: The file.
            **options: Of the format: `.bvh` and `.glb` files have `names="mixamo"`, `units="cm"`, `root_bone=True`.

        Raises:
            UserError: The suffix is unknown, the format has no such option, or the file cannot be written.
        """
        save_motions(path, [self], **options)

    def on_character(self, character: str | Path, path: str | Path, *, rig: str | None = None) -> None:
        """Writes a copy of a character's file in which the character moves as this motion.

        `load_character` and `Character.save` write several motions into one file.

        Args:
            character: A `.glb` or `.vrm` file with a skin, of any size and proportions, in any unit.
            path: The `.glb` file to write: the character with one more animation, which has the motion's frames, rate
                and caption. All else in it stays as it is.
            rig: Name of a rig or a YAML table with the character's bones; by default they are recognized.

        Raises:
            UserError: The character cannot be read, bones of it were not found, the motion has another skeleton than
                the 22 joints of HumanML3D, or the file cannot be written.
        """
        # Loaded by its name, as formats are, because its module imports this one.
        load_character = EntryPoint("character", "t2m_jax.motion.character:load_character", "").load()
        load_character(character, rig=rig).save(path, [self])

    def __repr__(self) -> str:
        caption = f", {self.caption!r}" if self.caption else ""
        return f"Motion({self.num_frames} frames, {self.seconds:.2f} s, {self.skeleton.name}{caption})"

    def _repr_html_(self) -> str:
        """Returns an interactive viewer for notebooks: the page of the format `html` in a frame."""
        with tempfile.TemporaryDirectory() as folder:
            page = Path(folder) / "motion.html"
            self.save(page)
            return notebook_frame(page.read_text(encoding="utf-8"))
