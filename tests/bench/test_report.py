import json
import math

import pytest

from t2m_jax.bench import load_report, report_text, save_report
from t2m_jax.bench.record import Figure
from t2m_jax.bench.tables import fitted_table
from t2m_jax.errors import UserError
from tests.bench.conftest import report


def test_a_report_survives_its_file(tmp_path):
    save_report(tmp_path / "report.json", report())
    assert load_report(tmp_path / "report.json") == report()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"format_version": 2}, "format_version 1"),
        ({"rows": 3}, "rows: expected a list"),
        ({"speed": 3}, "unknown entry 'speed'"),
        ({"date": "a\x1b[31m"}, "cannot be printed"),
    ],
)
def test_a_damaged_report_is_refused(tmp_path, change, message):
    path = tmp_path / "report.json"
    save_report(path, report())
    data = json.loads(path.read_text()) | change
    path.write_text(json.dumps(data))
    with pytest.raises(UserError, match="its checksum does not fit"):
        load_report(path)
    del data["checksum"]  # as in files of older versions
    path.write_text(json.dumps(data))
    with pytest.raises(UserError, match=message) as error:
        load_report(path)
    assert str(path) in str(error.value)


def test_a_report_is_shown_as_aligned_markdown():
    text = report_text(report())
    assert "Abacus, 2 cores; 1 x cpu; JAX 0.10.2; 2026-11-21." in text
    table = text.partition("## Training\n\n")[2].splitlines()[:3]
    assert len({len(line) for line in table}) == 1
    assert [cell.strip() for cell in table[2].split("|")[1:-1]] == ["gpt tiny", "10", "4", "1"]


def test_a_table_that_is_too_wide_is_turned():
    headings, rows = [f"heading {number}" for number in range(9)], [[f"{number}" for number in range(9)]]
    wide, narrow = fitted_table(headings, rows), fitted_table(headings, rows, width=40)
    assert max(map(len, wide.splitlines())) > 40 >= max(map(len, narrow.splitlines()))
    assert [line.split()[-2] for line in narrow.splitlines()[2:]] == [f"{number}" for number in range(1, 9)]


def test_a_name_that_moves_the_cursor_is_refused():
    with pytest.raises(ValueError, match="cannot be printed"):
        Figure(name="\x1b[2J", value=math.pi)
