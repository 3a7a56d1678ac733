"""A viewer in one HTML file, which contains the motions and the program that draws them and loads nothing else."""

import base64
import importlib.resources
import json
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from t2m_jax.errors import UserError
from t2m_jax.export.render.figure import TINTS
from t2m_jax.export.render.scene import SceneFigure, figure_from_motion
from t2m_jax.files.template import fill_template
from t2m_jax.files.writing import save_text
from t2m_jax.motion.formats import notebook_frame
from t2m_jax.motion.motion import Motion

VIEWER_SCRIPTS = (
    "vendor/three.min.js",
    "figures.js",
    "camera.js",
    "body.js",
    "ground.js",
    "scenery.js",
    "cell.js",
    "stage.js",
)
"""The renderer, in this order; other pages use it, too."""
STUDIO_SCRIPTS = ("vendor/three-character.min.js", *VIEWER_SCRIPTS[1:], "character.js", "miniature.js")
"""That of the studio, which also shows characters of GLB files."""
LICENSE = "vendor/LICENSE"
"""That of three.js, which every copy must have."""
FINEST_STEP = 4e-4
"""Meters. Points are stored in steps of this size, or in larger steps if a figure travels beyond 3 m."""


def save_html(path: Path, motions: Sequence[Motion]) -> None:
    """Writes one HTML file that shows the motions side by side."""
    save_text(path, viewer_html(motions, embed=False))


def scene_record(motions: Sequence[Motion]) -> dict[str, Any]:
    """Returns what the viewer shows as plain data: figures of the motions, and the seconds of the longest."""
    if not motions:
        raise UserError("there is no motion to draw; give at least one")
    figures = [figure_from_motion(motion) for motion in motions]
    seconds = max(len(figure.points) / figure.fps for figure in figures)
    records = [
        _figure_record(figure) | {"sentences": list(zip(motion.part_starts, motion.part_captions, strict=True))}
        for figure, motion in zip(figures, motions, strict=True)
    ]
    return {"seconds": seconds, "figures": records}


def viewer_script(*scripts: str) -> str:
    """Returns scripts of the viewer as one program, which defines `window.T2M`."""
    files = [f"/*!\n{_asset(LICENSE)}\n*/", *map(_asset, scripts)]
    return "(() => {\n" + "\n".join(['"use strict";', *files]) + "\n})();"


def stage_style() -> str:
    """Returns the style sheet of the renderer."""
    return _asset("stage.css")


def _asset(name: str) -> str:
    folder = importlib.resources.files("t2m_jax.export") / "viewer"
    return (folder / name).read_text(encoding="utf-8").rstrip("\n")


def viewer_html(motions: Sequence[Motion], *, embed: bool = True) -> str:
    """Returns the viewer as an HTML page or, with `embed`, as an iframe that contains the page, for notebooks."""
    data = json.dumps(scene_record(motions), ensure_ascii=True, separators=(",", ":"))  # keeps lone surrogates
    style = f"{_asset('viewer.css')}\n{stage_style()}"
    parts = {
        "style": style,
        "script": _compressed(viewer_script(*VIEWER_SCRIPTS, "viewer.js")),
        "data": _compressed(data),
    }
    # Readable, too: the program is compressed.
    parts["license"] = _asset(LICENSE)
    page = fill_template("t2m_jax.export", "viewer/viewer.html", parts)
    return notebook_frame(page) if embed else page


def _compressed(text: str) -> str:
    """Returns a text as the pages hold it, so that they are small: deflated, in base64."""
    return base64.b64encode(zlib.compress(text.encode(), 9)).decode("ascii")


def _figure_record(figure: SceneFigure) -> dict[str, Any]:
    """Returns one figure as plain data.

    Its points are steps from their center. For each coordinate, one after another, `data` has the second differences of
    the steps over time, which compress well: base64 of little-endian 16-bit numbers, modulo 2**16.
    """
    num_frames, num_points, _ = figure.points.shape
    axes = np.ascontiguousarray(figure.points.reshape(-1, 3).T)  # along contiguous values NumPy is much faster
    low = axes.min(axis=1)
    high = axes.max(axis=1)
    origin = (low + high).astype(np.float64) / 2
    # 16 bits for the largest coordinate, but no finer than anybody can see: small steps compress badly.
    step = max(float((high - low).max()) / 2 / 32767, FINEST_STEP)
    steps = np.rint((figure.points - origin) / step).clip(-32767, 32767).astype("<i2").reshape(num_frames, -1).T
    for _ in range(2):
        steps = np.diff(steps, prepend=np.zeros_like(steps[:, :1]))
    parts = [
        [part.start, part.end, round(part.start_radius, 4), round(part.end_radius, 4), TINTS.index(part.tint)]
        for part in figure.parts
    ]
    return {
        "caption": figure.caption,
        "fps": figure.fps,
        "frames": num_frames,
        "points": num_points,
        "contacts": [[one.first, one.last, round(one.x, 3), round(one.z, 3)] for one in figure.contacts],
        "lift": figure.lift,
        "step": step,
        "origin": [float(value) for value in origin],
        "parts": parts,
        "data": base64.b64encode(steps.tobytes()).decode("ascii"),
    }
