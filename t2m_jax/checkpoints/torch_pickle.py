"""Reads the pickles inside files of `torch.save` as data.

A pickle is a program for a small stack machine. Python's own machine imports and calls what the program names. The
machine here knows only the instructions that build dictionaries, lists, tuples, numbers and strings, and a few names
that it treats as plain text. It imports nothing and calls nothing, so a hostile file cannot run anything.
"""

import pickle
import pickletools
import struct
from collections.abc import Callable
from typing import Any, NamedTuple

import ml_dtypes
import numpy as np

from t2m_jax.errors import UserError

MAX_PICKLE_BYTES = 1_000_000
"""Longest pickle that is read. A published model has 60 kB; time and memory grow with the length."""

DTYPES: dict[str, np.dtype] = {
    "DoubleStorage": np.dtype(np.float64),
    "FloatStorage": np.dtype(np.float32),
    "HalfStorage": np.dtype(np.float16),
    "BFloat16Storage": np.dtype(ml_dtypes.bfloat16),
    "LongStorage": np.dtype(np.int64),
    "IntStorage": np.dtype(np.int32),
    "ShortStorage": np.dtype(np.int16),
    "CharStorage": np.dtype(np.int8),
    "ByteStorage": np.dtype(np.uint8),
    "BoolStorage": np.dtype(np.bool_),
}
"""The type of the numbers in each kind of storage."""

_ORDERED_DICT = "collections.OrderedDict"
_SIZE = "torch.Size"
_TENSOR = "torch._utils._rebuild_tensor_v2"
_PARAMETER = "torch._utils._rebuild_parameter"
_STORAGES = {f"{module}.{name}": dtype for module in ("torch", "torch.cuda") for name, dtype in DTYPES.items()}
_NAMES = frozenset((_ORDERED_DICT, _SIZE, _TENSOR, _PARAMETER, *_STORAGES))


class _DamageError(LookupError):
    """The pickle breaks the rules of the pickle language."""


class Name(NamedTuple):
    """The name of a class or function in a pickle; here only text."""

    text: str


class Storage(NamedTuple):
    """A row of numbers outside the pickle."""

    key: str
    dtype: np.dtype
    length: int


class Tensor(NamedTuple):
    """A view of a storage, in elements, as the file describes it. The values are not checked yet."""

    storage: Storage
    offset: Any
    shape: Any
    strides: Any


class Pickle(NamedTuple):
    """The contents of one pickle."""

    value: Any
    """Dictionaries, lists, tuples, numbers, strings and `Tensor`s; also a `Storage` or `Name` in the wrong place."""
    storages: dict[str, Storage]
    """The storages that the pickle refers to, by key."""
    end: int
    """Position of the first byte after the pickle."""


def read_pickle(data: bytes, *, start: int = 0) -> Pickle:
    """Returns the pickle at a position of `data`.

    Raises:
        UserError: It names or does something that tensors do not need, or it is damaged.
    """
    machine = _Machine(data, start)
    try:
        return Pickle(machine.run(), machine.storages, machine.position)
    except (LookupError, UnicodeDecodeError):
        raise UserError(f"its pickle is cut off or damaged at byte {machine.position}") from None


# How the argument of an instruction is stored: as a number, or as a number of bytes and then the bytes.
_FIXED = {
    pickle.BININT: "<i",
    pickle.BININT1: "<B",
    pickle.BININT2: "<H",
    pickle.BINFLOAT: ">d",
    pickle.BINGET: "<B",
    pickle.LONG_BINGET: "<I",
    pickle.BINPUT: "<B",
    pickle.LONG_BINPUT: "<I",
    pickle.PROTO: "<B",
    pickle.FRAME: "<Q",
}
_COUNTED = {
    pickle.BINUNICODE: "<I",
    pickle.SHORT_BINUNICODE: "<B",
    # The strings of Python 2, which files of its time contain.
    pickle.SHORT_BINSTRING: "<B",
    pickle.BINSTRING: "<I",
    pickle.LONG1: "<B",
}
_CONSTANTS: dict[bytes, Callable[[], Any]] = {
    pickle.NONE: lambda: None,
    pickle.NEWTRUE: lambda: True,
    pickle.NEWFALSE: lambda: False,
    pickle.EMPTY_DICT: dict,
    pickle.EMPTY_LIST: list,
    pickle.EMPTY_TUPLE: tuple,
}
_TUPLES = {pickle.TUPLE1: 1, pickle.TUPLE2: 2, pickle.TUPLE3: 3}


class _Machine:
    """The stack, the stacks below open marks, and the memo."""

    def __init__(self, data: bytes, position: int):
        self.position = position
        self.storages: dict[str, Storage] = {}
        self._data = data
        self._stack: list[Any] = []
        self._outer: list[list[Any]] = []
        self._memo: dict[int, Any] = {}

    def run(self) -> Any:
        """Returns the value on the stack when the pickle stops."""
        while (code := self._bytes(1)) != pickle.STOP:
            if code in _FIXED:
                number = self._number(_FIXED[code])
                if code in (pickle.BINGET, pickle.LONG_BINGET):
                    self._stack.append(self._memo[number])
                elif code in (pickle.BINPUT, pickle.LONG_BINPUT):
                    self._memo[number] = self._stack[-1]
                # The version, and the length of a part for readers of streams, say nothing about the value.
                elif code not in (pickle.PROTO, pickle.FRAME):
                    self._stack.append(number)
            elif code in _COUNTED:
                content = self._bytes(self._number(_COUNTED[code]))
                is_number = code == pickle.LONG1
                self._stack.append(int.from_bytes(content, "little", signed=True) if is_number else content.decode())
            elif code in _CONSTANTS:
                self._stack.append(_CONSTANTS[code]())
            elif code in _TUPLES:
                items = self._stack[-_TUPLES[code] :]
                self._pop(_TUPLES[code])
                self._stack.append(tuple(items))
            else:
                self._execute(code)
        return self._stack.pop()

    def _execute(self, code: bytes) -> None:
        """Runs an instruction that takes its arguments from the stack, or is unknown."""
        match code:
            case pickle.MARK:
                self._outer.append(self._stack)
                self._stack = []
            case pickle.MEMOIZE:
                self._memo[len(self._memo)] = self._stack[-1]
            case pickle.TUPLE | pickle.LIST:
                items = self._marked()
                self._stack.append(tuple(items) if code == pickle.TUPLE else items)
            case pickle.DICT:
                items = self._marked()
                self._stack.append({})
                self._set(items)
            case pickle.SETITEM:
                value = self._pop()
                key = self._pop()
                self._set([key, value])
            case pickle.SETITEMS:
                self._set(self._marked())
            case pickle.APPEND:
                self._append([self._pop()])
            case pickle.APPENDS:
                self._append(self._marked())
            case pickle.GLOBAL:
                self._push_name(self._line(), self._line())
            case pickle.STACK_GLOBAL:
                name = self._pop()
                self._push_name(self._pop(), name)
            case pickle.BINPERSID:
                self._push_storage(self._pop())
            case pickle.REDUCE:
                arguments = self._pop()
                self._stack.append(_made(self._pop(), arguments))
            case pickle.BUILD:
                self._drop_attributes(self._pop())
            case _:
                names = {known.code: known.name for known in pickletools.opcodes}
                name = names.get(code.decode("latin-1"), repr(code))
                raise UserError(f"its pickle has the instruction {name}, which no tensor needs")

    def _bytes(self, count: int) -> bytes:
        found = self._data[self.position : self.position + count]
        if len(found) < count:
            raise _DamageError
        self.position += count
        return found

    def _line(self) -> str:
        """Returns the text up to the end of a line."""
        # No name is this long. A search to the end of the data for each name would take quadratic time.
        end = self._data.find(b"\n", self.position, self.position + 1000)
        if end < 0:
            raise _DamageError
        return self._bytes(end + 1 - self.position)[:-1].decode()

    def _number(self, layout: str) -> Any:
        return struct.unpack(layout, self._bytes(struct.calcsize(layout)))[0]

    def _pop(self, count: int = 1) -> Any:
        """Removes `count` values, which must exist, and returns the last one removed."""
        if len(self._stack) < count:
            raise _DamageError
        for _ in range(count):
            value = self._stack.pop()
        return value

    def _marked(self) -> list[Any]:
        """Removes and returns the values since the last mark."""
        items = self._stack
        self._stack = self._outer.pop()
        return items

    def _set(self, items: list[Any]) -> None:
        """Puts alternating keys and values into the dictionary on the stack."""
        target = self._stack[-1]
        if type(target) is not dict or len(items) % 2:
            raise _DamageError
        for key, value in zip(items[::2], items[1::2], strict=True):
            # Hashing or comparing keys of other types could take forever.
            if not isinstance(key, str) and not (isinstance(key, int) and abs(key) < 2**63):
                raise UserError(f"has a dictionary whose keys are neither strings nor numbers ({_kind(key)})")
            target[key] = value

    def _append(self, items: list[Any]) -> None:
        if type(self._stack[-1]) is not list:
            raise _DamageError
        self._stack[-1].extend(items)

    def _push_name(self, module: Any, name: Any) -> None:
        text = f"{module}.{name}" if isinstance(module, str) and isinstance(name, str) else "something without a name"
        # The name must not contain dots: `a.b` would give access to the attributes of `a`.
        if text not in _NAMES or "." in name:
            raise UserError(
                f"contains {_shown(text)}, which is not a tensor, dictionary, number or string; "
                "refused, nothing was run"
            )
        self._stack.append(Name(text))

    def _push_storage(self, found: Any) -> None:
        """Pushes the storage of a persistent id, which has kind, type, key, device (ignored) and count."""
        if not isinstance(found, tuple) or len(found) not in (5, 6) or found[0] != "storage":
            raise UserError("refers to something outside the pickle that is not a storage of numbers")
        _, kind, key, _, count, *view = found
        if not isinstance(kind, Name) or kind.text not in _STORAGES:
            raise UserError(f"has a storage of an unknown type ({_kind(kind)})")
        if not isinstance(key, str) or type(count) is not int or count < 0 or view not in ([], [None]):
            raise UserError("has a storage that is not described as PyTorch does")
        storage = Storage(key, _STORAGES[kind.text], count)
        if self.storages.setdefault(key, storage) != storage:
            raise UserError(f"describes storage {_shown(key)} in two ways")
        self._stack.append(storage)

    def _drop_attributes(self, _: Any) -> None:
        """Ignores the attributes of a dictionary, such as the `_metadata` of a state dict."""
        if type(self._stack[-1]) is not dict:
            raise UserError(f"sets attributes of {_kind(self._stack[-1])}, not a dictionary; refused, nothing was run")


def _made(name: Any, arguments: Any) -> Any:
    """Returns the plain value or record that a name makes of its arguments."""
    if isinstance(name, Name) and isinstance(arguments, tuple):
        if name.text == _ORDERED_DICT and not arguments:
            return {}
        if name.text == _SIZE and len(arguments) == 1 and isinstance(arguments[0], tuple):
            return arguments[0]
        if name.text == _PARAMETER and len(arguments) == 3 and isinstance(arguments[0], Tensor):
            return arguments[0]
        is_tensor = name.text == _TENSOR and len(arguments) in (6, 7) and isinstance(arguments[0], Storage)
        # Arguments after the view: requires_grad, backward hooks, and marks of lazily conjugated or negated tensors.
        if is_tensor and not any(arguments[6:]):
            return Tensor(*arguments[:4])
    raise UserError(f"calls {_kind(name)} in a way that no version of PyTorch does; refused, nothing was run")


def _kind(value: Any) -> str:
    """Returns the description of a value for an error message."""
    return _shown(value.text) if isinstance(value, Name) else f"a value of type {type(value).__name__}"


def _shown(text: str) -> str:
    return repr(text if len(text) <= 60 else f"{text[:57]}…")
