"""Runs notebooks and saves them with small outputs: `python notebooks/run.py [NOTEBOOK...]`, by default all.

Interactive viewers are removed, because each has 200 kB and code hosts do not show them. Plots are stored with a
palette.
"""

import base64
import io
import sys
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from PIL import Image

PLOT = (64, Image.Quantize.MEDIANCUT)
SCENE = (32, Image.Quantize.MAXCOVERAGE)
"""Number of colors and how they are chosen: in plots, each must stay what it is; in pictures of motions, rare ones must
be kept."""


def small_picture(data: str, *, is_plot: bool) -> str:
    """Returns a PNG picture (base64) with fewer colors."""
    num_colors, method = PLOT if is_plot else SCENE
    picture = Image.open(io.BytesIO(base64.b64decode(data))).convert("RGB")
    stream = io.BytesIO()
    # Dots of dithering would make the file larger.
    few = picture.quantize(num_colors, method=method, dither=Image.Dither.NONE)
    few.save(stream, "PNG", optimize=True)
    return base64.b64encode(stream.getvalue()).decode("ascii")


def run_notebook(path: Path) -> None:
    """Executes a notebook and saves it."""
    notebook = nbformat.read(path, as_version=4)
    NotebookClient(notebook, timeout=1800, kernel_name="python3").execute()
    for cell in notebook.cells:
        cell.metadata.pop("execution", None)  # times change with every run
        for output in cell.get("outputs", []):
            data = output.get("data", {})
            for unwanted in ("text/html", "image/jpeg"):  # PIL images come as PNG, too
                data.pop(unwanted, None)
            if "image/png" in data:
                is_plot = data["text/plain"].startswith("<Figure")
                data["image/png"] = small_picture(data["image/png"], is_plot=is_plot)
        if "outputs" in cell:
            cell.outputs = [output for output in cell.outputs if output.get("data", True)]
    notebook.metadata.language_info = {"name": "python"}
    nbformat.write(notebook, path)


if __name__ == "__main__":
    for name in sys.argv[1:] or sorted(Path(__file__).parent.glob("*.ipynb")):
        run_notebook(Path(name))
        print(name)
