"""Pictures as they come, on a page that any browser of this machine can open.

A stream of JPEG pictures over HTTP (multipart/x-mixed-replace), so that it works without a display
where the program runs, and through a tunnel. Only this machine is answered.
"""

from __future__ import annotations

import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

from jaxtyping import UInt8
from numpy import ndarray as Array

from egocap.errors import MachineError

HOST = "127.0.0.1"
_BOUNDARY = "picture"
_PAGE = b"""<!doctype html><title>egocap live</title>
<body style="margin:0;background:#111"><img src="stream" style="width:100%">"""


class PictureStream:
    """Serves the newest picture. `port` 0 takes any that is free; `url` says which.

    Raises MachineError when the port is taken.
    """

    def __init__(self, port: int = 8642) -> None:
        self._fresh = threading.Condition()
        self._jpeg, self._count, self._closed = b"", 0, False
        stream = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                if self.path == "/stream":
                    stream._send(self)
                    return
                self.send_response(200 if self.path == "/" else 404)
                self.send_header("Content-Type", "text/html")
                self.end_headers()
                self.wfile.write(_PAGE if self.path == "/" else b"nothing here")

            def log_message(self, format: str, *args: object) -> None:
                """Say nothing of every request."""

        try:
            self._server = ThreadingHTTPServer((HOST, port), Handler)
        except OSError as error:
            raise MachineError(f"cannot serve pictures on port {port}: {error.strerror}",
                               remedy="choose another with --port") from None  # fmt: skip
        self._server.daemon_threads = True
        self.url = f"http://{HOST}:{self._server.server_port}"
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)
        self._thread.start()

    def show(self, picture: UInt8[Array, "H W 3"]) -> None:
        """Show an RGB picture."""
        import cv2

        done, data = cv2.imencode(".jpg", picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 80])
        assert done, picture.shape
        with self._fresh:
            self._jpeg, self._count = data.tobytes(), self._count + 1
            self._fresh.notify_all()

    def close(self) -> None:
        """Stop serving."""
        with self._fresh:
            self._closed = True
            self._fresh.notify_all()
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()

    def _send(self, handler: BaseHTTPRequestHandler) -> None:
        handler.send_response(200)
        handler.send_header("Content-Type", f"multipart/x-mixed-replace; boundary={_BOUNDARY}")
        handler.end_headers()
        sent = 0
        while True:
            with self._fresh:
                self._fresh.wait_for(lambda: self._count > sent or self._closed)  # noqa: B023
                if self._closed:
                    return
                jpeg, sent = self._jpeg, self._count
            kind, size = "Content-Type: image/jpeg", f"Content-Length: {len(jpeg)}"
            head = "\r\n".join((f"--{_BOUNDARY}", kind, size, "", ""))
            try:
                handler.wfile.write(head.encode() + jpeg + b"\r\n")
            except (BrokenPipeError, ConnectionError):
                return  # the page was closed
