"""Checked reading of the project's own files: a defect names file, key and what is valid."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from egocap.errors import FileError

if TYPE_CHECKING:
    from pydantic import BaseModel

    Model = TypeVar("Model", bound=BaseModel)


def read_toml(path: Path) -> dict[str, Any]:
    """Parse a TOML file; FileError with the line where it is not TOML."""
    try:
        return tomllib.loads(_read_text(path))
    except tomllib.TOMLDecodeError as error:
        raise FileError(path, f"not valid TOML: {error}") from None


def read_json(path: Path) -> dict[str, Any]:
    """Parse a JSON file that holds an object; FileError with the line where it is not JSON."""
    try:
        data = json.loads(_read_text(path))
    except json.JSONDecodeError as error:
        raise FileError(path, f"not valid JSON: {error.msg}", line=error.lineno) from None
    except RecursionError:
        raise FileError(path, "not valid JSON: nested too deeply") from None
    if not isinstance(data, dict):
        raise FileError(path, f"holds a {type(data).__name__}", valid="a JSON object")
    return data


def _read_text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise FileError(path, "no such file") from None
    except IsADirectoryError:
        raise FileError(path, "is a directory", valid="a file") from None
    except UnicodeDecodeError:
        raise FileError(path, "is not UTF-8 text") from None
    except OSError as error:
        raise FileError(path, f"cannot be read: {error.strerror}") from None


def validate(model: type[Model], data: dict[str, Any], path: str | Path) -> Model:
    """Build a pydantic model from a file's content.

    Raises FileError that lists every wrong key by its dotted path; for an unknown key it lists the
    valid ones.
    """
    from pydantic import ValidationError

    try:
        return model.model_validate(data)
    except ValidationError as error:
        details = error.errors(include_url=False)
    first = details[0]
    more = f" (and {len(details) - 1} more problems)" if len(details) > 1 else ""
    key = ".".join(str(part) for part in first["loc"])
    message = first["msg"].removeprefix("Value error, ")
    if first["type"] == "extra_forbidden":
        raise FileError(path, "unknown key" + more, key=key, valid=_fields(model, first["loc"]))
    if first["type"] == "missing":
        raise FileError(path, "missing" + more, key=key)
    value = repr(first["input"])
    shown = value if len(value) < 80 else value[:77] + "..."
    raise FileError(path, f"{message}, got {shown}{more}", key=key or None)


def _fields(model: type[BaseModel], location: tuple[int | str, ...]) -> list[str] | None:
    """Names that would have been valid beside an unknown key."""
    from pydantic import BaseModel

    here: Any = model
    for part in location[:-1]:
        if isinstance(part, int) or not (isinstance(here, type) and issubclass(here, BaseModel)):
            continue
        field = here.model_fields.get(part)
        options = [field.annotation, *getattr(field.annotation, "__args__", ())] if field else []
        here = next((o for o in options if isinstance(o, type) and issubclass(o, BaseModel)), None)
    return (
        sorted(here.model_fields)
        if isinstance(here, type) and issubclass(here, BaseModel)
        else None
    )
