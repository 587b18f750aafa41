"""The error of a scene that cannot be simulated; it names the invalid table or key."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from egocap.errors import InputError


class SceneError(InputError):
    """The value of `key` in a scene cannot be simulated."""

    def __init__(self, scene: str, key: str, problem: str) -> None:
        super().__init__(f"scene '{scene}', key '{key}': {problem}")
        self.key, self.problem = key, problem


@contextmanager
def errors_name_key(scene: str, key: str) -> Iterator[None]:
    """Turn an InputError into a SceneError for a key of the scene of this name.

    FileErrors, which name the file, and SceneErrors pass unchanged.
    """
    try:
        yield
    except SceneError:
        raise
    except InputError as error:
        raise SceneError(scene, key, str(error)) from None
