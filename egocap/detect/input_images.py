"""Input images: conversion to 8-bit RGB, reading from sequences, and prefetching."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, TypeVar

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray as Array

from egocap.data.sequence import Sequence, largest_reduction
from egocap.errors import InputError

ENOUGH = 640
"""Image width [px] sufficient for a canonical view; larger JPEGs are decoded at reduced size."""

_KINDS = "uint8 or uint16, (H, W), (H, W, 1) or RGB (H, W, 3)"
_Made = TypeVar("_Made")


def as_rgb(picture: Array) -> UInt8[Array, "H W 3"]:
    """Convert an image to 8-bit RGB; 16-bit values keep their upper eight bits.

    Raises InputError for other types or shapes, such as images with an alpha channel.
    """
    picture = np.asarray(picture)
    if picture.ndim == 2:
        picture = picture[..., None]
    deep = picture.dtype == np.uint16
    if picture.ndim != 3 or picture.shape[2] not in (1, 3) or 0 in picture.shape:
        raise InputError(f"a picture of shape {picture.shape}", valid=_KINDS)
    if not deep and picture.dtype != np.uint8:
        raise InputError(f"a picture of {picture.dtype}", valid=_KINDS)
    if deep:
        picture = (picture >> 8).astype(np.uint8)
    return np.repeat(picture, 3, 2) if picture.shape[2] == 1 else picture


def recorded_pictures(sequence: Sequence, index: int) -> tuple[UInt8[Array, "h w 3"] | None, ...]:
    """Images of one frame at the size the detector needs; None for a missing view.

    Raises FileError for a damaged image.
    """
    return tuple(
        sequence.picture(index, v, largest_reduction(camera, camera.width / ENOUGH))
        for v, camera in enumerate(sequence.rig.cameras)
    )


def ahead(jobs: Iterator[Any], make: Any, count: int = 2, threads: int = 1) -> Iterator[Any]:
    """Yield make(job) of every job in order, computed by threads up to `count` jobs ahead."""
    waiting: list[Future[Any]] = []
    with ThreadPoolExecutor(threads, thread_name_prefix="pictures") as pool:
        try:
            for job in jobs:
                waiting.append(pool.submit(make, job))
                if len(waiting) > count:
                    yield waiting.pop(0).result()
            while waiting:
                yield waiting.pop(0).result()
        finally:
            for future in waiting:
                future.cancel()
