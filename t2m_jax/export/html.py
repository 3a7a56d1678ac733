"""A viewer in one HTML file, which contains the motions and the program that draws them and loads nothing else."""

import base64
import html
import importlib.resources
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from t2m_jax.export.render.figure import TINTS
from t2m_jax.export.render.scene import Figure, scene_from_motions
from t2m_jax.files import save_text
from t2m_jax.motion.record import Motion

SCRIPTS = ("algebra.js", "figures.js", "camera.js", "shaders.js", "webgl.js", "canvas2d.js", "viewer.js")
ASSETS = (*SCRIPTS, "viewer.html", "viewer.css")
FINEST_STEP = 1e-4
"""Meters. Points are stored in steps of this size, or in larger steps if a figure travels beyond 3 m."""


def save_html(path: Path, motions: Sequence[Motion]) -> None:
    """Writes one HTML file that shows the motions side by side."""
    save_text(path, viewer_html(motions, embed=False))


def scene_record(motions: Sequence[Motion]) -> dict[str, Any]:
    """Returns what the viewer shows as plain data: figures of the motions, and the seconds of the longest."""
    scene = scene_from_motions(motions)
    return {"seconds": scene.seconds, "figures": [_figure_record(figure) for figure in scene.figures]}


def viewer_script() -> str:
    """Returns the program of the viewer."""
    return ""


def viewer_html(motions: Sequence[Motion], *, embed: bool = True) -> str:
    """Returns the viewer as an HTML page or, with `embed`, as an iframe that contains the page, for notebooks."""
    # In a script element only `<` can do harm. ASCII avoids problems with U+2028 and lone surrogates.
    data = json.dumps(scene_record(motions), ensure_ascii=True, separators=(",", ":")).replace("<", "\\u003c")
    assets = importlib.resources.files("t2m_jax.export") / "viewer"
    files = {name: (assets / name).read_text(encoding="utf-8").rstrip("\n") for name in ASSETS}
    script = "(() => {\n" + "\n".join(['"use strict";', *(files[name] for name in SCRIPTS)]) + "\n})();"
    page = files["viewer.html"].replace("/*{{style}}*/", files["viewer.css"]).replace("/*{{script}}*/", script)
    page = page.replace("/*{{data}}*/", data) + "\n"  # last, because captions could contain the other marks
    if not embed:
        return page
    return (
        f'<iframe srcdoc="{html.escape(page)}" title="Motion viewer" sandbox="allow-scripts" allowfullscreen '
        'style="width: 100%; height: 520px; border: 0; border-radius: 12px"></iframe>'
    )


def _figure_record(figure: Figure) -> dict[str, Any]:
    """Returns one figure as plain data. Its points are base64 of little-endian 16-bit steps from their center."""
    num_frames, num_points, _ = figure.points.shape
    low, high = figure.points.min(axis=(0, 1)), figure.points.max(axis=(0, 1))
    origin = (low + high).astype(np.float64) / 2
    step = max(float((high - low).max()) / 2 / 32767, FINEST_STEP)
    steps = np.rint((figure.points - origin) / step).clip(-32767, 32767).astype("<i2")
    parts = [
        [part.start, part.end, round(part.start_radius, 4), round(part.end_radius, 4), TINTS.index(part.tint)]
        for part in figure.parts
    ]
    return {
        "caption": figure.caption,
        "fps": figure.fps,
        "frames": num_frames,
        "points": num_points,
        "head": figure.head,
        "step": step,
        "origin": [float(value) for value in origin],
        "parts": parts,
        "data": base64.b64encode(steps.tobytes()).decode("ascii"),
    }
