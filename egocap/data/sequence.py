"""Reading sequences: frames for trackers and, separately, truth for evaluations.

A folder of manifest.json, rig.json, scene.toml, body.json, truth.npz [rig.true.json sensor.npz
others.npz] and WebDataset shards (shard-00000.tar with KEY.left.jpg KEY.right.jpg
[KEY.left.mask.png KEY.left.depth.png] KEY.json).
A sequence of footage has footage.json and times.npz instead of scene, body and truth, and its
pictures in shards or in the files they were imported from.
The manifest holds the byte range of every file in every shard, for random access to frames.
`egocap.data.sequence_writer` writes such folders.
"""

from __future__ import annotations

import logging
from base64 import b64encode
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8, UInt16
from numpy import ndarray as Array

from egocap.body.labels import LABELS
from egocap.body.proportions import Proportions
from egocap.cameras.camera import Camera
from egocap.cameras.rig import Rig
from egocap.cameras.rig_files import load_rig
from egocap.data.footage import FOOTAGE, TIMES, Footage, FootageImages, FrameTimes, load_footage
from egocap.data.manifest import load_manifest
from egocap.data.truth import OthersTruth, SensorTruth, Truth
from egocap.errors import FileError, InputError
from egocap.files import sha256
from egocap.media.decoding import decode
from egocap.schema import parsed

log = logging.getLogger(__name__)

TRUE_RIG = "rig.true.json"  # where rig.json has a calibration error
SENSOR = "sensor.npz"
OTHERS = "others.npz"  # in scenes with other people


@dataclass(frozen=True, eq=False)
class Frame:
    """Images of all cameras at one instant, without truth."""

    index: int
    time: float  # seconds
    images: tuple[UInt8[Array, "H W 3"], ...]  # RGB, one a view; black where not `present`
    present: tuple[bool, ...]  # whether a view has a picture of this instant


def largest_reduction(camera: Camera, most: float) -> int:
    """The largest factor up to `most` by which `Sequence.picture` decodes a view's JPEGs smaller.

    It divides both sides: others would be padded.
    """
    sides = camera.width, camera.height
    fitting = (f for f in (8, 4, 2) if f <= most and not any(side % f for side in sides))
    return next(fitting, 1)


class Sequence:
    """A complete sequence folder, open for reading.

    Raises FileError if the folder is not a sequence, is incomplete, or has a newer schema.
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)
        self.manifest = load_manifest(self.folder)
        if not self.manifest.complete:
            done, all_ = len(self.manifest.shards), self.manifest.shard_count
            command = "generate" if self.manifest.truth else "import"
            raise FileError(
                self.folder,
                f"unfinished: {done} of {all_} shards are recorded; "
                f"run the same {command} command again to complete it",
            )

    def __repr__(self) -> str:
        m = self.manifest
        truth = "" if m.truth else ", no truth"
        return (
            f"Sequence('{m.name}', {m.frames} frames at {m.fps:g} Hz, {len(m.views)} views{truth})"
        )

    def _repr_html_(self) -> str:
        """For notebooks: the summary and the middle frame's images at half size."""
        import simplejpeg

        images = self.frame(len(self) // 2).images
        jpegs = [simplejpeg.encode_jpeg(np.ascontiguousarray(i[::2, ::2]), 85) for i in images]
        tags = (f'<img src="data:image/jpeg;base64,{b64encode(j).decode()}">' for j in jpegs)
        return f"<p>{escape(repr(self))}</p>{' '.join(tags)}"

    def __len__(self) -> int:
        return self.manifest.frames

    def __iter__(self) -> Iterator[Frame]:
        return (self.frame(i) for i in range(len(self)))

    @cached_property
    def rig(self) -> Rig:
        """Calibrated cameras for trackers: as rendered, unless the sensor has a calibration error.

        A file that is not the recorded one is used, with a warning. Raises FileError if the
        manifest has other views.
        """
        entry, path = self.manifest.files.get("rig.json"), self.folder / "rig.json"
        if entry is not None and path.is_file() and sha256(path) != entry.sha256:
            log.warning("%s is not the rig that was recorded: it was edited or is damaged", path)
        return self._rig("rig.json")

    @cached_property
    def true_rig(self) -> Rig:
        """Cameras as rendered, for evaluations."""
        return self._rig(TRUE_RIG) if TRUE_RIG in self.manifest.files else self.rig

    @cached_property
    def sensor(self) -> SensorTruth | None:
        """Sensor effects; None for an ideal sensor."""
        if SENSOR not in self.manifest.files:
            return None
        return SensorTruth.load(self.folder / SENSOR)

    @cached_property
    def body(self) -> Proportions:
        """Body proportions of the wearer, available to trackers.

        Assign to it for footage, whose wearer is not known: until then FileError is raised.
        """
        if not self.manifest.truth and "body.json" not in self.manifest.files:
            raise FileError(self.folder, "footage of a person of unknown proportions",
                            valid="--body FILE, average:HEIGHT or fit")  # fmt: skip
        return Proportions.load(self.folder / "body.json")

    @cached_property
    def truth(self) -> Truth:
        """Simulated truth, for evaluations; not part of a Frame. Raises FileError for footage."""
        if not self.manifest.truth:
            raise FileError(self.folder, "footage, which has no truth",
                            valid="a sequence made by egocap-sim generate")  # fmt: skip
        return Truth.load(self.folder / "truth.npz")

    @cached_property
    def footage(self) -> Footage | None:
        """Files, clocks and colours of the views of footage; None for a simulated sequence.

        Raises FileError, also where its views are not those of the manifest.
        """
        if self.manifest.truth:
            return None
        found = load_footage(self.folder / FOOTAGE)
        if tuple(view.name for view in found.views) != self.manifest.views:
            raise FileError(self.folder / FOOTAGE, "has other views than the manifest",
                            key="views", valid=self.manifest.views)  # fmt: skip
        return found

    @cached_property
    def frame_times(self) -> FrameTimes | None:
        """Pictures of every frame of footage; None for a simulated sequence. Raises FileError."""
        if self.manifest.truth:
            return None
        found = FrameTimes.load(self.folder / TIMES)
        wanted = self.manifest.frames, len(self.manifest.views)
        if found.present.shape != wanted or not np.isfinite(found.time).all():
            raise FileError(self.folder / TIMES, f"has shape {found.present.shape}", key="present",
                            valid=f"{wanted}, and finite times")  # fmt: skip
        return found

    @cached_property
    def others(self) -> OthersTruth | None:
        """Joints of other people, for evaluations; None without other people."""
        if OTHERS not in self.manifest.files:
            return None
        return OthersTruth.load(self.folder / OTHERS)

    @cached_property
    def times(self) -> Float[Array, "T"]:
        """Frame times in seconds."""
        if self.frame_times is not None:
            return self.frame_times.time
        return np.arange(self.manifest.frames) / self.manifest.fps

    def frame(self, index: int) -> Frame:
        """Decode the images of one frame."""
        found = self.pictures(index)
        return Frame(index, float(self.times[index]), self._blackened(found),
                     tuple(image is not None for image in found))  # fmt: skip

    def images(self, index: int) -> tuple[UInt8[Array, "H W 3"], ...]:
        """RGB images of all views at a frame; black where a view has none."""
        return self._blackened(self.pictures(index))

    def pictures(self, index: int) -> tuple[UInt8[Array, "H W 3"] | None, ...]:
        """RGB images of all views at a frame; None where a view has none."""
        return tuple(self.picture(index, v) for v in range(len(self.manifest.views)))

    def mask(self, index: int, view: str) -> UInt8[Array, "H W"] | None:
        """Part labels (`core.part_labels`) of one view; None where they were not recorded."""
        return self._plane(index, view, "mask", np.dtype(np.uint8))

    def depth(self, index: int, view: str) -> UInt16[Array, "H W"] | None:
        """Distance along the ray in millimetres (0: nothing hit); None where not recorded."""
        return self._plane(index, view, "depth", np.dtype(np.uint16))

    def annotation(self, index: int) -> dict[str, Any]:
        """Content of the frame's KEY.json. Raises FileError unless it is an object."""
        return parsed(self.read(index, "json"), self.shard_path(index), key=f"{index:06d}.json")

    def labels(
        self, index: int, annotation: dict[str, Any] | None = None
    ) -> tuple[Float[Array, "V 18 2"], UInt8[Array, "V 18"]]:
        """Pixels and visibility codes of a frame's joints. Raises FileError if damaged.

        `annotation` is the frame's, where it has been read.
        """
        annotation = self.annotation(index) if annotation is None else annotation
        views = self.manifest.views
        try:
            pixels, seen = (
                [annotation[key][view] for view in views] for key in ("joints_2d", "visibility")
            )
            shape = len(views), len(LABELS)
            points = np.array(pixels, float).reshape(*shape, 2)
            return points, np.array(seen, np.uint8).reshape(shape)
        except (LookupError, TypeError, ValueError, OverflowError) as error:
            raise FileError(
                self.shard_path(index), f"frame {index}: annotation damaged: {error}"
            ) from None

    def read(self, index: int, suffix: str) -> bytes:
        """Raw bytes of one file of one frame, e.g. suffix 'left.jpg'."""
        try:
            offset, size = self.files(index)[suffix]
        except KeyError:
            raise InputError(
                f"frame {index} of {self.folder} has no '{suffix}'",
                valid=sorted(self.files(index)),
            ) from None
        path = self.shard_path(index)
        try:
            with path.open("rb") as file:
                file.seek(offset)
                data = file.read(size)
        except OSError as error:
            raise FileError(path, f"shard cannot be read: {error.strerror}") from None
        if len(data) != size:
            raise FileError(path, f"shard is truncated: frame {index} ends beyond its end")
        return data

    def _rig(self, name: str) -> Rig:
        path = self.folder / name
        rig = load_rig(path)
        if rig.views != self.manifest.views:
            raise FileError(path, f"has the views {rig.views}", valid=str(self.manifest.views))
        return rig

    def files(self, index: int) -> dict[str, tuple[int, int]]:
        """Recorded files of a frame: suffix -> offset and size in its shard."""
        self._check_frame(index)
        if not self.manifest.shards_hold_images:
            return {}
        shard, row = divmod(index, self.manifest.shard_frames)
        return self.manifest.shards[shard].frames[row]

    def picture(self, index: int, view: int, reduction: int = 1) -> UInt8[Array, "h w 3"] | None:
        """RGB image of one view at a frame; None where there is none.

        A JPEG in a shard is decoded at 1/`reduction` (1, 2, 4 or 8) of its size. Raises FileError
        for a damaged image, and one of another size than the camera's.
        """
        image = self._picture(index, view, reduction)
        if image is None or self.footage is None:
            return image
        return self.footage.views[view].colour.applied(image)

    def _picture(self, index: int, view: int, reduction: int) -> Any:
        import cv2

        if self._referred is not None:
            self._check_frame(index)
            return self._referred.image(index, view)
        suffix = self.image_suffix(index, view)
        if suffix is None:
            return None
        factor = reduction if suffix.endswith("jpg") else 1
        # With IMREAD_COLOR_RGB these flags select the factor only, not greyscale.
        flags = {1: 0, 2: cv2.IMREAD_REDUCED_GRAYSCALE_2, 4: cv2.IMREAD_REDUCED_GRAYSCALE_4,
                 8: cv2.IMREAD_REDUCED_GRAYSCALE_8}[factor]  # fmt: skip
        return self._decoded(index, view, suffix, flags | cv2.IMREAD_COLOR_RGB, factor)

    @cached_property
    def _referred(self) -> FootageImages | None:
        """Pictures that are not in shards."""
        if self.manifest.shards_hold_images:
            return None
        assert self.footage is not None and self.frame_times is not None
        return FootageImages(self.footage, self.frame_times)

    def _blackened(
        self, found: tuple[UInt8[Array, "H W 3"] | None, ...]
    ) -> tuple[UInt8[Array, "H W 3"], ...]:
        return tuple(
            np.zeros((camera.height, camera.width, 3), np.uint8) if image is None else image
            for image, camera in zip(found, self.rig.cameras, strict=True)
        )

    def image_suffix(self, index: int, view: int) -> str | None:
        """Suffix of a view's image for `read`, as 'left.jpg'; None where the view has none."""
        if self.frame_times is not None and not self.frame_times.present[index, view]:
            return None
        suffixes, name = self.files(index), self.manifest.views[view]
        return next((s for s in (f"{name}.jpg", f"{name}.png") if s in suffixes), None)

    def shard_path(self, index: int) -> Path:
        """The shard of a frame."""
        return self.folder / self.manifest.shards[index // self.manifest.shard_frames].name

    def _check_frame(self, index: int) -> None:
        if not 0 <= index < self.manifest.frames:
            raise InputError(
                f"no frame {index} in {self.folder}", valid=f"0 to {self.manifest.frames - 1}"
            )

    def _plane(self, index: int, view: str, kind: str, dtype: np.dtype[Any]) -> Any:
        import cv2

        suffix = f"{view}.{kind}.png"
        if suffix not in self.files(index):
            return None
        v = self.manifest.views.index(view)
        plane = self._decoded(index, v, suffix, cv2.IMREAD_UNCHANGED)
        if plane.ndim != 2 or plane.dtype != dtype:
            found = f"frame {index}: '{suffix}' is {plane.dtype} of shape {plane.shape}"
            raise FileError(self.shard_path(index), found, valid=f"{dtype}, one value a pixel")
        return plane

    def _decoded(self, index: int, view: int, suffix: str, flags: int, factor: int = 1) -> Any:
        path, camera = self.shard_path(index), self.rig.cameras[view]
        image = decode(self.read(index, suffix), flags, path)
        if image is None:
            raise FileError(path, f"frame {index}: '{suffix}' is damaged")
        width, height = (-(-side // factor) for side in (camera.width, camera.height))
        if image.shape[:2] != (height, width):
            found = f"frame {index}: '{suffix}' has {image.shape[1]} x {image.shape[0]} pixels"
            raise FileError(path, found, valid=f"{width} x {height}, as its camera in the rig")
        return image


def open_sequence(folder: str | Path) -> Sequence:
    """Open a complete sequence folder."""
    return Sequence(folder)
