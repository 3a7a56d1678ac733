"""`init` and `statistics`: training that starts from a trained model."""

import dataclasses
import json
import shutil
from pathlib import Path

import jax
import numpy as np
import pytest

from t2m_jax.checkpoints import load_tokenizer, save_bundle
from t2m_jax.checkpoints.model import load_generator_run
from t2m_jax.config import load_config
from t2m_jax.data import open_dataset
from t2m_jax.data.folder import Clip
from t2m_jax.data.texts import Caption
from t2m_jax.errors import UserError
from t2m_jax.motion.normalizer import save_normalizer
from t2m_jax.text.verbs import words_of
from t2m_jax.train import TrainVqVaeConfig, train
from t2m_jax.train.checks import fitting_weights, warn_of_schedule
from t2m_jax.train.experiment import find_trainer
from t2m_jax.train.generator import start_from_model
from t2m_jax.train.tokenize import CodedMotion, add_rewordings, draw_captions
from tests.tiny import LOOP, OPTIMIZER, VQVAE, gpt_training, vqvae_training

STILL = dataclasses.replace(OPTIMIZER, learning_rate=0.0, warmup_steps=0)
"""With it, weights stay where they start."""
SHORT = dataclasses.replace(LOOP, num_steps=1, validate_every=0)


def assert_same(one, other, **tolerance):
    jax.tree.map(lambda left, right: np.testing.assert_allclose(left, right, **tolerance), one, other)


@pytest.fixture(scope="module")
def bundle(runs, tmp_path_factory):
    folder = tmp_path_factory.mktemp("init") / "bundle"
    save_bundle(folder, load_generator_run(runs.gpt), card="")
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("source", ["run", "generator's run", "bundle"])
def test_a_tokenizer_starts_from_a_model(runs, bundle, tmp_path, source):
    init = {"run": runs.vqvae, "generator's run": runs.gpt, "bundle": bundle}[source]
    fields = {"init": init, "statistics": f"{init}", "optimizer": STILL}
    config = dataclasses.replace(vqvae_training(runs.data, tmp_path / "run", loop=SHORT), **fields)
    state, expected = train(config), load_tokenizer(init)
    assert_same(state.params, expected.variables["params"], rtol=1e-6)
    # One update moves the averages of the codebook a little, and may reset some codes.
    codebooks = [
        model.variables["codebook"]["quantizer"]["codebook"] for model in (expected, load_tokenizer(config.run))
    ]
    assert np.median(np.abs(codebooks[0] - codebooks[1])) < 0.02 * np.std(codebooks[0])
    np.testing.assert_array_equal(load_tokenizer(config.run).normalizer.std, expected.normalizer.std)


@pytest.mark.slow
def test_a_decoder_is_trained_alone_and_all_motion_keeps_its_codes(runs, tmp_path):
    optimizer = dataclasses.replace(OPTIMIZER, weight_decay=0.1, warmup_steps=0)
    init = shutil.copytree(runs.vqvae, tmp_path / "init")
    fields = {"init": init, "trained": "decoder", "optimizer": optimizer}
    config = dataclasses.replace(vqvae_training(runs.data, tmp_path / "run", loop=SHORT), **fields)
    train(config)
    longer = dataclasses.replace(config, loop=dataclasses.replace(SHORT, num_steps=2))
    shutil.rmtree(init)
    train(longer, resume=True)
    before, after = load_tokenizer(runs.vqvae).variables, load_tokenizer(config.run).variables
    for part in ("encoder", "quantizer"):
        assert_same(after["params"].get(part, {}), before["params"].get(part, {}), rtol=0)
    assert_same(after["codebook"], before["codebook"], rtol=0)
    with pytest.raises(AssertionError):
        assert_same(after["params"]["decoder"], before["params"]["decoder"], rtol=1e-3)


def test_a_decoder_alone_needs_its_tokenizer_and_its_statistics(runs, tmp_path):
    config = dataclasses.replace(vqvae_training(runs.data, tmp_path / "run"), trained="decoder")
    with pytest.raises(UserError, match="a decoder alone needs `init`"):
        train(config)
    with pytest.raises(UserError, match=r"init: .* has activation 'relu', not 'gelu' as in the config"):
        train(dataclasses.replace(config, init=runs.vqvae, model=dataclasses.replace(VQVAE, activation="gelu")))
    normalizer = load_tokenizer(runs.vqvae).normalizer
    save_normalizer(tmp_path, normalizer._replace(std=1.01 * normalizer.std))
    with pytest.raises(UserError, match=r"statistics: .* set it to `init`"):
        train(dataclasses.replace(config, init=runs.vqvae, statistics=f"{tmp_path}"))
    with pytest.raises(ValueError, match="batch norm"):
        dataclasses.replace(config, model=dataclasses.replace(VQVAE, norm="BN"))


@pytest.mark.slow
def test_weights_that_would_compute_something_else_are_refused(runs, tmp_path):
    """The shapes of their arrays are the same."""
    gpt, vqvae = gpt_training(runs.data, runs.vqvae, tmp_path / "gpt"), vqvae_training(runs.data, tmp_path / "vqvae")
    heads = dataclasses.replace(gpt.model, num_heads=2 * gpt.model.num_heads)
    network = dataclasses.replace(gpt.caption_encoder, num_heads=2 * gpt.caption_encoder.num_heads)
    for config, says in (
        (dataclasses.replace(gpt, init=runs.gpt, model=heads), "the generator of .* has num_heads"),
        (dataclasses.replace(gpt, init=runs.gpt, caption_encoder=network), "the text network of .* has num_heads"),
        (
            dataclasses.replace(vqvae, init=runs.vqvae, model=dataclasses.replace(VQVAE, dilation_growth=2)),
            ".* dilation",
        ),
    ):
        with pytest.raises(UserError, match=rf"init: {says}.*, not .* as in the config"):
            train(config)
        assert not config.run.exists()


@pytest.mark.slow
def test_more_subwords_than_the_config_has_room_for_are_refused(runs, tmp_path):
    config = gpt_training(runs.data, runs.vqvae, tmp_path / "run")
    few = dataclasses.replace(config.caption_encoder, vocabulary_size=config.caption_encoder.vocabulary_size // 2)
    config = dataclasses.replace(config, init=runs.gpt, init_parts="fitting", caption_encoder=few)
    with pytest.raises(UserError, match=r"caption_encoder.vocabulary_size: \d+ is less than the \d+ subwords of"):
        train(config)


@pytest.mark.slow
def test_a_generator_starts_from_a_model_and_keeps_its_subwords(runs, tmp_path):
    fields = {"init": runs.gpt, "optimizer": STILL}
    config = dataclasses.replace(gpt_training(runs.data, runs.vqvae, tmp_path / "run", loop=SHORT), **fields)
    state, expected = train(config), load_generator_run(runs.gpt)
    assert_same(state.params["gpt"], expected.variables["generator"]["params"], rtol=1e-6)
    assert_same(state.params["caption_encoder"], expected.variables["text_encoder"]["params"], rtol=1e-6)
    assert (config.run / "tokenizer.json").read_bytes() == (runs.gpt / "tokenizer.json").read_bytes()


@pytest.mark.slow
def test_other_sizes_are_refused_with_the_array_named(runs, tmp_path):
    model = dataclasses.replace(VQVAE, width=24)
    config = dataclasses.replace(vqvae_training(runs.data, tmp_path / "run"), init=runs.vqvae, model=model)
    with pytest.raises(UserError, match=r"init: array '.*' of .* is \(.*\), not \(.*\) as in the config"):
        train(config)


@pytest.mark.slow
@pytest.mark.parametrize("init", ["nowhere", "demo"])
def test_a_run_that_cannot_start_from_a_model_is_not_made(runs, tmp_path, init):
    for config in (
        vqvae_training(runs.data, tmp_path / "run"),
        gpt_training(runs.data, runs.vqvae, tmp_path / "run"),
    ):
        with pytest.raises(UserError, match=init):
            train(dataclasses.replace(config, init=Path(init)))
        assert not (tmp_path / "run").exists()


@pytest.mark.slow
def test_a_generator_whose_codes_or_statistics_mean_something_else_is_refused(runs):
    tokenizer = load_tokenizer(runs.vqvae)
    codebook = jax.tree.map(lambda leaf: leaf[::-1] if leaf.ndim else leaf, tokenizer.variables["codebook"])
    shifted = tokenizer.normalizer._replace(mean=tokenizer.normalizer.mean + 1)
    start_from_model(runs.gpt, tokenizer)
    for other in (
        tokenizer._replace(variables=tokenizer.variables | {"codebook": codebook}),
        tokenizer._replace(normalizer=shifted),
    ):
        with pytest.raises(UserError, match="was trained with another tokenizer"):
            start_from_model(runs.gpt, other)
        assert set(start_from_model(runs.gpt, other, parts="fitting")) == {"params"}


@pytest.mark.slow
@pytest.mark.parametrize("init_parts", ["all", "fitting"])
def test_a_generator_that_stays_as_it_is_has_its_own_sizes_and_codes(runs, tmp_path, init_parts):
    config = gpt_training(runs.data, runs.vqvae, tmp_path / "run")
    config = dataclasses.replace(config, init=runs.gpt, init_parts=init_parts, trained="text")
    wider = dataclasses.replace(config.model, embed_dim=2 * config.model.embed_dim)
    with pytest.raises(UserError, match=r"init: the generator of .* has embed_dim 16, not 32"):
        train(dataclasses.replace(config, model=wider))
    other = vqvae_training(runs.data, tmp_path / "vqvae", loop=dataclasses.replace(SHORT, seed=9))
    train(other)
    with pytest.raises(UserError, match=r"vqvae: the generator of .* stays as it is"):
        train(dataclasses.replace(config, vqvae=other.run))


def test_updates_that_change_nothing_are_said_before_they_are_made(runs, tmp_path, caplog):
    optimizer = dataclasses.replace(OPTIMIZER, cosine=(1, 2))
    config = dataclasses.replace(vqvae_training(runs.data, tmp_path / "run"), optimizer=optimizer)
    warn_of_schedule(config)
    assert "the learning rate is 0 from update 2 on, but loop.num_steps is 8" in caplog.text
    caplog.clear()
    warn_of_schedule(dataclasses.replace(config, loop=dataclasses.replace(config.loop, num_steps=2)))
    assert caplog.text == ""


def test_a_model_that_shares_no_array_is_refused_also_in_parts(runs):
    with pytest.raises(UserError, match=r"init: no array of .* has a name and a shape of this config"):
        fitting_weights(runs.gpt, {"params": {"a": np.zeros(2)}}, {"params": {"a": np.zeros(3)}, "empty": {}})


def test_arrays_that_fit_are_taken_and_the_others_stay():
    given = {"params": {"same": np.ones(2), "longer": np.ones(4), "unknown": np.ones(1)}}
    own = {"params": {"same": np.zeros(2), "longer": np.zeros(3), "new": np.zeros(1)}, "empty": {}}
    merged = fitting_weights(Path("demo"), given, own)
    expected = {"params": {"same": np.ones(2), "longer": np.zeros(3), "new": np.zeros(1)}, "empty": {}}
    assert_same(merged, expected, rtol=0)


@pytest.mark.parametrize("shape", [(2, 3), (3, 2)])
def test_half_of_a_codebook_is_not_taken(shape):
    """It would be a codebook of zeros that counts as initialized."""
    other, size = (
        {"codebook": np.full(some, fill), "ema_count": np.full(some[0], fill), "initialised": np.array(fill == 1)}
        for some, fill in (((2, 2), 1.0), (shape, 0.0))
    )
    weights = {"params": {"a": np.zeros(2)}, "codebook": size}
    merged = fitting_weights(Path("demo"), {"params": {"a": np.ones(2)}, "codebook": other}, weights)
    assert_same(merged, {"params": {"a": np.ones(2)}, "codebook": size}, rtol=0)


@pytest.mark.slow
def test_a_generator_takes_the_tokenizer_of_its_init_and_other_motion_than_this_learned(runs, tmp_path, caplog):
    other = tmp_path / "other"
    shutil.copytree(runs.data, other)
    statistics = open_dataset(other).normalizer
    save_normalizer(other, statistics._replace(mean=statistics.mean + statistics.std))
    config = dataclasses.replace(gpt_training(other, runs.vqvae, tmp_path / "run", loop=SHORT), optimizer=STILL)
    with pytest.raises(UserError, match="differ too much from those of the tokenizer"):
        train(config)
    with pytest.raises(UserError, match="vqvae: not given"):
        train(dataclasses.replace(config, vqvae=None))
    with caplog.at_level("WARNING"):
        train(dataclasses.replace(config, vqvae=None, init=runs.gpt))
    assert "the tokenizer learned other motion, and gives this one back with joint errors of" in caplog.text
    assert load_tokenizer(config.run).fingerprint == load_tokenizer(runs.gpt).fingerprint
    assert load_config(config.run / "config.yaml", type(config)).vqvae == runs.gpt


@pytest.mark.slow
def test_motion_that_a_tokenizer_cannot_give_back_is_refused(runs, tmp_path, monkeypatch):
    statistics = open_dataset(shutil.copytree(runs.data, tmp_path / "other")).normalizer
    save_normalizer(tmp_path / "other", statistics._replace(mean=statistics.mean + statistics.std))
    monkeypatch.setattr("t2m_jax.train.tokenize.MAX_JOINT_ERROR", 1)
    config = gpt_training(tmp_path / "other", runs.vqvae, tmp_path / "run", loop=SHORT)
    with pytest.raises(UserError, match=r"joint errors of \d+ mm \(allowed are 1\); train the tokenizer on this"):
        train(dataclasses.replace(config, init=runs.gpt))


def test_another_decoder_of_the_same_codes_fits_a_generator(runs):
    tokenizer = load_tokenizer(runs.vqvae)
    params = tokenizer.variables["params"]
    for part, fits in {"decoder": True, "encoder": False}.items():
        moved = params | {part: jax.tree.map(lambda leaf: leaf + 1, params[part])}
        other = tokenizer._replace(variables=tokenizer.variables | {"params": moved})
        if fits:
            assert "params" in start_from_model(runs.gpt, other)
        else:
            with pytest.raises(UserError, match="was trained with another tokenizer"):
                start_from_model(runs.gpt, other)


@pytest.mark.slow
def test_training_ends_when_the_loss_was_not_lower_for_some_validations(runs, tmp_path):
    loop = dataclasses.replace(LOOP, num_steps=40, validate_every=2)
    still = dataclasses.replace(gpt_training(runs.data, runs.vqvae, tmp_path / "run", loop=loop), optimizer=STILL)
    state = train(dataclasses.replace(still, patience=3))
    assert int(state.step) == 2 + 3 * 2
    with pytest.raises(ValueError, match="patience: -1 is not from 0 to 1000"):
        dataclasses.replace(still, patience=-1)


def test_some_captions_of_each_clip_are_drawn():
    captions = tuple(Caption(f"wave {number}") for number in range(9))
    clips = [Clip("wave", np.zeros((2, 1), np.float32), captions[:length]) for length in (9, 2, 9)]
    found = [clip.captions for clip in draw_captions(clips, count=4, seed=0)]
    assert [len(said) for said in found] == [4, 2, 4] and found[0] != found[2]
    assert all(set(said) <= set(captions) for said in found) and found[1] == captions[:2]
    assert [clip.captions for clip in draw_captions(clips, count=0, seed=0)] == [clip.captions for clip in clips]
    assert [clip.captions for clip in draw_captions(clips, count=4, seed=1)] != found


def test_a_run_records_the_captions_that_it_learns(runs, tmp_path):
    config = dataclasses.replace(gpt_training(runs.data, runs.vqvae, tmp_path / "run"), max_captions=1)
    trainer = find_trainer("gpt")
    setup = trainer.prepare(trainer.resolve(config, False), False)
    assert max(len(clip.captions) for clip in open_dataset(runs.data).clips("train")) > 1
    assert {len(clip.captions) for clip in setup.clips} == {1}
    assert set(np.asarray(setup.data.num_captions)) == {1}


def test_captions_are_also_learned_in_other_words():
    motions = [CodedMotion((np.zeros((2, 1), np.int32),), (Caption("a person waves"), Caption("a wave", (), 1.0, 2.0)))]
    (found,) = add_rewordings(motions, count=5, seed=0)
    assert found.captions[:2] == motions[0].captions and len(found.captions) == 12
    assert all("wave" in words_of(caption.text)[-1].bases for caption in found.captions)
    assert len({caption.text for caption in found.captions}) > 4
    assert add_rewordings(motions, count=5, seed=0) == [found] != add_rewordings(motions, count=5, seed=1)


@pytest.mark.slow
def test_a_generator_of_another_tokenizer_is_refused(runs, tmp_path):
    loop = dataclasses.replace(SHORT, seed=9)
    train(vqvae_training(runs.data, tmp_path / "other", loop=loop))
    config = gpt_training(runs.data, tmp_path / "other", tmp_path / "run", loop=SHORT)
    with pytest.raises(UserError, match="was trained with another tokenizer"):
        train(dataclasses.replace(config, init=runs.gpt))


@pytest.mark.slow
@pytest.mark.release
def test_statistics_come_from_files(runs, tmp_path):
    """As published: `mean.npy` and `std.npy`, measured on a slightly different build of the data."""
    mean, std = open_dataset(runs.data).normalizer
    published = open_dataset(runs.data).normalizer._replace(mean=mean + 0.23 * std)
    (tmp_path / "meta").mkdir()
    np.save(tmp_path / "meta" / "mean.npy", published.mean)
    np.save(tmp_path / "meta" / "std.npy", published.std)
    save_normalizer(tmp_path / "ours", published)
    for number, statistics in enumerate(("meta", "meta/mean.npy", "ours")):
        run = tmp_path / f"run{number}"
        config = dataclasses.replace(vqvae_training(runs.data, run, loop=SHORT), statistics=f"{tmp_path / statistics}")
        train(config)
        np.testing.assert_array_equal(load_tokenizer(run).normalizer.mean, published.mean)
    train(gpt_training(runs.data, tmp_path / "run0", tmp_path / "gpt", loop=SHORT))


def test_statistics_of_other_motion_are_refused(runs, tmp_path):
    mean, std = open_dataset(runs.data).normalizer
    save_normalizer(tmp_path / "far", open_dataset(runs.data).normalizer._replace(mean=mean + std))
    for statistics, said in ((f"{tmp_path / 'far'}", "differ too much"), ("nowhere", "nowhere does not exist")):
        config = dataclasses.replace(vqvae_training(runs.data, tmp_path / "run"), statistics=statistics)
        with pytest.raises(UserError, match=said):
            train(config)
        assert not (tmp_path / "run").exists()


@pytest.mark.slow
def test_statistics_of_other_motion_are_a_warning_for_a_training_that_goes_on(runs, tmp_path, caplog):
    mean, std = open_dataset(runs.data).normalizer
    save_normalizer(tmp_path / "far", open_dataset(runs.data).normalizer._replace(mean=mean + std))
    fields = {"statistics": f"{tmp_path / 'far'}", "init": runs.vqvae}
    with caplog.at_level("WARNING"):
        train(dataclasses.replace(vqvae_training(runs.data, tmp_path / "run", loop=SHORT), **fields))
    assert "differ too much from those of" in caplog.text and "starts from a model with them" in caplog.text


@pytest.mark.slow
def test_a_run_records_what_it_was_trained_on_and_how_far(runs, tmp_path):
    data = json.loads((runs.gpt / "training_data.json").read_text())
    assert data["num_clips"] == len(open_dataset(runs.data).clips("train"))
    assert "a" in data["words"] and sum(data["clips_per_action"].values()) == data["num_clips"]
    config = vqvae_training(runs.data, tmp_path / "run", loop=SHORT)
    train(config)
    train(dataclasses.replace(config, loop=dataclasses.replace(SHORT, num_steps=2)), resume=True)
    assert load_config(tmp_path / "run" / "config.yaml", TrainVqVaeConfig).loop.num_steps == 2


@pytest.fixture
def data_with_a_long_clip(runs, tmp_path):
    """Data in which one clip of training is too long, and validation has no other."""
    folder = Path(shutil.copytree(runs.data, tmp_path / "data"))
    name = open_dataset(folder).names("train")[0]
    path = folder / "new_joint_vecs" / f"{name}.npy"
    np.save(path, np.tile(np.load(path), (8, 1))[:300])
    (folder / "val.txt").write_text(f"{name}\n")
    return folder, name


@pytest.mark.slow
def test_only_clips_that_are_learned_are_recorded_and_validated(runs, data_with_a_long_clip, tmp_path, caplog):
    data, name = data_with_a_long_clip
    config = gpt_training(data, runs.vqvae, tmp_path / "run")
    setup = find_trainer("gpt").prepare(config, False)
    assert name not in {clip.name for clip in setup.clips} and len(setup.clips) > 1
    assert setup.validation is None
    assert "no validation, split val: " in caplog.text and "`--long_clips windows`" in caplog.text


@pytest.mark.slow
def test_a_model_of_another_kind_is_named(runs, tmp_path):
    config = dataclasses.replace(gpt_training(runs.data, runs.vqvae, tmp_path / "run"), init=Path("demo"))
    with pytest.raises(
        UserError, match=r"init: demo is a hifigpt with 6 codes per row, and the tokenizer has 1; start"
    ):
        train(config)
