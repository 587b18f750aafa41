"""person.json of a recording: who the wearer is, as `Person.description` states it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pydantic import ConfigDict, Field

from egocap.schema import Number, Strict, checked, read_json


class _Person(Strict):
    """What is read of it."""

    model_config = ConfigDict(extra="ignore")

    sex: str | None = None
    age_years: Number | None = Field(None, ge=0.0, le=150.0)
    height_m: Number | None = Field(None, ge=0.3, le=3.0)
    mass_kg: Number | None = Field(None, ge=1.0, le=1000.0)


def read_person(folder: Path) -> dict[str, Any]:
    """The description of a recording's wearer; empty where it has none. Raises FileError."""
    path = folder / "person.json"
    if not path.exists():
        return {}
    data = read_json(path)
    found = checked(_Person, data, path).model_dump(exclude_none=True)
    return {k: v for k, v in data.items() if k not in _Person.model_fields} | found
