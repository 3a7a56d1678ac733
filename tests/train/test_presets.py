"""The recipes of paper and code: in what they differ, and that each trains."""

import dataclasses

import jax
import numpy as np
import pytest

from t2m_jax.checkpoints.bundle import load_bundle
from t2m_jax.checkpoints.clip import load_clip
from t2m_jax.checkpoints.tokenizer import load_tokenizer
from t2m_jax.cli.main import main
from t2m_jax.errors import UserError
from t2m_jax.sampling import TextToMotion
from t2m_jax.train import train
from t2m_jax.train.shipped import differences, load_preset, preset_names
from tests.conftest import REPOSITORY
from tests.tiny import GPT, HIFIGPT, LOOP, RVQVAE, VQVAE

RECIPES = ("official", "paper")
SMALL_CLIP = REPOSITORY / "tests" / "golden" / "clip" / "text_only"


TOKENIZERS = {"gpt": "vqvae", "hifigpt": "rvqvae"}
"""What is trained before each generator."""
NAMED = [(stage, name) for stage in ("vqvae", "rvqvae", "gpt", "hifigpt") for name in preset_names(stage)]


@pytest.mark.parametrize(("stage", "name"), NAMED)
def test_presets_are_whole_configs(stage, name):
    config = load_preset(stage, name)
    assert config.kind == stage
    kit = name.startswith("kit_ml")
    assert ("kit_ml" in str(config.data)) == kit
    if stage in TOKENIZERS:
        assert config.vqvae == load_preset(TOKENIZERS[stage], name).run
    else:
        assert config.model.feature_dim == (251 if kit else 263)


def test_every_kind_has_its_recipes():
    assert len(NAMED) == 2 * 6 + 2 * 3
    assert preset_names("rvqvae") == ("hifigpt/paper", "humanml3d/hifigpt/paper", "kit_ml/hifigpt/paper")
    with pytest.raises(UserError, match="paper: no preset of stage rvqvae; known: hifigpt/paper"):
        load_preset("rvqvae", "paper")


def test_in_what_the_recipes_differ():
    """The values of the paper's text against those of the published commands."""
    vqvae = differences(load_preset("vqvae", "paper"), load_preset("vqvae", "official"))
    assert {name: values for name, values in vqvae.items() if name != "run"} == {
        "velocity": ("frame_difference", "joint_positions"),
        "commitment_weight": (1.0, 0.02),
        "optimizer.warmup_steps": (0, 1000),
        "loop.num_steps": (300_000, 300_999),
    }
    gpt = differences(load_preset("gpt", "paper"), load_preset("gpt", "official"))
    assert {name: values for name, values in gpt.items() if name not in ("run", "vqvae")} == {
        "corrupt_past_end": (False, True),
        "mean_over": ("tokens", "motions"),
        "optimizer.betas": ([0.5, 0.99], [0.5, 0.9]),
        "optimizer.weight_decay": (0.0, 1e-6),
    }
    kit = differences(load_preset("gpt", "kit_ml/paper"), load_preset("gpt", "kit_ml/official"))
    assert kit["tau"] == ("per_motion", 0.5)


def test_hifigpt_follows_its_paper():
    """Its sums over depths, and its epochs, of which KIT-ML has shorter ones."""
    assert load_preset("rvqvae", "hifigpt/paper").model.commitment == "sum"
    expected = {"humanml3d": (300_000, 22_000, 37_500), "kit_ml": (66_000, 4_600, None)}
    for data, (last, first, second) in expected.items():
        config = load_preset("rvqvae", f"{data}/hifigpt/paper")
        assert (config.loop.num_steps, config.optimizer.cosine) == (last, (first, last))
        if second is not None:
            config = load_preset("hifigpt", f"{data}/hifigpt/paper")
            assert (config.loop.num_steps, config.optimizer.cosine) == (last, (second, last))
    config = load_preset("hifigpt", "kit_ml/hifigpt/paper")
    assert (config.loop.num_steps, config.optimizer.cosine) == (59_000, (7_300, 59_000))
    assert (config.loop.batch_size, config.optimizer.clip_norm) == (128, 1.0)


@pytest.mark.parametrize("make", ["folder", "file"])
def test_a_preset_wins_over_what_has_its_name(make, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    if make == "folder":
        (tmp_path / "official").mkdir()
    else:
        (tmp_path / "official").write_text("tau: 0.25\n")
    assert main(["train", "gpt", "--diff", "official", "humanml3d/official"]) == 0
    assert capsys.readouterr().out.splitlines() == ["field  official  humanml3d/official"]
    if make == "file":
        assert main(["train", "gpt", "--diff", "./official", "official"]) == 0
        assert ["tau", "0.25", "0.5"] in [line.split() for line in capsys.readouterr().out.splitlines()]


def test_the_page_on_the_differences_names_each_of_them():
    page = (REPOSITORY / "docs" / "paper_and_code.md").read_text(encoding="utf-8")
    for stage in ("vqvae", "gpt"):
        for data in ("humanml3d", "kit_ml"):
            found = differences(load_preset(stage, f"{data}/paper"), load_preset(stage, f"{data}/official"))
            missing = [name for name in found if f"`{name}`" not in page and name not in ("run", "vqvae")]
            assert not missing


def test_the_command_shows_the_differences(capsys):
    assert main(["train", "vqvae", "--diff", "paper", "official"]) == 0
    rows = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert rows[0] == ["field", "paper", "official"]
    assert ["velocity", "frame_difference", "joint_positions"] in rows
    config = REPOSITORY / "configs" / "t2m-gpt" / "gpt.yaml"
    assert main(["train", "gpt", "--diff", str(config), "kit_ml/paper"]) == 0
    assert ["tau", "0.3", "per_motion"] in [line.split() for line in capsys.readouterr().out.splitlines()]


def test_an_unknown_recipe_is_one_line(capsys):
    assert main(["train", "gpt", "--diff", "paper", "oficial"]) == 2
    assert "oficial" in capsys.readouterr().err
    assert main(["train", "gpt"]) == 2
    assert "CONFIG is missing" in capsys.readouterr().err


LONG = dataclasses.replace(LOOP, num_steps=50, log_every=10, validate_every=0, checkpoint_every=50)


def losses(run):
    return np.genfromtxt(run / "train.csv", delimiter=",", names=True)["loss"]


@pytest.mark.slow
@pytest.mark.release
@pytest.mark.parametrize("recipe", RECIPES)
def test_each_recipe_trains_both_stages_at_reduced_size(recipe, data, tmp_path):
    places = {"data": data, "loop": LONG}
    sizes = {"model": VQVAE, "window": 32, "statistics": "data"}
    preset = load_preset("vqvae", recipe)
    # With the recipe's rates and warm-up, 50 updates learn less than the losses of two batches differ.
    sizes["optimizer"] = dataclasses.replace(preset.optimizer, learning_rate=2e-3, warmup_steps=0)
    first = dataclasses.replace(preset, run=tmp_path / "vqvae", **sizes, **places)
    train(first)
    found = losses(first.run)
    assert len(found) == 5 and found[-1] < found[0]
    second = dataclasses.replace(
        load_preset("gpt", recipe),
        vqvae=first.run,
        run=tmp_path / "gpt",
        clip=str(SMALL_CLIP),
        model=dataclasses.replace(GPT, text_dim=load_clip(SMALL_CLIP).config.text_dim),
        **places,
    )
    train(second)
    found = losses(second.run)
    assert len(found) == 5 and found[-1] < found[0]
    motion = TextToMotion.load(second.run).generate("a person walks", seed=1)[0]
    assert np.isfinite(motion.positions).all()
    assert main(["bundle", f"{second.run}", f"{tmp_path / 'bundle'}"]) == 0
    passed_on = load_bundle(tmp_path / "bundle").config.text_encoder.name
    assert passed_on == str(tmp_path / "bundle" / "clip")
    assert load_clip(passed_on).fingerprint == load_clip(SMALL_CLIP).fingerprint, "a bundle holds its text encoder"


@pytest.mark.slow
@pytest.mark.release
def test_the_recipe_of_hifigpt_trains_both_stages_at_reduced_size(data, tmp_path):
    """With CLIP, which no other test of this system has."""
    places, faster = {"data": data, "loop": LONG}, {"learning_rate": 2e-3}
    first = load_preset("rvqvae", "hifigpt/paper")
    optimizer = dataclasses.replace(first.optimizer, **faster)
    first = dataclasses.replace(first, run=tmp_path / "rvqvae", model=RVQVAE, optimizer=optimizer, **places)
    second = load_preset("hifigpt", "hifigpt/paper")
    model = dataclasses.replace(HIFIGPT, text_dim=load_clip(SMALL_CLIP).config.text_dim)
    optimizer = dataclasses.replace(second.optimizer, **faster)
    second = dataclasses.replace(
        second,
        vqvae=first.run,
        run=tmp_path / "hifigpt",
        clip=str(SMALL_CLIP),
        model=model,
        optimizer=optimizer,
        **places,
    )
    for config in (first, second):
        train(config)
        found = losses(config.run)
        assert len(found) == 5 and found[-1] < found[0]
    motion = TextToMotion.load(second.run).generate("a person walks", seed=1)[0]
    assert np.isfinite(motion.positions).all() and motion.codes.shape[1] == 3


@pytest.mark.slow
@pytest.mark.release
@pytest.mark.parametrize(("quantizer", "norm"), [("orig", "GN"), ("reset", "BN")])
def test_every_kind_of_codebook_and_norm_is_saved_and_resumed(quantizer, norm, data, tmp_path):
    """Kinds differ in which collections they have."""
    model = dataclasses.replace(VQVAE, quantizer=quantizer, norm=norm, width=32, num_stages=1)
    loop = dataclasses.replace(LOOP, validate_every=0)
    fields = {"data": data, "run": tmp_path / "run", "model": model, "window": 32, "loop": loop, "statistics": "data"}
    config = dataclasses.replace(load_preset("vqvae", "official"), **fields)
    whole = train(config)
    halves = dataclasses.replace(config, run=tmp_path / "halves", loop=dataclasses.replace(loop, num_steps=4))
    train(halves)
    again = train(dataclasses.replace(halves, loop=loop), resume=True)
    jax.tree.map(np.testing.assert_array_equal, again, whole)
    loaded = load_tokenizer(config.run).variables
    assert ("codebook" in loaded) == (quantizer != "orig")
    assert ("batch_stats" in loaded) == (norm == "BN")
    jax.tree.map(np.testing.assert_array_equal, loaded, {name: whole.variables[name] for name in loaded})
