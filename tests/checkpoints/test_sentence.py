"""Sentence encoders on disk: the reference's embeddings, copies, and what is refused by name."""

import json
import re
import shutil

import numpy as np
import pytest
from safetensors.numpy import load_file, save_file

from t2m_jax.checkpoints.encoder_files import find_encoder, user_folder
from t2m_jax.checkpoints.sentence import SENTENCE_FILES, load_sentence_encoder, save_sentence_encoder
from t2m_jax.checkpoints.text_encoder import SentenceReference, load_pretrained
from t2m_jax.errors import UserError
from t2m_jax.text.bpe import tokenize_captions
from tests.sentence_golden import BERT, CAPTIONS, FOLDERS, MPNET, ROBERTA, change_json, copy_encoder

TOKENIZER = "tokenizer_config.json"
LENGTH, PROMPTS, POOLING = "sentence_bert_config.json", "config_sentence_transformers.json", "1_Pooling/config.json"


def refused(name) -> str:
    with pytest.raises(UserError) as caught:
        load_sentence_encoder(name)
    assert "\n" not in str(caught.value) and len(str(caught.value)) <= 400
    return str(caught.value)


@pytest.fixture
def copy(tmp_path):
    return copy_encoder(BERT, tmp_path / "copy")


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.name)
def test_what_is_saved_comes_back(folder, tmp_path):
    encoder = load_sentence_encoder(folder)
    save_sentence_encoder(tmp_path / "saved", encoder)
    found = load_sentence_encoder(tmp_path / "saved")
    assert (found.config, found.fingerprint) == (encoder.config, encoder.fingerprint)
    assert all((folder / path.name).exists() for path in (tmp_path / "saved").iterdir())


def test_only_known_files_are_copied(copy, tmp_path):
    (copy / "modeling.py").write_text("raise SystemExit")
    (copy / "pytorch_model.bin").write_bytes(b"pickle")
    save_sentence_encoder(tmp_path / "saved", load_sentence_encoder(copy))
    assert not {"modeling.py", "pytorch_model.bin"} & {path.name for path in (tmp_path / "saved").rglob("*")}


def test_the_fingerprint_is_that_of_all_an_embedding_depends_on(copy):
    found = {load_sentence_encoder(BERT).fingerprint}
    change_json(copy / LENGTH, max_seq_length=20)
    found.add(load_sentence_encoder(copy).fingerprint)
    change_json(copy / POOLING, pooling_mode="cls")
    found.add(load_sentence_encoder(copy).fingerprint)
    arrays = load_file(copy / "model.safetensors")
    arrays["encoder.layer.1.output.dense.bias"][3] += 1e-6
    save_file(arrays, copy / "model.safetensors")
    found.add(load_sentence_encoder(copy).fingerprint)
    assert len(found) == 4


def test_other_parts_and_prefixes_of_the_weights_do_not_matter(copy):
    arrays = {f"bert.{name}": array for name, array in load_file(copy / "model.safetensors").items()}
    ids = np.arange(48, dtype=np.int64)[None]
    save_file(arrays | {"cls.bias": ids, "bert.embeddings.position_ids": ids}, copy / "model.safetensors")
    assert load_sentence_encoder(copy).fingerprint == load_sentence_encoder(BERT).fingerprint


def test_long_captions_are_cut_and_keep_their_marks(copy):
    change_json(copy / LENGTH, max_seq_length=9)
    encoder = load_sentence_encoder(copy)
    tokens, mask = tokenize_captions(encoder.tokenizer, CAPTIONS, max_length=9)
    first, last = (encoder.tokenizer.token_to_id(mark) for mark in ("[CLS]", "[SEP]"))
    assert mask.sum(axis=1).max() == 9 and mask.sum(axis=1).min() == 2
    assert np.all(tokens[:, 0] == first) and np.all(tokens[np.arange(len(tokens)), mask.sum(axis=1) - 1] == last)


def test_the_length_is_that_of_the_file_for_it_of_the_tokenizer_or_of_the_positions(copy):
    found = []
    for name, limit in (
        (LENGTH, 7),
        (LENGTH, None),
        (TOKENIZER, None),
        (TOKENIZER, 10**30),
    ):
        change_json(copy / name, **{"max_seq_length" if name == LENGTH else "model_max_length": limit})
        found.append(load_sentence_encoder(copy).config.max_length)
    assert found == [7, 40, 48, 48]
    change_json(copy / LENGTH, max_seq_length=49)
    assert load_sentence_encoder(copy).config.max_length == 48


def test_older_files_have_a_switch_for_each_kind_of_pooling(copy):
    switches = {"pooling_mode_cls_token": True, "pooling_mode_mean_tokens": False, "pooling_mode_max_tokens": False}
    change_json(copy / POOLING, pooling_mode=None, **switches)
    assert load_sentence_encoder(copy).config.pooling == "cls"
    change_json(copy / POOLING, pooling_mode_mean_tokens=True)
    assert f"{copy / POOLING}: the kind of pooling must be mean or cls" in refused(copy)


def test_captions_can_be_lowered_first(copy):
    data = json.loads((copy / "tokenizer.json").read_text())
    data["normalizer"] = None
    (copy / "tokenizer.json").write_text(json.dumps(data))
    wanted = load_sentence_encoder(BERT).tokenizer.encode("a person walks").ids
    assert load_sentence_encoder(copy).tokenizer.encode("A Person WALKS").ids != wanted
    change_json(copy / LENGTH, do_lower_case=True)
    assert load_sentence_encoder(copy).tokenizer.encode("A Person WALKS").ids == wanted


NO_SEP = {
    "type": "TemplateProcessing",
    "single": [{"Sequence": {"id": "A", "type_id": 0}}, {"SpecialToken": {"id": "[SEP]", "type_id": 0}}],
    "pair": [{"Sequence": {"id": "A", "type_id": 0}}, {"Sequence": {"id": "B", "type_id": 1}}],
    "special_tokens": {},
}


@pytest.mark.parametrize(
    ("file", "changes", "reason"),
    [
        ("config.json", {"model_type": "t5"}, "model_type 't5' is not supported; known: bert, roberta"),
        ("config.json", {"position_embedding_type": "relative_key"}, "position_embedding_type must be 'absolute'"),
        ("config.json", {"hidden_act": "relu"}, "activation: expected one of 'gelu'"),
        (
            "config.json",
            {"max_position_embeddings": "48"},
            "max_position_embeddings: expected a whole number, got '48'",
        ),
        ("config.json", {"hidden_size": 2**70}, "embed_dim: 1180591620717411303424 is more than"),
        ("config.json", {"num_hidden_layers": 3}, "array 'encoder.layer.2.attention.output.LayerNorm.bias' is missing"),
        ("config.json", {"vocab_size": 100}, "has a token 249, but its encoder knows 100 tokens"),
        (LENGTH, {"max_seq_length": 2}, "adds 2 special tokens; expected at least 1, and fewer than 2"),
        (LENGTH, {"max_seq_length": -5}, "max_length: -5"),
        (PROMPTS, {"default_prompt_name": "query"}, "has a default prompt, which is not supported"),
        (POOLING, {"pooling_mode": "max"}, "the kind of pooling must be mean or cls, not 'max'"),
        (POOLING, {"pooling_mode": ["mean", "max"]}, "the kind of pooling must be mean or cls, not ['mean', 'max']"),
        ("tokenizer.json", {"post_processor": None}, "adds 0 special tokens"),
        ("tokenizer.json", {"post_processor": NO_SEP}, "adds a token '[SEP]', which it does not define"),
        (
            "tokenizer.json",
            {"post_processor": {"type": "Sequence", "processors": [NO_SEP]}},
            "adds a token '[SEP]', which it does not define",
        ),
    ],
)
def test_files_that_do_not_fit_are_named(file, changes, reason, copy):
    change_json(copy / file, **changes)
    message = refused(copy)
    assert reason in message and str(copy) in message


@pytest.mark.parametrize(
    "modules", [3, [], [1, 2], [{"type": "a.Transformer", "path": ""}], "dense", "elsewhere"], ids=str
)
def test_other_steps_are_refused(modules, copy):
    if isinstance(modules, str):
        path = "2_Dense" if modules == "dense" else "../../1_Pooling"
        steps = {"dense": ("Transformer", "Pooling", "Dense"), "elsewhere": ("Transformer", "Pooling")}[modules]
        modules = [{"type": f"a.{step}", "path": ("", "1_Pooling", "2_Dense")[n]} for n, step in enumerate(steps)]
        modules[-1]["path"] = path
    (copy / "modules.json").write_text(json.dumps(modules))
    assert f"{copy / 'modules.json'}: expected Transformer, Pooling" in refused(copy)


@pytest.mark.parametrize("name", ["config.json", "modules.json", POOLING, "tokenizer.json", "model.safetensors"])
def test_a_missing_or_damaged_file_is_named(name, copy):
    (copy / name).write_bytes((copy / name).read_bytes()[:-3])
    assert str(copy / name) in refused(copy)
    (copy / name).unlink()
    assert str(copy / name) in refused(copy)


def test_another_width_is_refused():
    with pytest.raises(UserError, match=r"embeddings of 24 numbers, but the generator reads 512 \(model.text_dim\)"):
        load_pretrained(SentenceReference(name=str(BERT)), text_dim=512)
    assert load_pretrained(SentenceReference(name=str(BERT)), text_dim=24).config.text_dim == 24


@pytest.fixture
def hub(monkeypatch, tmp_path):
    """Returns the folder of the hub's client, which is offline."""
    from huggingface_hub import constants

    monkeypatch.setattr("platformdirs.user_data_dir", lambda name: str(tmp_path / "data" / name))
    monkeypatch.setattr(constants, "HF_HUB_CACHE", str(tmp_path / "hub"))
    monkeypatch.setattr(constants, "HF_HUB_OFFLINE", True)
    return tmp_path / "hub"


def test_offline_the_error_says_what_to_download_and_where_to_put_it(hub):
    message = refused("someone/tiny")
    for part in (
        "modules.json",
        POOLING,
        "tokenizer.json and model.safetensors",
        "huggingface.co/someone/tiny/tree/main",
    ):
        assert part in message
    folder = user_folder("someone/tiny", "sentence")
    assert str(folder) in message
    shutil.copytree(MPNET, folder)
    assert load_sentence_encoder("someone/tiny").fingerprint == load_sentence_encoder(MPNET).fingerprint


@pytest.mark.parametrize("missing", [None, "modules.json", POOLING, "tokenizer.json"])
def test_a_snapshot_of_the_hub_must_be_complete(missing, hub):
    """Another program may have downloaded the network alone; then nothing says how it makes an embedding."""
    repository = hub / "models--someone--tiny"
    (repository / "refs").mkdir(parents=True)
    (repository / "refs" / "main").write_text("a" * 40)
    snapshot = copy_encoder(ROBERTA, repository / "snapshots" / ("a" * 40))
    if missing is None:
        assert find_encoder("someone/tiny", SENTENCE_FILES) == snapshot
    else:
        (snapshot / missing).unlink()
        assert re.search(r"not on the hub \(.*\); copy config\.json", refused("someone/tiny"))
