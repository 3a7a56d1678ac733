"""The trainings of T2M-HiFiGPT: both stages, exact resumption, and the run as a model in every command."""

import csv
import dataclasses
import shutil

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax.checkpoints.evaluator import save_evaluator
from t2m_jax.checkpoints.tokenizer import load_tokenizer
from t2m_jax.cli.main import main
from t2m_jax.data import open_dataset
from t2m_jax.errors import UserError
from t2m_jax.evaluation.report.record import load_report
from t2m_jax.models.hifigpt import HiFiGptConfig
from t2m_jax.sampling import TextToMotion
from t2m_jax.train import train
from t2m_jax.train.hifigpt import TrainHiFiGptConfig, corrupt_codes
from tests import tiny
from tests.train.conftest import assert_same_checkpoint, stop_at

# One layer of each kind compiles in half of the time of two.
TOKENIZER = dataclasses.replace(tiny.RVQVAE, depth=1)
GENERATOR = dataclasses.replace(tiny.HIFIGPT, num_layers=1, num_residual_layers=1)


def rvqvae_training(data, run):
    return dataclasses.replace(tiny.rvqvae_training(data, run), model=TOKENIZER)


def hifigpt_training(data, tokenizer, run):
    return dataclasses.replace(tiny.hifigpt_training(data, tokenizer, run), model=GENERATOR)


@pytest.fixture(scope="module")
def both(data, tmp_path_factory):
    """The runs of both stages."""
    folder = tmp_path_factory.mktemp("hifigpt")
    train(rvqvae_training(data, folder / "rvqvae"))
    train(config_of("hifigpt", data, folder, folder / "hifigpt"))
    return folder


def config_of(kind, data, both, run):
    if kind == "rvqvae":
        return rvqvae_training(data, run)
    return dataclasses.replace(hifigpt_training(data, both / "rvqvae", run), contrastive_weight=0.5)


@pytest.mark.slow
@pytest.mark.release
@pytest.mark.parametrize("kind", ["rvqvae", "hifigpt"])
def test_a_resumed_run_equals_one_that_never_stopped(kind, data, both, tmp_path, monkeypatch):
    config = config_of(kind, data, both, tmp_path / "run")
    mend = stop_at(7, monkeypatch)
    with pytest.raises(KeyboardInterrupt):
        train(config)
    mend()
    train(config, resume=True)
    assert_same_checkpoint(config.run, both / kind)
    for name in ("train.csv", "val.csv"):
        assert (config.run / name).read_bytes() == (both / kind / name).read_bytes()


@pytest.mark.slow
@pytest.mark.release
def test_the_log_shows_every_depth(both, capsys):
    with (both / "rvqvae" / "train.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    for name in ("usage", "perplexity", "residual_norm", "expired"):
        assert [f"{name}/{w}" in rows[0] for w in (1, 2, 3, 4)] == [True, True, True, False]
    assert all(float(row["usage/1"]) > 0 for row in rows)
    assert {"acceleration", "bones", "velocity"} < set(rows[0])
    with (both / "hifigpt" / "train.csv").open(encoding="utf-8") as file:
        last = list(csv.DictReader(file))[-1]
    depths = [float(last[f"nll/{w}"]) for w in (1, 2, 3)]
    np.testing.assert_allclose(np.mean(depths), float(last["nll"]), rtol=1e-5)
    terms = float(last["nll"]) + float(last["stop"]) + 0.5 * float(last["contrastive"])
    np.testing.assert_allclose(float(last["loss"]), terms, rtol=1e-5)
    with (both / "hifigpt" / "val.csv").open(encoding="utf-8") as file:  # what chooses the best weights
        last = list(csv.DictReader(file))[-1]
    np.testing.assert_allclose(float(last["loss"]), float(last["nll"]) + float(last["stop"]), rtol=1e-5)


@pytest.mark.slow
def test_the_run_has_the_codebook_of_its_tokenizer(both):
    model, tokenizer = TextToMotion.load(both / "hifigpt"), load_tokenizer(both / "rvqvae")
    expected = tokenizer.variables["codebook"]["quantizer"]["codebook"]
    np.testing.assert_array_equal(model.variables["generator"]["codebook"]["codebook"], expected)
    assert "codebook" not in model.variables["generator"]["params"]
    assert model.config.generator.num_quantizers == 3 and model.config.generator.code_dim == 8


@pytest.mark.slow
@pytest.mark.release
def test_every_command_takes_the_run(both, data, tmp_path, capsys, monkeypatch):
    """Generate, bundle, view, evaluate: nothing but the name of the model differs from T2M-GPT."""
    monkeypatch.setenv("T2M_JAX_NO_COMPILATION_CACHE", "1")
    run, npz = str(both / "hifigpt"), str(tmp_path / "walk.npz")
    sentence = "a person walks forward"
    assert main(["generate", sentence, "--model", run, "--stop-rule", "threshold", "-o", npz]) == 0
    with np.load(npz) as file:
        assert file["codes"].shape[1] == 3
        assert len(file["positions"]) == 8 * len(file["codes"])
    assert main(["view", npz, "-o", str(tmp_path / "walk.html")]) == 0
    assert main(["bundle", run, str(tmp_path / "bundle")]) == 0
    options = ["--guidance-scale", "2", "-o", str(tmp_path / "a.npz")]
    assert main(["generate", sentence, "--model", str(tmp_path / "bundle"), *options]) == 0
    assert main(["generate", sentence, "--model", run, *options[:-1], str(tmp_path / "b.npz")]) == 0
    with np.load(tmp_path / "a.npz") as one, np.load(tmp_path / "b.npz") as other:
        np.testing.assert_array_equal(one["codes"], other["codes"])
    evaluator = tiny.random_evaluator()._replace(normalizer=open_dataset(data).normalizer)
    save_evaluator(tmp_path / "evaluator", evaluator)
    common = ["--data", str(data), "--evaluator", str(tmp_path / "evaluator"), "--split", "train", "--num-repeats", "1"]
    for what in ("generation", "reconstruction"):
        report = tmp_path / f"{what}.json"
        given = ["evaluate", what, "--model", run, *common, "--json", str(report)]
        assert main(given) == 0, capsys.readouterr().err
        assert load_report(report).header.guidance_scale == (4.0 if what == "generation" else None)
    assert main(["train", "hifigpt", str(tmp_path / "no.yaml")]) == 2
    assert "no.yaml" in capsys.readouterr().err


@pytest.mark.slow
def test_fewer_depths_give_a_coarser_motion():
    model = TextToMotion(tiny.random_bundle(tiny.HIFIGPT_BUNDLE))
    codes = np.asarray(model.generate("a person walks", seed=2, raw=True)[0].codes)
    whole = model.decode(codes, raw=True)
    for depth in (1, 2):
        coarse = model.decode(codes[:, :depth], raw=True)
        assert coarse.num_frames == whole.num_frames
        assert np.abs(coarse.positions - whole.positions).max() > 1e-4
    with pytest.raises(UserError, match="codes: expected rows of 3 codes"):
        model.decode(np.zeros((4, 4), int))


@pytest.mark.release
@pytest.mark.parametrize(
    "options",
    [
        {"model": {"code_embedding": "learned", "head": "per_depth"}, "corruption": "codes", "corrupt_residual": True},
        {"model": {"cumulative_depth": True, "stop_rule": "threshold"}, "corruption": "none", "num_parts": 2},
        {"model": {"guidance_scale": 1.0}, "condition_dropout": 0.0, "mean_over": "motions", "precision": "bfloat16"},
    ],
    ids=["learned", "cumulative", "unguided"],
)
def test_other_designs_train_and_resume(options, data, both, tmp_path):
    config = hifigpt_training(data, both / "rvqvae", tmp_path / "run")
    model = dataclasses.replace(config.model, **options.pop("model"))
    loop = dataclasses.replace(config.loop, num_steps=2, checkpoint_every=1, log_every=1, validate_every=0)
    config = dataclasses.replace(config, model=model, loop=loop, **options)
    train(config)
    longer = dataclasses.replace(config, loop=dataclasses.replace(loop, num_steps=4))
    state = train(longer, resume=True)
    whole = train(dataclasses.replace(longer, run=tmp_path / "whole"))
    jax.tree.map(np.testing.assert_array_equal, state, whole)
    loaded = TextToMotion.load(config.run)
    assert ("codebook" in loaded.variables["generator"]) == (model.code_embedding != "learned")
    assert len(loaded.generate("a person walks")[0].codes) >= 1


@pytest.mark.release
def test_training_starts_from_a_trained_model(data, both, tmp_path):
    config = hifigpt_training(data, both / "rvqvae", tmp_path / "run")
    loop = dataclasses.replace(config.loop, num_steps=1, log_every=1, validate_every=0)
    slow = dataclasses.replace(config.optimizer, learning_rate=1e-9, warmup_steps=0)
    state = train(dataclasses.replace(config, init=both / "hifigpt", loop=loop, optimizer=slow))
    model = TextToMotion.load(both / "hifigpt")
    expected = model.variables["generator"]["params"]
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, atol=1e-6), state.params["hifigpt"], expected)


@pytest.mark.parametrize("kind", ["rows", "codes", "none"])
def test_corruption_replaces_rows_or_codes(kind):
    codes = jnp.full((64, 20, 3), 15)
    read = corrupt_codes(codes, jax.random.split(jax.random.key(0), 64), kind=kind, tau=0.5, num_codes=1000)
    changed = np.asarray(read != codes)
    if kind == "none":
        assert not changed.any()
        return
    assert 0.45 < changed.mean() < 0.55
    whole_rows = changed.all(axis=2) | ~changed.any(axis=2)
    assert whole_rows.mean() > 0.95 if kind == "rows" else whole_rows.mean() < 0.4


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"tau": 1.5}, "tau: 1.5 is not a number from 0 to 1"),
        ({"condition_dropout": 0.0}, "condition_dropout: without it, guidance means nothing"),
        ({"num_parts": 3}, "num_parts: 3 does not divide"),
        ({"contrastive_weight": 0.5, "text_encoder": "clip"}, "contrastive_weight: the clip encoder is not trained"),
        ({"contrastive_weight": 0.5, "model": HiFiGptConfig(code_embedding="learned")}, "contrastive_weight: needs"),
    ],
)
def test_impossible_configs_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        TrainHiFiGptConfig(**options)


@pytest.mark.slow
def test_tokenizers_that_do_not_fit_are_one_line(data, both, tmp_path):
    """A GPT cannot predict several codes per row; a frozen codebook must be as wide as the model."""
    with pytest.raises(UserError, match="has 3 codes per row, but a gpt predicts 1"):
        train(tiny.gpt_training(data, both / "rvqvae", tmp_path / "gpt"))
    config = hifigpt_training(data, both / "rvqvae", tmp_path / "frozen")
    frozen = dataclasses.replace(config.model, code_embedding="frozen", code_dim=16)
    with pytest.raises(UserError, match="frozen needs code_dim 8 to be embed_dim 16"):
        train(dataclasses.replace(config, model=frozen))
    assert not (tmp_path / "frozen").exists()


@pytest.mark.release
def test_one_code_per_row_is_enough(data, runs, tmp_path):
    """The double-tier GPT also reads T2M-GPT's tokenizer."""
    config = hifigpt_training(data, runs.vqvae, tmp_path / "run")
    loop = dataclasses.replace(config.loop, num_steps=1, validate_every=0)
    train(dataclasses.replace(config, loop=loop))
    assert TextToMotion.load(config.run).generate("a person walks")[0].codes.shape[1:] in ((), (1,))


@pytest.mark.slow
def test_a_damaged_codebook_is_one_line(both, tmp_path):
    run = tmp_path / "run"
    shutil.copytree(both / "hifigpt", run)
    file = run / "rvqvae" / "rvqvae.safetensors"
    file.write_bytes(file.read_bytes()[:-100])
    with pytest.raises(UserError, match=r"rvqvae\.safetensors"):
        TextToMotion.load(run)
