"""Textures for floors and walls from a user's folder of pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt8
from numpy import ndarray as Array

from egocap.errors import FileError
from egocap.files import read_bytes
from egocap.media.decoding import decode
from egocap_sim.assets.textures import SIZE
from egocap_sim.environment.place import Place

SUFFIXES = (".jpg", ".jpeg", ".png", ".webp", ".bmp")
TEXTURED = ("floor", "yard", "wall", "picture", "house", "pavement", "court")
"""Names of the meshes whose texture is replaced."""


def picture_files(folder: Path) -> list[Path]:
    """The picture files in a folder, sorted. Raises FileError if there are none."""
    if not folder.is_dir():
        raise FileError(folder, "no such folder", valid="a folder of pictures")
    found = sorted(p for p in folder.iterdir() if p.suffix.lower() in SUFFIXES)
    if not found:
        raise FileError(folder, "has no pictures", valid=f"files that end in {', '.join(SUFFIXES)}")
    return found


def decode_picture(path: Path, valid: str) -> UInt8[Array, "H W 3"]:
    """Decode a picture (RGB). Raises FileError with the hint `valid` if it cannot be read."""
    image = decode(read_bytes(path), cv2.IMREAD_COLOR_RGB, path)
    if image is None:
        raise FileError(path, "is not a readable picture", valid=valid)
    return image


def read_picture(path: Path) -> UInt8[Array, "S S 3"]:
    """A picture resized to a texture (RGB). Raises FileError if it cannot be read."""
    image = decode_picture(path, "JPEG, PNG, WebP or BMP")
    return cv2.resize(image, (SIZE, SIZE), interpolation=cv2.INTER_AREA)


def with_pictures(place: Place, files: Sequence[Path], rng: np.random.Generator) -> Place:
    """The place with random pictures as textures of its floor, walls and pictures."""
    read = cache(read_picture)
    meshes = tuple(
        replace(mesh, texture=read(files[int(rng.integers(len(files)))]))
        if mesh.name in TEXTURED
        else mesh
        for mesh in place.meshes
    )
    return replace(place, meshes=meshes)
