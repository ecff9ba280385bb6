# SPDX-License-Identifier: Apache-2.0
"""Listens: a socket, a thread, an event loop."""

from __future__ import annotations

import socket
import threading
from pathlib import Path
from typing import Final

import uvicorn

from softgrip_panel.errors import PanelError
from softgrip_panel.texts import say

#: Without a port of its own the panel takes the first free one of these.
FIRST_PORT: Final = 8480
PORTS: Final = range(FIRST_PORT, FIRST_PORT + 100)


def listen(host: str, port: int) -> socket.socket:
    """Return a bound socket.

    Args:
        host: name or address.
        port: 0 = the first free one of `PORTS`.

    Raises:
        PanelError: it is taken, or the host is none of this machine's.
    """
    problem: OSError | None = None
    for one in [port] if port else PORTS:
        try:
            return _bound(host, one)
        except OSError as error:
            problem = error
    found = f"port {port}" if port else f"ports {PORTS.start} .. {PORTS.stop - 1}"
    raise PanelError(say("error.listen", host=host, ports=found, error=problem)) from problem


def _bound(host: str, port: int) -> socket.socket:
    family, kind, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    found = socket.socket(family, kind)
    try:
        found.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        found.bind(address)
        found.listen(128)
    except OSError:
        found.close()
        raise
    return found


class WebServer:
    """Serves an ASGI application from a thread of its own.

    Args:
        app: the application.
        bound: socket to serve.
        certificate: PEM files of certificate and key, None = without TLS.
    """

    def __init__(self, app: object, bound: socket.socket, certificate: tuple[Path, Path] | None = None) -> None:
        self._bound = bound
        tls: dict[str, object] = {}
        if certificate is not None:
            tls = {"ssl_certfile": str(certificate[0]), "ssl_keyfile": str(certificate[1])}
        config = uvicorn.Config(
            app,
            log_level="warning",
            access_log=False,
            server_header=False,
            timeout_graceful_shutdown=1,
            ws_max_size=256 * 1024,
            # what is large are JPEG pictures: to compress them takes more than all else that the panel does
            ws_per_message_deflate=False,
            h11_max_incomplete_event_size=32 * 1024,
            lifespan="on",
            **tls,
        )
        self._server = uvicorn.Server(config)
        self._thread = threading.Thread(target=self._run, name="web", daemon=True)

    def start(self) -> None:
        """Begin to serve."""
        self._thread.start()

    def close(self) -> None:
        """Stop serving; open pages are closed."""
        self._server.should_exit = True
        self._thread.join(timeout=2.0)
        self._bound.close()

    def _run(self) -> None:
        self._server.run(sockets=[self._bound])
