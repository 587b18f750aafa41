"""Pictures as they come, on a page that any browser of this machine can open.

A stream of JPEG pictures over HTTP (multipart/x-mixed-replace), so that it works without a display
where the program runs, and through a tunnel. Only this machine is answered, and only who knows the
random token in the address; pages of other sites are refused by Host and Origin.
"""

from __future__ import annotations

import re
import secrets
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

from jaxtyping import UInt8
from numpy import ndarray as Array

from egocap.errors import MachineError

HOST = "127.0.0.1"
MOST_VIEWERS = 8
"""Streams at a time."""
_SILENT_S = 30.0  # after which a client that neither sends nor takes anything is dropped
_LOOPBACK = re.compile(r"(127\.0\.0\.1|localhost|\[::1\])(:\d{1,5})?")
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

        self._viewers = threading.BoundedSemaphore(MOST_VIEWERS)
        token = secrets.token_urlsafe(16)

        class Handler(BaseHTTPRequestHandler):
            timeout = _SILENT_S

            def do_GET(self) -> None:
                if not _from_this_machine(self):
                    _answer(self, 403, b"refused")
                elif secrets.compare_digest(self.path.encode(), f"/{token}/stream".encode()):
                    stream._send(self)
                elif secrets.compare_digest(self.path.encode(), f"/{token}/".encode()):
                    _answer(self, 200, _PAGE)
                else:
                    _answer(self, 404, b"nothing here")

            def log_message(self, format: str, *args: object) -> None:
                """Say nothing of every request."""

        try:
            self._server = ThreadingHTTPServer((HOST, port), Handler)
        except OSError as error:
            raise MachineError(f"cannot serve pictures on port {port}: {error.strerror}",
                               remedy="choose another with --port") from None  # fmt: skip
        self._server.daemon_threads = True
        self.url = f"http://{HOST}:{self._server.server_port}/{token}/"
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
        if not self._viewers.acquire(blocking=False):
            _answer(handler, 503, f"{MOST_VIEWERS} pages are open already".encode())
            return
        try:
            self._send_pictures(handler)
        except (OSError, TimeoutError):
            return  # the page was closed, or takes nothing
        finally:
            self._viewers.release()

    def _send_pictures(self, handler: BaseHTTPRequestHandler) -> None:
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
            handler.wfile.write(head.encode() + jpeg + b"\r\n")


def _from_this_machine(handler: BaseHTTPRequestHandler) -> bool:
    """Whether the address in the browser is the loopback's, and no other site's page asks."""
    origin = handler.headers.get("Origin")
    places = [handler.headers.get("Host", "")]
    if origin is not None:
        places.append(origin.removeprefix("http://"))
    return all(_LOOPBACK.fullmatch(place) for place in places)


def _answer(handler: BaseHTTPRequestHandler, code: int, content: bytes) -> None:
    handler.send_response(code)
    for name, value in (
        ("Content-Type", "text/html"), ("Content-Length", str(len(content))),
        ("Cache-Control", "no-store"), ("Referrer-Policy", "no-referrer"),
        ("X-Content-Type-Options", "nosniff"), ("X-Frame-Options", "DENY"),
    ):  # fmt: skip
        handler.send_header(name, value)
    handler.end_headers()
    handler.wfile.write(content)
