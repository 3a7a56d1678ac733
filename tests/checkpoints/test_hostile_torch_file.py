"""Hostile `.pth` files: one line, nothing run, no crash, and no more time or memory than an honest file takes."""

import builtins
import os
import pickle
import random
import tracemalloc
import warnings
import zipfile

import numpy as np
import pytest

from t2m_jax.checkpoints.torch_file import MAX_DEPTH, MAX_VALUES, load_torch_file
from t2m_jax.checkpoints.torch_pickle import MAX_PICKLE_BYTES
from t2m_jax.errors import UserError
from tests.checkpoints.torch_archives import (
    TENSOR,
    entry,
    name,
    number,
    row,
    storage,
    tensor,
    text,
    write_archive,
    write_legacy,
)


def refusal(path) -> str:
    """Returns the one line with which a file is refused, without its folder."""
    with pytest.raises(UserError) as caught:
        load_torch_file(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert len(message) < 400 and message.isprintable()
    return message.removeprefix(f"{path}: ")


class Call:
    """Pickled, it is a call of a function."""

    def __init__(self, function, *arguments):
        self.call = function, arguments

    def __reduce__(self):
        return self.call


@pytest.mark.parametrize("protocol", range(6))
@pytest.mark.parametrize("function", [os.system, builtins.eval, builtins.exec, builtins.open, getattr, print])
def test_code_is_named_and_not_run(tmp_path, function, protocol):
    marker = tmp_path / "marker"
    arguments = {
        os.system: (f"touch {marker}",),
        builtins.open: (f"{marker}", "w"),
        getattr: (marker, "touch"),
    }.get(function, (f"open({str(marker)!r}, 'w')",))
    content = {"net": {"weight": Call(function, *arguments)}}
    message = refusal(write_archive(tmp_path / "x.pth", pickle.dumps(content, protocol=protocol)))
    # Protocols 0 and 1 write text with instructions that torch.save never uses.
    assert f".{function.__name__}'" in message or "the instruction" in message
    assert not marker.exists()
    if protocol == 2:
        assert "which is not a tensor, dictionary, number or string; refused, nothing was run" in message


def stacked(module: str, attribute: str) -> bytes:
    """Returns the newer instruction that looks something up."""
    return text(module) + text(attribute) + b"\x93"


ORDERED_DICT, REBUILD = name("collections", "OrderedDict"), name("torch._utils", "_rebuild_tensor_v2")
TRICKS = {
    "nested attribute": (stacked("torch._utils", "_rebuild_tensor_v2.__globals__"), "__globals__"),
    "attribute of a class": (stacked("collections", "OrderedDict.__init__.__globals__"), "OrderedDict.__init__"),
    "module as attribute": (stacked("torch", "_utils._rebuild_tensor_v2"), "_rebuild_tensor_v2"),
    "dotted global": (name("collections", "OrderedDict.fromkeys"), "fromkeys"),
    "module of numbers": (number(1) + number(2) + b"\x93", "something without a name"),
    "similar name": (name("torch._utils", "_rebuild_tensor_v2 "), "'torch._utils._rebuild_tensor_v2 '"),
    "long name": (name("a" * 300, "b" * 300), "…"),
    "name of control characters": (name("a\x1b[2J\r", "b"), r"\x1b"),
    "name cut off": (b"cos\nsystem", "damaged"),
    "name of no text": (b"c\xff\n\xff\n", "damaged"),
    "call of a string": (text("os.system") + b")R", "type str"),
    "call of a dictionary": (b"})R", "type dict"),
    "call without arguments": (ORDERED_DICT + b"]R", "OrderedDict"),
    "dictionary of arguments": (ORDERED_DICT + row(row(text("a"), number(1))) + b"R", "OrderedDict"),
    "tensor of nothing": (REBUILD + b")R", "_rebuild_tensor_v2"),
    "tensor of itself": (tensor((2,), (1,))[:-1] + b"\x85R", "_rebuild_tensor_v2"),
    "storage called": (name("torch", "FloatStorage") + row(number(2**60)) + b"R", "FloatStorage"),
    "size of a number": (name("torch", "Size") + row(number(2**60)) + b"R", "Size"),
    "inside of a class": (ORDERED_DICT + b"}" + text("keys") + ORDERED_DICT + b"sb", "OrderedDict"),
    "inside of a function": (REBUILD + b"}" + text("__code__") + number(1) + b"sb", "_rebuild_tensor_v2"),
    "inside of a list": (b"]}b", "type list"),
    "class left over": (ORDERED_DICT, "a bare name"),
    "storage left over": (storage(6), "a bare storage"),
    "instance by name": (b"(" + text("ls") + b"ios\nsystem\n", "INST"),
    "instance on the stack": (b"(" + ORDERED_DICT + b"o", "OBJ"),
    "new object": (ORDERED_DICT + b")\x81", "NEWOBJ"),
    "new object with keywords": (ORDERED_DICT + b")}\x92", "NEWOBJ_EX"),
    "extension": (b"\x82\x01", "EXT1"),
    "extensions": (b"\x84\x01\x00\x00\x00", "EXT4"),
    "persistent id in text": (b"P0\n", "PERSID"),
    "number in text": (b"I" + b"9" * 100_000 + b"\n", "INT"),
    "giant number": (b"\x8b\x00\x00\x00\x7f" + b"\xff" * 99, "LONG4"),
    "giant string": (b"X\xff\xff\xff\xff", "damaged"),
    "giant buffer": (b"\x8d" + b"\xff" * 8, "BINUNICODE8"),
    "string of no text": (b"X\x02\x00\x00\x00\xff\xfe", "damaged"),
    "no such instruction": (b"\xfe", "instruction"),
    "empty stack": (b"0" * 9, "POP"),
    "nothing to append to": (b"aaaa", "damaged"),
    "nothing marked": (b"ttttt", "damaged"),
    "no such memo": (b"h\x07", "damaged"),
    "keyed by a tuple": (b"})K\x01s", "type tuple"),
    "keyed by a list": (b"}]K\x01s", "type list"),
    "keyed by a float": (b"}G" + bytes(8) + b"K\x01s", "type float"),
    "keyed by a giant number": (b"}" + number(2**70) + b"K\x01s", "type int"),
    "key without value": (b"}(" + text("a") + b"u", "damaged"),
    "outside of the file": (
        row(text("module"), name("torch", "FloatStorage"), text("0"), text("cpu")) + b"Q",
        "outside",
    ),
    "unknown storage": (row(text("storage"), text("float"), text("0"), text("cpu"), number(6)) + b"Q", "type str"),
    "storage in two ways": (row(storage(6), storage(6, kind="IntStorage")), "two ways"),
    "storage of negative size": (storage(-6), "described"),
    "storage without a name": (storage(6).replace(text("0"), number(0)), "described"),
}


@pytest.mark.parametrize("trick", TRICKS)
def test_tricks_of_the_pickle_are_refused(tmp_path, trick):
    instructions, said = TRICKS[trick]
    assert said in refusal(write_archive(tmp_path / "x.pth", entry(text("net"), instructions)))


def test_a_far_place_in_the_memo_takes_no_room(tmp_path):
    pickled = entry(text("a"), number(7) + b"r\xff\xff\xff\xff0"[:5])
    assert load_torch_file(write_archive(tmp_path / "x.pth", pickled)) == {"a": 7}


@pytest.mark.parametrize(
    ("deeper", "depth"), [(b"\x85", 100), (b"]", 100), (b"}", 100), (b"\x85", 100_000), (b"]", 20_000), (b"}", 20_000)]
)
def test_nested_values_are_refused(tmp_path, deeper, depth):
    opened, closed = {b"\x85": (b")", b"\x85"), b"]": (b"]", b"a"), b"}": (b"}K\x01", b"s")}[deeper]
    instructions = opened + closed * depth if deeper == b"\x85" else opened * depth + b"N" + closed * depth
    path = write_archive(tmp_path / "x.pth", entry(text("a"), instructions))
    assert f"nested deeper than {MAX_DEPTH}" in refusal(path)


def test_a_list_in_itself_is_refused(tmp_path):
    assert "nested deeper" in refusal(write_archive(tmp_path / "x.pth", entry(text("a"), b"]q\x01h\x01a")))


def test_what_doubles_at_every_level_is_refused_before_it_grows(tmp_path):
    doubling = b"".join(b"q" + bytes([level]) + b"h" + bytes([level]) + b"\x86" for level in range(30))
    path = write_archive(tmp_path / "x.pth", entry(text("a"), b")" + doubling))
    assert f"more than {MAX_VALUES} values" in refusal(path)


@pytest.mark.parametrize(
    ("shape", "strides", "offset", "count"),
    [
        ((7,), (1,), 0, 6),
        ((2, 3), (3, 1), 1, 6),
        ((2, 3), (4, 1), 0, 6),
        ((6,), (1,), 2**62, 6),
        ((6,), (1,), -1, 6),
        ((-6,), (1,), 0, 6),
        ((-2, -3), (3, 1), 0, 6),
        ((6,), (-1,), 5, 6),
        ((2, 3), (1,), 0, 6),
        ((2**40, 2**40), (0, 0), 0, 6),
        ((10**9,), (0,), 0, 6),
        ((2**63, 2), (1, 1), 0, 6),
        ((6,), (2**63,), 0, 6),
        ((0, 2**62), (1, 1), 0, 6),
        ((0, 2**31, 2**31), (1, 1, 1), 0, 6),
        ((1,) * 70, (1,) * 70, 0, 6),
        ((2**40,), (1,), 0, 2**40),
        ((3,), (1,), 0, 3),
        ((6,), (1,), 0, 2**70),
    ],
)
def test_shapes_that_do_not_fit_are_refused(tmp_path, shape, strides, offset, count):
    pickled = entry(text("a"), tensor(shape, strides, offset=offset, count=count))
    message = refusal(write_archive(tmp_path / "x.pth", pickled))
    assert any(words in message for words in ("shape", "the wrong size", "share their numbers"))


def test_a_storage_must_be_there_and_of_its_size(tmp_path):
    for rows in ({}, {"1": bytes(24)}, {"0": bytes(23)}, {"0": bytes(48)}):
        assert "storage '0' is missing" in refusal(write_archive(tmp_path / "x.pth", TENSOR, rows=rows))
    key = "../../etc/passwd"
    pickled = entry(text("a"), tensor((6,), (1,), key=key))
    assert repr(key) in refusal(write_archive(tmp_path / "x.pth", pickled))


def test_truth_values_must_be_some(tmp_path):
    pickled = entry(text("a"), tensor((3,), (1,), count=3, kind="BoolStorage"))
    assert "booleans" in refusal(write_archive(tmp_path / "x.pth", pickled, rows={"0": b"\0\1\2"}))


def test_tensors_cannot_share_a_storage_without_end(tmp_path):
    one = tensor((100_000,), (1,), count=100_000)
    many = row(*[one] * 500)
    path = write_archive(tmp_path / "x.pth", entry(text("a"), many), rows={"0": bytes(400_000)})
    assert "share their numbers" in refusal(path)


def test_long_pickles_are_not_read(tmp_path):
    path = write_archive(tmp_path / "x.pth", b"\x80\x02}" + b"N" * MAX_PICKLE_BYTES + b".")
    assert "its pickle is larger than 1 MB" in refusal(path)


def test_archives_that_unpack_to_more_are_refused(tmp_path):
    path = tmp_path / "x.pth"
    zeros = entry(text("a"), tensor((10_000_000,), (1,), count=10_000_000, kind="ByteStorage"))
    write_archive(path, zeros, rows={"0": bytes(10_000_000)}, compression=zipfile.ZIP_DEFLATED)
    tracemalloc.start()
    assert "compressed" in refusal(path)
    assert tracemalloc.get_traced_memory()[1] < 1_000_000
    tracemalloc.stop()


def test_archives_with_a_name_twice_or_of_something_else_are_refused(tmp_path):
    path = write_archive(tmp_path / "x.pth", TENSOR)
    with warnings.catch_warnings(), zipfile.ZipFile(path, "a") as archive:
        warnings.simplefilter("ignore")
        archive.writestr("archive/data.pkl", b"cos\nsystem\n.")
    assert "two members of the same name" in refusal(path)
    path = write_archive(tmp_path / "y.pth", TENSOR)
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("other/data.pkl", b"cos\nsystem\n.")
    assert "not of torch.save" in refusal(path)
    with zipfile.ZipFile(tmp_path / "z.pth", "w") as archive:
        archive.writestr("weights.npy", b"")
    assert "not of torch.save" in refusal(tmp_path / "z.pth")
    assert "byte order" in refusal(write_archive(tmp_path / "order.pth", TENSOR, order="middle"))


def is_refused(path) -> bool:
    """Returns whether a damaged file is refused; otherwise it must load to a dictionary."""
    try:
        content = load_torch_file(path)
    except UserError as error:
        assert str(error).isprintable()
        return True
    assert isinstance(content, dict)
    return False


@pytest.fixture(params=[lambda path: write_archive(path, TENSOR), write_legacy], ids=["zip", "legacy"])
def whole(request, tmp_path):
    """Returns a small file of each format."""
    return request.param(tmp_path / "whole.pth").read_bytes()


def test_a_file_that_ends_early_is_refused_wherever_it_ends(tmp_path, whole):
    path = tmp_path / "x.pth"
    path.write_bytes(whole)
    assert not is_refused(path)
    loaded = []
    for length in range(len(whole)):
        path.write_bytes(whole[:length])
        if not is_refused(path):
            loaded.append(length)
    assert loaded == []


def test_changed_bytes_are_refused_or_load_to_a_dictionary(tmp_path, whole):
    draws = random.Random(0)
    path = tmp_path / "x.pth"
    refused = 0
    for _ in range(500):
        damaged = bytearray(whole)
        damaged[draws.randrange(len(whole))] = draws.randrange(256)
        path.write_bytes(damaged)
        refused += is_refused(path)
    assert 100 < refused < 500
    assert sorted(file.name for file in tmp_path.iterdir() if file.name != "whole.pth") == ["x.pth"]


def test_numbers_that_were_changed_are_noticed(tmp_path):
    path = write_archive(tmp_path / "x.pth", TENSOR)
    whole = path.read_bytes()
    place = whole.index(np.arange(6, dtype=np.float32).tobytes()) + 9
    path.write_bytes(whole[:place] + b"\x55" + whole[place + 1 :])
    assert "damaged; download it again (Bad CRC-32" in refusal(path)
