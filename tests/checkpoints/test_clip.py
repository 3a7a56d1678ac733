"""CLIPs on disk: both formats give the reference's embeddings, what is saved comes back, what is broken is named."""

import dataclasses
import json
import math
import shutil

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from safetensors.numpy import load_file, save_file

from t2m_jax.checkpoints.clip import TrainedClip, load_clip, save_clip
from t2m_jax.checkpoints.pretrained import encoder_fingerprint, param_shapes
from t2m_jax.errors import UserError
from t2m_jax.models.clip_text import ClipText, ClipTextConfig
from t2m_jax.models.rows import apply_compiled
from t2m_jax.text.bpe import clip_tokens
from tests.clip_golden import CAPTIONS, FULL, SAFETENSORS, TEXT_ONLY, TORCH, copy_files, golden

PREFIX = "text_model."


def embed(clip: TrainedClip) -> np.ndarray:
    tokens = clip_tokens(clip.tokenizer, CAPTIONS, max_length=clip.config.max_length)
    return np.asarray(apply_compiled(clip.variables, jnp.asarray(tokens), module=ClipText(clip.config)))


def assert_same_clip(found: TrainedClip, wanted: TrainedClip) -> None:
    assert found.config == wanted.config
    jax.tree.map(np.testing.assert_array_equal, found.variables, wanted.variables)


def refused(folder) -> str:
    with pytest.raises(UserError) as caught:
        load_clip(folder)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.fixture(scope="module")
def full():
    return load_clip(FULL)


@pytest.fixture
def copy(tmp_path):
    return copy_files(FULL, tmp_path / "copy")


def change_arrays(folder, change) -> None:
    arrays = load_file(folder / SAFETENSORS)
    change(arrays)
    save_file(arrays, folder / SAFETENSORS)


def change_config(folder, **changes) -> None:
    data = json.loads((folder / "config.json").read_text())
    for dotted, value in changes.items():
        *sections, field = dotted.split("__")
        place = data
        for section in sections:
            place = place[section]
        place[field] = value
    (folder / "config.json").write_text(json.dumps(data))


def test_the_embeddings_are_those_of_the_reference(full):
    np.testing.assert_allclose(embed(full), golden(FULL, "embeddings"), rtol=0, atol=1e-5)


def test_a_text_tower_alone_in_16_bits_gives_those_of_the_reference():
    clip = load_clip(TEXT_ONLY)
    assert clip.config.activation == "gelu"
    assert {leaf.dtype for leaf in jax.tree.leaves(clip.variables)} == {np.dtype(np.float32)}
    np.testing.assert_allclose(embed(clip), golden(TEXT_ONLY, "embeddings"), rtol=0, atol=1e-5)


def test_both_formats_give_the_same_weights(full, tmp_path):
    found = load_clip(copy_files(FULL, tmp_path / "copy", weights=TORCH))
    assert_same_clip(found, full)
    assert found.fingerprint == full.fingerprint


def test_the_shapes_of_vit_b_32_add_up():
    assert (
        sum(map(math.prod, param_shapes(ClipText(ClipTextConfig()), jnp.zeros((1, 77), jnp.int32)).values()))
        == 63_165_952 + 512 * 512
    )


def test_names_without_the_prefix_are_read(full, copy):
    def strip(arrays):
        for key in list(arrays):
            arrays[key.removeprefix(PREFIX)] = arrays.pop(key)

    change_arrays(copy, strip)
    assert_same_clip(load_clip(copy), full)


def test_a_config_says_only_what_differs_from_vit_b_32(full, copy):
    data = json.loads((copy / "config.json").read_text())
    text = data["text_config"]
    for field in ("max_position_embeddings", "hidden_act", "layer_norm_eps"):
        del text[field]
    (copy / "config.json").write_text(json.dumps(data))
    assert_same_clip(load_clip(copy), full)


def test_the_second_section_of_early_configs_counts(full, copy):
    change_config(copy, text_config_dict={"hidden_size": 32}, text_config__hidden_size=999)
    assert_same_clip(load_clip(copy), full)


def test_the_end_of_early_configs_is_the_largest_token(full, copy):
    assert full.config.end_token is None
    end = golden(FULL, "tokens").max()
    change_config(copy, text_config__eos_token_id=int(end))
    found = load_clip(copy)
    assert found.config.end_token == end
    np.testing.assert_array_equal(embed(found), embed(full))


@pytest.mark.parametrize("source", [FULL, TEXT_ONLY])
def test_what_is_saved_comes_back(source, tmp_path):
    clip = load_clip(source)
    save_clip(tmp_path / "saved", clip)
    found = load_clip(tmp_path / "saved")
    assert_same_clip(found, clip)
    assert found.fingerprint == clip.fingerprint
    assert sorted(path.name for path in (tmp_path / "saved").iterdir()) == [
        "config.json",
        "model.safetensors",
        "tokenizer.json",
    ]


def test_what_is_saved_can_be_read_by_others(full, tmp_path):
    save_clip(tmp_path / "saved", full)
    assert all(path.stat().st_mode & 0o444 == 0o444 for path in (tmp_path / "saved").iterdir())


def test_the_fingerprint_is_that_of_all_an_embedding_depends_on(full):
    config = dataclasses.replace(full.config, activation="gelu")
    moved = jax.tree.map(np.copy, full.variables)
    moved["params"]["block_1"]["up"]["kernel"][3, 2] += 1e-6
    other_tokenizer = load_clip(TEXT_ONLY).tokenizer
    fingerprints = {
        full.fingerprint,
        encoder_fingerprint(config, full.variables, full.tokenizer),
        encoder_fingerprint(full.config, moved, full.tokenizer),
        encoder_fingerprint(full.config, full.variables, other_tokenizer),
    }
    assert len(fingerprints) == 4
    assert encoder_fingerprint(full.config, full.variables, full.tokenizer) == full.fingerprint


@pytest.mark.parametrize("weights", [SAFETENSORS, TORCH])
@pytest.mark.parametrize("keep", [0.0, 0.01, 0.5, 0.999])
def test_truncated_weights_are_named(weights, keep, tmp_path):
    folder = copy_files(FULL, tmp_path / "copy", weights=weights)
    content = (folder / weights).read_bytes()
    (folder / weights).write_bytes(content[: int(keep * len(content))])
    assert str(folder / weights) in refused(folder)


def swap(key, change):
    def apply(arrays):
        arrays[key] = change(arrays[key])

    return apply


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda arrays: arrays.pop("text_projection.weight"), "saved with its projection"),
        (lambda arrays: arrays.pop(PREFIX + "final_layer_norm.bias"), "'final_layer_norm.bias' is missing"),
        (
            swap(PREFIX + "encoder.layers.1.mlp.fc1.weight", lambda array: array[:, :5].copy()),
            "'encoder.layers.1.mlp.fc1.weight' has shape (96, 5); its config needs (96, 32)",
        ),
        (swap(PREFIX + "final_layer_norm.bias", lambda array: array * np.nan), "not finite"),
        (swap(PREFIX + "final_layer_norm.bias", lambda array: array.astype(np.float64) * 1e300), "not finite"),
        (swap(PREFIX + "final_layer_norm.bias", lambda array: array.astype(np.int32)), "holds int32"),
        (
            lambda arrays: arrays.update({PREFIX + "encoder.extra": np.ones(3, np.float32)}),
            "'encoder.extra' is not part of the model",
        ),
    ],
)
def test_arrays_that_do_not_fit_are_named(change, reason, copy):
    change_arrays(copy, change)
    message = refused(copy)
    assert reason in message
    assert str(copy / SAFETENSORS) in message


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"text_config__num_hidden_layers": 2}, "'encoder.layers.2.layer_norm1.bias' is not part of the model"),
        ({"text_config__num_hidden_layers": 10**12}, "num_layers: 1000000000000 is more than"),
        ({"text_config__hidden_size": 2**70}, "embed_dim: 1180591620717411303424 is more than"),
        ({"text_config__hidden_size": 0}, "embed_dim: 0"),
        ({"text_config__vocab_size": 700}, "the tokenizer has a token 763, but its encoder knows 700 tokens"),
        ({"text_config__vocab_size": 800}, "its config needs (800, 32)"),
        ({"text_config__num_attention_heads": 5}, "num_heads: 5"),
        ({"text_config__hidden_act": "gelu_new"}, "activation"),
        ({"text_config__eos_token_id": 9}, "is token 763, but config.json says eos_token_id 9"),
        ({"text_config__eos_token_id": [1, 2]}, "end_token"),
        ({"text_config": 3}, "text_config is not a section"),
        ({"projection_dim": 30}, "'text_projection.weight' has shape (24, 32); its config needs (30, 32)"),
        ({"projection_dim": None}, "text_dim"),
        ({"model_type": "siglip"}, "model_type is 'siglip'"),
    ],
)
def test_configs_that_do_not_fit_are_named(changes, reason, copy):
    change_config(copy, **changes)
    message = refused(copy)
    assert reason in message
    assert str(copy) in message


@pytest.mark.parametrize("content", ["{", "[]", "3", "[" * 100_000, "\ud800".encode("utf-8", "surrogatepass")])
def test_a_config_that_is_none_is_named(content, copy):
    path = copy / "config.json"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    assert str(path) in refused(copy)


@pytest.mark.parametrize("name", ["config.json", SAFETENSORS, "tokenizer.json"])
def test_a_missing_file_is_named(name, copy):
    (copy / name).unlink()
    message = refused(copy)
    assert name in message
    assert str(copy) in message


def test_a_pointer_instead_of_weights_is_named(copy):
    (copy / SAFETENSORS).write_text("version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 605143284\n")
    assert str(copy / SAFETENSORS) in refused(copy)


def test_the_image_tower_is_not_read(copy, monkeypatch):
    from t2m_jax.checkpoints import clip

    read = []

    class Watched:
        def __init__(self, *arguments, **options):
            self._file = safe_open(*arguments, **options)

        def __enter__(self):
            return self

        def __exit__(self, *error):
            return None

        def keys(self):
            return self._file.keys()

        def get_tensor(self, key):
            read.append(key)
            return self._file.get_tensor(key)

    safe_open = clip.safe_open
    monkeypatch.setattr(clip, "safe_open", Watched)
    load_clip(copy)
    assert read
    assert not [key for key in read if "vision" in key or "visual" in key or "logit" in key]


def test_bfloat16_becomes_float32(copy, full):
    import ml_dtypes

    def shorten(arrays):
        for key in arrays:
            arrays[key] = arrays[key].astype(ml_dtypes.bfloat16)

    change_arrays(copy, shorten)
    found = load_clip(copy)
    jax.tree.map(lambda one, other: np.testing.assert_allclose(one, other, rtol=1e-2), found.variables, full.variables)
    assert {leaf.dtype for leaf in jax.tree.leaves(found.variables)} == {np.dtype(np.float32)}


def test_a_folder_is_not_written_to(copy):
    before = {path: path.read_bytes() for path in copy.iterdir()}
    load_clip(copy)
    assert {path: path.read_bytes() for path in copy.iterdir()} == before
    shutil.rmtree(copy)
