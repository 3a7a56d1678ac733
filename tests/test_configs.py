"""Configs are found by name; tests/lint/test_configs.py loads each of them."""

import pytest

from t2m_jax.cli.main import main
from t2m_jax.cli.train import _config
from t2m_jax.train import TrainVqVaeConfig
from t2m_jax.train.gpt import TrainGptConfig


def test_the_defaults_are_the_published_models():
    """Sizes of T2M-GPT on HumanML3D: the counts of its paper's code, less the unused position table."""
    import jax

    from t2m_jax.checkpoints.bundle import BundleConfig, expected_variables

    vqvae, gpt = TrainVqVaeConfig().model, TrainGptConfig()
    shapes = expected_variables(BundleConfig(tokenizer=vqvae, generator=gpt.model, text_encoder=gpt.caption_encoder))
    counts = {name: sum(leaf.size for leaf in jax.tree.leaves(shapes[name]["params"])) for name in shapes}
    assert counts["tokenizer"] == 19_436_807
    assert counts["generator"] == 228_311_040


def test_a_name_comes_before_a_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "t2m-gpt").mkdir()
    (tmp_path / "t2m-gpt" / "vqvae").write_text("window: 48\n")
    assert _config("vqvae", "t2m-gpt/vqvae").window == 64
    assert _config("vqvae", "./t2m-gpt/vqvae").window == 48


@pytest.mark.parametrize(
    ("kind", "name", "said"),
    [
        ("vqvae", "t2m-gtp/vqvae", "did you mean 't2m-gpt/vqvae'"),
        ("gpt", "configs/t2m-gpt/gtp.yaml", "did you mean 't2m-gpt/gpt'"),
        ("gpt", "oficial", "did you mean 'official'"),
        ("hifigpt", "hifigpt/papr", "did you mean 'hifigpt/paper'"),
        (
            "gpt",
            "nothing.yaml",
            "nothing.yaml: there is no such file, config or preset; `t2m train --list` shows all names",
        ),
    ],
)
def test_names_that_do_not_exist_get_similar_ones(capsys, kind, name, said):
    assert main(["train", kind, name]) == 2
    assert said in capsys.readouterr().err


def test_all_names_are_listed(capsys):
    assert main(["train", "--list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    rows = {tuple(line.split()[:2]) for line in lines}
    assert {("vqvae", "t2m-gpt/vqvae"), ("gpt", "official"), ("evaluator", "evaluator/bandai-namco")} <= rows
    assert len(rows) == len(lines) > 20
