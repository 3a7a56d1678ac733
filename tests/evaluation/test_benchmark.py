"""The benchmark: its packaged evaluators, its columns, and the command on a small model."""

import json

import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax.checkpoints.bundle import save_bundle
from t2m_jax.checkpoints.evaluator import PACKAGED, evaluator_path, load_trained_evaluator, save_evaluator
from t2m_jax.cli.main import main
from t2m_jax.data.folder import open_dataset
from t2m_jax.data.importers.synthetic import write_synthetic_dataset
from t2m_jax.errors import UserError
from t2m_jax.evaluation import benchmark
from t2m_jax.evaluation.report.record import Following, Header, Metric, Report, load_report, save_report
from t2m_jax.evaluation.report.tables import make_table
from t2m_jax.evaluation.run import unit_vectors
from t2m_jax.metrics.frechet import fid
from tests.tiny import random_bundle, random_evaluator

HEADER = Header(
    protocol="benchmark",
    data="d",
    split="test",
    num_samples=64,
    evaluator="ab",
    seed=0,
    weights="ab",
    contents="cd",
    unit=4,
    batch=32,
)
FINGERPRINTS = {"benchmark-free": "50125f28dc66a6f7", "benchmark-nc": "5abf2cadec5c9ecd"}
"""Figures with other evaluators cannot be compared, so a packaged one does not change."""


@pytest.mark.parametrize("name", PACKAGED)
def test_packaged_evaluators_are_small_and_the_same_as_ever(name):
    assert load_trained_evaluator(name).fingerprint == FINGERPRINTS[name]
    assert sum(path.stat().st_size for path in evaluator_path(name).iterdir()) < 3_000_000


def test_the_run_of_an_evaluator_is_packed(tmp_path, capsys):
    packaged = f"{evaluator_path('benchmark-free')}"
    assert main(["bundle", packaged, f"{tmp_path / 'mine'}"]) == 0
    assert load_trained_evaluator(tmp_path / "mine").fingerprint == FINGERPRINTS["benchmark-free"]
    for option in (["--card", "card.md"], ["--private"]):
        assert main(["bundle", packaged, f"{tmp_path / 'other'}", *option]) == 2
        assert "--card, --push, --private, --export-official are for models" in capsys.readouterr().err


def test_lengths_of_embeddings_do_not_change_the_normalized_distance():
    generator = np.random.default_rng(0)
    one, other = (generator.normal(size=(40, 3)).astype(np.float32) + 1 for _ in range(2))
    scaled = one * generator.uniform(0.5, 2, (40, 1)).astype(np.float32)
    plain, normalized = (
        [float(fid(jnp.asarray(a), jnp.asarray(b))) for a in (one, scaled)]
        for one, scaled, b in ((one, scaled, other), (*map(unit_vectors, (one, scaled)), unit_vectors(other)))
    )
    assert abs(plain[0] - plain[1]) > 0.01
    np.testing.assert_allclose(normalized[0], normalized[1], rtol=1e-4)
    assert not unit_vectors(np.zeros((2, 3), np.float32)).any()


def figures(**values):
    return {name: Metric(value, 0.1, (value,)) for name, value in values.items()}


def test_text_following_is_kept_and_is_a_column(tmp_path):
    groups = {"free": Following(right=3, samples=4), "all-actions": Following(right=0, samples=4)}
    report = Report(header=HEADER, kind="generated", real=figures(fid=0.1), measured=figures(fid=1.0), following=groups)
    save_report(tmp_path / "report.json", report)
    assert load_report(tmp_path / "report.json") == report
    table = make_table([report, report], ["a", "b"], measures="benchmark")
    cell = table.lines[1].cells["text_following"]
    assert cell.mean == 3 / 8 and abs(cell.interval - 1.96 * (3 / 8 * 5 / 8 / 8) ** 0.5) < 1e-9
    assert [column.heading for column in table.columns] == ["FID", "Follows"]
    assert "text_following" not in make_table([report], ["a"]).lines[1].cells


@pytest.mark.parametrize(
    "entry", [{}, {"free": {"right": 5, "samples": 4}}, {"free": {}}, {"f\x1b": {"right": 1, "samples": 4}}]
)
def test_counts_that_do_not_fit_are_refused(tmp_path, entry):
    good = Report(header=HEADER, kind="generated", real=figures(fid=0.1), measured=figures(fid=1.0))
    save_report(tmp_path / "report.json", good)
    data = json.loads((tmp_path / "report.json").read_text())
    del data["checksum"]
    (tmp_path / "report.json").write_text(json.dumps(data | {"following": entry}))
    with pytest.raises(UserError, match="is not a report with the metrics"):
        load_report(tmp_path / "report.json")


def test_other_lists_or_captions_are_not_the_benchmark(tmp_path):
    data = tmp_path / "data"
    write_synthetic_dataset(data, num_clips=20, seed=3)
    found = benchmark.lists_digest(open_dataset(data))
    with pytest.raises(UserError, match=f"captions \\({found}\\) are not the frozen ones of track free"):
        benchmark.check_track(open_dataset(data), "free")
    text = data / "texts" / f"{open_dataset(data).names('test')[0]}.txt"
    before = text.read_text()
    text.write_text(before.replace("a ", "the ", 1))
    assert benchmark.lists_digest(open_dataset(data)) != found
    text.write_text(before)


def test_each_track_has_an_evaluator_and_lists_of_its_own():
    assert tuple(track.evaluator for track in benchmark.TRACKS.values()) == PACKAGED
    assert len({track.lists for track in benchmark.TRACKS.values()}) == len(benchmark.TRACKS)


@pytest.mark.slow
def test_a_report_has_the_unit_of_both_systems_and_text_following(tmp_path, monkeypatch, capsys):
    data = tmp_path / "data"
    write_synthetic_dataset(data, num_clips=240, seed=3)
    track = benchmark.BenchmarkTrack(f"{data}", f"{tmp_path / 'evaluator'}", benchmark.lists_digest(open_dataset(data)))
    monkeypatch.setattr(benchmark, "TRACKS", {"free": track})
    monkeypatch.setattr(benchmark, "GROUPS", ("durations",))
    evaluator = random_evaluator()._replace(normalizer=open_dataset(data).normalizer)
    save_evaluator(tmp_path / "evaluator", evaluator)
    save_bundle(tmp_path / "gpt", random_bundle(), card="")
    file = tmp_path / "gpt.json"
    assert main(["benchmark", f"{tmp_path / 'gpt'}", "--num-repeats", "1", "--json", f"{file}"]) == 0
    assert "durations: " in capsys.readouterr().out
    report = load_report(file)
    # Its tokenizer has four frames per code, that of a HiFiGPT eight; other units could not be compared.
    assert report.header.unit == 8 and report.following["durations"].samples == 24
    assert {"fid_normalized", "r_precision_1"} <= set(report.measured)
