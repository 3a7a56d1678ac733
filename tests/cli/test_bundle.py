"""`t2m bundle`: what it refuses (the way to a bundle is walked in tests/train)."""


def test_what_is_no_run_is_refused(refusal, bundle_folder, tmp_path):
    assert "not a run directory" in refusal("bundle", bundle_folder, tmp_path / "out")
    assert not (tmp_path / "out").exists()
