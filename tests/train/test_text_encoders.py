"""Training with pretrained text encoders: from own data to generated motion, and what is refused."""

import dataclasses
import shutil

import numpy as np
import pytest
from safetensors.numpy import load_file, save_file

from t2m_jax.checkpoints.bundle import load_bundle
from t2m_jax.checkpoints.text_encoder import encoder_identity, load_pretrained
from t2m_jax.cli.main import main
from t2m_jax.errors import UserError
from t2m_jax.sampling.pipeline import TextToMotion
from t2m_jax.train import train
from tests.clip_golden import TEXT_ONLY
from tests.sentence_golden import BERT
from tests.tiny import GPT, LOOP, gpt_training

TWO_STEPS = dataclasses.replace(LOOP, num_steps=2, log_every=1, validate_every=2, checkpoint_every=1)
WIDTH = 24
"""Of the embeddings of both tiny encoders."""


def training(kind, encoder, runs, run):
    """Returns the config of a training of two steps."""
    config = gpt_training(runs.data, runs.vqvae, run, loop=TWO_STEPS)
    model = dataclasses.replace(GPT, text_dim=WIDTH)
    return dataclasses.replace(config, model=model, text_encoder=kind, **{kind: str(encoder)})


@pytest.fixture(scope="module", params=["sentence", "clip"])
def trained(request, runs, tmp_path_factory):
    """Returns the config of a finished training. Its encoder is beside the run; tests that change it change it back."""
    source, folder = {"sentence": BERT, "clip": TEXT_ONLY}[request.param], tmp_path_factory.mktemp(request.param)
    encoder = shutil.copytree(source, folder / "encoder")
    config = training(request.param, encoder, runs, folder / "run")
    train(config)
    return config


def change_weights(path):
    arrays = load_file(path)
    name = sorted(arrays)[0]
    arrays[name] = arrays[name] + arrays[name].dtype.type(0.5)
    save_file(arrays, path)


@pytest.mark.slow
def test_a_model_with_a_pretrained_encoder_is_trained_bundled_and_used(trained, tmp_path):
    kind, encoder = trained.text_encoder, trained.run.parent / "encoder"
    model = TextToMotion.load(trained.run)
    embeddings = np.asarray(model.text_encoder(["a person walks", "someone raises both arms"]))
    assert embeddings.shape == (2, WIDTH) and np.abs(embeddings[0] - embeddings[1]).max() > 1e-2
    found = model.generate("a person walks", seed=1)[0]
    assert main(["bundle", f"{trained.run}", f"{tmp_path / 'bundle'}"]) == 0
    encoder.rename(tmp_path / "elsewhere")
    bundle = load_bundle(tmp_path / "bundle")
    assert (bundle.bpe, bundle.config.text_encoder.name) == (None, str(tmp_path / "bundle" / kind))
    assert encoder_identity(load_pretrained(bundle.config.text_encoder)) == bundle.config.text_encoder.identity
    again = TextToMotion(bundle).generate("a person walks", seed=1)[0]
    assert found.codes.shape == again.codes.shape and np.isfinite(again.positions).all()
    assert main(["generate", "a person walks", "--model", f"{tmp_path / 'bundle'}", "-o", f"{tmp_path / 'a.npz'}"]) == 0
    (tmp_path / "elsewhere").rename(encoder)


@pytest.mark.slow
def test_a_generator_starts_from_a_model_with_the_same_encoder_only(trained, runs, tmp_path):
    encoder = shutil.copytree(trained.run.parent / "encoder", tmp_path / "other")
    change_weights(next(encoder.rglob("*.safetensors")))
    config = training(trained.text_encoder, encoder, runs, tmp_path / "run")
    config = dataclasses.replace(config, init=trained.run)
    with pytest.raises(UserError, match="is not the text encoder that the model was trained with"):
        train(config)
    assert not config.run.exists()
    train(dataclasses.replace(config, init_parts="fitting"))


@pytest.mark.slow
def test_a_run_is_resumed_with_its_encoder_only(trained):
    longer = dataclasses.replace(trained, loop=dataclasses.replace(TWO_STEPS, num_steps=3))
    assert int(train(longer, resume=True).step) == 3
    weights = trained.run.parent / "encoder" / "model.safetensors"
    kept = weights.read_bytes()
    change_weights(weights)
    for use in (lambda: train(longer, resume=True), lambda: TextToMotion.load(trained.run)):
        with pytest.raises(UserError, match=r"encoder: is not the text encoder that the model was trained with; its"):
            use()
    weights.write_bytes(kept)


@pytest.mark.parametrize(("kind", "folder"), [("sentence", BERT), ("clip", TEXT_ONLY)])
def test_another_width_is_refused_before_clips_are_encoded(kind, folder, runs, tmp_path, monkeypatch):
    monkeypatch.setattr("t2m_jax.train.tokenize.encode_clips", None)
    config = dataclasses.replace(training(kind, folder, runs, tmp_path / "run"), model=GPT)
    with pytest.raises(UserError, match=r"has embeddings of 24 numbers, but the \w+ reads 12") as caught:
        train(config)
    assert "\n" not in str(caught.value) and not config.run.exists()


def test_a_folder_of_something_else_is_refused_in_a_line(runs, tmp_path, capsys):
    options = ["--data", runs.data, "--vqvae", runs.vqvae, "--run", tmp_path / "run", "--text_encoder", "sentence"]
    for folder, said in (
        (TEXT_ONLY, "model_type 'clip_text_model' is not supported"),
        ("no/such/one", "no such folder"),
    ):
        assert main(["train", "gpt", "synthetic/gpt", *map(str, [*options, "--sentence", folder])]) == 2
        error = capsys.readouterr().err.strip()
        assert said in error and str(folder) in error and "\n" not in error


def test_the_shipped_configs_name_encoders_of_their_width():
    """CLIP ViT-B/32 and MiniLM have embeddings of 512 and 384 numbers."""
    from t2m_jax.cli.train import _config

    found = {name: _config("gpt", f"text_encoders/{name}") for name in ("clip", "sentence", "sentence_states")}
    assert {name: (config.text_encoder, config.model.text_dim) for name, config in found.items()} == {
        "clip": ("clip", 512),
        "sentence": ("sentence", 384),
        "sentence_states": ("sentence_states", 256),
    }
