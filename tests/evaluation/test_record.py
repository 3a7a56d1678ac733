"""Report files: what is written is read back, other files are refused."""

import contextlib
import dataclasses
import json

import pytest

from t2m_jax.errors import UserError
from t2m_jax.evaluation.prompts.results import PromptReport, PromptResult, load_prompt_report, save_prompt_report
from t2m_jax.evaluation.report.record import (
    MAX_REPORT,
    Header,
    Metric,
    QualityFigures,
    ReconstructionFigures,
    Report,
    load_reconstruction,
    load_report,
    save_reconstruction,
    save_report,
)

HEADER = {
    "protocol": "strict",
    "data": "d_1",
    "split": "test",
    "num_samples": 64,
    "evaluator": "ab%c",
    "weights": "ab",
    "contents": "cd",
    "seed": 0,
    "unit": 8,
    "batch": 16,
}
METRIC = {"mean": 1.5, "interval": 0.5, "repeats": [1.0, 2.0]}
ROWS = {"real": {"fid": METRIC}, "generated": {"fid": METRIC}}
QUALITY = QualityFigures(
    bone_variation=0.01, jerk=9.0, skating_ratio=0.1, skating_speed=0.2, floating=0.3, penetration=0.4
)
FIGURES = ReconstructionFigures(
    mpjpe_mm=30.5,
    mpjpe_median_clip_mm=20.0,
    codebook_usage=0.5,
    perplexity=7.0,
    num_clips=3,
    num_frames=99,
    split="test",
    global_mpjpe_mm=40.0,
    acceleration_error_mm=2.0,
    path_drift_mm=50.0,
    heading_drift_degrees=3.0,
    real_quality=QUALITY,
    quality=QUALITY,
    cleaned_quality=QUALITY,
)


def test_a_report_is_read_as_it_was_written(tmp_path):
    header = Header(**HEADER, sampling="sampled", temperature=0.5, top_k=3)
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


def saved_reports(folder):
    """Writes a report of each kind, and returns what reads each."""
    header, metrics = Header(**HEADER), {"fid": Metric.from_repeats([1.0, 2.0, 4.0])}
    save_report(folder / "all.json", Report(header=header, kind="generated", real=metrics, measured=metrics))
    save_reconstruction(folder / "figures.json", FIGURES)
    result = PromptResult(name="walk", right=1, samples=2, failures=("a man walks",), instead=(("run", 1),))
    save_prompt_report(folder / "prompts.json", PromptReport(group="kit", motion="cleaned", contents=(result,)))
    return {"all": load_report, "figures": load_reconstruction, "prompts": load_prompt_report}


@pytest.mark.parametrize("name", ["all", "figures", "prompts"])
def test_a_flipped_bit_is_noticed_or_without_effect(name, tmp_path):
    load, path = saved_reports(tmp_path)[name], tmp_path / f"{name}.json"
    content, intact = path.read_bytes(), load(path)
    for place in range(0, 8 * len(content), 13):
        flipped = bytearray(content)
        flipped[place // 8] ^= 1 << place % 8
        path.write_bytes(flipped)
        with contextlib.suppress(UserError):
            assert load(path) == intact, place


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
        json.dumps({name: value for name, value in HEADER.items() if name != "unit"} | {"rows": ROWS}),
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
