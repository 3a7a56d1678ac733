"""Every notebook runs from the first cell to the last."""

import os
from pathlib import Path

import pytest

from tests.conftest import PROGRAMS

NOTEBOOKS = sorted((Path(__file__).parents[1] / "notebooks").glob("*.ipynb"))
SHORT = {"01_text_to_motion"}
"""Notebooks that `make test-slow` runs; the others take minutes."""
RUN = [
    pytest.param(path, marks=pytest.mark.slow if path.stem in SHORT else pytest.mark.release, id=path.stem)
    for path in NOTEBOOKS
]


@pytest.fixture
def notebook(path):
    import nbformat  # here, because its import takes seconds, and every process of pytest imports this file

    return nbformat.read(path, as_version=4)


@pytest.mark.parametrize("path", RUN)
@pytest.mark.filterwarnings("ignore:Proactor event loop:RuntimeWarning")
def test_notebook_runs(notebook, monkeypatch):
    from nbclient import NotebookClient

    monkeypatch.setenv("T2M_SHORT", "1")  # some updates, repeats and samples
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", os.environ[PROGRAMS])  # most of them use one model
    NotebookClient(notebook, timeout=900, kernel_name="python3").execute()
    outputs = [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]
    assert any("text/html" in output.get("data", {}) for output in outputs), "a viewer is shown"
    assert any("image/png" in output.get("data", {}) for output in outputs), "a plot is shown"


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebooks_are_stored_with_small_outputs(path, notebook):
    """A code host shows the plots of a notebook that was saved by `make notebooks`, and the file stays small."""
    assert path.stat().st_size < 200_000
    outputs = [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]
    assert any("image/png" in output.get("data", {}) for output in outputs)
    assert all(output.output_type != "error" for output in outputs)
