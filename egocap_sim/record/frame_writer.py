"""Render a frame and encode its files: images, part labels, depth and the annotation."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from egocap.geometry import rigid
from egocap_sim.core.bodies import INDEX
from egocap_sim.core.pose_sampling import between_frames
from egocap_sim.render.renderer import FisheyeRenderer
from egocap_sim.render.views import Views
from egocap_sim.sensor.capture import CapturedFrame, JointTest, SensorSimulator
from egocap_sim.truth.visibility import JointVisibility
from egocap_sim.world.world import World

_PNG = [cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE]
EARLIEST = 2  # frames by which props and bystanders are extrapolated before the first
_FLAT = [*_PNG, cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_NONE]  # labels, three times as fast


@dataclass(frozen=True, eq=False)
class _Instant:
    """A frame of perfect cameras, as `CapturedFrame`; its images are made when asked for."""

    views: Views
    parts: tuple[UInt8[Array, "H W"], ...]
    depth: tuple[Float[Array, "H W"], ...]
    visibility: UInt8[Array, "V 18"]

    @property
    def images(self) -> tuple[UInt8[Array, "H W 3"], ...]:
        return self.views.images


class FrameWriter:
    """Renders the frames of a world. Holds a GL context: use one in a process, in one thread."""

    def __init__(self, world: World) -> None:
        record, plan = world.scene.record, world.take.sensor_plan
        self.rig, self.person, self.record = world.rig, world.person, record
        self.truth, self._sensor_plan, self.actors = world.take.truth, plan, world.actors
        self.renderer = FisheyeRenderer(
            self.rig,
            [self.person.actor, *(actor.actor for actor in self.actors)],
            world.place,
            samples=record.samples,
            face_size=record.face_size,
            coarse=plan.sensor.subframe_sharpness if plan else 1.0,
        )
        self._visibility = JointVisibility(self.person, self.rig)
        last = max((len(actor.skinning) for actor in self.actors), default=0)
        self._numbers = np.arange(-EARLIEST, last)
        self._times = self._numbers / world.scene.fps
        self._T_body_rest = rigid(np.eye(3), -self.person.joints)
        self._sensor = None
        if plan is not None:
            planes = {"parts": record.masks, "depth": record.depth}
            self._sensor = SensorSimulator(self.rig, plan, self._draw, **planes)

    def close(self) -> None:
        """Release the GL context."""
        self.renderer.close()

    def files(self, frames: Iterable[int]) -> Iterator[dict[str, bytes]]:
        """Content of every file of each frame, by suffix; encoded while the next is drawn.

        Perfect cameras' images are also resampled meanwhile.
        """
        with ThreadPoolExecutor(1) as pool:
            encoding: Future[dict[str, bytes]] | None = None
            for index in frames:
                frame = self._sensor.capture(index) if self._sensor else self._instant(index)
                if encoding is not None:
                    yield encoding.result()
                encoding = pool.submit(self._encoded, index, frame)
            if encoding is not None:
                yield encoding.result()

    def _encoded(self, index: int, frame: CapturedFrame | _Instant) -> dict[str, bytes]:
        files: dict[str, bytes] = {}
        for view, image in zip(self.rig.views, frame.images, strict=True):
            files[f"{view}.{self.record.image_format}"] = self._encode(image)
        if self.record.masks:
            for view, parts in zip(self.rig.views, frame.parts, strict=True):
                files[f"{view}.mask.png"] = _png(parts, _FLAT)
        if self.record.depth:
            for view, depth in zip(self.rig.views, frame.depth, strict=True):
                files[f"{view}.depth.png"] = _png(_millimetres(depth))
        files["json"] = self._annotation(index, frame.visibility)
        return files

    def _instant(self, index: int) -> _Instant:
        """Capture the frame with perfect cameras."""
        views, find_visible = self._draw(index, self.truth.time[index])
        parts = views.parts() if self.record.masks else ()
        depth = views.depth() if self.record.depth else ()
        return _Instant(views, parts, depth, find_visible(range(len(self.rig.views))))

    def _draw(
        self,
        index: int,
        time: float,
        rows: Mapping[int, slice] | None = None,
        still_m: float = 0.0,
        coarsely: bool = False,
    ) -> tuple[Views, JointTest]:
        """Render the world at a time in seconds during a frame: all, or rows of some views."""
        truth, poses = self.truth, self._sensor_plan.poses if self._sensor_plan else None
        T_world_body = truth.T_world_body[index] if poses is None else poses.at(time)
        skinning = {self.person.actor.name: T_world_body @ self._T_body_rest}
        for actor in self.actors:
            moved = actor.skinning[index]
            if poses is not None:
                moved = between_frames(actor.skinning, np.interp(time, self._times, self._numbers))
            skinning[actor.actor.name] = moved
        views = self.renderer.render(T_world_body[INDEX["head"]], skinning, rows, still_m, coarsely)

        def find_visible(wanted: Collection[int]) -> UInt8[Array, "V 18"]:
            return self._visibility(views, T_world_body, truth.in_view[index], wanted)

        return views, find_visible

    def _encode(self, image: UInt8[Array, "H W 3"]) -> bytes:
        if self.record.image_format == "png":
            return _png(image[..., ::-1])
        import simplejpeg

        return simplejpeg.encode_jpeg(
            np.ascontiguousarray(image),
            quality=self.record.jpeg_quality,
            colorspace="RGB",
            colorsubsampling="444",
        )

    def _annotation(self, index: int, visibility: UInt8[Array, "V 18"]) -> bytes:
        truth = self.truth
        content = {
            "frame": index,
            "time": truth.time[index],
            "T_world_head": truth.T_world_head[index].tolist(),
            "joints_head": truth.joints_head[index].tolist(),
            "joints_2d": dict(zip(self.rig.views, truth.joints_2d[index].tolist(), strict=True)),
            "visibility": dict(zip(self.rig.views, visibility.tolist(), strict=True)),
            "contact": truth.contact[index].tolist(),
        }
        people = [e.joints[index] for e in self.actors if e.joints is not None]
        if people:
            content["others"] = np.round(people, 5).tolist()  # joints in the world
        return json.dumps(content, separators=(",", ":")).encode()


def _png(image: Array, how: Sequence[int] = _PNG) -> bytes:
    done, data = cv2.imencode(".png", image, how)
    assert done, f"PNG encoding of {image.shape} {image.dtype} failed"
    return data.tobytes()


def _millimetres(depth: Float[Array, "H W"]) -> Array:
    """16-bit millimetres; 0 for background."""
    finite = np.where(np.isfinite(depth), depth * 1000.0, 0.0)
    return np.clip(np.rint(finite), 0, 65535).astype(np.uint16)
