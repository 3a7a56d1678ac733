"""Bundles from anybody: whatever stands in their files, they load or are refused in one line, and nothing is run."""

import json
import os
import random
import shutil
import struct

import jax
import numpy as np
import pytest
import yaml

from t2m_jax.checkpoints.bundle import (
    CONFIG_FILE,
    WEIGHTS_FILE,
    expected_variables,
    load_bundle,
    load_bundle_config,
    part_kinds,
    save_bundle,
)
from t2m_jax.errors import UserError
from t2m_jax.files.arrays import load_arrays
from t2m_jax.motion.normalizer import load_normalizer
from t2m_jax.sampling import TextToMotion
from t2m_jax.text.bpe import load_bpe
from tests.tiny import BUNDLE, random_bundle, trust_manifests

MEAN, TOKENIZER = "Mean.npy", "tokenizer.json"


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


@pytest.fixture(scope="module")
def loaders():
    """Returns what reads each file of a bundle, so that many damaged ones can be read in little time."""
    kinds = part_kinds(BUNDLE)
    expected = {kinds[role]: shapes for role, shapes in expected_variables(BUNDLE).items()}
    return {
        CONFIG_FILE: load_bundle_config,
        WEIGHTS_FILE: lambda folder: load_arrays(folder / WEIGHTS_FILE, expected),
        MEAN: load_normalizer,
        TOKENIZER: load_bpe,
    }


def is_refused(load, folder) -> bool:
    try:
        load(folder)
    except UserError as error:
        assert "\n" not in str(error)
        return True
    return False


@pytest.mark.parametrize("name", [CONFIG_FILE, WEIGHTS_FILE, MEAN, TOKENIZER])
def test_changed_bytes(saved, copy, loaders, name):
    draws = random.Random(1)
    whole = (saved / name).read_bytes()
    refused = 0
    for _ in range(100):
        damaged = bytearray(whole)
        for _ in range(draws.randint(1, 3)):
            # The heads of the files say what the rest means.
            damaged[draws.randrange(min(len(whole), 3000))] = draws.randrange(256)
        (copy / name).write_bytes(damaged)
        refused += is_refused(loaders[name], copy)
    assert refused > 10


@pytest.mark.parametrize("name", [CONFIG_FILE, WEIGHTS_FILE, MEAN, TOKENIZER])
def test_files_that_end_early(saved, copy, loaders, name):
    whole = (saved / name).read_bytes()
    # A config may end anywhere: what it leaves out has a default.
    for length in range(0, len(whole), max(len(whole) // 30, 1)):
        (copy / name).write_bytes(whole[:length])
        assert is_refused(loaders[name], copy) or name == CONFIG_FILE


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no named pipes")
@pytest.mark.parametrize("name", [CONFIG_FILE, WEIGHTS_FILE, MEAN, TOKENIZER])
def test_pipes_and_devices_in_the_place_of_files(saved, copy, loaders, tmp_path, name):
    listed = shutil.copytree(saved, tmp_path / "listed")
    for folder, load in ((copy, loaders[name]), (listed, load_bundle)):
        (folder / name).unlink()
        os.mkfifo(folder / name)
        with pytest.raises(UserError, match=rf"{name}: is a pipe or device"):
            load(folder)
    (copy / name).unlink()
    (copy / name).symlink_to("/dev/zero")
    with pytest.raises(UserError, match=rf"{name}: is a pipe or device"):
        loaders[name](copy)


@pytest.mark.parametrize(
    ("section", "field"),
    [
        ("tokenizer", "width"),
        ("tokenizer", "num_stages"),
        ("tokenizer", "depth"),
        ("tokenizer", "dilation_growth"),
        ("generator", "embed_dim"),
        ("generator", "num_layers"),
        ("generator", "block_size"),
        ("text_encoder", "max_length"),
        ("text_encoder", "num_layers"),
    ],
)
@pytest.mark.parametrize("size", [10**6, 2**63, 10**30])
def test_sizes_that_would_fill_the_machine(copy, section, field, size):
    data = yaml.safe_load((copy / CONFIG_FILE).read_text())
    data[section][field] = size
    (copy / CONFIG_FILE).write_text(yaml.safe_dump(data))
    with pytest.raises(UserError, match=rf"{section}: {field}: {size} is more than \d+, the most that is allowed"):
        load_bundle(copy)


class Touch:
    """Pickled, it makes a file."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return os.system, (f"touch {self.path}",)


def npy(header: str, content: bytes = b"") -> bytes:
    """Returns a file of numpy with any header."""
    text = header.encode().ljust(117) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text + content


@pytest.mark.parametrize(
    "header",
    [
        "{'descr': '<f4', 'fortran_order': False, 'shape': (1000000000000,)}",
        "{'descr': '<f4', 'fortran_order': False, 'shape': (9223372036854775807,)}",
        "{'descr': '<f4', 'fortran_order': False, 'shape': (99999999999999999999999,)}",
        "{'descr': '<f4', 'fortran_order': False, 'shape': (-263,)}",
        "{'descr': '<f4', 'fortran_order': False, 'shape': (263, 4611686018427387904)}",
        "{'descr': '<f4', 'fortran_order': False, 'shape': 263}",
        "{'descr': '|V1000000000', 'fortran_order': False, 'shape': (263,)}",
        "{'descr': [('a', '<f4')], 'fortran_order': False, 'shape': (263,)}",
        "{'descr': '<c8', 'fortran_order': False, 'shape': (131,)}",
        "{'descr': '|O', 'fortran_order': False, 'shape': (263,)}",
        "{'descr': '<f4', 'fortran_order': False, 'shape': (__import__('os'),)}",
        "{'descr': '<f4', 'fortran_order': False, 'shape': (" + "(" * 60,
        "{'descr': ',f4', 'fortran_order': False, 'shape': (263,)}",
        "{}",
        "[]",
        "",
    ],
)
def test_headers_of_statistics(copy, header):
    (copy / MEAN).write_bytes(npy(header, bytes(1052)))
    with pytest.raises(UserError, match=MEAN):
        load_normalizer(copy)


def test_pickled_statistics_are_refused_and_not_run(copy, tmp_path):
    np.save(copy / MEAN, np.array([Touch(tmp_path / "marker")] * 263), allow_pickle=True)
    with pytest.raises(UserError, match=MEAN):
        load_normalizer(copy)
    assert not (tmp_path / "marker").exists()


def safetensors(header, content: bytes = b"") -> bytes:
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    return struct.pack("<Q", len(text)) + text + content


@pytest.mark.parametrize(
    "content",
    [
        struct.pack("<Q", 2**63) + b"{}",
        struct.pack("<Q", 10**8) + b"{}",
        safetensors(b"[" * 100_000),
        safetensors(b'{"a":' * 100_000),
        safetensors({"a": {"dtype": "F32", "shape": [2**40, 2**40], "data_offsets": [0, 4]}}, bytes(4)),
        safetensors({"a": {"dtype": "F32", "shape": [2**62], "data_offsets": [0, 2**64 - 1]}}, bytes(4)),
        safetensors({"a": {"dtype": "F32", "shape": [-1], "data_offsets": [0, 4]}}, bytes(4)),
        safetensors({"a": {"dtype": "F32", "shape": [1], "data_offsets": [4, 0]}}, bytes(4)),
        safetensors({"a": {"dtype": "OBJECT", "shape": [1], "data_offsets": [0, 4]}}, bytes(4)),
        safetensors({"a": {"dtype": "BF16", "shape": [2], "data_offsets": [0, 4]}}, bytes(4)),
        safetensors({"a": {"dtype": "F8_E4M3", "shape": [4], "data_offsets": [0, 4]}}, bytes(4)),
        safetensors({"a\n\x1b[2J": {"dtype": "F32", "shape": [1], "data_offsets": [0, 4]}}, bytes(4)),
        safetensors({"__metadata__": {"a": 3}}),
        safetensors([]),
    ],
)
def test_headers_of_weights(copy, loaders, content):
    (copy / WEIGHTS_FILE).write_bytes(content)
    assert is_refused(loaders[WEIGHTS_FILE], copy)


@pytest.mark.parametrize(
    "content",
    [
        b"[" * 100_000,
        b'{"a":' * 100_000,
        b"{}",
        b"null",
        b"3",
        b'{"version":"1.0","model":{"type":"BPE"}}',
        b"\xff\xfe",
    ],
)
def test_tokenizers_that_are_none(copy, content):
    (copy / TOKENIZER).write_bytes(content)
    with pytest.raises(UserError, match=TOKENIZER):
        load_bpe(copy)


def with_tokenizer(copy, change):
    path = copy / TOKENIZER
    tree = json.loads(path.read_text())
    change(tree)
    path.write_text(json.dumps(tree))


def template(token: int) -> dict:
    """A post-processor that adds a token which is not in the vocabulary."""
    special = {"id": "[x]", "ids": [token], "tokens": ["[x]"]}
    pieces = [{"SpecialToken": {"id": "[x]", "type_id": 0}}, {"Sequence": {"id": "A", "type_id": 0}}]
    return {"type": "TemplateProcessing", "single": pieces, "pair": pieces, "special_tokens": {"[x]": special}}


def raise_vocabulary(by: int):
    return lambda tree: tree["model"]["vocab"].update(a=tree["model"]["vocab"]["a"] + by)


def raise_added(by: int):
    return lambda tree: tree["added_tokens"].append(tree["added_tokens"][1] | {"id": by, "content": "[new]"})


CHANGES = {
    "vocabulary": raise_vocabulary,
    "added": raise_added,
    "template": lambda by: lambda tree: tree.update(post_processor=template(by)),
    "bert": lambda by: (
        lambda tree: tree.update(post_processor={"type": "BertProcessing", "sep": ["a", by], "cls": ["b", 2]})
    ),
}


@pytest.mark.parametrize("name", CHANGES)
def test_tokens_outside_the_table_of_embeddings(copy, name):
    with_tokenizer(copy, CHANGES[name](100_000))
    with pytest.raises(UserError, match=r"tokenizer\.json: the tokenizer has a token \d+"):
        load_bundle(copy)


@pytest.mark.parametrize("token", [2**31, 2**32 - 1, 10**30, 10**400])
@pytest.mark.parametrize("name", CHANGES)
def test_numbers_of_tokens_that_would_fill_the_memory(copy, name, token):
    with_tokenizer(copy, CHANGES[name](token))
    with pytest.raises(UserError, match=r"tokenizer\.json: "):
        load_bpe(copy)


def test_padding_of_a_tokenizer_that_would_fill_the_memory(copy):
    padding = {"direction": "Right", "pad_id": 0, "pad_type_id": 0, "pad_token": "[pad]", "pad_to_multiple_of": None}
    with_tokenizer(copy, lambda tree: tree.update(padding=padding | {"strategy": {"Fixed": 2**31}}))
    assert len(load_bpe(copy).encode("a").ids) == 1


def test_what_is_checked_of_a_tokenizer_is_what_is_read(copy):
    path = copy / TOKENIZER
    text = path.read_text()
    hidden = json.dumps(json.loads(text)["model"] | {"vocab": {"a": 2**31}})
    path.write_text('{"model": ' + hidden + ", " + text.lstrip()[1:])
    load_bpe(copy)


def test_embeddings_that_are_not_finite_are_refused():
    bundle = random_bundle()
    bad = jax.tree.map(lambda leaf: leaf * np.nan, bundle.variables["text_encoder"])
    model = TextToMotion(bundle._replace(variables=bundle.variables | {"text_encoder": bad}))
    with pytest.raises(UserError, match="not finite"):
        model.generate("a person walks", seed=1)
