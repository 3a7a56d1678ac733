"""`t2m bundle` and `t2m bench`: what they refuse (the way to a bundle is walked in tests/train)."""

from t2m_jax.cli.main import main


def test_what_is_no_run_is_refused(refusal, bundle_folder, tmp_path):
    assert "not a run directory" in refusal("bundle", bundle_folder, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_bench_prints_one_line_a_batch_size(bundle_folder, capsys):
    arguments = ["--model", f"{bundle_folder}", "--batch", "1", "2", "--codes", "4", "--repeats", "1"]
    assert main(["bench", "sample", *arguments]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(":")[0].split()[-1] for line in lines] == ["1", "2"]
    assert all("ms per code" in line for line in lines)


def test_bench_refuses_numbers_out_of_range(refusal, bundle_folder):
    assert "--codes" in refusal("bench", "sample", "--model", bundle_folder, "--codes", "0")
    assert "--codes" in refusal("bench", "sample", "--model", bundle_folder, "--codes", "1000")
    assert "--batch" in refusal("bench", "sample", "--model", bundle_folder, "--batch", "0")
