"""Comparing two reports: the paired test, and what does not compare."""

import dataclasses

import numpy as np
import pytest

from t2m_jax.cli.main import main
from t2m_jax.errors import UserError
from t2m_jax.evaluation.report.comparison import PAIRED, compare_reports, comparison_table, sign_test
from t2m_jax.evaluation.report.record import Header, Metric, Report, save_report

HEADER = Header(
    protocol="strict",
    data="d",
    split="test",
    num_samples=64,
    evaluator="abc",
    seed=0,
    weights="ab",
    contents="cd",
    unit=4,
    batch=32,
)
OTHERS = {int: -1, str: "other"}


def report(kind="generated", header=HEADER, **metrics):
    measured = {name: Metric.from_repeats(list(values)) for name, values in metrics.items()}
    return Report(header=header, kind=kind, real={}, measured=measured)


def test_the_test_is_exact_for_few_repeats():
    assert sign_test(np.array([1.0, 2.0, 3.0])) == 2 / 8
    assert sign_test(np.array([1.0, -1.0])) == 1.0
    assert sign_test(np.full(10, 0.5)) == 2 / 2**10
    assert sign_test(np.zeros(5)) == 1.0


def test_chance_is_rarely_called_a_difference():
    generator = np.random.default_rng(1)
    p_values = [sign_test(generator.normal(size=12)) for _ in range(200)]
    assert np.mean(np.array(p_values) < 0.05) < 0.1
    drawn = sign_test(np.r_[generator.normal(1.0, 0.5, 25)])
    assert drawn < 0.001


def test_differences_are_those_of_the_repeats():
    noise = np.random.default_rng(0).normal(size=12)
    found = {row.metric: row for row in compare_reports(report(fid=5 + noise, other=noise), report(fid=4.9 + noise))}
    assert set(found) == {"fid"}
    assert found["fid"].second - found["fid"].first == pytest.approx(-0.1)
    assert found["fid"].p_value < 0.001, "the repeats are not taken in pairs"


def test_generation_compares_with_reconstruction():
    (found,) = compare_reports(report(kind="reconstruction", fid=[1.0, 2.0]), report(fid=[3.0, 4.0]))
    assert found.second - found.first == 2.0


def test_no_chance_is_printed_as_none():
    steady = [compare_reports(report(fid=[1.0] * 20), report(fid=[2.0] * 20))[0]]
    assert steady[0].p_value > 0
    assert comparison_table(["a", "b"], steady).endswith("| < 0.0001 |")


@pytest.mark.parametrize("name", PAIRED)
def test_reports_of_different_kinds_do_not_compare(name):
    other = report(fid=[1.0, 2.0], header=dataclasses.replace(HEADER, **{name: OTHERS[type(getattr(HEADER, name))]}))
    with pytest.raises(UserError, match=f"^{name}: .* evaluate both in the same way"):
        compare_reports(report(fid=[1.0, 2.0]), other)


def test_the_command(tmp_path, capsys):
    for name, shift in (("a", 0.0), ("b", -0.1)):
        save_report(tmp_path / f"{name}.json", report(fid=[5 + shift + n / 7 for n in range(8)]))
    paths = [str(tmp_path / f"{name}.json") for name in "ab"]
    assert main(["evaluate", "compare", *paths]) == 0
    said = capsys.readouterr()
    assert "| fid | 5.500 | 5.400 | **-0.100 ± 0.000** | 0.0078 |" in said.out
    assert said.err == f"next: t2m evaluate table {paths[0]} {paths[1]}\n"
    (tmp_path / "b.json").write_text("[]")
    assert main(["evaluate", "compare", *paths]) == 2
    assert "is not a report" in capsys.readouterr().err
    assert main(["evaluate", "compare", paths[0]]) == 2
    assert "arguments are required: REPORT" in capsys.readouterr().err
