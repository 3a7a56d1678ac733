"""Report files: what is written is read back, older files are read, other files are refused."""

import dataclasses
import json

import pytest

from t2m_jax.errors import UserError
from t2m_jax.evaluation.report.record import (
    MAX_REPORT,
    Header,
    Metric,
    ReconstructionFigures,
    Report,
    load_report,
    save_report,
)

HEADER = {"protocol": "strict", "data": "d_1", "split": "test", "num_samples": 64, "evaluator": "ab%c", "seed": 0}
METRIC = {"mean": 1.5, "interval": 0.5, "repeats": [1.0, 2.0]}
ROWS = {"real": {"fid": METRIC}, "generated": {"fid": METRIC}}
FIGURES = ReconstructionFigures(
    mpjpe_mm=30.5,
    mpjpe_median_clip_mm=20.0,
    codebook_usage=0.5,
    perplexity=7.0,
    num_clips=3,
    num_frames=99,
    split="test",
)


def test_a_report_is_read_as_it_was_written(tmp_path):
    header = Header(**HEADER, unit=8, batch=16, sampling="sampled", temperature=0.5, top_k=3)
    metrics = {"fid": Metric.from_repeats([1.0, 2.0, 4.0])}
    for kind, figures in (("generated", None), ("reconstruction", FIGURES)):
        report = Report(header=header, kind=kind, real=metrics, measured=metrics, reconstruction=figures)
        save_report(tmp_path / "report.json", report)
        assert load_report(tmp_path / "report.json") == report


def test_figures_of_a_reconstruction_are_beside_the_header(tmp_path):
    report = Report(header=Header(**HEADER), kind="reconstruction", real={}, measured={}, reconstruction=FIGURES)
    save_report(tmp_path / "report.json", report)
    found = json.loads((tmp_path / "report.json").read_text())
    assert dataclasses.asdict(FIGURES).items() <= found.items() and HEADER.items() <= found.items()


def test_a_report_of_version_0_1_has_its_unit_and_batch(tmp_path):
    old = HEADER | {"model": "demo", "sampling": "greedy", "left_out_for_shared_source": None}
    path = tmp_path / "report.json"
    path.write_text(json.dumps(old | {"rows": ROWS}))
    report = load_report(path)
    assert (report.kind, report.header.unit, report.header.batch) == ("generated", 4, 32)
    assert (report.header.sampling, report.header.temperature) == ("greedy", None)
    assert report.measured == {"fid": Metric(1.5, 0.5, (1.0, 2.0))}


@pytest.mark.parametrize(
    "content",
    [
        "{",
        "[]",
        "{}",
        "null",
        '{"rows": {}}',
        '{"rows": 3}',
        json.dumps({"rows": {"real": {}, "generated": {}}}),
        json.dumps(HEADER | {"rows": {"generated": {}}}),
        json.dumps(HEADER | {"rows": {"real": {}, "generated": {}, "reconstruction": {}}}),
        json.dumps(HEADER | {"rows": {"real": {"fid": METRIC | {"mean": "1"}}, "generated": {}}}),
        json.dumps(HEADER | {"rows": {"real": {"fid": METRIC | {"repeats": []}}, "generated": {}}}),
        json.dumps(HEADER | {"rows": {"real": {"fid": METRIC | {"repeats": "12"}}, "generated": {}}}),
        json.dumps(HEADER | {"rows": ROWS | {"generated": {}}}),
        json.dumps(HEADER | {"rows": {"real": {"fid": METRIC}, "measured": {"fid": METRIC}}}),
        json.dumps(HEADER | {"rows": ROWS | {"real": {"fid\u001b[2J": METRIC}}}),
        json.dumps(HEADER | {"rows": ROWS | {"real": {"fid": METRIC | {"mean": True}}}}),
        json.dumps(HEADER | {"rows": ROWS | {"real": {"fid": METRIC | {"mean": 10**400}}}}),
        json.dumps(HEADER | {"rows": ROWS | {"real": {"fid": METRIC | {"repeats": [float("inf")]}}}}),
        json.dumps(HEADER | {"rows": ROWS, "batch": "32"}),
        json.dumps(HEADER | {"rows": ROWS, "model": "\u001b[2J"}),
        json.dumps(HEADER | {"rows": ROWS, "mpjpe_mm": 3.0}),
    ],
)
def test_other_files_are_refused(content, tmp_path):
    (tmp_path / "report.json").write_text(content)
    with pytest.raises(UserError, match=r"report\.json: (is not a report|cannot be read as JSON)"):
        load_report(tmp_path / "report.json")


def test_a_report_that_is_too_large_is_refused_before_it_is_read(tmp_path):
    (tmp_path / "report.json").write_text(json.dumps(HEADER | {"rows": ROWS}) + " " * MAX_REPORT)
    with pytest.raises(UserError, match=r"report\.json: has [\d,]+ bytes; at most 2,000,000 are read"):
        load_report(tmp_path / "report.json")
