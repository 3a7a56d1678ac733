"""The whole way on a tiny scale: train both stages, generate, measure, bundle, pass on, save."""

import dataclasses
import json
import shutil

import jax
import numpy as np
import pytest

from t2m_jax.checkpoints.bundle import CONFIG_FILE, WEIGHTS_FILE, load_bundle
from t2m_jax.checkpoints.model import load_model, load_runs
from t2m_jax.checkpoints.official.load import load_gpt
from t2m_jax.checkpoints.official.load import load_vqvae as load_official_vqvae
from t2m_jax.checkpoints.run import run_info
from t2m_jax.checkpoints.tokenizer import load_tokenizer
from t2m_jax.cli.main import main
from t2m_jax.config import load_config
from t2m_jax.data.folder import open_dataset
from t2m_jax.errors import UserError
from t2m_jax.evaluation.prompts.following import RULES
from t2m_jax.evaluation.reconstruction import evaluate_reconstruction
from t2m_jax.evaluation.report.record import load_reconstruction
from t2m_jax.motion.formats import load_motion
from t2m_jax.sampling import TextToMotion
from t2m_jax.train import TrainVqVaeConfig, train
from t2m_jax.train.gpt import TrainGptConfig
from tests.export.test_html import Elements
from tests.hub_server import TOKEN
from tests.tiny import BUNDLE, LOOP, gpt_training, vqvae_training

pytestmark = pytest.mark.slow

PROMPTS = ["a person walks forward", "a person waves with the left hand"]


@pytest.fixture(scope="module")
def model(runs):
    return TextToMotion.load(runs.gpt)


@pytest.fixture(scope="module")
def bundle_folder(runs, tmp_path_factory):
    folder = tmp_path_factory.mktemp("bundles") / "passed-on"
    assert main(["bundle", f"{runs.gpt}", f"{folder}"]) == 0
    return folder


def test_runs_hold_what_they_were_made_with(runs):
    assert run_info(runs.vqvae).kind == "vqvae"
    assert run_info(runs.gpt).kind == "gpt"
    trained = load_config(runs.vqvae / "config.yaml", TrainVqVaeConfig)
    assert trained == vqvae_training(runs.data, runs.data.parent / "first")
    trained = load_config(runs.gpt / "config.yaml", TrainGptConfig)
    assert trained == gpt_training(runs.data, runs.data.parent / "first", runs.gpt)
    for run in (runs.vqvae, runs.gpt):
        rows = np.genfromtxt(run / "train.csv", delimiter=",", names=True)
        assert rows["step"].tolist() == [3, 4, 6, 8]
        assert np.isfinite(rows["loss"]).all()
        assert np.genfromtxt(run / "val.csv", delimiter=",", names=True)["step"].tolist() == [4, 8]
        assert sorted(folder.name for folder in (run / "checkpoints").iterdir() if folder.name.isdigit()) == ["4", "8"]
        assert list((run / "tensorboard").iterdir())


def test_the_gpt_run_needs_no_other_folder(runs, model, tmp_path):
    assert not (runs.data.parent / "first").exists(), "the VQ-VAE's run is still where the GPT found it"
    shutil.copytree(runs.gpt, tmp_path / "elsewhere")
    motion = TextToMotion.load(tmp_path / "elsewhere").generate(PROMPTS[0], seed=1)[0]
    expected = model.generate(PROMPTS[0], seed=1)[0]
    np.testing.assert_array_equal(motion.codes, expected.codes)
    np.testing.assert_array_equal(motion.positions, expected.positions)


def test_the_gpt_run_keeps_the_vqvae_it_was_trained_on(runs):
    ours, theirs = load_tokenizer(runs.gpt), load_tokenizer(runs.vqvae)
    assert ours.config == theirs.config
    np.testing.assert_array_equal(ours.normalizer.std, theirs.normalizer.std)
    codebook = ours.variables["codebook"]["quantizer"]["codebook"]
    np.testing.assert_array_equal(codebook, theirs.variables["codebook"]["quantizer"]["codebook"])
    assert np.unique(codebook, axis=0).shape == codebook.shape


def test_root_columns_weigh_more_in_the_statistics(runs):
    plain, weighted = open_dataset(runs.data).normalizer, load_tokenizer(runs.vqvae).normalizer
    np.testing.assert_allclose(plain.std[:4] / weighted.std[:4], 25.0, rtol=1e-5)
    np.testing.assert_array_equal(plain.std[4:259], weighted.std[4:259])


def test_generated_motion_is_whole(model):
    for prompt, motion in zip(PROMPTS, model.generate(PROMPTS, seed=3), strict=True):
        assert motion.caption == prompt
        assert motion.positions.shape == (4 * len(motion.codes), 22, 3)
        assert 1 <= len(motion.codes) <= BUNDLE.generator.max_codes


def test_reconstruction_is_measured(runs, tmp_path, capsys):
    dataset = open_dataset(runs.data)
    report = evaluate_reconstruction(load_tokenizer(runs.vqvae), dataset, split="test")
    arguments = ["--model", f"{runs.vqvae}", "--data", f"{runs.data}", "--json", f"{tmp_path}/figures.json"]
    assert main(["evaluate", "reconstruction", *arguments]) == 0
    assert load_reconstruction(tmp_path / "figures.json") == report
    assert f"{report.mpjpe_mm:,.3f}" in capsys.readouterr().out
    assert (report.split, report.num_clips) == ("test", len(dataset.clips("test")))
    assert 10 < report.mpjpe_mm < 2000
    assert 1 / 16 <= report.codebook_usage <= 1
    assert report.perplexity <= 16 * report.codebook_usage + 1e-3


def test_either_stage_can_be_measured_with_the_same_result(runs):
    dataset = open_dataset(runs.data)
    first = evaluate_reconstruction(load_tokenizer(runs.vqvae), dataset, split="val")
    assert evaluate_reconstruction(load_tokenizer(runs.gpt), dataset, split="val") == first


def test_a_bundle_is_complete_and_small(runs, bundle_folder):
    names = {path.name for path in bundle_folder.iterdir()}
    assert names == {
        CONFIG_FILE,
        WEIGHTS_FILE,
        "Mean.npy",
        "Std.npy",
        "tokenizer.json",
        "README.md",
        "training_data.json",
        "manifest.txt",
    }
    card = (bundle_folder / "README.md").read_text(encoding="utf-8")
    assert "num_steps: 8" in card
    checkpoint = sum(path.stat().st_size for path in (runs.gpt / "checkpoints").rglob("*") if path.is_file())
    assert (bundle_folder / WEIGHTS_FILE).stat().st_size < checkpoint
    assert load_bundle(bundle_folder).config == BUNDLE


@pytest.mark.filterwarnings("ignore:Use 'content=:DeprecationWarning")
def test_a_run_is_packed_and_pushed_if_its_card_has_a_license(runs, hub, monkeypatch, tmp_path, capsys):
    monkeypatch.setenv("HF_TOKEN", TOKEN)
    arguments = ["bundle", f"{runs.gpt}", f"{tmp_path / 'mine'}", "--push", "someone/mine"]
    assert main(arguments) == 2
    assert f"{tmp_path / 'mine'}: refused, because it has no license" in capsys.readouterr().err
    assert hub.asked == [] and not (tmp_path / "mine").exists()
    (tmp_path / "card.md").write_text("---\nlicense: mit\n---\n# Mine\n")
    assert main([*arguments, "--card", f"{tmp_path / 'card.md'}"]) == 0
    assert hub.files("someone/mine").keys() - {".gitattributes"} == {
        path.name for path in (tmp_path / "mine").iterdir()
    }


def test_users_of_the_original_can_check_a_run(runs, tmp_path):
    assert main(["bundle", f"{runs.gpt}", f"{tmp_path / 'out'}", "--export-official"]) == 0
    trained, official = load_model(runs.gpt), tmp_path / "out" / "official"
    config, variables = load_gpt(official / "gpt.safetensors", num_heads=BUNDLE.generator.num_heads)
    assert config == BUNDLE.generator
    jax.tree.map(np.testing.assert_array_equal, variables, trained.variables["generator"])
    config, variables = load_official_vqvae(official / "vqvae.safetensors")
    assert config == BUNDLE.tokenizer
    jax.tree.map(np.testing.assert_array_equal, variables["params"], trained.variables["tokenizer"]["params"])
    np.testing.assert_array_equal(np.load(official / "mean.npy"), trained.normalizer.mean)
    assert load_bundle(tmp_path / "out").config == BUNDLE


@pytest.mark.release
@pytest.mark.filterwarnings("ignore::t2m_jax.text.coverage.PromptWarning")
def test_half_precision_changes_little(model, bundle_folder):
    passed_on = TextToMotion.load(bundle_folder)
    prompts = [f"a person walks {word}" for word in ("forward", "left", "right", "slowly", "back", "up", "on", "away")]
    ours, theirs = model.generate(prompts, seed=7), passed_on.generate(prompts, seed=7)
    same = [np.array_equal(one.codes, other.codes) for one, other in zip(ours, theirs, strict=True)]
    assert np.mean(same) >= 0.75
    for one, other, agree in zip(ours, theirs, same, strict=True):
        assert np.isfinite(other.positions).all()
        if agree:
            np.testing.assert_allclose(one.positions, other.positions, atol=0.05)


def test_bundles_are_made_from_the_runs_that_belong_together(runs, tmp_path):
    folder, bundle = load_runs([runs.vqvae, runs.gpt])
    assert folder == runs.gpt
    assert bundle.config == BUNDLE
    decoder = load_tokenizer(runs.vqvae).variables["params"]["decoder"]
    jax.tree.map(np.testing.assert_array_equal, bundle.variables["tokenizer"]["params"]["decoder"], decoder)
    with pytest.raises(UserError, match="0 of 1"):
        load_runs([runs.vqvae])
    with pytest.raises(UserError, match="is the run of a vqvae only"):
        load_model(runs.vqvae)
    with pytest.raises(UserError, match="is the run of a vqvae only"):
        TextToMotion.load(runs.vqvae)


@pytest.mark.parametrize("suffix", ["npz", "bvh", "html"])
def test_motions_of_a_bundle_are_saved(bundle_folder, tmp_path, capsys, suffix):
    path = tmp_path / f"walk.{suffix}"
    assert main(["generate", PROMPTS[0], "--model", f"{bundle_folder}", "--seed", "1", "-o", f"{path}"]) == 0
    assert capsys.readouterr().out == f"{path}\n"
    expected = TextToMotion.load(bundle_folder).generate(PROMPTS[0], seed=1)[0]
    if suffix == "html":
        page = path.read_text(encoding="utf-8")
        elements = Elements(page)
        assert PROMPTS[0] in elements.data
        for text in (page, elements.program, elements.data):
            assert "http://" not in text.replace("http://www.w3.org", "")
        return
    motion = load_motion(path)
    assert motion.num_frames == expected.num_frames
    if suffix == "npz":
        np.testing.assert_array_equal(motion.positions, expected.positions)
        np.testing.assert_array_equal(motion.codes, expected.codes)


def test_prompts_are_measured(bundle_folder, tmp_path, capsys):
    arguments = ["--model", f"{bundle_folder}", "--num-seeds", "1", "--json", f"{tmp_path}/prompts.json"]
    assert main(["evaluate", "prompts", *arguments]) == 0
    figures = json.loads((tmp_path / "prompts.json").read_text(encoding="utf-8"))
    assert figures["num_samples"] == len(RULES) == 11
    right = sum(content["right"] for content in figures["contents"].values())
    failures = sum(len(content["failures"]) for content in figures["contents"].values())
    assert (figures["prompt_following"], failures) == (right / 11, 11 - right)
    table = capsys.readouterr().out
    assert f"**{right} of 11" in table
    assert table.count("\n") == 14


def test_the_number_of_codes_is_that_of_the_tokenizer(runs, tmp_path):
    loop = dataclasses.replace(LOOP, num_steps=1, validate_every=0)
    config = gpt_training(runs.data, runs.vqvae, tmp_path / "run", loop=loop)
    train(dataclasses.replace(config, model=dataclasses.replace(config.model, num_codes=8)))
    assert load_config(tmp_path / "run" / "config.yaml", TrainGptConfig).model == config.model


def test_a_vqvae_of_other_data_is_refused(runs, tmp_path):
    shutil.copytree(runs.data, tmp_path / "data")
    mean, std = (np.load(runs.data / f"{name}.npy") for name in ("Mean", "Std"))
    np.save(tmp_path / "data" / "Mean.npy", mean + std)
    with pytest.raises(UserError, match="differ too much from those of the tokenizer"):
        train(gpt_training(tmp_path / "data", runs.vqvae, tmp_path / "run"))
