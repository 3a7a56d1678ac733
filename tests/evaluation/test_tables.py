"""Tables of reports: figures as papers print them, the best of each column, and reports that cannot be compared."""

import dataclasses

import pytest

from t2m_jax.cli.main import main
from t2m_jax.errors import UserError
from t2m_jax.evaluation.report.comparison import compare_reports
from t2m_jax.evaluation.report.formats import format_table, heading
from t2m_jax.evaluation.report.record import COMPARABLE, Header, Metric, Report, save_report
from t2m_jax.evaluation.report.tables import make_table

HEADER = Header(
    protocol="strict",
    data="d_1",
    split="test",
    num_samples=64,
    evaluator="ab%c",
    seed=0,
    weights="ab",
    contents="cd",
    unit=4,
    batch=32,
)
REAL = {"fid": (0.002, 0.0001), "diversity": (9.5, 0.065)}
FITS = {"r_precision_3": (0.8, 0.01)}
OTHERS = {int: -1, str: "other"}


def figures(repeats, **metrics):
    return {name: Metric(mean, interval, (mean,) * repeats) for name, (mean, interval) in metrics.items()}


def report(*, kind="generated", repeats=20, real=REAL, header=HEADER, **metrics):
    return Report(header=header, kind=kind, real=figures(repeats, **real), measured=figures(repeats, **metrics))


def best(table):
    return {(row.name, metric) for row in table.lines for metric, cell in row.cells.items() if cell.best}


@pytest.fixture
def two():
    """Returns two models: the first is better by FID, the second nearer to real motion's diversity."""
    real, other = REAL | FITS, {"r_precision_3": (0.73, 0.002)}
    first = report(real=real, fid=(0.116, 0.0041), diversity=(9.844, 1.0951), multimodality=(1.856, 0.011), **FITS)
    second = report(real=real, fid=(0.1409, 0.0049), diversity=(9.3, 0.08), multimodality=(1.8559, 0.048), **other)
    return make_table([first, second], ["tau_0|a", "b & c"])


def test_the_terminal_shows_columns_in_line(two):
    assert format_table(two, style="terminal") == "\n".join(
        [
            "                R top-3 ↑         FID ↓    Diversity →   MModality ↑",
            "real motion  0.800 ± .010  0.002 ± .000   9.500 ± .065             -",
            "tau_0|a      0.800 ± .010  0.116 ± .004  9.844 ± 1.095  1.856 ± .011",
            "b & c        0.730 ± .002  0.141 ± .005   9.300 ± .080  1.856 ± .048",
            "",
            "Mean and 95 % interval over 20 repeats; protocol strict, data d_1, split test, num samples 64, "
            "evaluator ab%c, seed 0, batch 32.",
        ]
    )


@pytest.mark.parametrize(("suffix", "start"), [("png", b"\x89PNG\r"), ("svg", b"<?xml"), ("pdf", b"%PDF-")])
def test_a_table_is_drawn(tmp_path, suffix, start, capsys):
    paths = [tmp_path / f"{name}.json" for name in ("first", "a$b_c$d")]
    for path, fid in zip(paths, (0.1, 0.2), strict=True):
        save_report(path, report(real=REAL | FITS, fid=(fid, 0.01), diversity=(9.0, 0.1), **FITS))
    plot = tmp_path / f"plot.{suffix}"
    assert main(["evaluate", "table", *map(str, paths), "--plot", f"{plot}"]) == 0
    assert plot.read_bytes().startswith(start)
    assert "FID" in capsys.readouterr().out


@pytest.mark.parametrize("style", ["terminal", "markdown", "latex"])
def test_tables_with_fid_say_if_it_is_of_few_motions(style):
    few = dataclasses.replace(HEADER, fid_motions=64, embedding_dim=33)
    enough, old = dataclasses.replace(few, embedding_dim=32), dataclasses.replace(few, fid_motions=None)
    quality = {"bone_variation": (1.0, 0.1)}
    tables = [
        make_table([report(header=header, real=REAL | quality, fid=(0.1, 0.01), **quality)], ["a"], measures=measures)
        for header, measures in ((few, "captions"), (few, "quality"), (enough, "captions"), (old, "captions"))
    ]
    assert ["Use 66 motions or more." in format_table(table, style=style) for table in tables] == [True] + [False] * 3


def test_bold_of_the_terminal_takes_no_room(two):
    plain, colored = (format_table(two, style="terminal", color=color) for color in (False, True))
    assert colored.replace("\033[1m", "").replace("\033[0m", "") == plain
    assert colored.count("\033[1m") == 5
    assert "\033[1m0.116 ± .004\033[0m  9.844 ± 1.095  \033[1m1.856 ± .011\033[0m\n" in colored


def test_markdown(two):
    assert format_table(two, style="markdown").splitlines()[:5] == [
        "| | R top-3 ↑ | FID ↓ | Diversity → | MModality ↑ |",
        "| --- | ---: | ---: | ---: | ---: |",
        "| real motion | 0.800 ± .010 | 0.002 ± .000 | 9.500 ± .065 | - |",
        r"| tau\_0\|a | **0.800** ± .010 | **0.116** ± .004 | 9.844 ± 1.095 | **1.856** ± .011 |",
        "| b & c | 0.730 ± .002 | 0.141 ± .005 | **9.300** ± .080 | **1.856** ± .048 |",
    ]


def test_latex(two):
    assert format_table(two, style="latex").splitlines() == [
        r"% needs \usepackage{booktabs}",
        r"\begin{table}",
        r"  \centering",
        r"  \caption{Mean and 95 \% interval over 20 repeats; protocol strict, data d\_1, split test, num samples 64, "
        r"evaluator ab\%c, seed 0, batch 32.}",
        r"  \begin{tabular}{lcccc}",
        r"    \toprule",
        r"    & R top-3 $\uparrow$ & FID $\downarrow$ & Diversity $\rightarrow$ & MModality $\uparrow$ \\",
        r"    \midrule",
        r"    real motion & $0.800^{\pm.010}$ & $0.002^{\pm.000}$ & $9.500^{\pm.065}$ & -- \\",
        r"    \midrule",
        r"    tau\_0|a & $\mathbf{0.800}^{\pm.010}$ & $\mathbf{0.116}^{\pm.004}$ & $9.844^{\pm1.095}$ & "
        r"$\mathbf{1.856}^{\pm.011}$ \\",
        r"    b \& c & $0.730^{\pm.002}$ & $0.141^{\pm.005}$ & $\mathbf{9.300}^{\pm.080}$ & "
        r"$\mathbf{1.856}^{\pm.048}$ \\",
        r"    \bottomrule",
        r"  \end{tabular}",
        r"\end{table}",
    ]


def test_figures_that_read_the_same_are_equally_good(two):
    assert best(two) == {
        ("tau_0|a", "r_precision_3"),
        ("tau_0|a", "fid"),
        ("b & c", "diversity"),
        ("tau_0|a", "multimodality"),
        ("b & c", "multimodality"),
    }


@pytest.mark.parametrize(
    ("metric", "winner"),
    [("r_precision_1", "c"), ("fid", "a"), ("matching_score", "a"), ("diversity", "b"), ("multimodality", "c")],
)
def test_the_arrow_says_which_is_best(metric, winner):
    real = {"diversity": (9.5, 0.0), "r_precision_3": (0.8, 0.0)}
    figures = [{"r_precision_3": (0.8, 0.0), metric: (mean, 0.0)} for mean in (9.0, 9.4, 9.7)]
    found = best(make_table([report(real=real, **one) for one in figures], list("abc")))
    assert {(name, marked) for name, marked in found if marked == metric} == {(winner, metric)}


@pytest.mark.parametrize(
    ("precisions", "marked", "arrow"),
    [
        ((0.73, 0.9, 0.71), {"b"}, " ↑"),
        ((0.73, 0.1, 0.2), set(), " ↑"),
        ((0.71, 0.1, 0.2), set(), ""),
    ],
)
def test_variety_counts_only_if_motion_fits_its_captions(precisions, marked, arrow):
    """At least 0.9 of real motion's 0.8; the last model ignores its captions and has the most variety."""
    reports = [
        report(real=FITS, r_precision_3=(precision, 0.0), multimodality=(variety, 0.0))
        for precision, variety in zip(precisions, (1.0, 2.0, 9.0), strict=True)
    ]
    table = make_table(reports, list("abc"))
    assert {name for name, metric in best(table) if metric == "multimodality"} == marked
    assert heading(table.columns[-1]) == f"MModality{arrow}"


def test_variety_is_not_judged_without_r_precision():
    table = make_table([report(multimodality=(variety, 0.0)) for variety in (1.0, 2.0)], ["a", "b"])
    assert not best(table) and heading(table.columns[-1]) == "MModality"


def test_real_motion_and_reconstruction_do_not_compete():
    generated = report(fid=(0.2, 0.01))
    reconstruction = report(kind="reconstruction", fid=(0.07, 0.001))
    assert not best(make_table([generated, reconstruction], ["a", "b"])), "one generated row has no rival"
    rows = make_table([generated, reconstruction, report(fid=(0.3, 0.01))], ["a", "b", "c"])
    assert best(rows) == {("a", "fid")}
    assert [row.kind for row in rows.lines] == ["real", "generated", "reconstruction", "generated"]


def test_real_motion_is_that_of_the_longest_report():
    short, long = report(repeats=2, fid=(0.2, 0.0)), report(repeats=20, real={"fid": (0.5, 0.0)}, fid=(0.3, 0.0))
    table = make_table([short, long], ["a", "b"])
    assert table.lines[0].cells["fid"].mean == 0.5
    assert "over 2 to 20 repeats" in format_table(table, style="terminal")


@pytest.mark.parametrize("style", ["terminal", "markdown", "latex"])
def test_a_single_repeat_has_no_interval(style):
    """`0.112 ± .000` would look like a figure that is certain."""
    reports = [report(repeats=1, fid=(0.1119, 0.0), **FITS), report(repeats=1, fid=(0.2, 0.0), **FITS)]
    text = format_table(make_table(reports, ["a", "b"]), style=style)
    assert "0.112" in text
    assert "Figures of one repeat; protocol strict" in text
    assert not any(mark in text for mark in ("±", "\\pm", "nan", "interval"))


@pytest.mark.parametrize("name", COMPARABLE)
def test_reports_of_different_kinds_are_not_put_into_one_table(name):
    other = report(fid=(0.2, 0.0), header=dataclasses.replace(HEADER, **{name: OTHERS[type(getattr(HEADER, name))]}))
    with pytest.raises(UserError, match=f"^{name}: .* in a, (-1|other) in b; make a table for each"):
        make_table([report(fid=(0.2, 0.0)), other], ["a", "b"])


def test_reports_of_other_contents_are_not_put_into_one_table():
    headers = [dataclasses.replace(HEADER, contents=contents) for contents in ("abc", "abd")]
    first, other = (report(fid=(0.2, 0.0), header=header) for header in headers)
    with pytest.raises(UserError, match=r"^contents: abc in a, abd in b; make a table for each"):
        make_table([first, other], ["a", "b"])
    with pytest.raises(UserError, match=r"^contents: abc in one report, abd in the other"):
        compare_reports(first, other)


def test_tokenizers_with_other_units_can_be_in_one_table():
    other = report(fid=(0.3, 0.0), header=dataclasses.replace(HEADER, unit=8))
    assert best(make_table([report(fid=(0.2, 0.0)), other], ["a", "b"])) == {("a", "fid")}


@pytest.mark.parametrize("style", ["terminal", "markdown", "latex"])
def test_a_name_stays_in_its_cell(style):
    name = "a\n\x1b[2J\\begin{x}"
    lines = format_table(make_table([report(fid=(0.2, 0.0))], [name]), style=style).splitlines()
    assert sum("0.200" in line for line in lines) == 1
    expected = {"terminal": "a \\x1b[2J\\begin{x}", "markdown": "begin{x}", "latex": r"\textbackslash{}begin\{x\}"}
    assert any(expected[style] in line for line in lines)


@pytest.mark.parametrize("style", ["terminal", "markdown", "latex"])
def test_no_line_can_change_the_terminal(style):
    names = ["\x1b[31mred", "\x9b31m\x7f\u202e", "Ä \U000e0001 走る \udc80"]
    header = dataclasses.replace(HEADER, data="\x1b[31m\x9b31m")
    text = format_table(make_table([report(fid=(0.2, 0.0), header=header)] * 3, names), style=style)
    assert all(line.isprintable() for line in text.split("\n"))
    assert "Ä" in text and "走る" in text


def command(*words):
    return main(["evaluate", "table", *(str(word) for word in words)])


@pytest.fixture
def files(tmp_path):
    paths = [tmp_path / folder / "report.json" for folder in ("one", "two")]
    for number, path in enumerate(paths):
        path.parent.mkdir()
        save_report(path, report(fid=(0.1 + number / 10, 0.0)))
    return paths


def test_rows_bear_the_names_of_files_or_those_given(files, capsys):
    assert command(files[0]) == 0
    assert capsys.readouterr().out.splitlines()[2].startswith("report ")
    for given, expected in (([], [str(path) for path in files]), (["--names", "x", "y"], ["x", "y"])):
        command(*files, *given)
        lines = capsys.readouterr().out.splitlines()[2:4]
        assert [line.split("  ")[0].strip() for line in lines] == expected


def test_mistakes_of_the_command_are_one_line(files, tmp_path, capsys):
    for words, says in (
        ([], "the following arguments are required: REPORT"),
        ([*files, "--names", "x"], "1 given for 2"),
        ([*files, "--names", "x", "x"], "not all different"),
        ([tmp_path / "none.json"], "there is no such file"),
    ):
        assert command(*words) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert says in line


def test_a_page_needs_an_evaluator(tmp_path, capsys):
    where = ["--evaluator", "none", "--html", str(tmp_path / "no" / "page.html")]
    assert main(["evaluate", "reconstruction", "--data", str(tmp_path), *where]) == 2
    assert "does not exist" in capsys.readouterr().err
    assert main(["evaluate", "reconstruction", "--data", str(tmp_path), "--html", str(tmp_path / "page.html")]) == 2
    assert "use it with --evaluator" in capsys.readouterr().err


def test_labels_take_the_place_of_pairs():
    given = {"r_precision_1": (0.4, 0.01), "r_precision_1_by_label": (0.6, 0.01), "fid": (1.0, 0.1)}
    table = make_table([report(real=given, **given)], ["a"], measures="labels")
    assert [column.heading for column in table.columns] == ["R top-1 by label", "FID"]
    assert "0.600 ± .010" in format_table(table, style="terminal")
    with pytest.raises(UserError, match="d_1 has no labels"):
        make_table([report(fid=(1.0, 0.1))], ["a"], measures="labels")


def test_quality_has_a_table_of_its_own():
    given = {"jerk": (120.0, 1.0), "bone_variation": (0.03, 0.001), "fid": (1.0, 0.1)}
    table = make_table([report(real=given, **given)], ["a"], measures="quality")
    assert [column.heading for column in table.columns] == ["Bone variation", "Jerk"]
    assert "120.000 ± 1.000" in format_table(table, style="terminal")
    cleaned = make_table([report(real=given, **given, cleaned_jerk=(70.0, 1.0))], ["a"], measures="quality")
    assert [row.name for row in cleaned.lines] == ["real motion", "a", "a, cleaned"]
    assert [row.cells["jerk"].mean for row in cleaned.lines] == [120.0, 120.0, 70.0]
    assert len(make_table([report(real=given, **given, cleaned_jerk=(70.0, 1.0))], ["a"]).lines) == 2
    with pytest.raises(UserError, match="quality: not in these reports; evaluate the models again"):
        make_table([report(fid=(1.0, 0.1))], ["a"], measures="quality")


def test_a_notebook_shows_a_report_as_a_table():
    header = dataclasses.replace(HEADER, fid_motions=60, embedding_dim=512)
    shown = report(fid=(0.116, 0.0041), jerk=(120.0, 1.5), header=header)
    table, warning = shown._repr_markdown_().split("\n\n")
    assert table.splitlines() == [
        "| metric | real | generated |",
        "| --- | ---: | ---: |",
        "| fid | 0.002 ± 0.000 | 0.116 ± 0.004 |",
        "| jerk | | 120.000 ± 1.500 |",
        "| diversity | 9.500 ± 0.065 | |",
    ]
    assert warning == header.fid_warning != ""
