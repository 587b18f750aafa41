"""Reading pickles of plain data: numbers, text, lists, tuples, dictionaries and numpy arrays.

Nothing in the file is imported or called. `pickletools.genops` splits the file into opcodes and
this module carries out those that build plain data; a name of anything else is refused, whatever
the file would do with it. Memory stays in proportion to the size of the file: nothing is allocated
by a length or an index that the file states.
"""

from __future__ import annotations

import io
import pickletools
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from egocap.errors import FileError
from egocap.files import read_bytes

_PLAIN_TYPE = re.compile(r"[<>|=]?([biuf?][0-9]{0,2}|[US][0-9]{1,9})")


class _Refused(Exception):
    """The file holds something that is not plain data."""


class _DType:
    """A numpy type under construction: its text, and the byte order that its state sets."""

    def __init__(self, text: Any, *_: Any) -> None:
        if not isinstance(text, str) or not _PLAIN_TYPE.fullmatch(text):
            raise _Refused(f"an array of type {str(text)[:40]!r}")
        self.dtype = np.dtype(text)

    def build(self, state: Any) -> _DType:
        order = state[1] if isinstance(state, tuple) and len(state) > 1 else None
        if order not in ("<", ">", "|", "="):
            raise _Refused("an array type without byte order")
        self.dtype = self.dtype.newbyteorder(order)
        return self


class _Shell:
    """An array before its content is known."""

    def __init__(self, *_: Any) -> None:
        self.keys: list[int] = []  # of the memo, to replace there

    def build(self, state: Any) -> np.ndarray:
        if not isinstance(state, tuple) or len(state) != 5:
            raise _Refused("an array of unknown state")
        _, shape, kind, fortran, data = state
        return _array(data, kind, shape, "F" if fortran else "C")


def _array(data: Any, kind: Any, shape: Any, order: Any = "C") -> np.ndarray:
    data = data.encode("latin1") if isinstance(data, str) else data  # Python 2 wrote text
    if not isinstance(kind, _DType) or not isinstance(data, bytes | bytearray):
        raise _Refused("an array of Python objects")
    flat = np.frombuffer(data, kind.dtype)
    return flat.reshape(shape, order=order).copy()


def _scalar(kind: Any, data: Any) -> Any:
    return _array(data, kind, ()).item()


def _latin1(text: Any, encoding: Any) -> bytes:
    if encoding != "latin1":
        raise _Refused(f"text in the encoding {encoding!r}")
    return text.encode("latin1")


class _Ndarray:
    """Stands for the class that `_reconstruct` names; not callable."""


_NAMES: dict[str, Any] = {
    "__builtin__.bytes": lambda: b"",  # of no argument: how Python 2 is given empty bytes
    "_codecs.encode": _latin1,
    "numpy.ndarray": _Ndarray(),
    "numpy.dtype": _DType,
    "collections.OrderedDict": lambda items=(): dict(items),
}
for _core in ("numpy.core", "numpy._core"):
    _NAMES |= {
        f"{_core}.multiarray._reconstruct": _Shell,
        f"{_core}.multiarray.scalar": _scalar,
        f"{_core}.numeric._frombuffer": _array,
    }


class _Machine:
    """Stack and memo of a pickle that is being read."""

    def __init__(self) -> None:
        self.stack: list[Any] = []
        self.marks: list[int] = []
        self.memo: dict[int, Any] = {}

    def push(self, value: Any) -> None:
        self.stack.append(value)

    def pop(self) -> Any:
        return self.stack.pop()

    def pop_mark(self) -> list[Any]:
        start = self.marks.pop()
        items = self.stack[start:]
        del self.stack[start:]
        return items

    def put(self, key: int) -> None:
        top = self.stack[-1]
        self.memo[key] = top
        if isinstance(top, _Shell):
            top.keys.append(key)

    def name(self, module: Any, attribute: Any) -> None:
        full = f"{module}.{attribute}"
        if full not in _NAMES:
            raise _Refused(f"'{full[:80]}'")
        self.push(_NAMES[full])

    def reduce(self) -> None:
        arguments, function = self.pop(), self.pop()
        if not any(function is known for known in _NAMES.values()) or not callable(function):
            raise _Refused("a call of something that is not numpy's")
        self.push(function(*arguments))

    def build(self) -> None:
        state, shell = self.pop(), self.pop()
        if not isinstance(shell, _Shell | _DType):
            raise _Refused("an object with a state")
        built = shell.build(state)
        for key in getattr(shell, "keys", ()):
            self.memo[key] = built
        self.push(built)

    def extend(self, items: list[Any]) -> None:
        self._top(list).extend(items)

    def update(self, items: list[Any]) -> None:
        self._top(dict).update(zip(items[::2], items[1::2], strict=True))

    def tuple(self, size: int) -> None:
        items = tuple(self.stack[-size:])
        del self.stack[-size:]
        self.push(items)

    def _top(self, kind: type) -> Any:
        if type(self.stack[-1]) is not kind:
            raise _Refused("an object with items")
        return self.stack[-1]


_CONSTANTS: dict[str, Callable[[], Any]] = {
    "NONE": lambda: None, "NEWTRUE": lambda: True, "NEWFALSE": lambda: False,
    "EMPTY_LIST": list, "EMPTY_DICT": dict, "EMPTY_TUPLE": tuple,
}  # fmt: skip
_VALUES = {
    "INT", "BININT", "BININT1", "BININT2", "LONG", "LONG1", "LONG4", "FLOAT", "BINFLOAT", "STRING",
    "BINSTRING", "SHORT_BINSTRING", "UNICODE", "BINUNICODE", "SHORT_BINUNICODE", "BINUNICODE8",
    "BINBYTES", "SHORT_BINBYTES", "BINBYTES8", "BYTEARRAY8",
}  # fmt: skip
_ACTIONS: dict[str, Callable[[_Machine, Any], Any]] = {
    "PROTO": lambda m, arg: None,
    "FRAME": lambda m, arg: None,
    "MARK": lambda m, arg: m.marks.append(len(m.stack)),
    "POP": lambda m, arg: m.pop(),
    "POP_MARK": lambda m, arg: m.pop_mark(),
    "DUP": lambda m, arg: m.push(m.stack[-1]),
    "PUT": lambda m, arg: m.put(arg),
    "BINPUT": lambda m, arg: m.put(arg),
    "LONG_BINPUT": lambda m, arg: m.put(arg),
    "MEMOIZE": lambda m, arg: m.put(len(m.memo)),
    "GET": lambda m, arg: m.push(m.memo[arg]),
    "BINGET": lambda m, arg: m.push(m.memo[arg]),
    "LONG_BINGET": lambda m, arg: m.push(m.memo[arg]),
    "LIST": lambda m, arg: m.push(m.pop_mark()),
    "APPEND": lambda m, arg: m.extend([m.pop()]),
    "APPENDS": lambda m, arg: m.extend(m.pop_mark()),
    "TUPLE": lambda m, arg: m.push(tuple(m.pop_mark())),
    "TUPLE1": lambda m, arg: m.tuple(1),
    "TUPLE2": lambda m, arg: m.tuple(2),
    "TUPLE3": lambda m, arg: m.tuple(3),
    "DICT": lambda m, arg: (items := m.pop_mark(), m.push({}), m.update(items)),
    "SETITEM": lambda m, arg: (value := m.pop(), key := m.pop(), m.update([key, value])),
    "SETITEMS": lambda m, arg: m.update(m.pop_mark()),
    "GLOBAL": lambda m, arg: m.name(*arg.split(" ", 1)),
    "STACK_GLOBAL": lambda m, arg: (attribute := m.pop(), m.name(m.pop(), attribute)),
    "REDUCE": lambda m, arg: m.reduce(),
    "BUILD": lambda m, arg: m.build(),
}


def load_plain_pickle(path: Path) -> Any:
    """Read a pickle of plain data and numpy arrays of numbers or text.

    Raises FileError for anything else in it, and for a damaged file; nothing of it is executed.
    """
    try:
        return _run(read_bytes(path))
    except _Refused as error:
        valid = "numbers, text, lists, tuples, dictionaries, numpy arrays"
        raise FileError(path, f"holds {error}, which is not plain data", valid=valid) from None
    except (ValueError, IndexError, KeyError, TypeError, OverflowError, AttributeError,
            MemoryError, RecursionError) as error:  # fmt: skip
        raise FileError(path, f"a damaged pickle: {error}") from None


def _run(data: bytes) -> Any:
    machine = _Machine()
    for opcode, argument, position in pickletools.genops(io.BytesIO(data)):
        if opcode.name in _VALUES:
            machine.push(argument)
        elif opcode.name in _CONSTANTS:
            machine.push(_CONSTANTS[opcode.name]())
        elif opcode.name in _ACTIONS:
            _ACTIONS[opcode.name](machine, argument)
        elif opcode.name != "STOP":
            raise _Refused(f"the opcode {opcode.name} at byte {position}")
    (value,) = machine.stack
    if isinstance(value, _Shell | _DType | _Ndarray):
        raise _Refused("an unfinished array")
    return value
