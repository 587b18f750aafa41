"""A live run in the Rerun viewer: poses in space and over their pictures, with a time line.

The viewer is another process of this machine, a window or a server for a browser; it is sent every
pose with its pictures as they come, and drops the oldest when its memory is full.

Source: https://rerun.io/docs (recordings, gRPC).
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from typing import Any, Literal
from urllib.parse import quote

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from egocap.cameras.rig import Rig
from egocap.data.head_pose import HeadPoses, in_world
from egocap.data.track import Track
from egocap.errors import MachineError, require
from egocap.track.online import PoseEstimate
from egocap.view.scene import Scene, Shown
from egocap.view.viewer import CURVES, layout

Where = Literal["window", "browser"]
HOST = "127.0.0.1"
MEMORY = "1GB"
"""Of pictures and poses that the viewer keeps."""
_REMEDY = "--viewer browser needs no display; --view is a page without this viewer"
_PATIENCE_S = 30.0
"""For the viewer to start."""


class LiveScene:
    """Poses and pictures of a live run in a Rerun recording, in the world or in the head frame.

    In the world, a pose without a head pose is drawn at the last one, and on the floor before any.
    """

    def __init__(self, rr: Any, recording: Any, rig: Rig, *, world: bool = False) -> None:
        shown = Shown(rig=rig, placed=world)
        self._last: Float[Array, "4 4"] | None = None
        self._out, self._scene = recording, Scene(rr, recording, shown)
        curves = {name: title for name, title in CURVES.items() if name != "error"}
        recording.send_blueprint(layout(rr, shown, rig.views, curves))
        self._scene.start(rig)

    def show(
        self, pose: PoseEstimate, images: Sequence[UInt8[Array, "H W 3"] | None], time: float
    ) -> None:
        """Add a pose and its pictures at a time in seconds."""
        frame = Track(
            times=np.array([time]), angles=pose.angles[None], joints_head=pose.joints_head[None],
            energy=np.zeros(1), converged=np.array([pose.converged]), detections_used=np.zeros(1),
            seconds_per_frame=0.0, config={}, covariance=pose.covariance[None],
            confidence=pose.confidence[None],
        )  # fmt: skip
        if self._scene.shown.placed:
            frame = in_world(frame, HeadPoses(self._place(pose)[None], np.ones(1, bool)))
        self._scene.show("live", frame, images)

    def _place(self, pose: PoseEstimate) -> Float[Array, "4 4"]:
        """T_world_head under which a pose is drawn."""
        if pose.T_world_head is not None:
            self._last = pose.T_world_head
        if self._last is not None:
            return self._last
        T = np.eye(4)
        T[2, 3] = -pose.joints_head[:, 2].min()
        return T

    def close(self) -> None:
        """Send what is left."""
        self._out.flush()


class LiveViewer(LiveScene):
    """A running viewer that shows a live run; `url` is the page of a viewer for a browser.

    Raises MachineError without the extra `view`, and when the viewer does not start.
    """

    def __init__(self, rig: Rig, where: Where, *, world: bool = False) -> None:
        require("rerun", "view")
        import rerun as rr

        if where == "window" and not _has_display():
            raise MachineError("no display for a window", remedy=_REMEDY)
        port, page = _free_ports()
        address = f"rerun+http://{HOST}:{port}/proxy"
        self.url = f"http://{HOST}:{page}/?url={quote(address)}" if where == "browser" else None
        self._process = subprocess.Popen(
            _command(port, page, where), start_new_session=True, stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        _wait(self._process, port)
        recording = rr.RecordingStream("egocap live")
        recording.connect_grpc(address)
        super().__init__(rr, recording, rig, world=world)

    def show(
        self, pose: PoseEstimate, images: Sequence[UInt8[Array, "H W 3"] | None], time: float
    ) -> None:
        """Add a pose and its pictures, unless the viewer was closed."""
        if self._process.poll() is None:
            super().show(pose, images, time)

    def close(self) -> None:
        """Send what is left. A window stays open; a server ends, its pages keep what they have."""
        if self._process.poll() is None:
            with suppress(RuntimeError):  # it was closed this moment
                super().close()
                self._out.disconnect()
            if self.url is not None:
                _end(self._process)


def _has_display() -> bool:
    shown = any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))
    return shown or not sys.platform.startswith("linux")


def _end(process: subprocess.Popen[bytes]) -> None:
    """End the viewer, which its start-up script runs as a process of its own."""
    os.killpg(process.pid, signal.SIGTERM)
    process.wait()
    end = time.monotonic() + _PATIENCE_S
    with suppress(ProcessLookupError):  # the last process of the group has ended
        while time.monotonic() < end:
            os.killpg(process.pid, 0)
            time.sleep(0.02)


def _command(port: int, page: int, where: Where) -> list[str]:
    """The viewer's command line. Without --bind it accepts data from other machines."""
    command = [sys.executable, "-m", "rerun", "--bind", HOST, "--port", str(port),
               "--memory-limit", MEMORY]  # fmt: skip
    if where == "window":
        return [*command, "--expect-data-soon"]
    return [*command, "--server-memory-limit", MEMORY, "--serve-web", "--web-viewer-port",
            str(page)]  # fmt: skip


def _free_ports() -> tuple[int, int]:
    """Two free ports of this machine."""
    with socket.socket() as first, socket.socket() as second:
        for one in (first, second):
            one.bind((HOST, 0))
        return first.getsockname()[1], second.getsockname()[1]


def _wait(process: subprocess.Popen[bytes], port: int) -> None:
    """Return when the viewer listens. Raises MachineError if it ended or takes too long."""
    end = time.monotonic() + _PATIENCE_S
    while time.monotonic() < end:
        if process.poll() is not None:
            raise MachineError("the viewer did not open", remedy=_REMEDY)
        with socket.socket() as tried:
            tried.settimeout(0.2)
            if tried.connect_ex((HOST, port)) == 0:
                return
        time.sleep(0.05)
    _end(process)
    raise MachineError("the viewer did not answer", remedy=_REMEDY)
