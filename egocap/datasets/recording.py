"""A recording of a published data set: cameras, images where they lie, and its labels as ours.

The head frame of a recording is the data set's own device frame, moved by a constant (`mounting`):
errors between poses do not depend on it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray as Array

from egocap.body.joint_names import match_labels
from egocap.body.labels import LABELS
from egocap.cameras.rig import Rig
from egocap.data.sequence import Frame
from egocap.datasets.pictures import Picture
from egocap.errors import InputError


@dataclass(frozen=True, eq=False)
class Labels:
    """Reference poses of a recording; what a mask leaves out is zero and means nothing."""

    joints_head: Float[Array, "T 18 3"]  # metres, `labels.LABELS`
    labelled: Bool[Array, "T 18"]  # joints that the data set labels in 3-D
    points: Float[Array, "T V 18 2"]  # pixels
    in_view: Bool[Array, "T V 18"]  # joints labelled in 2-D, inside the image
    T_world_head: Float[Array, "T 4 4"] | None = None  # world: z up


@dataclass(frozen=True, eq=False)
class Recording:
    """One sequence of a data set, read in place. `frames` are the data set's own numbers."""

    dataset: str  # a name of `catalogue.DATASETS`
    name: str  # the sequence's place inside the data set, with slashes
    rig: Rig
    times: Float[Array, "T"]  # seconds
    frames: tuple[int, ...]
    pictures: tuple[tuple[Picture, ...], ...]  # of each frame, one a view
    labels: Labels | None = None
    T_head_device: Float[Array, "4 4"] | None = None  # of the frame of `device_pts3d`
    known_frame: bool = True  # False: labels in a frame unrelated to the camera's
    category: str = ""  # of the motion, where the data set names it

    def __repr__(self) -> str:
        labels = "" if self.labels is not None else ", no labels"
        views = ", ".join(self.rig.views)
        return f"Recording({self.dataset}: {self.name}, {len(self)} frames, views {views}{labels})"

    def __len__(self) -> int:
        return len(self.frames)

    def __iter__(self) -> Iterator[Frame]:
        return (self.frame(i) for i in range(len(self)))

    def frame(self, index: int) -> Frame:
        """Decode the images of one frame. Raises FileError."""
        images = self.images(index)
        return Frame(index, float(self.times[index]), images, (True,) * len(images))

    def images(self, index: int) -> tuple[UInt8[Array, "H W 3"], ...]:
        """RGB images of all views at a frame, of the rig's sizes. Raises FileError."""
        cameras = self.rig.cameras
        return tuple(p.read(c) for p, c in zip(self.pictures[index], cameras, strict=True))

    def reprojection_px(self) -> float | None:
        """Median distance in pixels of the 2-D labels from the 3-D labels seen by the rig's
        cameras; None without both. Above a pixel or two, calibration or axes do not fit."""
        if self.labels is None:
            return None
        pixels, inside = self.rig.project(self.labels.joints_head)
        both = self.labels.in_view & np.moveaxis(inside, 0, 1) & self.labels.labelled[:, None]
        apart = np.linalg.norm(np.moveaxis(pixels, 0, 1) - self.labels.points, axis=-1)[both]
        return float(np.median(apart)) if apart.size else None


def on_labels(
    points: Float[Array, "T *V J C"], names: Sequence[str], table: str
) -> tuple[Float[Array, "T *V 18 C"], Bool[Array, "T *V 18"]]:
    """Points of a data set's joints on our labels, and which labels they give.

    Joints without a label are left out. `table` is a key of `joint_names.DATASET_NAMES`. NaN stands
    for a joint that is not labelled. Raises InputError for unknown names.
    """
    found = match_labels(names, table)
    placed = np.full((*points.shape[:-2], len(LABELS), points.shape[-1]), np.nan)
    placed[..., list(found.values()), :] = points[..., list(found), :]
    there = np.asarray(np.isfinite(placed).all(-1))
    return np.where(there[..., None], placed, 0.0), there


def on_joints(
    points: Float[Array, "T 18 C"], names: Sequence[str], table: str
) -> Float[Array, "T J C"]:
    """The inverse of `on_labels`: NaN for joints without a label."""
    found = match_labels(names, table)
    placed = np.full((*points.shape[:-2], len(names), points.shape[-1]), np.nan)
    placed[..., list(found), :] = points[..., list(found.values()), :]
    return placed


def inside_images(points: Float[Array, "T V 18 2"], rig: Rig) -> Bool[Array, "T V 18"]:
    """Whether each point lies in its view's image."""
    size = np.array([(camera.width, camera.height) for camera in rig.cameras])[:, None]
    return np.asarray(((points >= -0.5) & (points <= size - 0.5)).all(-1))


def frame_times(frames: Sequence[int], rate: float) -> Float[Array, "T"]:
    """Times in seconds of frame numbers, from 0. Raises InputError unless they increase."""
    numbers = np.array(frames)
    if (np.diff(numbers) <= 0).any():
        raise InputError("frame numbers do not increase")
    return (numbers - numbers[0]) / rate
