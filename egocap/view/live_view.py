"""What a live run looks like: handed to a browser's page, to a film, or both."""

from __future__ import annotations

from collections.abc import Sequence

from jaxtyping import UInt8
from numpy import ndarray as Array

from egocap.cameras.rig import Rig
from egocap.track.online import PoseEstimate
from egocap.view.live_page import PictureStream
from egocap.view.skeleton import side_by_side
from egocap.view.video import Film


class Watcher:
    """Called with every pose and the pictures that it was found in."""

    def __init__(
        self, rig: Rig, stream: PictureStream | None = None, film: Film | None = None
    ) -> None:
        self.rig, self.stream, self.film = rig, stream, film
        self._start: float | None = None

    def __call__(self, pose: PoseEstimate, images: Sequence[UInt8[Array, "H W 3"] | None]) -> None:
        """Draw the pose and hand the drawing on."""
        if self.stream is None and self.film is None:
            return
        picture = side_by_side(images, pose.joints_head, pose.confidence, self.rig)
        if self._start is None:
            self._start = pose.time
        if self.stream is not None:
            self.stream.show(picture)
        if self.film is not None:
            self.film.add(picture, pose.time - self._start)
