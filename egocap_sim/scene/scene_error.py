"""The error of a scene that cannot be simulated: it names the table or key at fault."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from egocap.errors import InputError


class SceneError(InputError):
    """A table of a scene, `key`, asks for something that cannot be made."""

    def __init__(self, scene: str, key: str, problem: str) -> None:
        super().__init__(f"scene '{scene}', key '{key}': {problem}")
        self.key, self.problem = key, problem


@contextmanager
def errors_name_key(scene: str, key: str) -> Iterator[None]:
    """Turn an InputError into a SceneError for a key of the scene of this name.

    Errors of files pass, since they name the file, and so do those that name a key already.
    """
    try:
        yield
    except SceneError:
        raise
    except InputError as error:
        raise SceneError(scene, key, str(error)) from None
