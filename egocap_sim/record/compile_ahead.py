"""The slowest kernel, compiled by another process while this one makes the wearer and the motion.

Once a machine: kernels are cached beside their modules, or in numba's cache folder of the user.
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
    """Compile the forces of contacts meanwhile, unless the cache has them."""
    if _is_cached():
        yield
        return
    command = [sys.executable, "-m", "egocap_sim.record.compile_ahead"]
    quiet = subprocess.DEVNULL
    # A session of its own: Ctrl-C ends it through this process, without a traceback.
    with subprocess.Popen(command, stdin=quiet, stdout=quiet, stderr=quiet,
                          start_new_session=True) as process:  # fmt: skip
        try:
            yield
        finally:
            process.terminate()


def compile_contacts() -> None:
    """Compile the kernel by a call with the types of a simulation."""
    from egocap_sim.physics.contact_forces import contact_forces

    up = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    contact_forces(np.zeros((1, 3)), np.zeros(1, np.int64), np.zeros(4), np.zeros((4, 3)),
                   np.zeros(3), np.eye(3), up, 1.0, 1.0)  # fmt: skip


def _is_cached() -> bool:
    from egocap_sim.physics.contact_forces import contact_forces

    folder = contact_forces.stats.cache_path
    return folder is not None and any(Path(folder).glob(f"*.{contact_forces.__name__}-*.nbi"))


if __name__ == "__main__":
    compile_contacts()
