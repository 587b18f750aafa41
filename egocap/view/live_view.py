"""The display of a live run: on a web page, in a video, in the Rerun viewer, or several."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from jaxtyping import UInt8
from numpy import ndarray as Array

from egocap.cameras.rig import Rig
from egocap.track.online import PoseEstimate
from egocap.view.live_page import PictureStream
from egocap.view.skeleton import side_by_side
from egocap.view.video import VideoFile

if TYPE_CHECKING:
    from egocap.view.live_scene import LiveScene


class PoseDisplay:
    """Draws every pose over its pictures, for a web page and a video file, and in a scene."""

    def __init__(
        self, rig: Rig, stream: PictureStream | None = None, video: VideoFile | None = None,
        scene: LiveScene | None = None,
    ) -> None:  # fmt: skip
        self.rig, self.stream, self.video, self.scene = rig, stream, video, scene
        self._start: float | None = None

    def __call__(self, pose: PoseEstimate, images: Sequence[UInt8[Array, "H W 3"] | None]) -> None:
        """Draw one pose."""
        if self._start is None:
            self._start = pose.time
        if self.scene is not None:
            self.scene.show(pose, images, pose.time - self._start)
        if self.stream is None and self.video is None:
            return
        picture = side_by_side(images, pose.joints_head, pose.confidence, self.rig)
        if self.stream is not None:
            self.stream.show(picture)
        if self.video is not None:
            self.video.add(picture, pose.time - self._start)
