"""Bundles: what was saved comes back, and what is broken is refused by name."""

import functools
import shutil

import jax
import numpy as np
import pytest
import yaml
from flax import traverse_util

from t2m_jax.checkpoints.bundle import CONFIG_FILE, WEIGHTS_FILE, bundle_path, load_bundle, save_bundle
from t2m_jax.checkpoints.model import load_model
from t2m_jax.checkpoints.tokenizer import load_tokenizer
from t2m_jax.errors import UserError
from t2m_jax.files.arrays import load_arrays, read_arrays, save_arrays, save_weights
from t2m_jax.files.manifest import MANIFEST, read_manifest, write_manifest
from tests.tiny import BUNDLE, HIFIGPT_BUNDLE, random_bundle, trust_manifests


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bundles") / "tiny"
    save_bundle(folder, random_bundle(), card="# tiny\n")
    return folder


@pytest.fixture
def copy(saved, tmp_path, monkeypatch):
    """A bundle whose files can be changed."""
    shutil.copytree(saved, tmp_path / "copy")
    trust_manifests(monkeypatch)
    return tmp_path / "copy"


def change_config(folder, **changes):
    data = yaml.safe_load((folder / CONFIG_FILE).read_text())
    for dotted, value in changes.items():
        *sections, field = dotted.split("__")
        place = data
        for section in sections:
            place = place[section]
        place[field] = value
    (folder / CONFIG_FILE).write_text(yaml.safe_dump(data))


def refused(folder) -> str:
    with pytest.raises(UserError) as caught:
        load_bundle(folder)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_round_trip(saved):
    original, loaded = random_bundle(), load_bundle(saved)
    codebook = original.variables["tokenizer"]["codebook"]["quantizer"]
    codebook["ema_sum"] = codebook["codebook"] * codebook["ema_count"][:, None]
    assert loaded.config == BUNDLE
    jax.tree.map(
        lambda one, other: np.testing.assert_allclose(one, other, rtol=1e-3, atol=1e-4),
        original.variables,
        loaded.variables,
    )
    jax.tree.map(np.testing.assert_array_equal, original.normalizer, loaded.normalizer)
    assert loaded.bpe.to_str() == original.bpe.to_str()
    assert {leaf.dtype for leaf in jax.tree.leaves(loaded.variables["generator"])} == {np.dtype(np.float32)}


def test_weights_take_two_bytes_a_number(saved):
    count = sum(leaf.size for leaf in jax.tree.leaves(random_bundle().variables))
    assert (saved / WEIGHTS_FILE).stat().st_size < 2 * count + 20_000


@pytest.mark.parametrize("half", [True, False])
def test_small_bundles_leave_out_sums_and_copies_of_codes(tmp_path, half):
    bundle = random_bundle(HIFIGPT_BUNDLE)
    codebook = bundle.variables["tokenizer"]["codebook"]["quantizer"]
    if half:
        codebook["ema_sum"] = codebook["codebook"] * codebook["ema_count"][:, None]
    bundle.variables["generator"]["codebook"]["codebook"] = codebook["codebook"]
    save_bundle(tmp_path / "small", bundle, card="", half=half)
    left_out = {"rvqvae/codebook/quantizer/ema_sum", "hifigpt/codebook/codebook"}
    assert left_out.isdisjoint(read_arrays(tmp_path / "small" / WEIGHTS_FILE)) == half
    loaded = load_bundle(tmp_path / "small").variables
    jax.tree.map(functools.partial(np.testing.assert_allclose, rtol=2e-3, atol=1e-4), bundle.variables, loaded)


def test_codes_that_are_not_finite_are_refused_before_anything_follows_from_them(saved, tmp_path):
    folder = shutil.copytree(saved, tmp_path / "copy")
    arrays = read_arrays(folder / WEIGHTS_FILE)
    arrays["vqvae/codebook/quantizer/codebook"][:] = np.inf
    arrays["vqvae/codebook/quantizer/ema_count"][:] = 0.0
    save_weights(folder / WEIGHTS_FILE, arrays)
    write_manifest(folder)
    assert "has values that are not finite" in refused(folder)


def test_everybody_may_read_it(saved):
    assert all(path.stat().st_mode & 0o044 == 0o044 for path in (saved, *saved.iterdir()))


def test_the_tokenizer_can_be_loaded_alone(saved):
    assert load_tokenizer(saved).config == BUNDLE.tokenizer


def test_an_existing_folder_is_not_written_over(saved):
    before = sorted(path.name for path in saved.parent.iterdir())
    with pytest.raises(UserError, match="exists"):
        save_bundle(saved, random_bundle(), card="")
    assert sorted(path.name for path in saved.parent.iterdir()) == before


def test_the_demo_model_loads():
    """What travels with the package: complete, small, and with its licence on the card."""
    folder = bundle_path("demo")
    bundle = load_model("demo")
    assert bundle.config.skeleton == "humanml3d"
    assert sum(path.stat().st_size for path in folder.iterdir()) < 20e6
    assert "CC BY-NC 4.0" in (folder / "README.md").read_text()


def test_every_change_of_a_file_is_refused(saved, tmp_path):
    copy = tmp_path / "copy"
    shutil.copytree(saved, copy)
    for path in sorted(copy.iterdir()):
        whole = path.read_bytes()
        flipped = bytearray(whole)
        flipped[len(whole) // 2] ^= 1
        for changed in (bytes(flipped), whole[:-1], whole + b"\n", None):
            path.unlink() if changed is None else path.write_bytes(changed)
            assert f"{path}: " in refused(copy)
        path.write_bytes(whole)
    load_bundle(copy)


def test_a_bundle_without_a_manifest_is_refused(saved, tmp_path):
    shutil.copytree(saved, tmp_path / "copy")
    assert list(read_manifest(saved)) == sorted({path.name for path in saved.iterdir()} - {MANIFEST})
    (tmp_path / "copy" / MANIFEST).unlink()
    assert MANIFEST in refused(tmp_path / "copy")


@pytest.mark.parametrize("name", [CONFIG_FILE, WEIGHTS_FILE, "Mean.npy", "Std.npy", "tokenizer.json"])
def test_missing_and_empty_files_are_named(copy, name):
    (copy / name).write_bytes(b"")
    if name != CONFIG_FILE:  # an empty config means all defaults, which do not fit the other files
        assert name in refused(copy)
    (copy / name).unlink()
    assert name in refused(copy)


def test_missing_folders_name_what_there_is(tmp_path):
    assert "demo" in refused(tmp_path / "nothing")


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"format_version": 99}, "format_version 99"),
        ({"format_version": 2}, "format_version 2 is of an older t2m_jax; use it with t2m_jax 0.1, or make it again"),
        ({"skeleton": "kit_ml"}, "tokenizer.feature_dim"),
        ({"tokenizer__kind": "horse"}, "tokenizer.kind: 'horse'"),
        ({"tokenizer__kind": "gpt"}, "'gpt' is a generator"),
        ({"text_encoder__kind": "horse"}, "text_encoder.kind: 'horse'"),
        ({"skeleton": "horse"}, "horse"),
        ({"generator__num_codes": 17}, "generator.num_codes"),
        ({"generator__text_dim": 13}, "generator.text_dim"),
        ({"generator__embed_dim": 15}, "num_heads"),
        ({"generator__embed_dim": 32}, "shape"),
        ({"tokenizer__depth": 2}, "is missing"),
        ({"generator__num_layers": 1}, "not part of the model"),
        ({"text_encoder__vocabulary_size": 5}, "shape"),
        ({"generator__num_layerz": 1}, "num_layers"),
        ({"generator__num_heads": 0}, "num_heads: 0"),
        ({"generator__block_size": 1}, "block_size: 1"),
        ({"text_encoder__num_heads": 3}, "num_heads: 3 does not divide"),
        ({"tokenizer__width": 0}, "width: 0"),
        ({"tokenizer__num_stages": -1}, "num_stages: -1"),
    ],
)
def test_configs_that_do_not_fit_are_refused(copy, changes, said):
    change_config(copy, **changes)
    assert said in refused(copy)


def test_weights_that_are_not_finite_are_refused(copy):
    arrays = traverse_util.unflatten_dict(read_arrays(copy / WEIGHTS_FILE), sep="/")
    arrays["gpt"]["params"]["head"]["kernel"][0, 0] = np.nan
    save_arrays(copy / WEIGHTS_FILE, arrays)
    assert "gpt/params/head/kernel" in refused(copy)


@pytest.mark.parametrize(
    "content",
    [
        '{"a": NaN}',
        '{"a": 1e999}',
        "[1]",
        "{",
        '{"words": 3}',
        '{"words": {"a": -1}}',
        '{"actions": {"walk": "2"}}',
        '{"actions": {"walk": true}}',
        '{"num_clips": 1.5}',
        '{"num_clips": {}}',
        '{"shortest_frames": 2.5}',
        '{"captions": "a person walks"}',
        '{"captions": ["a person walks", 3]}',
        '{"learned": "a person walks"}',
        '{"missing": [3]}',
        '{"taught": {"boing": 3}}',
    ],
)
def test_training_data_that_are_damaged_are_refused(copy, content):
    (copy / "training_data.json").write_text(content)
    with pytest.raises(UserError, match=r"training_data\.json: "):
        load_bundle(copy)


@pytest.mark.parametrize(
    ("card", "license_"),
    [
        ("---\nlicense: cc-by-nc-4.0\n---\n# mine\n", "cc-by-nc-4.0"),
        ("---\ntags:\n- motion\nlicense: mit\nlanguage: en\n---\n", "mit"),
        ("# mine\n---\nlicense: mit\n---\n", "unknown"),
        ("---\ntags: []\n---\nlicense: mit\n---\n", "unknown"),
        ("---\nlicense: cc-by-4.0  # of the data\n---\n", "cc-by-4.0"),
        ("---\nlicense: [mit, gpl]\n---\n", "unknown"),
        ("---\nlicense: mit\nlicense: gpl\n---\n", "unknown"),
        ("---\nlicense: mit\n---", "mit"),
        ("---\nlicense: 'mit'\ntitle: A: b\n---\n", "mit"),
        ("---\ntitle: A: b\nlicense: mit\nlicense: gpl\n---\n", "unknown"),
        ("---\nlicense: ''\n---\n", "unknown"),
        ('---\nlicense: "mit\\ngpl"\n---\n', "unknown"),
        ("", "unknown"),
        ("---\n" + "a\n" * 100_000, "unknown"),
    ],
)
def test_the_license_is_that_of_the_metadata_of_the_card(copy, card, license_):
    (copy / "README.md").write_text(card)
    assert load_bundle(copy).license == license_


def test_examples_are_those_of_the_card_or_captions(copy):
    captions = ("one", "two", "three", "four", "five", "six")
    bundle = load_bundle(copy)
    assert bundle._replace(training_data=None).examples == ()
    bundle = bundle._replace(training_data={"captions": captions}, card="# mine\n---\nwidget:\n- text: he walks\n---\n")
    assert bundle.examples == captions[:5]
    metadata = 'license: mit\nwidget:\n- text: he walks\n- example_title: b\n  text: "she: waves"\n- 1\ntags: []'
    assert bundle._replace(card=f"---\n{metadata}\n---\n").examples == ("he walks", "she: waves")


def test_statistics_of_another_width_are_refused(copy):
    for name in ("Mean", "Std"):
        np.save(copy / f"{name}.npy", np.ones(251, np.float32))
    assert "251" in refused(copy)


def test_statistics_with_a_damaged_header_are_refused(copy):
    whole = (copy / "Std.npy").read_bytes()
    (copy / "Std.npy").write_bytes(whole.replace(b"(263,)", b"(263,("))
    assert "Std.npy" in refused(copy)


@pytest.mark.parametrize("name", [CONFIG_FILE, WEIGHTS_FILE, "Mean.npy", "tokenizer.json"])
def test_damaged_files_are_refused_and_never_crash(saved, copy, name):
    generator = np.random.default_rng(0)
    whole = (saved / name).read_bytes()
    for trial in range(4):
        damaged = bytearray(whole)
        if trial % 2:
            del damaged[int(generator.integers(len(whole))) :]
        else:
            for place in generator.integers(min(len(whole), 2000), size=8):
                damaged[place] = int(generator.integers(256))
        (copy / name).write_bytes(bytes(damaged))
        try:
            load_bundle(copy)
        except UserError as error:
            assert "\n" not in str(error)


def test_arrays_keep_their_types(tmp_path):
    tree = {"a": {"b": np.arange(3, dtype=np.int32)}, "c": np.array(True), "d": np.ones(2, np.float32)}
    save_arrays(tmp_path / "x.safetensors", tree, half=True)
    loaded = load_arrays(tmp_path / "x.safetensors", tree)
    assert [leaf.dtype for leaf in jax.tree.leaves(loaded)] == [np.int32, np.bool_, np.float32]
