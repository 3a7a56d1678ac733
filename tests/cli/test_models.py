"""`t2m models`: what there is, and under which license."""

from t2m_jax.checkpoints.bundle import BUNDLED
from t2m_jax.cli.main import main


def test_each_packaged_model_is_a_line_with_its_license(capsys):
    assert main(["models"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.partition(":")[0] for line in lines] == list(BUNDLED)
    licenses = {"demo-free": "cc-by-4.0"}
    for name, line in zip(BUNDLED, lines, strict=True):
        assert line.endswith(f"({licenses.get(name, 'cc-by-nc-4.0')})")


def test_the_card_of_a_model_is_shown(capsys, bundle_folder):
    assert main(["models", f"{bundle_folder}"]) == 0
    assert capsys.readouterr().out == "# tiny\n"


def test_a_model_that_does_not_exist_is_refused(refusal, tmp_path):
    assert f"{tmp_path / 'no'}" in refusal("models", tmp_path / "no")
