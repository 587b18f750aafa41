"""Reading sequences: frames for trackers and, separately, truth for evaluations.

A folder of manifest.json, rig.json, scene.toml, body.json, truth.npz [rig.true.json sensor.npz
others.npz] and WebDataset shards (shard-00000.tar with KEY.left.jpg KEY.right.jpg
[KEY.left.mask.png KEY.left.depth.png] KEY.json).
The manifest holds the byte range of every file in every shard, for random access to frames.
`egocap.data.sequence_writer` writes such folders.
"""

from __future__ import annotations

import json
from base64 import b64encode
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from html import escape
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, Float, Int64, UInt8, UInt16
from numpy import ndarray as Array
from pydantic import Field

from egocap.body.proportions import Proportions
from egocap.cameras.rig import Rig
from egocap.cameras.rig_files import load_rig
from egocap.data.arrays import FrameArrays
from egocap.errors import FileError, InputError
from egocap.schema import Strict, checked, read_json, refuse_newer

SCHEMA = 1
MANIFEST = "manifest.json"
TRUE_RIG = "rig.true.json"  # where rig.json has a calibration error
SENSOR = "sensor.npz"
OTHERS = "others.npz"  # in scenes with other people

BLACK = -1  # `SensorTruth.source` of a dropped frame that is recorded black
VISIBLE, OUT_OF_VIEW, SELF_OCCLUDED, OCCLUDED = range(4)
"""Values of `Truth.visibility`; out of view: of the image or lens; OCCLUDED: by other things."""


class ShardEntry(Strict):
    """One shard: its checksum, and the byte range of every file of its frames."""

    name: str = Field(pattern=r"^shard-\d{5}\.tar$")
    first: int = Field(ge=0)  # index of its first frame
    bytes: int = Field(gt=0)
    sha256: str = Field(pattern=r"^[0-9a-f]{64}$")
    frames: list[dict[str, tuple[int, int]]]  # for each frame: suffix -> (offset, size)


class FileEntry(Strict):
    """Size and checksum of a side file."""

    bytes: int = Field(ge=0)
    sha256: str = Field(pattern=r"^[0-9a-f]{64}$")


class Manifest(Strict):
    """manifest.json. Units are metres, radians, seconds and pixels throughout."""

    kind: Literal["egocap-sequence"] = "egocap-sequence"
    schema_version: int = Field(ge=1)
    name: str
    units: dict[str, str] = {"length": "m", "angle": "rad", "time": "s", "image": "px"}
    fps: float = Field(gt=0)
    frames: int = Field(ge=1)
    shard_frames: int = Field(ge=1)
    views: tuple[str, ...]
    seed: int
    config: dict[str, Any]  # everything the content depends on, resolved
    config_sha256: str
    code_version: str
    files: dict[str, FileEntry] = {}
    shards: list[ShardEntry] = []

    @property
    def shard_count(self) -> int:
        """Number of shards of the complete sequence."""
        return -(-self.frames // self.shard_frames)

    @property
    def complete(self) -> bool:
        """Whether every shard and the truth are recorded."""
        return len(self.shards) == self.shard_count and "truth.npz" in self.files


@dataclass(frozen=True, eq=False)
class Frame:
    """Images of all cameras at one instant, without truth."""

    index: int
    time: float  # seconds
    images: tuple[UInt8[Array, "H W 3"], ...]  # RGB, one a view


@dataclass(frozen=True, eq=False)
class Truth(FrameArrays):
    """Exact state of the simulated person at every frame. Axis J follows `labels.LABELS`."""

    time: Float[Array, "T"]
    T_world_head: Float[Array, "T 4 4"]
    joints_world: Float[Array, "T 18 3"]
    joints_head: Float[Array, "T 18 3"]
    joints_camera: Float[Array, "T V 18 3"]
    joints_2d: Float[Array, "T V 18 2"]  # pixels; meaningful where `in_view`
    in_view: Bool[Array, "T V 18"]  # inside the lens's field of view and the image
    visibility: UInt8[Array, "T V 18"]  # VISIBLE, OUT_OF_VIEW, SELF_OCCLUDED, OCCLUDED
    T_world_body: Float[Array, "T 21 4 4"]  # `egocap_sim.core.bodies.BODIES`
    contact: Bool[Array, "T 4"]  # left foot, left toe, right foot, right toe on the ground
    ground_force: Float[Array, "T 2 3"]  # left, right; newtons, world, on the person
    root_wrench: Float[Array, "T 6"]  # residual force (N) and torque (N m) at the pelvis


@dataclass(frozen=True, eq=False)
class SensorTruth(FrameArrays):
    """Sensor effects on every frame; absent for an ideal sensor.

    `Truth` holds joints_camera, joints_2d, in_view and visibility at the instant at which the view
    exposed each joint, everything else at the frame's time. The truth of a dropped frame is that of
    the lost image.
    """

    time: Float[Array, "T V"]  # s, middle of the exposure of the view's middle row
    joint_time: Float[Array, "T V 18"]  # s, middle of the exposure of the joint's row
    exposure_ev: Float[
        Array, "T V"
    ]  # exposure relative to the rendered image, stops; includes flicker
    source: Int64[Array, "T V"]  # index of the frame whose image is recorded; BLACK: none
    subframes: Int64[Array, "T"]  # number of subframes averaged per image

    @property
    def dropped(self) -> Bool[Array, "T V"]:
        """Whether a frame was dropped and another image is recorded for it."""
        return self.source != np.arange(len(self.source))[:, None]


@dataclass(frozen=True, eq=False)
class OthersTruth(FrameArrays):
    """Joints of other people at every frame's time; axis O follows `[others]`, float32.

    Absent in sequences without other people.
    """

    joints_world: Float[Array, "T O 18 3"]
    joints_camera: Float[Array, "T V O 18 3"]


class Sequence:
    """A complete sequence folder, open for reading.

    Raises FileError if the folder is not a sequence, is incomplete, or has a newer schema.
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)
        self.manifest = load_manifest(self.folder)
        if not self.manifest.complete:
            done, all_ = len(self.manifest.shards), self.manifest.shard_count
            raise FileError(
                self.folder,
                f"unfinished: {done} of {all_} shards are recorded; "
                "run the same generate command again to complete it",
            )

    def __repr__(self) -> str:
        m = self.manifest
        truth = "" if "truth.npz" in m.files else ", no truth"
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

        Raises FileError if the manifest has other views.
        """
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
        """Body proportions of the wearer, available to trackers."""
        return Proportions.load(self.folder / "body.json")

    @cached_property
    def truth(self) -> Truth:
        """Simulated truth, for evaluations; not part of a Frame."""
        return Truth.load(self.folder / "truth.npz")

    @cached_property
    def others(self) -> OthersTruth | None:
        """Joints of other people, for evaluations; None without other people."""
        if OTHERS not in self.manifest.files:
            return None
        return OthersTruth.load(self.folder / OTHERS)

    @property
    def times(self) -> Float[Array, "T"]:
        """Frame times in seconds."""
        return np.arange(self.manifest.frames) / self.manifest.fps

    def frame(self, index: int) -> Frame:
        """Decode the images of one frame."""
        return Frame(index, index / self.manifest.fps, self.images(index))

    def images(self, index: int) -> tuple[UInt8[Array, "H W 3"], ...]:
        """RGB images of all views at a frame."""
        return tuple(self._image(index, view) for view in self.manifest.views)

    def mask(self, index: int, view: str) -> UInt8[Array, "H W"] | None:
        """Part labels (`core.part_labels`) of one view; None where they were not recorded."""
        return self._plane(index, f"{view}.mask.png")

    def depth(self, index: int, view: str) -> UInt16[Array, "H W"] | None:
        """Distance along the ray in millimetres (0: nothing hit); None where not recorded."""
        return self._plane(index, f"{view}.depth.png")

    def annotation(self, index: int) -> dict[str, Any]:
        """Content of the frame's KEY.json."""
        return json.loads(self.read(index, "json"))

    def read(self, index: int, suffix: str) -> bytes:
        """Raw bytes of one file of one frame, e.g. suffix 'left.jpg'."""
        entry = self.manifest.shards[index // self.manifest.shard_frames]
        try:
            offset, size = self.files(index)[suffix]
        except KeyError:
            raise InputError(
                f"frame {index} of {self.folder} has no '{suffix}'",
                valid=sorted(self.files(index)),
            ) from None
        path = self.folder / entry.name
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
        if not 0 <= index < self.manifest.frames:
            raise InputError(
                f"no frame {index} in {self.folder}", valid=f"0 to {self.manifest.frames - 1}"
            )
        shard, row = divmod(index, self.manifest.shard_frames)
        return self.manifest.shards[shard].frames[row]

    def _image(self, index: int, view: str) -> UInt8[Array, "H W 3"]:
        import cv2

        return self._decoded(index, self.image_suffix(index, view), cv2.IMREAD_COLOR_RGB)

    def image_suffix(self, index: int, view: str) -> str:
        """Suffix of the image of a view for `read`: 'left.jpg' or 'left.png'. Raises FileError."""
        suffixes = self.files(index)
        for suffix in (f"{view}.jpg", f"{view}.png"):
            if suffix in suffixes:
                return suffix
        path = self.folder / MANIFEST
        raise FileError(path, f"no image of view '{view}'", valid=sorted(suffixes))

    def _plane(self, index: int, suffix: str) -> Any:
        import cv2

        if suffix not in self.files(index):
            return None
        return self._decoded(index, suffix, cv2.IMREAD_UNCHANGED)

    def _decoded(self, index: int, suffix: str, flags: int) -> Any:
        import cv2

        data = np.frombuffer(self.read(index, suffix), np.uint8)
        image = cv2.imdecode(data, flags) if len(data) else None
        if image is None:
            shard = self.manifest.shards[index // self.manifest.shard_frames].name
            raise FileError(self.folder / shard, f"frame {index}: '{suffix}' is damaged")
        return image


def open_sequence(folder: str | Path) -> Sequence:
    """Open a complete sequence folder."""
    return Sequence(folder)


def load_manifest(folder: Path) -> Manifest:
    """Read manifest.json of a complete or unfinished sequence. Raises FileError."""
    path = folder / MANIFEST
    if not folder.is_dir():
        raise FileError(folder, "no such folder", valid="a sequence made by egocap-sim generate")
    if not path.exists():
        if (folder / "episodes.json").exists():
            raise FileError(folder, "holds a data set of several sequences",
                            valid=f"one of them, e.g. {folder}/episode-00000")  # fmt: skip
        raise FileError(folder, f"not a sequence: it has no {MANIFEST}")
    data = read_json(path)
    refuse_newer(data, SCHEMA, path)
    manifest = checked(Manifest, data, path)
    _check_index(manifest, path)
    return manifest


def _check_index(manifest: Manifest, path: Path) -> None:
    if len(manifest.shards) > manifest.shard_count:
        raise FileError(path, f"lists {len(manifest.shards)} shards for {manifest.frames} frames",
                        key="shards", valid=f"at most {manifest.shard_count}")  # fmt: skip
    last = -1
    for i, shard in enumerate(manifest.shards):
        index, rest = divmod(shard.first, manifest.shard_frames)
        expected = min(manifest.shard_frames, manifest.frames - shard.first)
        if rest or len(shard.frames) != expected or shard.name != shard_name(index):
            raise FileError(
                path, f"entry of {shard.name} does not fit the frame count", key=f"shards.{i}"
            )
        if index <= last:  # shards are indexed by position
            raise FileError(path, f"{shard.name} is repeated or out of order", key=f"shards.{i}")
        last = index


def shard_name(index: int) -> str:
    """File name of a shard."""
    return f"shard-{index:05d}.tar"
