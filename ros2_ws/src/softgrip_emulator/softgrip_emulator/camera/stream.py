# SPDX-License-Identifier: Apache-2.0
"""Motion JPEG over HTTP (multipart/x-mixed-replace), one part a frame with its time of capture in `X-Timestamp`."""

from __future__ import annotations

import http.server
import logging
import threading
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from pathlib import Path

_log = logging.getLogger(__name__)

BOUNDARY: Final = "softgripframe"
_WAIT_S: Final = 0.5


@dataclass(frozen=True)
class StampedJpeg:
    """One compressed frame and its time of capture in seconds since the epoch."""

    data: bytes
    stamp_s: float
    number: int


class FrameBoard:
    """Where the camera pins its newest frame and clients wait for it."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._newest: StampedJpeg | None = None
        self._closed = False
        self.viewers = 0

    def pin(self, data: bytes, stamp_s: float) -> None:
        """Replace the newest frame."""
        with self._changed:
            number = 1 if self._newest is None else self._newest.number + 1
            self._newest = StampedJpeg(data, stamp_s, number)
            self._changed.notify_all()

    def after(self, number: int) -> StampedJpeg | None:
        """Wait for a frame newer than `number`; None when none came for a while."""
        with self._changed:
            self._changed.wait_for(lambda: self._closed or self._newer(number), _WAIT_S)
            return self._newest if self._newer(number) else None

    def _newer(self, number: int) -> bool:
        return self._newest is not None and self._newest.number > number

    def close(self) -> None:
        """Let every waiting client go."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    @property
    def closed(self) -> bool:
        """True after `close`."""
        return self._closed

    def count(self, change: int) -> None:
        """A viewer came (+1) or went (-1)."""
        with self._changed:
            self.viewers += change


class StreamServer:
    """Serves a `FrameBoard` on the loopback interface.

    Args:
        board: where the frames come from.
        port: TCP port, 0 for a free one.

    Raises:
        OSError: the port is taken.
    """

    def __init__(self, board: FrameBoard, port: int = 0) -> None:
        self._board = board
        handler = type("_BoundHandler", (_Handler,), {"board": board})
        self._server = http.server.ThreadingHTTPServer(("127.0.0.1", port), handler)
        self._server.daemon_threads = True
        self._thread = threading.Thread(
            target=self._server.serve_forever, kwargs={"poll_interval": 0.1}, name="camera-http", daemon=True
        )

    @property
    def url(self) -> str:
        """Address of the stream."""
        return f"http://127.0.0.1:{self._server.server_address[1]}/stream.mjpg"

    def start(self, url_file: Path | None = None) -> None:
        """Serve; `url_file` gets the address, written in one step."""
        self._thread.start()
        if url_file is not None:
            url_file.parent.mkdir(parents=True, exist_ok=True)
            scratch = url_file.with_name(f".{url_file.name}.part")
            scratch.write_text(self.url + "\n", encoding="utf-8")
            scratch.replace(url_file)

    def close(self) -> None:
        """Stop serving and let clients go."""
        self._board.close()
        if self._thread.is_alive():
            self._server.shutdown()
            self._thread.join(2.0)
        self._server.server_close()


class _Handler(http.server.BaseHTTPRequestHandler):
    board: FrameBoard

    def do_GET(self) -> None:
        if self.path not in {"/", "/stream.mjpg"}:
            self.send_error(404, "expected /stream.mjpg")
            return
        self.send_response(200)
        self.send_header("Content-Type", f"multipart/x-mixed-replace; boundary={BOUNDARY}")
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        self.board.count(+1)
        try:
            self._send_frames()
        except OSError:
            # The client went away; that is how such a stream ends.
            self.close_connection = True
        finally:
            self.board.count(-1)

    def _send_frames(self) -> None:
        number = 0
        while not self.board.closed:
            frame = self.board.after(number)
            if frame is None:
                continue
            number = frame.number
            head = (
                f"--{BOUNDARY}\r\nContent-Type: image/jpeg\r\nContent-Length: {len(frame.data)}\r\n"
                f"X-Timestamp: {frame.stamp_s:.9f}\r\n\r\n"
            )
            self.wfile.write(head.encode() + frame.data + b"\r\n")

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002  the base class' name
        _log.debug(format, *args)
