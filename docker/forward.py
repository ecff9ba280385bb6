# SPDX-License-Identifier: Apache-2.0
"""Carries bytes between a port and a Unix socket: so the page of a cell that sees no network is reached.

python3 forward.py unix:out/page.sock tcp:127.0.0.1:8480     in the cell's container, which has the loopback only
python3 forward.py tcp:0.0.0.0:8480 unix:out/page.sock       in the container whose port compose.yaml publishes
"""

from __future__ import annotations

import asyncio
import contextlib
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path

CHUNK = 64 * 1024
Handler = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]


async def carry(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Carry bytes one way until their end."""
    with contextlib.suppress(OSError):
        while data := await reader.read(CHUNK):
            writer.write(data)
            await writer.drain()
    with contextlib.suppress(OSError):
        writer.close()


async def connect(place: str) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    """Open a connection to `unix:PATH` or `tcp:HOST:PORT`."""
    kind, _, rest = place.partition(":")
    if kind == "unix":
        return await asyncio.open_unix_connection(rest)
    host, _, port = rest.rpartition(":")
    return await asyncio.open_connection(host, int(port))


async def listen(place: str, handler: Handler) -> asyncio.Server:
    """Listen at `unix:PATH`, for this user alone, or `tcp:HOST:PORT`."""
    kind, _, rest = place.partition(":")
    if kind == "unix":
        file = Path(rest)
        file.unlink(missing_ok=True)  # of a container before
        server = await asyncio.start_unix_server(handler, file)
        file.chmod(0o600)
        return server
    host, _, port = rest.rpartition(":")
    return await asyncio.start_server(handler, host, int(port))


async def forward(here: str, there: str) -> None:
    """Forward for ever; a connection that the other side does not take is closed."""

    async def handle(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            far_reader, far_writer = await connect(there)
        except OSError:  # the page is not up yet: the browser tries again
            writer.close()
            return
        await asyncio.gather(carry(reader, far_writer), carry(far_reader, writer))

    async with await listen(here, handle) as server:
        await server.serve_forever()


if __name__ == "__main__":
    asyncio.run(forward(sys.argv[1], sys.argv[2]))
