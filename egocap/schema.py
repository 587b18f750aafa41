"""Reading TOML and JSON files and validating them; errors name file and key.

pydantic models derive from `Strict`; `checked` turns a validation error into one FileError.
"""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from egocap.errors import FileError

Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
"""A finite number; text and booleans are refused."""


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
    """Read a TOML file. Raises FileError."""
    try:
        return tomllib.loads(read_text(path))
    except ValueError as error:  # a TOMLDecodeError, or a number beyond what Python converts
        raise FileError(path, f"not TOML: {error}") from None
    except RecursionError:
        raise FileError(path, "TOML nested too deeply") from None


def read_json(path: str | Path) -> dict[str, Any]:
    """Read a JSON object from a file. Raises FileError, also for JSON that is not an object."""
    try:
        data = json.loads(read_text(path))
    except json.JSONDecodeError as error:
        raise FileError(path, f"not JSON: {error.msg}", line=error.lineno) from None
    except ValueError as error:  # a number with more digits than Python converts
        raise FileError(path, f"not readable JSON: {error}") from None
    except RecursionError:
        raise FileError(path, "JSON nested too deeply") from None
    if not isinstance(data, dict):
        raise FileError(path, f"holds a {type(data).__name__}", valid="a JSON object")
    return data


def read_text(path: str | Path) -> str:
    """Read a text file. Raises FileError if it is missing, a folder, or not UTF-8."""
    try:
        return Path(path).read_text(encoding="utf-8")
    except FileNotFoundError:
        raise FileError(path, "no such file") from None
    except IsADirectoryError:
        raise FileError(path, "is a folder", valid="a file") from None
    except UnicodeDecodeError:
        raise FileError(path, "not a text file (UTF-8)") from None
    except (OSError, ValueError) as error:
        raise FileError(path, f"cannot be read: {error}") from None


def _file_error(
    model: type[Strict], error: ValidationError, where: str | Path, prefix: str, line: int | None
) -> FileError:
    first = error.errors(include_url=False)[0]
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
