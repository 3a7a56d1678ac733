"""Small copies of sentence encoders: nearly the same embeddings, and the same tokens of English sentences."""

import json

import numpy as np
import pytest
from safetensors.numpy import load_file, save_file

from t2m_jax.checkpoints.compact import TOKEN_TABLE, kept_tokens, quantize_rows, save_compact_encoder
from t2m_jax.checkpoints.pretrained import restore_rows
from t2m_jax.checkpoints.sentence import load_sentence_encoder
from t2m_jax.cli.main import main
from t2m_jax.errors import UserError
from t2m_jax.sampling.text_encoders import PretrainedTextEncoder
from tests.sentence_golden import BERT, CAPTIONS, ROBERTA, change_json, copy_encoder


@pytest.fixture(scope="module")
def copy(tmp_path_factory):
    folder = tmp_path_factory.mktemp("compact") / "copy"
    save_compact_encoder(folder, BERT)
    return folder


@pytest.mark.slow
def test_embeddings_are_nearly_those_of_the_original(copy):
    english = [caption for caption in CAPTIONS if caption.isascii() and len(caption) < 100]
    whole, small = (
        np.asarray(PretrainedTextEncoder(load_sentence_encoder(folder))(english)) for folder in (BERT, copy)
    )
    cosines = np.sum(whole * small, axis=1) / np.linalg.norm(whole, axis=1) / np.linalg.norm(small, axis=1)
    assert len(english) > 5 and 0.999 < cosines.min() < 1 - 1e-9


def test_the_copy_has_8_bits_and_the_same_tokens(copy):
    arrays = load_file(copy / "model.safetensors")
    assert {array.dtype for name, array in arrays.items() if array.ndim == 2 and not name.endswith(".scale")} == {
        np.dtype(np.int8)
    }
    one, other = (load_sentence_encoder(folder).tokenizer for folder in (BERT, copy))
    for caption in CAPTIONS[:4]:
        assert one.encode(caption).tokens == other.encode(caption).tokens
    assert other.encode(CAPTIONS[0]).ids[0] == other.token_to_id("[CLS]")


@pytest.mark.parametrize("kind", ["TemplateProcessing", "BertProcessing"])
def test_special_tokens_may_have_any_numbers(copy, tmp_path, kind):
    """Here, tokens are numbered from the end, after one of another script. Older files say the marks in another way."""
    source = copy_encoder(BERT, tmp_path / "source")
    tokenizer = json.loads((source / "tokenizer.json").read_text(encoding="utf-8"))
    last = len(tokenizer["model"]["vocab"])
    numbers = {token: last - number for token, number in tokenizer["model"]["vocab"].items()}
    tokenizer["model"]["vocab"] = numbers | {"привет": 0}
    for token in tokenizer["added_tokens"]:
        token["id"] = last - token["id"]
    for token in tokenizer["post_processor"]["special_tokens"].values():
        token["ids"] = [last - number for number in token["ids"]]
    if kind == "BertProcessing":
        marks = {end: [token, numbers[token]] for end, token in (("cls", "[CLS]"), ("sep", "[SEP]"))}
        tokenizer["post_processor"] = {"type": kind, **marks}
    (source / "tokenizer.json").write_text(json.dumps(tokenizer), encoding="utf-8")
    arrays = load_file(source / "model.safetensors")
    table = arrays[TOKEN_TABLE][:last]
    arrays[TOKEN_TABLE] = np.concatenate([table[:1], table[::-1]])
    save_file(arrays, source / "model.safetensors")
    change_json(source / "config.json", vocab_size=last + 1)
    save_compact_encoder(tmp_path / "small", source)
    one, other = (PretrainedTextEncoder(load_sentence_encoder(folder)) for folder in (copy, tmp_path / "small"))
    np.testing.assert_allclose(one(CAPTIONS[:6]), other(CAPTIONS[:6]), atol=1e-6)


def test_marks_of_an_unknown_kind_are_refused(tmp_path):
    source = copy_encoder(BERT, tmp_path / "source")
    marks = json.loads((source / "tokenizer.json").read_text(encoding="utf-8"))["post_processor"]
    change_json(source / "tokenizer.json", post_processor={"type": "Sequence", "processors": [marks]})
    with pytest.raises(UserError, match="adds marks to sentences by Sequence; it cannot be made smaller"):
        save_compact_encoder(tmp_path / "small", source)


def test_other_scripts_are_left_out_and_numbered_anew():
    words = ["[PAD]", "[unused1]", "[CLS]", "walk", "##ing", "跳", "##é", "…", "180", "привет", "‘"]
    kept = kept_tokens({word: number for number, word in enumerate(words)}, special={"[PAD]", "[CLS]"})
    assert list(kept) == ["[PAD]", "[CLS]", "walk", "##ing", "##é", "…", "180", "‘"]
    assert kept["walk"] == 3


def test_matrices_come_back_within_half_a_step(tmp_path):
    matrix = np.random.default_rng(0).normal(size=(5, 128)).astype(np.float32) * [[1], [10], [0.1], [0], [3]]
    arrays = quantize_rows({"matrix": matrix.astype(np.float32), "bias": np.ones(3, np.float32)})
    found = restore_rows(tmp_path, arrays)
    assert arrays["matrix.scale"].shape == (5, 2) and set(found) == {"matrix", "bias"}
    steps = np.repeat(arrays["matrix.scale"].astype(np.float32), 64, axis=1)
    assert (np.abs(found["matrix"] - matrix) <= 0.56 * steps).all()


@pytest.mark.parametrize("shape", [None, (3, 1), "no scale for a row", (24,)])
def test_8_bits_without_their_scales_are_refused(copy, tmp_path, shape):
    arrays = load_file(copy / "model.safetensors")
    name = "embeddings.word_embeddings.weight.scale"
    rows = len(arrays.pop(name))
    shape = (rows, 0) if isinstance(shape, str) else shape
    scales = {} if shape is None else {name: np.ones(shape, np.float16)}
    save_file(arrays | scales, tmp_path / "model.safetensors")
    with pytest.raises(UserError, match=r"word_embeddings.weight' has 8 bits, but no scales that fit its rows"):
        restore_rows(tmp_path / "model.safetensors", load_file(tmp_path / "model.safetensors"))


def test_the_command_writes_a_copy_and_refuses_what_is_none(copy, tmp_path, capsys):
    assert main(["convert", "sentence", f"{tmp_path / 'copy'}", "--encoder", f"{BERT}"]) == 0
    assert (tmp_path / "copy" / "model.safetensors").read_bytes() == (copy / "model.safetensors").read_bytes()
    capsys.readouterr()
    for options, said in (
        (["--encoder", f"{ROBERTA}"], "is not a WordPiece tokenizer"),
        ([], "convert: give both"),
        (["--encoder", f"{BERT}", "--gpt", "x"], "convert: --gpt cannot be used with a sentence encoder"),
    ):
        assert main(["convert", "sentence", f"{tmp_path / 'other'}", *options]) == 2
        error = capsys.readouterr().err.strip()
        assert said in error and "\n" not in error
