"""Read motion clips stored as numpy archives of joint positions and rotations.

Keys: `joints` (J,) names, `pos` (T,J,3) metres z-up, `quat` (T,J,4) w,x,y,z world rotations of the
source's bones, `fps`. Joint names are the 21 bodies', with or without the underscore (`l_upperarm`,
`lupperarm`) or in the short form (`larm`, `lfore`, `lclav`).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.errors import FileError
from egocap.files import read_npz
from egocap.geometry import quaternion_to_matrix
from egocap_sim.core.bodies import BODIES

FARTHEST = 1e4  # metres
_KEYS = ("joints", "pos", "quat", "fps")
_SHORT = {"clav": "clavicle", "arm": "upperarm", "fore": "forearm"}


def read_npz_clip(
    path: str | Path,
) -> tuple[Float[Array, "T 21 3"], Float[Array, "T 21 3 3"], float]:
    """Read positions (m, z up) and world bone rotations in the order of BODIES, and the frame rate.

    Raises FileError, with the key, for a damaged archive, missing or unknown joints, wrong shapes,
    values that are not finite, and quaternions of length zero.
    """
    path = Path(path)
    data = _arrays(path)
    order = _order(data["joints"], path)
    shape = data["pos"].shape
    if len(shape) != 3 or shape[1:] != (len(data["joints"]), 3) or shape[0] < 1:
        raise FileError(path, f"has shape {shape}", key="pos", valid="(T, joints, 3), T above 0")
    if data["quat"].shape != (*shape[:2], 4):
        raise FileError(
            path, f"has shape {data['quat'].shape}", key="quat", valid=f"({shape[0]}, joints, 4)"
        )
    for key in ("pos", "quat", "fps"):
        if not np.isfinite(data[key]).all():
            raise FileError(path, "has values that are not finite", key=key)
    if np.abs(data["pos"]).max() > FARTHEST:
        raise FileError(path, f"has positions beyond {FARTHEST:g} m", key="pos", valid="metres")
    if data["fps"].size != 1 or not 1 <= float(data["fps"].ravel()[0]) <= 10_000:
        raise FileError(path, f"is {data['fps']}", key="fps", valid="one number, 1 to 10000")
    quat = data["quat"][:, order]
    if np.linalg.norm(quat, axis=-1).min() < 0.5:
        raise FileError(path, "has quaternions far from length one", key="quat")
    return data["pos"][:, order], quaternion_to_matrix(quat), float(data["fps"].ravel()[0])


def _arrays(path: Path) -> dict[str, Array]:
    data = read_npz(path, only=_KEYS)
    for key in _KEYS:
        if key not in data:
            raise FileError(path, "is missing", key=key, valid=_KEYS)
    for key in _KEYS[1:]:
        if data[key].dtype.kind not in "fiu":
            raise FileError(path, f"has type {data[key].dtype}", key=key, valid="numbers")
        data[key] = data[key].astype(np.float64)
    if data["joints"].dtype.kind != "U" or data["joints"].ndim != 1:
        raise FileError(path, f"has type {data['joints'].dtype}", key="joints", valid="(J,) text")
    return data


def _order(joints: Array, path: Path) -> list[int]:
    """Column of each body."""
    names = [_body(str(name)) for name in joints]
    unknown = [str(j) for j, name in zip(joints, names, strict=True) if name not in BODIES]
    missing = [body for body in BODIES if body not in names]
    if unknown or missing:
        problem = "; ".join(
            f"{what} {', '.join(which)}"
            for what, which in (("unknown joints", unknown), ("missing", missing))
            if which
        )
        raise FileError(path, problem, key="joints", valid=BODIES)
    if len(set(names)) != len(names):
        raise FileError(path, "two names stand for the same joint", key="joints", valid=BODIES)
    return [names.index(body) for body in BODIES]


def _body(name: str) -> str:
    if name in BODIES:
        return name
    side, limb = name[:1], name[1:].lstrip("_")
    return f"{side}_{_SHORT.get(limb, limb)}"
