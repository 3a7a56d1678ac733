"""Models as ONNX graphs: onnxruntime computes what JAX does, and the sampler of the docs makes the same motion."""

import dataclasses
import hashlib
import importlib
import sys

import jax
import jax.numpy as jnp
import numpy as np
import onnx
import onnxruntime
import pytest

from t2m_jax.checkpoints.bundle import save_bundle
from t2m_jax.checkpoints.text_encoder import ClipReference, SentenceReference, SentenceStatesConfig, load_pretrained
from t2m_jax.cli.main import main
from t2m_jax.errors import UserError
from t2m_jax.export.onnx.convert import save_graph
from t2m_jax.export.onnx.folder import export_onnx
from t2m_jax.export.onnx.graphs import array_of, make_graph
from t2m_jax.models.caption_encoder import StateEncoderConfig
from t2m_jax.sampling import TextToMotion
from tests.clip_golden import CAPTIONS as CLIP_CAPTIONS
from tests.clip_golden import FULL
from tests.clip_golden import golden as clip_golden
from tests.conftest import REPOSITORY
from tests.sentence_golden import BERT, MPNET, ROBERTA, golden
from tests.sentence_golden import CAPTIONS as SENTENCES
from tests.tiny import BUNDLE, CAPTIONS, GPT, HIFIGPT, HIFIGPT_BUNDLE, random_bundle

TABLE = np.random.default_rng(0).normal(size=(7, 4)).astype(np.float32)
KERNEL = np.random.default_rng(1).normal(size=(3, 4, 5)).astype(np.float32)

FUNCTIONS = {
    "a row is written": lambda x, n: jax.lax.dynamic_update_slice_in_dim(x, 2 * x[:, :1], n[0], axis=1),
    "a row is written far after the end": lambda x, n: jax.lax.dynamic_update_slice_in_dim(x, x[:, :1], n[0] + 99, 1),
    "rows are read": lambda x, n: jax.lax.dynamic_slice_in_dim(x, n[0], 2, axis=1),
    "rows are read after the end": lambda x, n: jax.lax.dynamic_slice_in_dim(x, n[0] + 99, 2, axis=1),
    "a table is read": lambda x, n: jnp.asarray(TABLE)[jnp.stack([n, n + 1])],
    "an axis is indexed": lambda x, n: jnp.take_along_axis(x, n[:, None, None], axis=1),
    "a product of batches": lambda x, n: jnp.einsum("btc,bsc->bst", x, 2 * x),
    "a product with a matrix": lambda x, n: x @ jnp.asarray(TABLE.T),
    "a sum over two axes": lambda x, n: jnp.einsum("btc,btd->dc", x, jnp.exp(x)),
    "a convolution": lambda x, n: jax.lax.conv_general_dilated(
        x, jnp.asarray(KERNEL), (2,), [(1, 2)], rhs_dilation=(2,), dimension_numbers=("NHC", "HIO", "NHC")
    ),
    "a reversed sum": lambda x, n: jax.lax.cumsum(x, axis=1, reverse=True),
    "the largest": lambda x, n: (jnp.argmax(x, axis=1) + n[:, None]).astype(jnp.float32),
    "limits": lambda x, n: jnp.clip(x, -0.5, n.astype(jnp.float32)[0]),
    "choices": lambda x, n: jnp.where((x > 0) & ~(x == n[0]) | (x != x), x, jnp.pad(x, ((0, 0), (0, 0), (0, 0)))),
    "padding": lambda x, n: jnp.pad(x, ((0, 0), (1, 2), (0, 0)), constant_values=3.0),
    "activations": lambda x, n: jax.nn.gelu(x, approximate=False) + jax.nn.silu(x) + jnp.tanh(x) ** 3,
    "norms": lambda x, n: jax.nn.softmax(x) + (x - x.mean(axis=-1, keepdims=True)) * jax.lax.rsqrt(x.var() + 1e-5),
    "parts": lambda x, n: jnp.concatenate([jnp.moveaxis(x, 1, 0)[1], *jnp.split(x[0], 5)], axis=0)[::2],
    "slices of an inner axis": lambda x, n: jax.vmap(lambda places: x[0][:, places])(jnp.array([[0, 2, 1], [3, 3, 0]])),
    "rows of each batch": lambda x, n: jax.vmap(lambda own, place: own[place])(
        x, jnp.stack([n, jnp.minimum(n + 1, 4)], axis=1)
    ),
    "changed rows": lambda x, n: x.at[:, jnp.array([3, 1])].set(2 * x[:, :2]),
    "sums by place": lambda x, n: jax.vmap(lambda own, place: jax.ops.segment_sum(own, place, 5))(
        x, jnp.array([[1, 1, 4, 0, 1]]) * n[:, None].clip(0, 1)
    ),
    "neighbors": lambda x, n: jax.lax.reduce_window(x, 0.0, jax.lax.max, (1, 3, 1), (1, 1, 1), "SAME"),
    "any neighbor": lambda x, n: jax.lax.reduce_window(
        x > 0.5, False, jax.lax.bitwise_or, (1, 1, 3), (1, 1, 1), "SAME"
    ).astype(jnp.float32),
    "the largest so far": lambda x, n: jax.lax.cummax(x, axis=1) + jax.lax.cummin(x, axis=2, reverse=True),
    "whole numbers so far": lambda x, n: jax.lax.cummax((9 * x).astype(jnp.int32), axis=1, reverse=True),
    "an order": lambda x, n: jnp.sort(x, axis=1),
    "rounds": lambda x, n: jax.lax.fori_loop(0, 3, lambda number, y: y * x + number, x),
    "angles": lambda x, n: jnp.arccos(jnp.clip(x, -1, 1)) + jnp.floor(x) + jnp.ceil(x),
    "an input": lambda x, n: x,
    "what depends on nothing": lambda x, n: jnp.arange(3.0) * 2,
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_a_graph_computes_what_its_function_does(name, tmp_path):
    """`save_graph` compares, too, but with ones as numbers of rows."""
    inputs = {"x": array_of(1, 5, 4), "n": array_of(1, dtype=jnp.int32)}
    graph = make_graph(lambda *given: (FUNCTIONS[name](*given),), inputs, ["y"])
    save_graph(tmp_path / "graph.onnx", graph)
    session = onnxruntime.InferenceSession(tmp_path / "graph.onnx")
    x = np.random.default_rng(2).normal(size=(1, 5, 4)).astype(np.float32)
    for number in (0, 2, 4):
        given = {"x": x, "n": np.array([number], np.int32)}
        (found,) = session.run(["y"], given)
        np.testing.assert_allclose(found, FUNCTIONS[name](*map(jnp.asarray, given.values())), atol=1e-5)


def test_a_function_without_a_rule_is_refused(tmp_path):
    graph = make_graph(lambda x: (jnp.linalg.qr(x)[0],), {"x": array_of(3, 3)}, ["q"])
    with pytest.raises(UserError, match=r"export: the model computes '.*', for which there is no rule yet"):
        save_graph(tmp_path / "graph.onnx", graph)


def test_weights_are_small_where_that_changes_nothing(tmp_path):
    random = np.random.default_rng(0)
    numbers = random.integers(-127, 128, (64, 32), np.int8)
    scales = random.uniform(0.5, 1.5, (64, 2)).astype(np.float16)
    eights = (numbers.reshape(64, 2, 16) * scales[:, :, None].astype(np.float32)).reshape(64, 32)
    halves = random.normal(size=(64, 32)).astype(np.float16).astype(np.float32)
    others = random.normal(size=(32, 64)).astype(np.float32)
    graph = make_graph(lambda x: (x @ eights.T @ halves @ others,), {"x": array_of(1, 32)}, ["y"])
    save_graph(tmp_path / "graph.onnx", graph, quantized=[(numbers, scales)])
    stored = onnx.load(tmp_path / "graph.onnx").graph.initializer
    sizes = {(onnx.TensorProto.DataType.Name(array.data_type), int(np.prod(array.dims))) for array in stored}
    assert {("INT8", 2048), ("FLOAT16", 2048), ("FLOAT", 2048)} <= sizes
    x = random.normal(size=(1, 32)).astype(np.float32)
    (found,) = onnxruntime.InferenceSession(tmp_path / "graph.onnx").run(None, {"x": x})
    np.testing.assert_allclose(found, x @ eights.T @ halves @ others, rtol=1e-4, atol=1e-2)


@pytest.fixture(scope="module")
def parity():
    """The module of the docs that compares graphs with JAX."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(REPOSITORY / "docs" / "engines")
        yield importlib.import_module("parity")


def pretrained(reference):
    """Returns the config of a T2M-GPT that reads captions with an encoder that was trained before."""
    width = load_pretrained(reference).config.text_dim
    return dataclasses.replace(BUNDLE, generator=dataclasses.replace(GPT, text_dim=width), text_encoder=reference)


STATES = SentenceStatesConfig(
    encoder=SentenceReference(name=f"{BERT}"),
    network=StateEncoderConfig(state_dim=24, embed_dim=16, num_layers=1, num_heads=2, text_dim=12, max_length=10),
)


@pytest.mark.slow
@pytest.mark.parametrize(
    "folder",
    [BERT, FULL, *(pytest.param(folder, marks=pytest.mark.release) for folder in (MPNET, ROBERTA))],
    ids=lambda folder: folder.name,
)
def test_sentences_get_the_embeddings_of_the_reference(folder, tmp_path, parity):
    kind = ClipReference if folder == FULL else SentenceReference
    config = pretrained(kind(name=f"{folder}"))
    export_onnx(tmp_path / "model", random_bundle(config)._replace(bpe=None))
    is_clip = folder == FULL
    captions = CLIP_CAPTIONS if is_clip else SENTENCES
    wanted = clip_golden(FULL, "embeddings") if is_clip else golden(folder)
    graphs = parity.OnnxModel(tmp_path / "model")
    # Longer sentences are cut, as the manifest says.
    short = [len(graphs.tokenizer.encode(caption).ids) <= graphs.manifest["text"]["max_tokens"] for caption in captions]
    assert sum(short) > len(captions) // 2
    for caption, embedding, fits in zip(captions, wanted, short, strict=True):
        if fits or is_clip:
            np.testing.assert_allclose(graphs.embed(caption)[0], embedding, atol=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize(
    "config",
    [
        pytest.param(BUNDLE, marks=pytest.mark.release),
        HIFIGPT_BUNDLE,
        pytest.param(
            dataclasses.replace(
                HIFIGPT_BUNDLE,
                text_encoder=STATES,
                generator=dataclasses.replace(HIFIGPT, stop_rule="sampled", head="per_depth", code_embedding="learned"),
            ),
            marks=pytest.mark.release,
        ),
    ],
    ids=["t2m_gpt", "hifigpt", "hifigpt-states"],
)
def test_an_exported_model_makes_the_motion_of_the_package(config, tmp_path, parity):
    save_bundle(tmp_path / "bundle", random_bundle(config), card="---\nlicense: mit\n---\n# Tiny\n")
    assert main(["export", "onnx", f"{tmp_path / 'bundle'}", f"{tmp_path / 'onnx'}"]) == 0
    model, graphs = TextToMotion.load(tmp_path / "bundle"), parity.OnnxModel(tmp_path / "onnx")
    for greedy in (True, False):
        found = parity.compare(model, graphs, [*CAPTIONS] * 2, greedy=greedy)
        assert found["motions"] == 10 and found["rows"] > 10
        assert found["other_rows"] == 0 and found["largest_mm"] < 1 and found["largest_cleaned_mm"] < 1
    manifest = graphs.manifest
    assert manifest["license"] == "mit"
    for name, file in manifest["files"].items():
        data = (tmp_path / "onnx" / name).read_bytes()
        assert file == {"bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()}
    named = {graph["file"] for graph in manifest["graphs"].values()} | {manifest["card"], manifest["text"]["tokenizer"]}
    assert set(manifest["files"]) == named


def test_without_the_extra_there_is_one_line(monkeypatch, tmp_path, capsys):
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    assert main(["export", "onnx", "no-such-model", f"{tmp_path / 'onnx'}"]) == 2
    wanted = "t2m: error: export: onnxruntime is missing; pip install 't2m-jax[onnx]'\n"
    assert capsys.readouterr().err == wanted


def test_a_folder_is_not_replaced(tmp_path, capsys):
    (tmp_path / "onnx").mkdir()
    (tmp_path / "onnx" / "mine").touch()
    assert main(["export", "onnx", "no-such-model", f"{tmp_path / 'onnx'}"]) == 2
    assert f"{tmp_path / 'onnx'}: " in capsys.readouterr().err
