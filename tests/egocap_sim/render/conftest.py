"""Scenes for renderer tests: a rig in the middle of things at known places."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from egocap import geometry
from egocap.cameras.camera import Camera
from egocap.cameras.rig import Mount, Rig
from egocap.errors import MachineError
from egocap_sim.environment.place import Light, Place


@pytest.fixture(scope="session")
def gl():
    """The renderer module; tests that need it are skipped, loudly, where OpenGL is absent."""
    try:
        from egocap_sim.render import renderer
        from egocap_sim.render.gl import Context

        Context().close()
    except MachineError as error:
        warnings.warn(f"NO RENDERER TEST RUNS HERE: {error}", stacklevel=1)
        pytest.skip(f"no OpenGL: {error}")
    return renderer


def looking_forward(*cameras: Camera) -> Rig:
    """A rig whose cameras sit at the head's origin and look along world +x, image up being +z."""
    R = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    mounts = [Mount(f"view{i}", c, geometry.rigid(R, np.zeros(3))) for i, c in enumerate(cameras)]
    return Rig("test", tuple(mounts))


def equidistant(width: int = 640, height: int = 640, degrees: float = 180.0) -> Camera:
    """A lens whose image circle touches the longer side."""
    f = (max(width, height) / 2) / np.radians(degrees / 2)
    centre = ((width - 1) / 2, (height - 1) / 2)
    return Camera(
        "equidistant",
        width,
        height,
        centre,
        ((f, 0.0), (0.0, f)),
        max_angle=np.radians(degrees / 2),
    )


def plain_light(ambient: float = 1.0, color: float = 0.0) -> Light:
    """Light from straight above; with ambient 1 alone every surface shows its texture."""
    return Light(
        np.array([0.0, 0.0, -1.0]), np.full(3, color), np.full(3, ambient), np.full(3, ambient),
        np.array([0.0, 0.0, 1.0]),
    )  # fmt: skip


def place_of(*meshes, light: Light | None = None) -> Place:
    """A place of these meshes before black."""
    return Place("test", tuple(meshes), light or plain_light(), np.zeros(3))
