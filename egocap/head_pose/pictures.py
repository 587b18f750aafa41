"""Grey pictures at working size; those of a sequence are decoded ahead, on another thread."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray as Array

from egocap.cameras.rig import Rig
from egocap.data.sequence import Sequence
from egocap.errors import FileError

AHEAD = 4  # frames
Grey = UInt8[Array, "h w"]


def grey_frames(
    sequence: Sequence, rig: Rig, frames: Iterable[int]
) -> Iterator[tuple[int, tuple[Grey | None, ...]]]:
    """Frame numbers and grey pictures of all views at the size of `rig`; None: no picture."""
    with ThreadPoolExecutor(1) as pool:
        waiting: deque[tuple[int, Future[tuple[Grey | None, ...]]]] = deque()
        upcoming = iter(frames)
        try:
            while True:
                while len(waiting) < AHEAD and (index := next(upcoming, None)) is not None:
                    waiting.append((index, pool.submit(grey_pictures, sequence, rig, index)))
                if not waiting:
                    return
                index, future = waiting.popleft()
                yield index, future.result()
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def grey_pictures(sequence: Sequence, rig: Rig, index: int) -> tuple[Grey | None, ...]:
    """Grey pictures of a frame in all views at the size of `rig`; None: no picture."""
    return tuple(
        _picture(sequence, index, view, (mount.camera.width, mount.camera.height))
        for view, mount in enumerate(rig.mounts)
    )


def _picture(sequence: Sequence, index: int, view: int, size: tuple[int, int]) -> Grey | None:
    """A JPEG in a shard is decoded at a fraction of its size; colours are not corrected."""
    suffix = sequence.image_suffix(index, view)
    if suffix is not None and suffix.endswith("jpg"):
        return _reduced(_jpeg(sequence, index, view, size), size)
    image = sequence.picture(index, view)
    return None if image is None else grey_of(image, size)


def grey_of(image: UInt8[Array, "H W 3"], size: tuple[int, int]) -> Grey:
    """A colour picture in grey, at a size (width, height)."""
    import cv2

    return _reduced(np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)), size)


def _reduced(grey: Grey, size: tuple[int, int]) -> Grey:
    import cv2

    if grey.shape == size[::-1]:
        return grey
    return np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA))


def _jpeg(sequence: Sequence, index: int, view: int, size: tuple[int, int]) -> Grey:
    import simplejpeg

    suffix, camera = f"{sequence.manifest.views[view]}.jpg", sequence.rig.cameras[view]
    data = sequence.read(index, suffix)
    try:
        if simplejpeg.decode_jpeg_header(data)[:2] != (camera.height, camera.width):
            raise FileError(sequence.shard_path(index), f"frame {index}: '{suffix}' has another "
                            "size than its camera in the rig")  # fmt: skip
        image = simplejpeg.decode_jpeg(data, "GRAY", min_width=size[0], min_height=size[1])
    except ValueError:
        path = sequence.shard_path(index)
        raise FileError(path, f"frame {index}: '{suffix}' is damaged") from None
    return image[..., 0]
