"""Shader programs: a pair of files of `shaders`, compiled and linked, with inputs set by name."""

from __future__ import annotations

from collections.abc import Iterable
from importlib.resources import files

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from OpenGL.GL.shaders import compileProgram, compileShader

from egocap_sim.render.egl import GL


class Program:
    """A vertex and a fragment shader, with the names in `defined` defined for the preprocessor."""

    def __init__(self, name: str, defined: Iterable[str] = ()) -> None:
        self._id = compileProgram(
            compileShader(_source(f"{name}.vert", defined), GL.GL_VERTEX_SHADER),
            compileShader(_source(f"{name}.frag", defined), GL.GL_FRAGMENT_SHADER),
            validate=False,  # which would need the state of a draw call
        )
        self._location: dict[str, int] = {}

    def use(self) -> Program:
        """Make it the program of the next calls."""
        GL.glUseProgram(self._id)
        return self

    def matrix(self, name: str, value: Float[Array, "4 4"]) -> None:
        """Set a 4x4 matrix."""
        GL.glUniformMatrix4fv(self._locate(name), 1, GL.GL_TRUE, value.astype(np.float32))

    def vector(self, name: str, value: Float[Array, "3"]) -> None:
        """Set three numbers."""
        GL.glUniform3f(self._locate(name), *map(float, value))

    def delete(self) -> None:
        """Free it."""
        GL.glDeleteProgram(self._id)

    def _locate(self, name: str) -> int:
        if name not in self._location:
            location = GL.glGetUniformLocation(self._id, name)
            assert location >= 0, f"shader has no active input '{name}'"
            self._location[name] = location
        return self._location[name]


class Programs:
    """The programs of one context, each compiled on first use."""

    def __init__(self) -> None:
        self._compiled: dict[tuple[str, tuple[str, ...]], Program] = {}

    def use(self, name: str, defined: Iterable[str] = ()) -> Program:
        """The program of a pair of shader files, in use."""
        key = name, tuple(defined)
        if key not in self._compiled:
            self._compiled[key] = Program(*key)
        return self._compiled[key].use()

    def delete(self) -> None:
        """Free all."""
        for program in self._compiled.values():
            program.delete()
        self._compiled.clear()


def _source(file: str, defined: Iterable[str]) -> str:
    text = (files("egocap_sim.render") / "shaders" / file).read_text()
    version, rest = text.split("\n", 1)  # definitions follow the line with the version
    return "\n".join([version, *(f"#define {name}" for name in defined), rest])
