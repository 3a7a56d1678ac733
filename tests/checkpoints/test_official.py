"""The original's state dicts: names, shapes, both ways, and what is refused."""

import dataclasses
import json

import jax
import numpy as np
import pytest
from flax import traverse_util
from safetensors.numpy import save_file

from t2m_jax.checkpoints.official.export import gpt_state_dict, vqvae_state_dict
from t2m_jax.checkpoints.official.load import load_gpt, load_vqvae
from t2m_jax.checkpoints.official.names import gpt_constant_shapes, gpt_weights, vqvae_constant_shapes, vqvae_weights
from t2m_jax.errors import UserError
from t2m_jax.models.motion_gpt import MotionGptConfig
from t2m_jax.models.system import variable_shapes
from t2m_jax.models.vqvae import VqVaeConfig
from tests.checkpoints.torch_archives import entry, number, text, write_archive
from tests.golden_files import state_dict
from tests.tiny import GPT, RVQVAE, VQVAE, random_variables

VQVAE_NAMES = (
    "vqvae_d2_dim263_relu_ema_reset",
    "vqvae_d3_dim251_relu_orig",
    "vqvae_d2_dim263_silu_LN_ema",
    "vqvae_d2_dim251_gelu_depth2_reset",
)
UNUSED, POSITIONS = "trans_base.pos_embedding.weight", "trans_base.pos_embed.embed"


def golden(golden_dir, name):
    """Returns the state dict of a golden file and what it was made with."""
    with np.load(golden_dir / "t2m_gpt" / f"{name}.npz") as arrays:
        return state_dict(arrays), json.loads(str(arrays["config_json"]))


def written(tmp_path, arrays, name="x.safetensors"):
    save_file({key: array.copy() for key, array in arrays.items()}, tmp_path / name)
    return tmp_path / name


def shapes(tree):
    return {path: leaf.shape for path, leaf in traverse_util.flatten_dict(dict(tree)).items()}


@pytest.mark.parametrize(
    ("table", "config"),
    [
        ("vqvae_t2m_down2_ema_reset", VqVaeConfig()),
        ("vqvae_kit_down2_ema_reset", VqVaeConfig(feature_dim=251)),
        ("vqvae_t2m_down3_ema_reset", VqVaeConfig(num_stages=3)),
        ("gpt_9layers_1024", MotionGptConfig()),
    ],
)
def test_full_size_tables(golden_dir, table, config):
    expected = json.loads((golden_dir / "t2m_gpt" / "state_dict_shapes.json").read_text())[table]
    if isinstance(config, VqVaeConfig):
        weights, constants = vqvae_weights(config), vqvae_constant_shapes(config)
    else:
        weights, constants = gpt_weights(config, num_base=9), gpt_constant_shapes(config, num_base=9)
    found = {weight.key: weight.shape for weight in weights} | constants
    assert found == {key: tuple(shape) for key, shape in expected.items()}


@pytest.mark.parametrize("norm", ["none", "LN", "GN", "BN"])
@pytest.mark.parametrize("quantizer", ["orig", "ema", "reset", "ema_reset"])
def test_every_array_of_ours_has_one_name_in_the_original(norm, quantizer):
    config = VqVaeConfig(num_codes=7, code_dim=5, width=32, num_stages=3, depth=2, norm=norm, quantizer=quantizer)
    weights = list(vqvae_weights(config))
    ours = shapes(variable_shapes(config))
    for name in ("ema_sum", "ema_count", "initialised"):  # not in the original's files
        ours.pop(("codebook", "quantizer", name), None)
    assert {weight.path: weight.shape[::-1] if weight.is_reversed else weight.shape for weight in weights} == ours
    assert len({weight.key for weight in weights}) == len(weights)


def test_every_array_of_our_gpt_has_one_name_in_the_original():
    config = MotionGptConfig(num_codes=9, embed_dim=6, text_dim=5, num_layers=5, num_heads=2, mlp_ratio=3, block_size=7)
    weights = list(gpt_weights(config, num_base=2))
    ours = shapes(variable_shapes(config))
    assert {weight.path: weight.shape[::-1] if weight.is_reversed else weight.shape for weight in weights} == ours
    assert len({weight.key for weight in weights}) == len(weights)


@pytest.mark.parametrize("name", VQVAE_NAMES)
def test_vqvae_there_and_back_is_bit_identical(golden_dir, tmp_path, name):
    state, sizes = golden(golden_dir, name)
    config, variables = load_vqvae(written(tmp_path, state), activation=sizes["activation"])
    kind = "orig" if sizes["quantizer"] == "orig" else "ema_reset"
    assert config == VqVaeConfig(
        feature_dim=sizes["input_dim"],
        num_codes=sizes["nb_code"],
        code_dim=sizes["code_dim"],
        width=sizes["width"],
        num_stages=sizes["down_t"],
        depth=sizes["depth"],
        activation=sizes["activation"],
        norm=sizes["norm"] or "none",
        quantizer=kind,
    )
    assert shapes(variables) == shapes(variable_shapes(config))
    back = vqvae_state_dict(variables, config)
    assert back.keys() == state.keys()
    for key, array in state.items():
        assert back[key].dtype == np.float32
        np.testing.assert_array_equal(back[key], array, err_msg=key)


@pytest.mark.parametrize("name", ["gpt_l2", "gpt_l3"])
def test_gpt_there_and_back_is_bit_identical(golden_dir, tmp_path, name):
    state, sizes = golden(golden_dir, name)
    config, variables = load_gpt(written(tmp_path, state), num_heads=sizes["n_head"])
    assert config == MotionGptConfig(
        num_codes=sizes["nb_code"],
        embed_dim=sizes["embed_dim"],
        text_dim=sizes["clip_dim"],
        num_layers=2 * sizes["num_layers"],
        num_heads=sizes["n_head"],
        mlp_ratio=sizes["fc_rate"],
        block_size=sizes["block_size"],
    )
    back = gpt_state_dict(variables, config)
    assert back.keys() == state.keys()
    assert not back.pop(UNUSED).any()  # the original never reads it
    np.testing.assert_allclose(back.pop(POSITIONS), state[POSITIONS], atol=1e-6)  # ours is computed, not read
    for key, array in back.items():
        np.testing.assert_array_equal(array, state[key], err_msg=key)


@pytest.mark.parametrize("norm", ["none", "LN", "GN", "BN"])
@pytest.mark.parametrize("quantizer", ["orig", "ema"])
def test_our_vqvae_there_and_back(tmp_path, norm, quantizer):
    config = VqVaeConfig(num_codes=7, code_dim=5, width=32, depth=2, norm=norm, quantizer=quantizer)
    variables = random_variables(variable_shapes(config))
    state = vqvae_state_dict(variables, config)
    if norm == "BN":
        assert state["vqvae.encoder.model.2.1.model.0.norm1.num_batches_tracked"].dtype == np.int64
    named = {"norm": norm if norm == "GN" else None, "quantizer": quantizer if quantizer == "ema" else None}
    found_config, found = load_vqvae(written(tmp_path, state), **named)
    assert found_config == config
    for collection in {"params", "batch_stats"} & variables.keys():
        jax.tree.map(np.testing.assert_array_equal, found[collection], variables[collection])
    if quantizer == "ema":
        codebook = variables["codebook"]["quantizer"]["codebook"]
        for name in ("codebook", "ema_sum"):
            np.testing.assert_array_equal(found["codebook"]["quantizer"][name], codebook)
        np.testing.assert_array_equal(found["codebook"]["quantizer"]["ema_count"], np.ones(7))
        assert found["codebook"]["quantizer"]["initialised"]


@pytest.mark.parametrize("options", [{"num_quantizers": 1, "projections": True}, {"num_quantizers": 3}])
def test_a_vqvae_that_the_original_does_not_have_is_refused(options):
    config = dataclasses.replace(RVQVAE, **({"projections": False} | options))
    with pytest.raises(UserError, match="the original code has no such VQ-VAE"):
        vqvae_state_dict(random_variables(variable_shapes(config)), config)


def test_our_gpt_there_and_back(tmp_path):
    variables = random_variables(variable_shapes(GPT))
    config, found = load_gpt(written(tmp_path, gpt_state_dict(variables, GPT)), num_heads=GPT.num_heads)
    assert config == GPT
    jax.tree.map(np.testing.assert_array_equal, found, variables)


def test_base_and_head_may_differ_in_depth_on_reading_only(golden_dir, tmp_path):
    state, sizes = golden(golden_dir, "gpt_l3")
    state = {key: array for key, array in state.items() if not key.startswith("trans_head.blocks.2.")}
    config, variables = load_gpt(written(tmp_path, state), num_heads=sizes["n_head"])
    assert config.num_layers == 5
    np.testing.assert_array_equal(
        variables["params"]["block_3"]["ln1"]["scale"], state["trans_head.blocks.0.ln1.weight"]
    )
    with pytest.raises(UserError, match=r"num_layers: 5 is odd"):
        gpt_state_dict(variables, config)


def test_names_may_carry_the_mark_of_parallel_training(golden_dir, tmp_path):
    state, _ = golden(golden_dir, VQVAE_NAMES[0])
    marked = {f"module.{key}": array for key, array in state.items()}
    config, variables = load_vqvae(written(tmp_path, marked))
    back = vqvae_state_dict(variables, config)
    assert all(np.array_equal(back[key], array) for key, array in state.items())


@pytest.mark.parametrize("prefix", ["model.", "trans.", "model.trans.module."])
def test_names_may_carry_the_prefixes_of_trainers(golden_dir, tmp_path, prefix):
    state, sizes = golden(golden_dir, "gpt_l2")
    marked = {f"{prefix}{key}": array for key, array in state.items()}
    config, variables = load_gpt(written(tmp_path, marked), num_heads=sizes["n_head"])
    back = gpt_state_dict(variables, config)
    assert all(np.array_equal(back[key], state[key]) for key in back if key not in (UNUSED, POSITIONS))


@pytest.mark.parametrize("dtype", [np.float16, np.float64])
@pytest.mark.parametrize(("load", "name"), [(load_vqvae, VQVAE_NAMES[0]), (load_gpt, "gpt_l2")])
def test_half_precision_and_doubles_are_read(golden_dir, tmp_path, load, name, dtype):
    state, sizes = golden(golden_dir, name)
    options = {"num_heads": sizes["n_head"]} if load is load_gpt else {}
    arrays = {key: array.astype(dtype) for key, array in state.items()}
    _, variables = load(written(tmp_path, arrays), **options)
    assert {leaf.dtype for leaf in jax.tree.leaves(variables["params"])} == {np.dtype(np.float32)}


def test_whole_numbers_are_no_table_of_positions(golden_dir, tmp_path):
    state, sizes = golden(golden_dir, "gpt_l2")
    path = written(tmp_path, state | {POSITIONS: state[POSITIONS].astype(np.int64)})
    assert "is not the table that the original computes" in refusal(load_gpt, path, num_heads=sizes["n_head"])


def refusal(load, path, **options) -> str:
    with pytest.raises(UserError) as caught:
        load(path, **options)
    message = str(caught.value)
    assert message.startswith(f"{path}: ") and message.isprintable()
    return message


CONV, CODEBOOK = "vqvae.decoder.model.3.0.model.1.conv2.weight", "vqvae.quantizer.codebook"
TOKENS = "trans_base.tok_emb.weight"
SIZES = (CODEBOOK, POSITIONS, TOKENS)
"""Keys that sizes are read off: where one is changed, it may be another that does not fit."""
MASK, KEY = "trans_head.blocks.1.attn.mask", "trans_base.blocks.1.attn.key.weight"


@pytest.mark.parametrize(
    ("load", "name", "key", "change", "said"),
    [
        (load_vqvae, VQVAE_NAMES[0], CONV, None, "is missing"),
        (load_vqvae, VQVAE_NAMES[0], CODEBOOK, None, "is missing"),
        (load_vqvae, VQVAE_NAMES[0], "vqvae.extra.weight", lambda _: np.ones(3), "is not part of the model"),
        (load_vqvae, VQVAE_NAMES[0], CONV, lambda old: old[:-1], "has shape (31, 32, 1); its config needs"),
        (load_vqvae, VQVAE_NAMES[0], CONV, lambda old: old * np.nan, "not finite"),
        (load_vqvae, VQVAE_NAMES[0], CONV, lambda old: old.astype(np.float64) + 1e300, "not finite"),
        (load_vqvae, VQVAE_NAMES[0], CONV, lambda old: old.astype(np.int32), "holds int32"),
        (load_vqvae, VQVAE_NAMES[0], CODEBOOK, lambda old: old[:, :5], "has shape"),
        (load_vqvae, VQVAE_NAMES[0], CODEBOOK, lambda old: old[:, 0], "2 axes are needed"),
        (load_vqvae, VQVAE_NAMES[0], CODEBOOK, lambda old: old[:0], "num_codes: 0"),
        (load_gpt, "gpt_l2", MASK, None, "is missing"),
        (load_gpt, "gpt_l2", MASK, np.ones_like, "is not the table"),
        (load_gpt, "gpt_l2", POSITIONS, lambda old: old + 2e-4, "is not the table"),
        (load_gpt, "gpt_l2", POSITIONS, lambda old: old[:-1], "has shape"),
        (load_gpt, "gpt_l2", UNUSED, lambda old: old[:-1], "has shape"),
        (load_gpt, "gpt_l2", KEY, lambda old: old[:, :8], "has shape"),
        (load_gpt, "gpt_l2", TOKENS, lambda old: old[:2], "num_codes: 0"),
        (load_gpt, "gpt_l2", TOKENS, lambda old: old[:, :0], "embed_dim: 0"),
        (load_gpt, "gpt_l2", "trans_base.blocks.3.ln1.weight", lambda _: np.ones(32), "is not part of the model"),
    ],
)
def test_what_does_not_fit_is_named(golden_dir, tmp_path, load, name, key, change, said):
    state, sizes = golden(golden_dir, name)
    old = state.pop(key, None)
    if change is not None:
        state[key] = change(old)
    options = {"num_heads": sizes["n_head"]} if load is load_gpt else {}
    message = refusal(load, written(tmp_path, state), **options)
    assert said in message
    if key not in SIZES:
        assert repr(key) in message


def test_files_of_something_else_are_named(golden_dir, tmp_path):
    folder = golden_dir / "t2m_gpt"
    assert "contains a GPT ('trans'), but a VQ-VAE is needed" in refusal(load_vqvae, folder / "ckpt_gpt_small.pth")
    assert "contains a VQ-VAE ('net'), but a GPT is needed" in refusal(load_gpt, folder / "ckpt_vqvae_small.pth")
    assert "'vqvae.encoder.model.0.weight' is missing" in refusal(load_vqvae, golden_dir / "torch" / "zip.pth")
    path = write_archive(tmp_path / "x.pth", entry(text("trans"), number(3)))
    assert "'trans' is not a dictionary of tensors" in refusal(load_gpt, path)
    path = write_archive(tmp_path / "x.pth", entry(text("epoch"), number(3)))
    assert "'epoch' in 'trans' is not a tensor" in refusal(load_gpt, path)
    assert "is missing" in refusal(load_gpt, written(tmp_path, {"a": np.ones(2)}))
    (tmp_path / "damaged.safetensors").write_bytes(b"no")
    assert "damaged" in refusal(load_gpt, tmp_path / "damaged.safetensors")
    assert "num_heads: 5 does not divide" in refusal(load_gpt, folder / "ckpt_gpt_small.pth", num_heads=5)
    assert "num_heads: 0" in refusal(load_gpt, folder / "ckpt_gpt_small.pth", num_heads=0)
    config = VqVaeConfig(**{**vars(VQVAE), "norm": "LN"})
    state = vqvae_state_dict(random_variables(variable_shapes(config)), config)
    assert "width: 16 is not a multiple" in refusal(load_vqvae, written(tmp_path, state), norm="GN")
    assert "is not part of the model" in refusal(load_vqvae, written(tmp_path, state), norm="none")
