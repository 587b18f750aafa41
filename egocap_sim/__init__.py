"""The simulated world: scene files in; fisheye footage of people with exact truth out.

It uses only the cameras, body and data rooms of `egocap`. The public names load when they are
first used; `__init__.pyi` declares them to type checkers.
"""

from importlib import import_module
from typing import Any

_MODULES = {
    "generate": "api",
    "generate_episodes": "api",
    "preview": "api",
    "refine": "refinement.refine",
    "verify": "verification.integrity",
}
__all__ = list(_MODULES)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module 'egocap_sim' has no attribute '{name}'")
    value = globals()[name] = getattr(import_module(f"egocap_sim.{_MODULES[name]}"), name)
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
