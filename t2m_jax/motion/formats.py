"""Files of motions by their suffix. Readers and writers are entry points, so that a package can add a format.

`Motion` uses this module, so the record is not imported here: what is read and written is of that class.
"""

import functools
import html
import inspect
from collections.abc import Sequence
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any, Literal, get_args, get_origin, get_type_hints

from t2m_jax.errors import UserError
from t2m_jax.files.reading import first_line
from t2m_jax.files.writing import check_output
from t2m_jax.motion.resampling import MAX_FPS

MAX_FRAMES = 1_000_000
"""Frames that are read of a file; an hour of motion capture has fewer."""
MAX_SECONDS = 4 * 3600.0
"""A longer motion is taken as an error in its file; at another rate it could fill the memory."""
SINGLE = ("bvh", "npz", "vrma")
"""Formats whose files hold exactly one motion."""
READERS = "t2m_jax.motion_readers"
"""Entry points by suffix: functions of a path that return its motion; they may take an `animation` and a `rig`."""
WRITERS = "t2m_jax.motion_writers"
"""Entry points by suffix: functions of a path, motions and options, each of which is a `Literal` or a `bool`."""


def motion_formats() -> tuple[str, ...]:
    """Returns the suffixes of the formats that motions can be saved in: sorted, without dots."""
    return tuple(sorted(_entry_points(WRITERS)))


def reader_options(path: Path) -> frozenset[str]:
    """Returns which of `animation`, `rig` and `up` can be chosen for a file, by its suffix.

    Raises:
        UserError: The suffix is unknown.
    """
    known = inspect.signature(_entry_point(READERS, path).load()).parameters
    return frozenset(known) & {"animation", "rig", "up"}


def load_motion(
    path: str | Path, *, animation: str | None = None, rig: str | None = None, up: str | None = None
) -> Any:
    """Returns the `Motion` of a file: `.npz`, `.bvh`, `.glb`, `.vrma`, `.amc`, or a data set's `.npy`.

    Args:
        path: The file.
        animation: Name of the animation in a `.glb` file, with or without the armature's name; needed if there are
            several.
        rig: Name of a rig or a YAML table with joints of the file, such as `pelvis: Hips`, for files of skeletons; by
            default they are recognized.
        up: The axis that points up in a file of a skeleton, `y` or `z`; by default found from the figure, and in a
            `.glb` file `y`.

    Raises:
        UserError: The suffix is unknown, the file does not contain a motion, is too long, or has several motions and
            none was chosen, or files of its kind do not have what was chosen.
    """
    path = Path(path)
    read = _entry_point(READERS, path).load()
    if not path.is_file():
        raise UserError(f"{path}: {'is a folder' if path.is_dir() else 'there is no such file'}")
    given = {"animation": animation, "rig": rig, "up": up}
    chosen = {name: value for name, value in given.items() if value is not None}
    if unknown := sorted(chosen.keys() - reader_options(path)):
        raise UserError(f"{unknown[0]}: {path} has none, as all {path.suffix} files; leave it out")
    try:
        motion = read(path, **chosen)
    except (UserError, OSError, MemoryError):
        raise
    except Exception as error:  # a file may say anything, and no list of errors of all libraries is complete
        raise UserError(f"{path}: is not a correct {path.suffix} file ({first_line(error)})") from error
    check_size(path, motion)
    return motion


def check_size(path: Path, motion: Any) -> None:
    """Raises `UserError` if a number of a file makes its motion, a `Motion` or a clip, too large to work with."""
    if motion.fps > MAX_FPS:
        raise UserError(f"{path}: has {motion.fps:g} frames per second; at most {MAX_FPS:g} are read")
    if motion.num_frames > MAX_FRAMES:
        raise UserError(f"{path}: has {motion.num_frames:,} frames; at most {MAX_FRAMES:,} are read")
    if motion.num_frames > MAX_SECONDS * motion.fps:
        raise UserError(f"{path}: has {motion.num_frames / motion.fps:g} seconds; at most {MAX_SECONDS:g} are read")


def check_motion_output(path: str | Path, *, num_motions: int = 1) -> Path:
    """Returns the path of a motion file to write.

    Call this before long work, so that a wrong path is reported first.

    Raises:
        UserError: The suffix is unknown, the format cannot contain that many motions, or the file cannot be written.
    """
    path = Path(path)
    _entry_point(WRITERS, path)
    if num_motions != 1 and path.suffix[1:].lower() in SINGLE:
        several = f"a {path.suffix} file holds exactly one motion, not {num_motions}"
        raise UserError(f"{path}: {several}; write a file for each, or a .glb or .html file")
    return check_output(path)


def format_options(path: str | Path) -> dict[str, tuple[str | bool, ...]]:
    """Returns the options of the format of a file, with the values that each can have."""
    hints = get_type_hints(_entry_point(WRITERS, Path(path)).load())
    choices = {name: get_args(hint) for name, hint in hints.items() if get_origin(hint) is Literal}
    return choices | {name: (False, True) for name, hint in hints.items() if hint is bool}


def save_motions(path: str | Path, motions: Sequence[Any], **options: Any) -> None:
    """Writes motions into one file. The suffix selects the format. Some formats contain exactly one motion.

    Args:
        path: The file.
        motions: What is written.
        **options: See `Motion.save`.

    Raises:
        UserError: The suffix is unknown, the format has no such option or cannot contain that many motions, or the file
            cannot be written.
    """
    # The path and the options are checked before anything is written.
    path = check_motion_output(path, num_motions=len(motions))
    known = format_options(path) if options else {}
    for name, value in options.items():
        if value not in known.get(name, ()):
            choices = (
                ", ".join(map(str, known.get(name, ()))) or f"nothing, because {path.suffix} files have no such option"
            )
            raise UserError(f"{name}: {value!r} is unknown; known is {choices}")
    write = _entry_point(WRITERS, path).load()
    try:
        write(path, motions, **options)
    except OSError as error:
        raise UserError(f"{path}: cannot be written ({error})") from error


def notebook_frame(page: str) -> str:
    """Returns an iframe that contains an HTML page, for notebooks."""
    return (
        f'<iframe srcdoc="{html.escape(page)}" title="Motion viewer" sandbox="allow-scripts" allowfullscreen '
        'style="width: 100%; height: 520px; border: 0; border-radius: 12px"></iframe>'
    )


def _entry_point(group: str, path: Path) -> EntryPoint:
    """Returns the reader or the writer of a file.

    Raises:
        UserError: The suffix is unknown, or the package is not installed.
    """
    found = _entry_points(group)
    suffix = path.suffix.lower().removeprefix(".")
    if suffix not in found:
        known = ", ".join(f".{name}" for name in sorted(found))
        problem = "cannot read motions with" if group == READERS else "no motion format has"
        raise UserError(f"{path}: {problem} the suffix {path.suffix!r}; use one of {known}")
    return found[suffix]


@functools.cache
def _entry_points(group: str) -> dict[str, EntryPoint]:
    """Returns the entry points of a group by name.

    Raises:
        UserError: The group is empty, because the package is not installed.
    """
    found = {point.name: point for point in entry_points(group=group)}
    if not found:
        raise UserError(f"nothing is registered as {group}; install the package (pip install -e . in a source tree)")
    return found
