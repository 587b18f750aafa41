"""How the options of the three commands are read and shown.

In: types of options. Out: tyro's specifications of them, for `egocap.commandline.run`.
"""

from __future__ import annotations

from dataclasses import replace
from types import NoneType, UnionType
from typing import Any, Union, get_args

import tyro
from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

registry = ConstructorRegistry()


def several(metavar: str) -> Any:
    """Show a list of words in the help as this placeholder, without its empty default."""
    return tyro.conf.arg(metavar=f"{metavar} ...", help_behavior_hint="")


@registry.primitive_rule
def _may_be_left_out(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Any] | None:
    """Read an option of type X | None as X: None is to leave it out, and no word to type."""
    types = [kind for kind in get_args(info.type) if kind is not NoneType]
    if info.type_origin not in (UnionType, Union) or len(types) != 1:
        return None
    of = ConstructorRegistry.get_primitive_spec(PrimitiveTypeInfo.make(types[0], info.markers))
    if not isinstance(of, PrimitiveConstructorSpec):
        return None
    return replace(
        of, is_instance=lambda value: value is None or of.is_instance(value),
        str_from_instance=lambda value: ["None"] if value is None else of.str_from_instance(value),
    )  # fmt: skip
