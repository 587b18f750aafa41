"""The tracker's settings as flags: a few, or all with --advanced; defaults from --config FILE."""

from __future__ import annotations

import argparse
import ast
import inspect
import sys
from collections.abc import Sequence
from dataclasses import fields, replace
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, get_type_hints

from tyro.conf import arg
from tyro.constructors import (
    ConstructorRegistry,
    StructConstructorSpec,
    StructFieldSpec,
    StructTypeInfo,
)

from egocap.errors import FileError, InputError
from egocap.pose.config import TrackerConfig

BASIC = (
    "smoothing", "lag", "multistart", "appearance_check", "estimate_noise", "colour", "covariance",
    "synchronise", "align_cameras",
)  # fmt: skip
"""Settings that are flags without --advanced."""
_SOURCES = (
    StructFieldSpec(
        name="config", type=Path | None, default=None,  # pyright: ignore[reportArgumentType]
        helptext="TOML file of the tracker's settings; flags override it.",
    ),
    StructFieldSpec(
        name="advanced", type=bool, default=False,
        helptext="Accept all settings of the tracker as flags; --advanced --help lists them.",
    ),
)  # fmt: skip
COMMANDS = ("track", "live")
registry = ConstructorRegistry()


@registry.struct_rule
def _flags(info: StructTypeInfo) -> StructConstructorSpec | None:
    """Flags of a TrackerConfig; both --advanced and --config must be known before they are made."""
    if info.type is not TrackerConfig:
        return None
    default = info.default if isinstance(info.default, TrackerConfig) else TrackerConfig()
    advanced, file = _early_options(sys.argv[1:])
    if file is not None:
        default = read_settings(file, default)
    docs, types = _field_docs(), get_type_hints(TrackerConfig)
    shown = [f.name for f in fields(TrackerConfig)] if advanced else BASIC
    specs = [
        StructFieldSpec(
            name=name, type=_flag_type(types[name]), default=getattr(default, name),
            helptext=_flag_help(docs[name], getattr(default, name)),
        )
        for name in shown
    ]  # fmt: skip

    def make(config: Path | None, advanced: bool, **changed: Any) -> TrackerConfig:
        made = replace(default, **changed)  # both options were read above
        if made.smoothing == "fixed-lag" and made.motion_prior != "network":
            raise InputError(f"motion prior '{made.motion_prior}' with smoothing 'fixed-lag'",
                             valid="network")  # fmt: skip
        return made

    return StructConstructorSpec(instantiate=make, fields=(*_SOURCES, *specs))


def read_settings(path: Path, default: TrackerConfig) -> TrackerConfig:
    """Settings with those of a TOML file. Raises FileError."""
    from pydantic import ConfigDict, create_model

    from egocap.schema import Strict, checked, read_toml

    class Base(Strict):
        model_config = ConfigDict(strict=True)

    types = get_type_hints(TrackerConfig)
    members = {name: (type_, getattr(default, name)) for name, type_ in types.items()}
    model = create_model("TrackerSettings", __base__=Base, **members)  # pyright: ignore
    given = checked(model, read_toml(path), path).model_dump(exclude_unset=True)
    try:
        return replace(default, **given)
    except InputError as error:
        raise FileError(path, str(error)) from None


def _early_options(words: Sequence[str]) -> tuple[bool, Path | None]:
    """Whether --advanced is among a command's words, and the file of --config."""
    if not words or words[0] not in COMMANDS:
        return False, None
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    parser.add_argument("--advanced", action="store_true")
    parser.add_argument("--config", nargs="?", type=Path)
    found, _ = parser.parse_known_args(words[1:])
    return found.advanced, found.config


def _field_docs() -> dict[str, str]:
    """The comment below each field, in one line."""
    (definition,) = ast.parse(inspect.getsource(TrackerConfig)).body
    assert isinstance(definition, ast.ClassDef)
    return {
        field.target.id: " ".join(text.value.value.split())
        for field, text in pairwise(definition.body)
        if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name)
        and isinstance(text, ast.Expr) and isinstance(text.value, ast.Constant)
        and isinstance(text.value.value, str)
    }  # fmt: skip


def _flag_type(annotation: Any) -> Any:
    """On/off flags say what they do; their default would read the wrong way round."""
    return Annotated[bool, arg(help_behavior_hint="")] if annotation is bool else annotation


def _flag_help(doc: str, default: object) -> str:
    """What giving the flag does: for what is on, what follows "Off:" in its comment."""
    on, _, off = doc.partition(" Off: ")
    if default is True:
        return off or f"Turn off: {on}"
    return on
