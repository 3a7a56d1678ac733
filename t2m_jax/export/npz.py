"""NumPy archives that keep everything a `Motion` holds."""

import pathlib
import zipfile
import zlib
from collections.abc import Sequence
from typing import Any

import numpy as np

from t2m_jax.errors import UserError
from t2m_jax.export.writing import only_motion, whole_file
from t2m_jax.motion.record import Motion
from t2m_jax.motion.skeleton import HUMANML3D, skeleton_from_name

REQUIRED_KEYS = ("positions", "fps")
OPTIONAL_KEYS = ("features", "codes", "caption", "seed", "skeleton")


def save_npz(path: pathlib.Path, motions: Sequence[Motion]) -> None:
    """Writes one motion as an archive; what the motion does not have gets no entry.

    Entries: `positions` [T, J, 3] metres, `features` [T, D] raw, `codes` [N], `fps`, `caption`, `seed`, `skeleton`.
    """
    motion = only_motion(path, motions)
    entries: dict[str, Any] = {
        "positions": motion.positions,
        "features": motion.features,
        "codes": _flat_codes(motion.codes),
        "fps": motion.fps,
        "caption": motion.caption,
        "seed": motion.seed,
        "skeleton": motion.skeleton.name,
    }
    known = {key: value for key, value in entries.items() if value is not None}
    with whole_file(path) as part, part.open("wb") as file:
        np.savez_compressed(file, **known)


def load_npz(path: str | pathlib.Path) -> Motion:
    """Returns the motion in an archive that `save_npz` wrote, or another program with the same entries.

    Raises:
        UserError: The file is no such archive; the message names the entry.
    """
    path = pathlib.Path(path)
    entries = _read_entries(path)
    for key in REQUIRED_KEYS:
        if key not in entries:
            raise UserError(f"{path}: there is no entry {key!r}; a motion has at least {', '.join(REQUIRED_KEYS)}")
    for key in entries:
        if key not in REQUIRED_KEYS + OPTIONAL_KEYS:
            known = ", ".join(REQUIRED_KEYS + OPTIONAL_KEYS)
            raise UserError(f"{path}: unknown entry {key!r}; a motion has {known}")
    features, codes = entries.get("features"), entries.get("codes")
    skeleton = _text(path, "skeleton", entries["skeleton"]) if "skeleton" in entries else HUMANML3D.name
    try:
        return Motion(
            positions=_numbers(path, "positions", entries["positions"], "f", 3),
            fps=float(_numbers(path, "fps", entries["fps"], "fiu", 0)),
            skeleton=skeleton_from_name(skeleton),
            features=None if features is None else _numbers(path, "features", features, "f", 2),
            codes=None if codes is None else _numbers(path, "codes", codes, "iu", codes.ndim).reshape(len(codes), -1),
            caption=_text(path, "caption", entries["caption"]) if "caption" in entries else "",
            seed=int(_numbers(path, "seed", entries["seed"], "iu", 0)) if "seed" in entries else None,
        )
    except UserError as error:
        if str(error).startswith(str(path)):
            raise
        raise UserError(f"{path}: {error}") from error


def _flat_codes(codes: np.ndarray | None) -> np.ndarray | None:
    """Returns codes [N, R] without the axis of the one code per row, as other programs expect them."""
    return codes[:, 0] if codes is not None and codes.ndim == 2 and codes.shape[1] == 1 else codes


def _read_entries(path: pathlib.Path) -> dict[str, np.ndarray]:
    """Returns all arrays of an archive; nothing in it is ever executed."""
    try:
        with path.open("rb") as file:
            archive = np.load(file, allow_pickle=False)
            if not isinstance(archive, np.lib.npyio.NpzFile):
                raise UserError(f"{path}: this is a single array, not an archive of a motion's entries")
            with archive:
                return {key: _read_entry(path, archive, key) for key in archive.files}
    except FileNotFoundError as error:
        raise UserError(f"{path}: there is no such file") from error
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror or error})") from error
    except (zipfile.BadZipFile, EOFError, ValueError) as error:
        if isinstance(error, UserError):
            raise
        raise UserError(f"{path}: this is no NumPy archive, or only a part of one") from error


def _read_entry(path: pathlib.Path, archive: "np.lib.npyio.NpzFile", key: str) -> np.ndarray:
    """Returns one array of an archive."""
    try:
        return archive[key]
    except ValueError as error:
        raise UserError(f"{path}: entry {key!r} does not hold plain numbers or text") from error
    except (zipfile.BadZipFile, EOFError, zlib.error) as error:
        raise UserError(f"{path}: entry {key!r} is damaged; copy the file again") from error


def _numbers(path: pathlib.Path, key: str, value: np.ndarray, kinds: str, ndim: int) -> np.ndarray:
    """Returns the entry if it holds numbers of one of NumPy's `kinds` and has as many axes as it should."""
    if value.dtype.kind not in kinds or value.ndim != ndim:
        names = {"f": "real numbers", "i": "whole numbers"}
        expected = names["f" if "f" in kinds else "i"]
        raise UserError(
            f"{path}: entry {key!r} should hold {expected} with {ndim} axes, not {value.dtype} {value.shape}"
        )
    return value


def _text(path: pathlib.Path, key: str, value: np.ndarray) -> str:
    """Returns the entry if it is one piece of text."""
    if value.dtype.kind != "U" or value.ndim != 0:
        raise UserError(f"{path}: entry {key!r} should be one text, not {value.dtype} {value.shape}")
    return str(value)
