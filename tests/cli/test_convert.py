"""`t2m convert`: published files become a model that says the same numbers, and models become such files."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax.checkpoints import load_bundle
from t2m_jax.checkpoints.bundle import expected_variables
from t2m_jax.checkpoints.official import export_official, load_gpt, load_vqvae
from t2m_jax.checkpoints.text_encoder import ClipReference
from t2m_jax.cli.main import main
from t2m_jax.models.motion_gpt import MotionGpt
from t2m_jax.models.vqvae import VqVae
from t2m_jax.sampling import Greedy, StopAtEnd, TextToMotion
from t2m_jax.sampling.loop import Sampling
from t2m_jax.sampling.programs import decode_batch, generate_codes
from tests.jit import compiled_apply
from tests.tiny import BUNDLE, random_bundle, random_variables

NAMES = ("vqvae", "gpt", "mean", "std")


def arguments(files, *rest):
    return ["convert", "official", *(f"--{name}={files[name]}" for name in NAMES if name in files), *map(str, rest)]


@pytest.fixture(scope="module")
def published(tmp_path_factory, golden_dir):
    """Returns four files in the published form, full size apart."""
    folder = tmp_path_factory.mktemp("published")
    draws = np.random.default_rng(0)
    np.save(folder / "mean.npy", draws.normal(size=263))
    np.save(folder / "std.npy", draws.uniform(0.5, 2, size=263))
    files = {name: folder / f"{name}.npy" for name in ("mean", "std")}
    return files | {name: golden_dir / "t2m_gpt" / f"ckpt_{name}_small.pth" for name in ("vqvae", "gpt")}


@pytest.fixture(scope="module")
def converted(published, tmp_path_factory):
    folder = tmp_path_factory.mktemp("converted") / "model"
    assert main(arguments(published, "--num-heads", "4", folder)) == 0
    return folder


@pytest.mark.slow
def test_the_converted_vqvae_says_the_same(converted, published, golden_dir):
    bundle = load_bundle(converted)
    assert (bundle.config.skeleton, bundle.config.text_encoder, bundle.bpe) == ("humanml3d", ClipReference(), None)
    model, variables = VqVae(bundle.config.tokenizer), jax.device_put(bundle.variables["tokenizer"])
    with np.load(golden_dir / "t2m_gpt" / "vqvae_d2_dim263_relu_ema_reset.npz") as arrays:
        motion = jnp.asarray(arrays["x"])
        found = compiled_apply(model, variables, motion, method="encode")
        np.testing.assert_array_equal(found[..., 0], arrays["code_idx"])
        output = compiled_apply(model, variables, motion, train=False)
        np.testing.assert_allclose(output.reconstruction, arrays["y"], atol=1e-4, rtol=1e-4)
        codes, expected = jnp.asarray(arrays["code_idx"][:1, :, None]), arrays["dec_sample0"]
    statistics = tuple(np.load(published[name]).astype(np.float32) for name in ("mean", "std"))
    np.testing.assert_array_equal(bundle.normalizer, statistics)
    decoded = decode_batch(variables, bundle.normalizer, codes, jnp.array([codes.shape[1]]), tokenizer=model)
    raw = expected * statistics[1] + statistics[0]
    np.testing.assert_allclose(decoded, raw, atol=2e-4, rtol=1e-4)


@pytest.mark.slow
def test_the_converted_gpt_says_the_same(converted, golden_dir):
    bundle = load_bundle(converted)
    model, variables = MotionGpt(bundle.config.generator), jax.device_put(bundle.variables["generator"])
    with np.load(golden_dir / "t2m_gpt" / "gpt_l2.npz") as arrays:
        tokens, text = jnp.asarray(arrays["input_tokens"]), jnp.asarray(arrays["clip_feat"])
        logits = compiled_apply(model, variables, tokens, text, train=False)
        np.testing.assert_allclose(logits, arrays["logits"], atol=1e-4, rtol=1e-4)
        texts, lengths, rows = (arrays[f"greedy_{name}"] for name in ("clip_feat", "length", "tokens"))
    keys = jax.random.split(jax.random.key(0), len(texts))
    sampling = Sampling(Greedy(), StopAtEnd(), bundle.config.generator.max_codes)
    sampled = generate_codes(variables, jnp.asarray(texts), keys, generator=model, sampling=sampling)
    np.testing.assert_array_equal(sampled.code_lengths, lengths)
    for codes, row, length in zip(sampled.codes, rows, lengths, strict=True):
        np.testing.assert_array_equal(codes[:length, 0], row[:length])


def test_nothing_is_rounded_and_the_card_names_the_files(converted, published):
    bundle = load_bundle(converted)
    vqvae, gpt = load_vqvae(published["vqvae"]), load_gpt(published["gpt"], num_heads=4)
    assert (bundle.config.tokenizer, bundle.config.generator) == (vqvae[0], gpt[0])
    for role, (_, variables) in (("tokenizer", vqvae), ("generator", gpt)):
        jax.tree.map(np.testing.assert_array_equal, bundle.variables[role], variables)
    card = (converted / "README.md").read_text()
    assert all(path.name in card for path in published.values())
    assert card.count("`") == 16 and "License" in card


@pytest.mark.slow
def test_any_model_becomes_the_published_form_and_comes_back(bundle_folder, tmp_path, golden_dir, capsys):
    """The whole way of a user: our model, their files, our model again, with a CLIP, and a motion from it."""
    clip = golden_dir / "clip" / "text_only"
    config = dataclasses.replace(
        BUNDLE, generator=dataclasses.replace(BUNDLE.generator, text_dim=24), text_encoder=ClipReference()
    )
    bundle = random_bundle()._replace(config=config, variables=random_variables(expected_variables(config)))
    export_official(tmp_path / "theirs", bundle)
    files = {name: tmp_path / "theirs" / f"{name}.safetensors" for name in ("vqvae", "gpt")}
    files |= {name: tmp_path / "theirs" / f"{name}.npy" for name in ("mean", "std")}
    card = tmp_path / "card.md"
    card.write_text("# mine\n")
    options = ("--num-heads", 2, "--clip", clip, "--card", card)
    assert main(arguments(files, *options, tmp_path / "ours")) == 0
    assert (tmp_path / "ours" / "README.md").read_text() == "# mine\n"
    model = TextToMotion.load(tmp_path / "ours")
    (motion,) = model.generate("a person walks forward", strategy=Greedy())
    assert motion.features.shape[1] == 263
    assert main(["convert", "official", "--export-official", f"{tmp_path / 'ours'}", f"{tmp_path / 'again'}"]) == 0
    for path in sorted((tmp_path / "theirs").iterdir()):
        assert (tmp_path / "again" / path.name).read_bytes() == path.read_bytes()
    assert capsys.readouterr().out.split() == [f"{tmp_path / name}" for name in ("ours", "again")]


def test_a_clip_may_be_left_to_its_name(published, tmp_path):
    assert main(arguments(published, "--num-heads", "4", "--clip", "some/clip", tmp_path / "out")) == 0
    assert load_bundle(tmp_path / "out").config.text_encoder == ClipReference(name="some/clip")


def test_options_of_training_get_into_the_config(published, tmp_path):
    options = ("--num-heads=4", "--quantizer=ema", "--ema-decay=0.9", "--reset-threshold=2.5")
    assert main(arguments(published, *options, tmp_path / "out")) == 0
    config = load_bundle(tmp_path / "out").config.tokenizer
    assert (config.quantizer, config.ema_decay, config.reset_threshold) == ("ema", 0.9, 2.5)


def test_what_does_not_fit_together_is_refused(refusal, published, tmp_path, bundle_folder, golden_dir):
    out = tmp_path / "out"
    assert "--gpt, --mean missing" in refusal(*arguments({**dict(list(published.items())[1:3])}, out))
    assert "num_heads: 5 does not divide" in refusal(*arguments(published, "--num-heads", "5", out))
    np.save(tmp_path / "short.npy", np.ones(251))
    short = tmp_path / "short.npy"
    assert "263 columns, but short.npy has 251" in refusal(*arguments(published | {"std": short}, "--num-heads=4", out))
    both = published | {"mean": short, "std": short}
    assert f"{short}: its statistics are for 251 features; the model has 263" in refusal(
        *arguments(both, "--num-heads=4", out)
    )
    export_official(tmp_path / "theirs", random_bundle())
    other = published | {"gpt": tmp_path / "theirs" / "gpt.safetensors"}
    assert "generator.num_codes is 16, but the other parts need 24" in refusal(*arguments(other, "--num-heads=2", out))
    clip = golden_dir / "clip" / "text_only"
    assert "embeddings of 24 numbers, but the generator reads 16" in refusal(
        *arguments(published, "--num-heads=4", "--clip", clip, out)
    )
    export = ("--export-official", bundle_folder)
    assert "--vqvae, --gpt, --mean, --std cannot be used with --export-official" in refusal(
        *arguments(published, *export, out)
    )
    assert "--num-heads, --card cannot be used with --export-official" in refusal(
        *arguments({}, *export, "--num-heads=2", "--card", tmp_path / "card.md", out)
    )
    assert "no such model" in refusal(*arguments({}, "--export-official", tmp_path / "no", out))
    assert not out.exists()
    assert "exists already" in refusal(*arguments({}, *export, tmp_path / "theirs"))
    assert "exists already" in refusal(*arguments(published, "--num-heads=4", tmp_path / "theirs"))
