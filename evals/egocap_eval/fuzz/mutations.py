"""Mutations of valid files: of their bytes, and of the structure that their suffix promises.

A structured mutation keeps the file readable as JSON, text or npz, so that it reaches the checks
behind the parser.
"""

from __future__ import annotations

import io
import json
import re
import struct
import zipfile
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy import ndarray as Array

Random = np.random.Generator
Mutation = Callable[[bytes, Random], bytes]

_VALUES: tuple[Any, ...] = (
    None, True, 0, -1, 1, 0.5, -1e308, 1e308, float("nan"), float("inf"), 10**400, 2**63, 2**31,
    1e-320, "", "x", "../../etc/passwd", "\x00", "\x1b[31m", "é" * 300, "9" * 5000, [], {}, [[]],
    [None], [1, "a"], {"": 0}, [[0.0] * 3] * 3, -0.0, "nan", "__class__", ["x"] * 2000,
)  # fmt: skip
_TOKENS = ("nan", "inf", "-1", "0", "1e999", "9" * 400, '"x"', "true", "[]", "{}", "", "=", "\n",
           "[[a]]", "[a.b]", "a.b.c = 1", "1_000", "0x10", "\x00", "\x1b", "'", '"""', "1e-320",
           "End Site", "}", "{", "MOTION", "Frames: 99999999999", "1979-05-27", "#")  # fmt: skip
_WORD = re.compile(r"[^\s=,\[\]{}]+|[=,\[\]{}]|\n")
_DEPTH = 200
_ARRAYS: tuple[Any, ...] = (
    np.zeros(()), np.array("text"), np.zeros(0), np.zeros((1, 0)), np.array(["a", "b"]),
    np.array(np.nan), np.array(2**63, np.uint64), np.array(-1), np.zeros((2, 2), bool),
    np.full((3, 3), np.inf), np.zeros((1,) * 20), np.arange(5, dtype=np.int8),
)  # fmt: skip
_HEADERS = (
    (b"'shape': (", b"'shape': (1000000000,"), (b"'shape': (", b"'shape': (-1,"),
    (b"<f8", b"<f4"), (b"<f8", b"<c8"), (b"<f8", b"|O"), (b"<f8", b"<U0"), (b"<f8", b"<M8"),
    (b"False", b"True"), (b"{", b"(" * 50), (b"\x93NUMPY\x01", b"\x93NUMPY\x03"),
    (b"'descr'", b"'decsr'"), (b"<f8", b"|V8"),
)  # fmt: skip


def mutated(content: bytes, suffix: str, rng: Random) -> bytes:
    """One or several random mutations of a file's content."""
    kinds = _KINDS.get(suffix, ())
    for _ in range(rng.geometric(0.7)):
        mutation = kinds[rng.integers(len(kinds))] if kinds and rng.random() < 0.85 else _bytes
        try:
            with np.errstate(invalid="ignore", over="ignore"):
                content = mutation(content, rng)
        except Exception:  # of any parser: no longer readable after an earlier mutation
            content = _bytes(content, rng)
    return content


def _bytes(content: bytes, rng: Random) -> bytes:
    """Flip, cut, insert, repeat or clear some bytes."""
    if not content:
        return rng.bytes(int(rng.integers(64)))
    at, size = int(rng.integers(len(content))), int(rng.integers(1, 1 + min(64, len(content))))
    head, middle, tail = content[:at], content[at : at + size], content[at + size :]
    return (
        head + bytes([content[at] ^ (1 << int(rng.integers(8)))]) + content[at + 1 :],
        head,
        head + rng.bytes(size) + content[at:],
        head + middle * int(rng.integers(2, 9)) + tail,
        head + bytes(len(middle)) + tail,
        head + b"\xff" * len(middle) + tail,
        head + tail,
    )[int(rng.integers(7))]


def _json(content: bytes, rng: Random) -> bytes:
    """Replace, remove, repeat or nest a random value; of JSON lines, in a random line."""
    lines = content.split(b"\n") if content.count(b"}\n{") else [content]
    row = int(rng.integers(len(lines)))
    data = json.loads(lines[row] or b"{}")
    _change(data, rng)
    lines[row] = json.dumps(data).encode()
    return b"\n".join(lines)


def _change(data: Any, rng: Random) -> None:
    """Change a random value in place; a text that is JSON is mostly changed inside."""
    node, key = _place(data, rng)
    if node is None:
        raise ValueError
    if isinstance(node[key], str) and node[key][:1] in ("{", "[") and rng.random() < 0.75:
        inner = json.loads(node[key])
        _change(inner, rng)
        node[key] = json.dumps(inner)
        return
    action = rng.integers(6)
    if action == 0:
        del node[key]
    elif action == 1 and isinstance(node, dict):
        node[f"{key}x"] = node.pop(key)
    elif action == 2:
        node[key] = _nested(node[key], int(rng.integers(1, _DEPTH)))
    elif action == 3 and isinstance(node[key], list):
        node[key] = node[key] * int(rng.integers(2, 5))
    else:
        node[key] = _VALUES[int(rng.integers(len(_VALUES)))]


def _place(data: Any, rng: Random) -> tuple[Any, Any]:
    """A random container in the data and one of its keys; (None, None) in an empty one."""
    node, key = None, None
    while isinstance(data, dict | list) and data and (node is None or rng.random() < 0.8):
        keys = list(data) if isinstance(data, dict) else range(len(data))
        node, key = data, keys[int(rng.integers(len(keys)))]
        data = node[key]
    return node, key


def _nested(value: Any, levels: int) -> Any:
    for _ in range(levels):
        value = [value]
    return value


def _text(content: bytes, rng: Random) -> bytes:
    """Replace, remove or repeat a random word or line of a text file."""
    text = content.decode("utf-8")
    words = list(_WORD.finditer(text))
    if not words:
        raise ValueError
    word = words[int(rng.integers(len(words)))]
    if rng.random() < 0.25:
        lines = text.splitlines(keepends=True)
        row = int(rng.integers(len(lines)))
        lines[row : row + 1] = [lines[row]] * int(rng.integers(3))
        return "".join(lines).encode()
    new = _TOKENS[int(rng.integers(len(_TOKENS)))]
    return (text[: word.start()] + new + text[word.end() :]).encode()


def _npz(content: bytes, rng: Random) -> bytes:
    """Replace a member by another array, damage its header, rename, remove or add one."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        members = {info.filename: archive.read(info) for info in archive.infolist()}
    name = list(members)[int(rng.integers(len(members)))]
    action = int(rng.integers(6))
    if action == 0:
        del members[name]
    elif action == 1:
        members[str(rng.choice(["x.npy", "a/b.npy", "../x.npy", "x", ".npy"]))] = members.pop(name)
    elif action == 2:
        old, new = _HEADERS[int(rng.integers(len(_HEADERS)))]
        members[name] = members[name].replace(old, new, 1)
    elif action == 3:
        members[name] = _npy(_ARRAYS[int(rng.integers(len(_ARRAYS)))])
    else:
        members[name] = _npy(_spoilt(np.load(io.BytesIO(members[name])), rng))
    out = io.BytesIO()
    packing = zipfile.ZIP_DEFLATED if rng.random() < 0.5 else zipfile.ZIP_STORED
    with zipfile.ZipFile(out, "w", packing) as archive:
        for name, member in members.items():
            archive.writestr(zipfile.ZipInfo(name), member, packing)  # without the time of day
    return out.getvalue()


def _spoilt(array: Array, rng: Random) -> Array:
    """The array with another shape, type or value."""
    action = int(rng.integers(5))
    if action == 0:
        return array.ravel()
    if action == 1:
        return array[:-1] if array.ndim else array[None]
    if action == 2:
        return np.concatenate([array, array], -1) if array.ndim else np.array([array, array])
    if action == 3 and array.dtype.kind != "U":
        return array.astype(rng.choice(["f4", "i8", "u1", "?", "U8"]))
    if array.dtype.kind == "U" and array.shape == () and str(array)[:1] == "{":
        return np.array(_json(str(array).encode(), rng).decode())
    changed = array.copy()
    if changed.size:
        extremes = [np.nan, np.inf, -1e300, 0.0] if array.dtype.kind == "f" else [0, 1, 100]
        value = "{" if array.dtype.kind == "U" else extremes[int(rng.integers(len(extremes)))]
        changed.flat[int(rng.integers(changed.size))] = value
    return changed


def _npy_file(content: bytes, rng: Random) -> bytes:
    """Damage the header of a single array, or replace the array."""
    if rng.random() < 0.5:
        old, new = _HEADERS[int(rng.integers(len(_HEADERS)))]
        return content.replace(old, new, 1)
    return _npy(_spoilt(np.load(io.BytesIO(content)), rng))


def _npy(array: Array) -> bytes:
    out = io.BytesIO()
    np.lib.format.write_array(out, array, allow_pickle=False)
    return out.getvalue()


def _safetensors(content: bytes, rng: Random) -> bytes:
    """A JSON mutation of the header, with its length put right."""
    (size,) = struct.unpack("<Q", content[:8])
    header = _json(content[8 : 8 + size], rng)
    return struct.pack("<Q", len(header)) + header + content[8 + size :]


_KINDS: dict[str, tuple[Mutation, ...]] = {
    ".json": (_json, _text), ".jsonl": (_json, _text), ".toml": (_text,), ".txt": (_text,),
    ".bvh": (_text,), ".csv": (_text,), ".npz": (_npz,), ".safetensors": (_safetensors,),
    ".yaml": (_text,), ".yml": (_text,), ".xml": (_text,), ".npy": (_npy_file,),
}  # fmt: skip
