"""Limits of connections: clients that send much, read nothing or never ask do not fill a server."""

from __future__ import annotations

from typing import Any

from websockets.asyncio.server import ServerConnection

MAX_WAITING = 128
"""Connections without a role, such as those of files; a new one takes the place of the oldest."""
MAX_UNREAD = 8 * 2**20
"""Bytes that wait for a client: answers to pings have no other limit."""


def limited(waiting: dict[ServerConnection, None]) -> type[ServerConnection]:
    """Connections that enter themselves into `waiting`; a role takes a connection out."""

    class Limited(ServerConnection):
        def connection_made(self, transport: Any) -> None:
            super().connection_made(transport)
            waiting[self] = None
            if len(waiting) > MAX_WAITING:
                oldest = next(iter(waiting))
                del waiting[oldest]
                oldest.transport.abort()

        def connection_lost(self, exc: Exception | None) -> None:
            waiting.pop(self, None)
            super().connection_lost(exc)

        def data_received(self, data: bytes) -> None:
            super().data_received(data)
            if self.transport.get_write_buffer_size() > MAX_UNREAD:
                self.transport.abort()

    return Limited
