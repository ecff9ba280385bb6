# SPDX-License-Identifier: Apache-2.0
"""Connections to the router."""

from __future__ import annotations

import socket

from embedded_ros.network import drop_connection


def test_only_connections_to_the_port_are_cut() -> None:
    with socket.create_server(("localhost", 0)) as router, socket.create_server(("localhost", 0)) as other:
        port = router.getsockname()[1]
        to_router, at_router = socket.create_connection(("localhost", port)), router.accept()[0]
        to_other, at_other = socket.create_connection(other.getsockname()[:2]), other.accept()[0]
        with to_router, at_router, to_other, at_other:
            drop_connection(port)
            assert at_router.recv(1) == b""
            assert to_router.recv(1) == b""
            to_other.sendall(b"x")
            assert at_other.recv(1) == b"x"
