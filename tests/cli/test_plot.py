"""`t2m plot`: the loss curves of runs in one figure."""

import io
import sys

import pytest
from PIL import Image

from t2m_jax.cli.main import main
from t2m_jax.evaluation.report.charts import curves_chart
from t2m_jax.train import Run

LOGS = {"train": "step,loss,accuracy\n10,2.5,0.1\n20,1.5,0.2\n", "val": "step,loss\n20,1.75\n"}


@pytest.fixture
def run(tmp_path):
    folder = tmp_path / "a run"
    folder.mkdir()
    for name, text in LOGS.items():
        (folder / f"{name}.csv").write_text(text)
    return folder


def test_the_curves_are_those_of_the_logs(run):
    assert Run(run).curves() == {"train": ([10, 20], [2.5, 1.5]), "val": ([20], [1.75])}
    assert Run(run).curves("accuracy") == {"train": ([10, 20], [0.1, 0.2])}


def test_several_runs_are_in_one_figure(run, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["plot", f"{run}", f"{run}", "-o", "curves.svg"]) == 0
    assert (tmp_path / "curves.svg").is_file()
    said = capsys.readouterr()
    assert (said.out, said.err) == ("curves.svg\n", "next: open curves.svg\n")
    curves = {name: Run(run).curves() for name in ("one", "other")}
    lines = curves_chart(curves, metric="loss").axes[0].get_lines()
    assert [line.get_label() for line in lines] == ["one, train", "one, val", "other, train", "other, val"]
    assert lines[0].get_color() == lines[1].get_color() != lines[2].get_color()
    assert lines[3].get_ydata().tolist() == [1.75]


def test_a_notebook_shows_a_run_as_the_plot_of_its_losses(run, monkeypatch):
    from IPython.core.formatters import DisplayFormatter

    shown = DisplayFormatter(active_types=["text/plain", "image/png"])
    texts, _ = shown.format(Run(f"{run}"))
    with Image.open(io.BytesIO(texts["image/png"])) as picture:
        assert picture.width > picture.height > 500
        assert len(picture.convert("RGB").getcolors(100_000)) > 20  # it is not empty
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    texts, _ = shown.format(Run(f"{run}"))
    assert texts == {"text/plain": f"Run(path='{run}')"}


def test_rows_that_a_crash_cut_are_left_out(run):
    with (run / "train.csv").open("a") as file:
        file.write("30,0.5,0.3,7\n\0\n40,1.25")
    assert Run(run).curves()["train"] == ([10, 20], [2.5, 1.5])


def test_what_cannot_be_drawn_is_refused(run, refusal, tmp_path):
    output = ("-o", tmp_path / "curves.png")
    assert "its logs have no 'fid'; they have accuracy, loss" in refusal("plot", run, "--metric", "fid", *output)
    assert "has no logs of a training" in refusal("plot", tmp_path, *output)
    (run / "val.csv").write_text("step,loss\n20,x\n")
    assert "val.csv: is damaged: a step or a value of loss is not a number" in refusal("plot", run, *output)
    assert not (tmp_path / "curves.png").exists()


def test_what_cannot_be_drawn_is_said_before_the_reports_are_read(tmp_path, refusal, monkeypatch):
    assert "plot.jpg: is not a name for a figure; give a file that ends in .png, .svg, .pdf" in refusal(
        "evaluate", "table", "no.json", "--plot", tmp_path / "plot.jpg"
    )
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert "plot.png: figures need the extra `plot`: pip install 't2m-jax[plot]'" in refusal(
        "evaluate", "table", "no.json", "--plot", tmp_path / "plot.png"
    )
