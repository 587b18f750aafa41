"""Reading TOML and JSON files and validating them; errors name file and key.

pydantic models derive from `Strict`; `checked` turns a validation error into one FileError.
"""

from __future__ import annotations

import json
import re
import sys
import tomllib
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from egocap.errors import FileError
from egocap.files import MOST_BYTES, read_bytes


def _normal(number: float) -> float:
    if 0.0 < abs(number) < sys.float_info.min:
        raise ValueError(f"not 0, but below {sys.float_info.min:.1e}, the least normal number")
    return number


Number = Annotated[float, Field(strict=True, allow_inf_nan=False), AfterValidator(_normal)]
"""A finite number, 0 or normal: a smaller one can be 0 in another unit. Text and booleans are
refused."""

MOST_TEXT, MOST_TOML = MOST_BYTES, 1 << 22
"""Largest text file and largest TOML file, bytes."""

MOST_LEVELS = 32
"""Deepest nesting of JSON and TOML."""

_PART = r"""(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')"""
_LONG_KEY = re.compile(rf"(?<![\w-]){_PART}(?:[ \t]*\.[ \t]*{_PART}){{{MOST_LEVELS}}}")


class Strict(BaseModel):
    """Base of models read from files: unknown keys, NaN and infinity are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


M = TypeVar("M", bound=Strict)


def checked(
    model: type[M], data: Any, where: str | Path, prefix: str = "", line: int | None = None
) -> M:
    """Validate `data` and make the model instance. `prefix` is the key of `data` in its file.

    Raises FileError with the first wrong key and the number of further errors.
    """
    try:
        return model.model_validate(data)
    except ValidationError as error:
        raise _file_error(model, error, where, prefix, line) from None


def read_toml(path: str | Path) -> dict[str, Any]:
    """Read a TOML file. Raises FileError, also beyond the limits of size and nesting."""
    text = read_text(path, MOST_TOML)
    if _LONG_KEY.search(text):  # tomllib needs memory in the square of a key's parts
        raise FileError(path, f"a key of more than {MOST_LEVELS} parts")
    return parsed(text, path, "TOML")


def read_json(path: str | Path) -> dict[str, Any]:
    """Read a JSON object from a file. Raises FileError, also for JSON that is not an object."""
    return parsed(read_text(path), path)


def parsed(
    text: str | bytes, path: str | Path, form: str = "JSON", levels: int = MOST_LEVELS, **place: Any
) -> dict[str, Any]:
    """The table of a JSON or TOML text of `path`; `place`: its line or key there.

    Raises FileError for anything else, and for nesting deeper than `levels`.
    """
    try:
        data = tomllib.loads(str(text)) if form == "TOML" else json.loads(text)
    except json.JSONDecodeError as error:
        place = {"line": error.lineno} | place
        raise FileError(path, f"not JSON: {error.msg}", **place) from None
    except ValueError as error:  # a TOMLDecodeError, or a number with too many digits
        raise FileError(path, f"not {form}: {error}", **place) from None
    except (RecursionError, MemoryError):
        raise FileError(path, f"{form} nested too deeply", **place) from None
    if not isinstance(data, dict):
        problem = f"holds a {type(data).__name__}"
        raise FileError(path, problem, valid=f"a {form} object", **place)
    level: list[Any] = [data]
    for _ in range(levels):
        level = [inner for node in level for inner in _inside(node)]
    if level:
        raise FileError(path, f"{form} nested deeper than {levels} levels", **place)
    return data


def _inside(node: Any) -> Any:
    if isinstance(node, dict):
        return node.values()
    return node if isinstance(node, list) else ()


def read_text(path: str | Path, limit: int = MOST_TEXT) -> str:
    """Read a text file. Raises FileError if it is missing, a folder, too large, or not UTF-8."""
    try:
        text = read_bytes(path, limit).decode("utf-8-sig")  # some editors write a mark
    except UnicodeDecodeError:
        raise FileError(path, "not a text file (UTF-8)") from None
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _file_error(
    model: type[Strict], error: ValidationError, where: str | Path, prefix: str, line: int | None
) -> FileError:
    errors = error.errors(include_url=False)
    first = next((e for e in errors if e["type"] == "extra_forbidden"), errors[0])  # a misspelling
    key = ".".join([prefix, *map(str, first["loc"])] if prefix else map(str, first["loc"]))
    valid = None
    if first["type"] == "extra_forbidden":
        valid = _fields_at(model, first["loc"][:-1])
    problem = "unknown key" if first["type"] == "extra_forbidden" else _sentence(first)
    more = error.error_count() - 1
    if more:
        problem += f" (and {more} more error{'s' if more > 1 else ''})"
    return FileError(where, problem, line=line, key=key or None, valid=valid)


def _sentence(item: Any) -> str:
    text = item["msg"].removeprefix("Value error, ")
    value = item.get("input")
    shown = isinstance(value, int | float | str) and item["type"] != "missing"
    return f"{text[:1].lower()}{text[1:]}" + (f", not {value!r:.80}" if shown else "")


def _fields_at(model: Any, loc: tuple[Any, ...]) -> list[str] | None:
    """Field names of the (nested) model at an error's location."""
    for step in loc:
        field = getattr(model, "model_fields", {}).get(step)
        if field is None and not isinstance(step, int):
            return None
        model = _model_in(field.annotation) if field is not None else model
    return sorted(model.model_fields) if hasattr(model, "model_fields") else None


def _model_in(annotation: Any) -> Any:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    for inner in getattr(annotation, "__args__", ()):
        found = _model_in(inner)
        if found is not None:
            return found
    return None


def refuse_newer(
    data: dict[str, Any], newest: int, path: str | Path, key: str = "schema_version"
) -> None:
    """Raise FileError if a later release wrote the file. Call before validating the content."""
    version = data.get(key)
    if isinstance(version, int) and version > newest:
        raise FileError(
            path, f"written by a newer version (schema {version})", key=key,
            valid=f"up to {newest}; upgrade egocap",
        )  # fmt: skip
