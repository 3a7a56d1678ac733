"""Reads the pickles inside files of `torch.save` as data.

A pickle is a program for a small stack machine. Python's own machine imports and calls what the program names. Here, it
has only the instructions that build dictionaries, lists, tuples, numbers and strings, and a few names that it treats as
plain text. It imports nothing and calls nothing, so a hostile file cannot run anything.
"""

import io
import pickle
import pickletools
import struct
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

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
_COUNTER = "collections.Counter"
"""Schedules of the learning rate, such as MultiStepLR, have one."""
_SIZE = "torch.Size"
_TENSOR = "torch._utils._rebuild_tensor_v2"
_PARAMETER = "torch._utils._rebuild_parameter"
_STORAGES = {f"{module}.{name}": dtype for module in ("torch", "torch.cuda") for name, dtype in DTYPES.items()}
_NAMES = frozenset((_ORDERED_DICT, _COUNTER, _SIZE, _TENSOR, _PARAMETER, *_STORAGES))
_DAMAGED = (LookupError, ValueError, TypeError, AttributeError, EOFError, struct.error, pickle.UnpicklingError)
"""What Python's machine raises for a pickle that breaks the rules of the language."""


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
    file = io.BytesIO(data)
    file.seek(start)
    machine = _Machine(file, encoding="utf-8")  # the strings of Python 2, which files of its time contain
    machine.storages = {}
    try:
        return Pickle(machine.load(), machine.storages, file.tell())
    except UserError:  # which is a `ValueError`
        raise
    except _DAMAGED:
        raise UserError(f"its pickle is cut off or damaged at byte {file.tell()}") from None


class _Instructions(dict[int, Callable[..., None]]):
    """What the machine does for each instruction; others are refused."""

    def __missing__(self, code: int) -> Callable[..., None]:
        names = {known.code: known.name for known in pickletools.opcodes}
        raise UserError(f"its pickle has the instruction {names.get(chr(code), code)}, which no tensor needs")


_PLAIN = (
    "MARK STOP PROTO FRAME NONE NEWTRUE NEWFALSE BININT BININT1 BININT2 BINFLOAT LONG1 BINUNICODE SHORT_BINUNICODE "
    "SHORT_BINSTRING BINSTRING EMPTY_DICT EMPTY_LIST EMPTY_TUPLE TUPLE TUPLE1 TUPLE2 TUPLE3 LIST APPEND APPENDS BINGET "
    "LONG_BINGET BINPUT LONG_BINPUT MEMOIZE BINPERSID"
)
"""Instructions that only build values, which Python's machine may run."""


class _Machine(pickle._Unpickler):
    """The machine that is written in Python: its memo grows only with the pickle."""

    stack: list[Any]
    append: Callable[[Any], None]
    pop_mark: Callable[[], list[Any]]
    readline: Callable[[], bytes]
    storages: dict[str, Storage]
    dispatch: ClassVar = _Instructions(
        {code: pickle._Unpickler.dispatch[code] for code in (getattr(pickle, name)[0] for name in _PLAIN.split())}  # type: ignore[attr-defined]
    )

    def find_class(self, module: Any, name: Any) -> Name:
        """Returns a name as text."""
        text = f"{module}.{name}" if isinstance(module, str) and isinstance(name, str) else "something without a name"
        # The name must not contain dots: `a.b` would give access to the attributes of `a`.
        if text not in _NAMES or "." in name:
            advice = "; save NumPy arrays as tensors" if text.startswith("numpy.") else ""
            raise UserError(
                f"contains {_shown(text)}, which is not a tensor, dictionary, number or string; "
                f"refused, nothing was run{advice}"
            )
        return Name(text)

    def persistent_load(self, found: Any) -> Storage:
        """Returns the storage of a persistent id, which has kind, type, key, device (ignored) and count."""
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
        return storage

    def _name(self) -> None:
        lines = [self.readline() for _ in range(2)]
        if not lines[1].endswith(b"\n"):
            raise EOFError
        self.append(self.find_class(*(line[:-1].decode() for line in lines)))

    def _name_from_stack(self) -> None:
        name = self.stack.pop()
        self.append(self.find_class(self.stack.pop(), name))

    def _call(self) -> None:
        arguments = self.stack.pop()
        self.append(_made(self.stack.pop(), arguments))

    def _attributes(self) -> None:
        """Ignores the attributes of a dictionary, such as the `_metadata` of a state dict."""
        self.stack.pop()
        if type(self.stack[-1]) is not dict:
            raise UserError(f"sets attributes of {_kind(self.stack[-1])}, not a dictionary; refused, nothing was run")

    def _dictionary(self) -> None:
        items = self.pop_mark()
        self.append({})
        self._set(items)

    def _set(self, items: list[Any]) -> None:
        """Puts alternating keys and values into the dictionary on the stack."""
        target = self.stack[-1]
        if type(target) is not dict:
            raise TypeError
        for key, value in zip(items[::2], items[1::2], strict=True):
            # Hashing or comparing keys of other types could take forever.
            if not isinstance(key, str) and not (isinstance(key, int) and abs(key) < 2**63):
                raise UserError(f"has a dictionary whose keys are neither strings nor numbers ({_kind(key)})")
            target[key] = value

    def _set_one(self) -> None:
        value = self.stack.pop()
        self._set([self.stack.pop(), value])

    dispatch |= {
        pickle.GLOBAL[0]: _name,
        pickle.STACK_GLOBAL[0]: _name_from_stack,
        pickle.REDUCE[0]: _call,
        pickle.BUILD[0]: _attributes,
        pickle.DICT[0]: _dictionary,
        pickle.SETITEM[0]: _set_one,
        pickle.SETITEMS[0]: lambda machine: machine._set(machine.pop_mark()),
    }


def _made(name: Any, arguments: Any) -> Any:
    """Returns the plain value or record that a name makes of its arguments."""
    if isinstance(name, Name) and isinstance(arguments, tuple):
        if name.text == _ORDERED_DICT and not arguments:
            return {}
        if name.text == _COUNTER and len(arguments) == 1 and type(arguments[0]) is dict:
            return arguments[0]
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
