"""The table of the papers' claims: intervals over trainings, and differences that can be told from none."""

import json
import sys

import pytest

from docs.measure import claims


@pytest.fixture
def print_claims(tmp_path, monkeypatch, capsys):
    """Returns a function that writes the FIDs of generators, seed by seed, as reports and returns what is printed."""

    def run(**fids):
        for name, values in fids.items():
            for seed, fid in enumerate(values):
                report = {"rows": {"real": {"fid": {"mean": 0.0}}, "generated": {"fid": {"mean": fid}}}}
                (tmp_path / f"hifigpt-{name.replace('_', '-')}-{seed}.json").write_text(json.dumps(report))
        monkeypatch.setattr(sys, "argv", ["claims.py", str(tmp_path)])
        claims.main()
        return capsys.readouterr().out

    return run


def test_the_interval_is_that_of_three_trainings(print_claims):
    # Student's t with two degrees of freedom is 4.303; the standard error of 1, 2, 3 is 0.577.
    assert "2.000 ± 2.484" in print_claims(rows=(1.0, 2.0, 3.0))


def test_what_is_measured_of_the_same_trainings_is_compared_seed_by_seed(print_claims):
    """Trainings differ by more than guidance changes, but guidance changes each of them alike."""
    without, other = (3.0, 5.1, 6.9), (3.0, 5.1, 6.9)
    printed = print_claims(rows=(4.0, 6.0, 8.0), guidance_1=without, none=other)
    assert "| hifigpt-rows | hifigpt-guidance-1 | fid | +1.000 ± 0.248 | more |" in printed
    (welch,) = (line for line in printed.splitlines() if line.startswith("| hifigpt-rows | hifigpt-none | fid"))
    assert "+1.000 ±" in welch and "cannot be said" in welch


def test_a_claim_without_all_of_its_seeds_is_left_out(print_claims):
    printed = print_claims(rows=(1.0, 2.0, 3.0), none=(1.0, 2.0))
    assert "hifigpt-rows" in printed and "hifigpt-none" not in printed
