"""The kernels of the appearance check, compiled by another process while this one does the rest.

Once a machine: numba keeps them beside their modules, or in its cache folder of the user.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np


@contextmanager
def compiling_ahead() -> Iterator[None]:
    """Compile the image model's visibility and optical depths meanwhile, unless they are cached."""
    if _is_cached():
        yield
        return
    command = [sys.executable, "-m", __spec__.name]
    quiet = subprocess.DEVNULL
    # A session of its own: Ctrl-C ends it through this process, without a traceback.
    with subprocess.Popen(command, stdin=quiet, stdout=quiet, stderr=quiet,
                          start_new_session=True) as process:  # fmt: skip
        try:
            yield
        finally:
            process.terminate()


def compile_images() -> None:
    """Compile the kernels by calls with the types of a track."""
    from egocap.body.gaussians import GaussianBody
    from egocap.body.proportions import Proportions
    from egocap.body.skeleton import DOF_COUNT
    from egocap.cameras.camera import Camera
    from egocap.cameras.rig import Mount, Rig
    from egocap.image_model.image_rays import image_rays
    from egocap.image_model.model import ImageModel
    from egocap.image_model.occlusion import optical_depths

    person = Proportions.from_lengths(1.75)
    body, rest = GaussianBody.from_proportions(person), np.zeros(DOF_COUNT)
    camera = Camera("equidistant", 16, 16, (7.5, 7.5), ((5.0, 0.0), (0.0, 5.0)))
    rig = Rig("any", (Mount("any", camera, np.eye(4)),))
    ImageModel(body, image_rays(rig)).visibility(rest)
    optical_depths(rest[None], person.rest_joints[None], body, rig)


def _is_cached() -> bool:
    from egocap.image_model.image_kernel import image_visibility

    folder = image_visibility.stats.cache_path
    return folder is not None and any(Path(folder).glob(f"*.{image_visibility.__name__}-*.nbi"))


if __name__ == "__main__":
    compile_images()
