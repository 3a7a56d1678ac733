"""Generators whose captions are read by a trained network over the token states of a sentence encoder."""

import dataclasses
import shutil

import jax
import numpy as np
import pytest

from t2m_jax.checkpoints.bundle import load_bundle
from t2m_jax.checkpoints.model import load_generator_run
from t2m_jax.cli.main import main
from t2m_jax.data.folder import open_dataset
from t2m_jax.data.index import IndexEntry, save_index
from t2m_jax.errors import UserError
from t2m_jax.models.caption_encoder import StateEncoderConfig
from t2m_jax.sampling.pipeline import TextToMotion
from t2m_jax.text.encoder import CuttingTextEncoder
from t2m_jax.train import train
from t2m_jax.train.generator import draw_shares
from t2m_jax.train.tokenize import CodedMotion
from tests.sentence_golden import BERT, ROBERTA
from tests.tiny import LOOP, OPTIMIZER, gpt_training, hifigpt_training, rvqvae_training
from tests.train.conftest import assert_same_checkpoint, stop_at

NETWORK = StateEncoderConfig(max_length=12, embed_dim=16, num_layers=1, num_heads=2, text_dim=12, token_dropout=0.1)
SHORT = dataclasses.replace(LOOP, num_steps=4, log_every=1, validate_every=2, checkpoint_every=2)


def with_states(config, encoder=BERT, **fields):
    return dataclasses.replace(
        config, text_encoder="sentence_states", sentence=f"{encoder}", state_encoder=NETWORK, **fields
    )


@pytest.fixture(scope="module")
def trained(runs, tmp_path_factory):
    """Returns the config of a finished training of a GPT. Its encoder is beside the run."""
    folder = tmp_path_factory.mktemp("states")
    encoder = shutil.copytree(BERT, folder / "encoder")
    config = with_states(gpt_training(runs.data, runs.vqvae, folder / "run", loop=SHORT), encoder)
    train(config)
    return config


@pytest.mark.slow
def test_a_model_is_trained_bundled_and_used_without_its_old_encoder(trained, tmp_path):
    model = TextToMotion.load(trained.run)
    texts = ["a person walks", "someone raises both arms"]
    embeddings = np.asarray(model.text_encoder(texts))
    assert embeddings.shape == (2, 12) and np.abs(embeddings[0] - embeddings[1]).max() > 1e-3
    assert isinstance(model.text_encoder, CuttingTextEncoder)
    read = model.text_encoder.read_part("a person walks " * 9)
    assert read.startswith("a person walks") and len(read) < len("a person walks " * 9) - 1
    assert main(["bundle", f"{trained.run}", f"{tmp_path / 'bundle'}"]) == 0
    encoder = trained.run.parent / "encoder"
    encoder.rename(tmp_path / "elsewhere")
    bundle = load_bundle(tmp_path / "bundle")
    assert (bundle.bpe, bundle.config.text_encoder.encoder.name) == (None, f"{tmp_path / 'bundle' / 'sentence'}")
    again = TextToMotion(bundle)
    np.testing.assert_allclose(again.text_encoder(texts), embeddings, atol=1e-2)
    pieces = list(again.stream("a person walks", seed=1))
    (whole,) = again.generate("a person walks", seed=1, raw=True)
    assert sum(len(piece.positions) for piece in pieces) == len(whole.positions)
    assert main(["generate", "a person walks", "--model", f"{tmp_path / 'bundle'}", "-o", f"{tmp_path / 'a.npz'}"]) == 0
    (tmp_path / "elsewhere").rename(encoder)


@pytest.mark.slow
def test_states_are_computed_once_for_a_data_set(trained, runs, tmp_path, monkeypatch):
    """Training, resuming and a second training read them from the cache in the data set's folder."""
    monkeypatch.setattr("t2m_jax.sampling.text_encoders.SentenceStates.read_batch", None)
    longer = dataclasses.replace(trained, loop=dataclasses.replace(SHORT, num_steps=5))
    run = shutil.copytree(trained.run, tmp_path / "run")
    assert int(train(dataclasses.replace(longer, run=run), resume=True).step) == 5


@pytest.mark.slow
@pytest.mark.release
def test_a_resumed_run_with_balance_equals_one_that_never_stopped(runs, tmp_path, monkeypatch):
    config = with_states(gpt_training(runs.data, runs.vqvae, tmp_path / "whole"), balance=0.5)
    train(config)
    resumed = dataclasses.replace(config, run=tmp_path / "resumed")
    mend = stop_at(7, monkeypatch)
    with pytest.raises(KeyboardInterrupt):
        train(resumed)
    mend()
    train(resumed, resume=True)
    assert_same_checkpoint(resumed.run, config.run)


@pytest.mark.slow
@pytest.mark.release
def test_the_double_tier_gpt_learns_with_the_contrastive_loss(data, tmp_path):
    train(rvqvae_training(data, tmp_path / "rvqvae", loop=SHORT))
    config = hifigpt_training(data, tmp_path / "rvqvae", tmp_path / "run", loop=SHORT)
    state = train(with_states(config, contrastive_weight=0.5))
    before = load_generator_run(tmp_path / "run").variables["text_encoder"]["params"]
    assert set(state.params) == {"hifigpt", "state_encoder"} and "reduce" in before
    assert np.isfinite(jax.tree.leaves(before)[0]).all()


@pytest.mark.slow
@pytest.mark.release
def test_a_network_starts_from_a_model_with_the_same_encoder_only(trained, runs, tmp_path):
    still = dataclasses.replace(OPTIMIZER, learning_rate=0.0, warmup_steps=0)
    loop = dataclasses.replace(SHORT, num_steps=1, validate_every=0)
    config = with_states(gpt_training(runs.data, runs.vqvae, tmp_path / "run", loop=loop), init=trained.run)
    state = train(dataclasses.replace(config, optimizer=still))
    expected = load_generator_run(trained.run).variables["text_encoder"]["params"]
    jax.tree.map(np.testing.assert_array_equal, state.params["state_encoder"], expected)
    other = dataclasses.replace(config, sentence=f"{ROBERTA}", run=tmp_path / "other")
    with pytest.raises(UserError, match="is not the text encoder that the model was trained with"):
        train(other)
    assert not other.run.exists()


@pytest.mark.slow
@pytest.mark.release
def test_a_trained_generator_gets_another_text_encoder_and_stays_as_it_is(runs, tmp_path):
    quick = dataclasses.replace(OPTIMIZER, weight_decay=0.1, warmup_steps=0)
    loop = dataclasses.replace(SHORT, num_steps=2, validate_every=0)
    config = with_states(gpt_training(runs.data, runs.vqvae, tmp_path / "run", loop=loop), optimizer=quick)
    with pytest.raises(UserError, match="the text alone needs `init`"):
        train(dataclasses.replace(config, trained="text"))
    config = dataclasses.replace(config, trained="text", init=runs.gpt)
    with pytest.raises(UserError, match=r"init: array 'params/caption_encoder/.*' of .* is \(.*\), not missing"):
        train(config)
    config = dataclasses.replace(config, init_parts="fitting")
    state = train(config)
    one_step = dataclasses.replace(config, run=tmp_path / "short", loop=dataclasses.replace(loop, num_steps=1))
    earlier = train(one_step)
    expected = load_generator_run(runs.gpt).variables["generator"]["params"]
    jax.tree.map(np.testing.assert_array_equal, state.params["gpt"], expected)
    texts = (jax.tree.leaves(other.params["state_encoder"]) for other in (state, earlier))
    assert any(np.any(one != other) for one, other in zip(*texts, strict=True))


def test_only_a_network_that_is_trained_may_be_trained_alone(runs, tmp_path):
    config = gpt_training(runs.data, runs.vqvae, tmp_path / "run")
    with pytest.raises(ValueError, match="trained: the sentence encoder is not trained"):
        dataclasses.replace(config, text_encoder="sentence", trained="text")


def test_another_width_of_the_network_is_refused(runs, tmp_path):
    config = gpt_training(runs.data, runs.vqvae, tmp_path / "run")
    with pytest.raises(ValueError, match=r"state_encoder.text_dim: 9, but the generator reads model.text_dim 12"):
        dataclasses.replace(
            config, text_encoder="sentence_states", state_encoder=dataclasses.replace(NETWORK, text_dim=9)
        )


def test_balance_needs_labels(runs, tmp_path):
    data = shutil.copytree(runs.data, tmp_path / "data")
    (data / "index.csv").unlink()
    config = dataclasses.replace(gpt_training(data, runs.vqvae, tmp_path / "run"), balance=1.0)
    with pytest.raises(
        UserError, match=r"index.csv: has no labels of these clips, which balance and single_share need"
    ):
        train(config)
    with pytest.raises(ValueError, match=r"balance: 1.5 is not a power from 0 to 1"):
        dataclasses.replace(config, balance=1.5)


@pytest.mark.slow
@pytest.mark.release
def test_single_motions_get_their_share_of_the_draws(runs, tmp_path):
    data = shutil.copytree(runs.data, tmp_path / "data")
    config = dataclasses.replace(gpt_training(data, runs.vqvae, tmp_path / "run"), single_share=0.25)
    with pytest.raises(UserError, match=r"single_share: .* has only motions of one kind"):
        train(config)
    dataset = open_dataset(data)
    motions = [CodedMotion((), (), name) for name in dataset.names("train")]
    names = [name for name in dataset.names("train") if not name.startswith("M")]
    labels = dict(zip(names[:2], ("walk + bow", "jump x 3"), strict=True))
    save_index(data, [IndexEntry(name, "", label) for name, label in labels.items()])
    shares = np.diff(draw_shares(config, dataset, motions), prepend=0)
    single = [motion.clip.removeprefix("M") not in labels for motion in motions]
    np.testing.assert_allclose(shares[single].sum(), 0.25, rtol=1e-6)
    with pytest.raises(ValueError, match=r"single_share: 1.0 is not a share between 0 and 1"):
        dataclasses.replace(config, single_share=1.0)
