"""The display of a live run: on a web page, in a video, or both."""

from __future__ import annotations

from collections.abc import Sequence

from jaxtyping import UInt8
from numpy import ndarray as Array

from egocap.cameras.rig import Rig
from egocap.track.online import PoseEstimate
from egocap.view.live_page import PictureStream
from egocap.view.skeleton import side_by_side
from egocap.view.video import VideoFile


class PoseDisplay:
    """Draws every pose over its pictures, for a web page and a video file."""

    def __init__(
        self, rig: Rig, stream: PictureStream | None = None, video: VideoFile | None = None
    ) -> None:
        self.rig, self.stream, self.video = rig, stream, video
        self._start: float | None = None

    def __call__(self, pose: PoseEstimate, images: Sequence[UInt8[Array, "H W 3"] | None]) -> None:
        """Draw one pose."""
        if self.stream is None and self.video is None:
            return
        picture = side_by_side(images, pose.joints_head, pose.confidence, self.rig)
        if self._start is None:
            self._start = pose.time
        if self.stream is not None:
            self.stream.show(picture)
        if self.video is not None:
            self.video.add(picture, pose.time - self._start)
