"""Files of `torch.save` put together by hand: a pickle assembler and an archive writer."""

import pickle
import struct
import zipfile
from pathlib import Path

import numpy as np


def name(module: str, attribute: str) -> bytes:
    """Returns the instruction that looks something up."""
    return b"c" + f"{module}\n{attribute}\n".encode()


def text(value: str) -> bytes:
    return b"X" + struct.pack("<I", len(value.encode())) + value.encode()


def number(value: int) -> bytes:
    """Returns the instruction for a whole number of any size up to 255 bytes."""
    content = value.to_bytes(value.bit_length() // 8 + 1, "little", signed=True)
    return pickle.LONG1 + bytes([len(content)]) + content


def row(*items: bytes) -> bytes:
    """Returns the instructions for a tuple."""
    return b"(" + b"".join(items) + b"t"


def entry(key: bytes, value: bytes) -> bytes:
    """Returns a whole pickle of a dictionary with one entry."""
    return b"\x80\x02}" + key + value + b"s."


def storage(count: int, *, kind: str = "FloatStorage", key: str = "0") -> bytes:
    return row(text("storage"), name("torch", kind), text(key), text("cuda:0"), number(count)) + b"Q"


def tensor(shape, strides, *, offset: int = 0, count: int = 6, kind: str = "FloatStorage", key: str = "0") -> bytes:
    """Returns the instructions for a tensor, as `torch.save` writes them."""
    arguments = (
        storage(count, kind=kind, key=key),
        number(offset),
        row(*map(number, shape)),
        row(*map(number, strides)),
        b"\x89",
        name("collections", "OrderedDict") + b")R",
    )
    return name("torch._utils", "_rebuild_tensor_v2") + row(*arguments) + b"R"


def write_archive(
    path: Path, pickled: bytes, *, rows=None, root: str = "archive", order: str = "little", **extra
) -> Path:
    """Writes the archive of a pickle and its storages (by default one of 6 numbers), and returns its path."""
    rows = {"0": np.arange(6, dtype=np.float32)} if rows is None else rows
    with zipfile.ZipFile(path, "w", **extra) as archive:
        archive.writestr(f"{root}/data.pkl", pickled)
        archive.writestr(f"{root}/byteorder", order)
        for key, content in rows.items():
            archive.writestr(f"{root}/data/{key}", content if isinstance(content, bytes) else content.tobytes())
        archive.writestr(f"{root}/version", "3\n")
    return path


def write_legacy(path: Path) -> Path:
    """Writes what `TENSOR` says in the format before PyTorch 1.6, and returns its path."""
    magic = pickle.dumps(0x1950A86A20F9469CFC6C, protocol=2)
    system = {"protocol_version": 1001, "little_endian": True, "type_sizes": {"short": 2, "int": 4, "long": 4}}
    parts = [magic, pickle.dumps(1001, protocol=2), pickle.dumps(system, protocol=2)]
    parts += [TENSOR.replace(b"tQ", b"NtQ"), pickle.dumps(["0"], protocol=2)]
    path.write_bytes(b"".join(parts) + struct.pack("<q", 6) + np.arange(6, dtype="<f4").tobytes())
    return path


TENSOR = entry(text("a"), tensor((2, 3), (3, 1)))
"""The pickle of {"a": [[0, 1, 2], [3, 4, 5]]}."""
