"""Files of `torch.save`: what PyTorch wrote comes back. For what is refused, see test_hostile_torch_file.py."""

import pickle
from collections import Counter

import ml_dtypes
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from t2m_jax.checkpoints.torch_file import load_torch_file
from t2m_jax.errors import UserError
from tests.checkpoints.torch_archives import TENSOR, write_archive

BASE = np.arange(24, dtype=np.float32).reshape(4, 6)
NUMBERS = np.array([0, 1, -2, 100])
KINDS = {
    name: NUMBERS.astype(ml_dtypes.bfloat16 if name == "bfloat16" else name)
    for name in ("float64", "float32", "float16", "bfloat16", "int64", "int32", "int16", "int8", "uint8", "bool")
}


def assert_array(found, expected):
    assert isinstance(found, np.ndarray)
    assert found.dtype == expected.dtype
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("name", ["zip.pth", "protocol4.pth", "legacy.tar"])
def test_what_pytorch_wrote_comes_back(golden_dir, name):
    content = load_torch_file(golden_dir / "torch" / name)
    plain = {key: content[key] for key in ("epoch", "best", "name", "done", "nothing", "list", "big", "size")}
    assert plain == {
        "epoch": 3,
        "best": 0.125,
        "name": "größe",
        "done": True,
        "nothing": None,
        "list": [1, (2, -70000), [], {}],
        "big": 2**40,
        "size": (4, 6),
    }
    # Adam's first step is the learning rate, 0.25.
    np.testing.assert_allclose(content["net"]["weight"], np.arange(6).reshape(2, 3) - 0.25, atol=1e-6)
    assert content["opt"]["param_groups"][0]["betas"] == (0.9, 0.999)
    np.testing.assert_allclose(content["opt"]["state"][1]["exp_avg"], [0.1, 0.1])
    assert content["kinds"].keys() == KINDS.keys()
    for kind, expected in KINDS.items():
        assert_array(content["kinds"][kind], expected)
    assert_array(content["transposed"], BASE.T)
    assert_array(content["rows"], BASE[1:3])
    assert_array(content["columns"], BASE[:, 1::2])
    assert_array(content["scalar"], BASE[2, 3, ...])
    assert_array(content["empty"], np.zeros((0, 5), np.float32))
    assert_array(content["parameter"], np.ones(2, np.float32))


@pytest.mark.parametrize(
    ("name", "arrays"), [("ckpt_vqvae_small", "vqvae_d2_dim263_relu_ema_reset"), ("ckpt_gpt_small", "gpt_l2")]
)
def test_published_form(golden_dir, name, arrays):
    content = load_torch_file(golden_dir / "t2m_gpt" / f"{name}.pth")
    ((wrapper, state),) = content.items()
    assert wrapper in ("net", "trans")
    with np.load(golden_dir / "t2m_gpt" / f"{arrays}.npz") as expected:
        assert {f"sd/{key}" for key in state} == {key for key in expected if key.startswith("sd/")}
        for key, array in state.items():
            assert_array(array, expected[f"sd/{key}"])


@pytest.mark.parametrize(("name", "word"), [("module.pth", "torch.nn.modules.linear.Linear"), ("dtype.pth", "float32")])
def test_what_is_no_tensor_is_refused_by_name(golden_dir, name, word):
    with pytest.raises(UserError, match=f"{name}: contains '.*{word}', which is not a tensor"):
        load_torch_file(golden_dir / "torch" / name)


def test_numpy_arrays_are_refused_with_what_to_do(tmp_path):
    path = write_archive(tmp_path / "x.pth", pickle.dumps({"net": {"weight": np.zeros(3)}}, protocol=2))
    with pytest.raises(UserError, match=r"contains 'numpy\..*, nothing was run; save NumPy arrays as tensors"):
        load_torch_file(path)


def test_storages_are_shared_and_cannot_be_written_to(golden_dir):
    content = load_torch_file(golden_dir / "torch" / "zip.pth")
    assert np.shares_memory(content["rows"], content["transposed"])
    with pytest.raises(ValueError, match="read-only"):
        content["rows"][0, 0] = 1


@pytest.mark.parametrize("root", ["archive", "net_last", "a b.pth"])
def test_the_archive_may_have_any_name(tmp_path, root):
    path = write_archive(tmp_path / "x.pth", TENSOR, root=root)
    assert_array(load_torch_file(path)["a"], np.arange(6, dtype=np.float32).reshape(2, 3))


leaves = st.none() | st.booleans() | st.integers(-(2**63), 2**63) | st.floats(allow_nan=False) | st.text(max_size=5)
keys = st.text(max_size=5) | st.integers(-5, 5)
values = st.recursive(
    leaves, lambda below: st.lists(below) | st.lists(below).map(tuple) | st.dictionaries(keys, below), max_leaves=12
)


@given(content=st.dictionaries(keys, values, max_size=4), protocol=st.integers(2, 5))
def test_plain_values_come_back_as_pickle_itself_reads_them(tmp_path_factory, content, protocol):
    path = tmp_path_factory.mktemp("plain") / "x.pth"
    found = load_torch_file(write_archive(path, pickle.dumps(content, protocol=protocol)))
    assert repr(found) == repr(content)


def test_a_counter_is_read_as_a_dictionary(tmp_path):
    content = {"milestones": Counter({150_000: 1, 250_000: 1})}
    assert load_torch_file(write_archive(tmp_path / "x.pth", pickle.dumps(content, protocol=2))) == content


def test_what_is_no_file_of_torch_save(tmp_path):
    path = tmp_path / "x.pth"
    with pytest.raises(UserError, match=r"x\.pth: cannot be read \(No such file"):
        load_torch_file(path)
    with pytest.raises(UserError, match="cannot be read"):
        load_torch_file(tmp_path)
    for content in (b"", b"<!doctype html>", b"version https://git-lfs.github.com/spec/v1\n", b"\x80\x02}."):
        path.write_bytes(content)
        with pytest.raises(UserError, match=r"x\.pth: not a file of torch\.save"):
            load_torch_file(path)
    with pytest.raises(UserError, match="contains a list, but a dictionary"):
        load_torch_file(write_archive(path, b"\x80\x02]."))
