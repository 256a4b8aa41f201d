"""The gate of the Foxglove server: it passes connections whose path is a secret.

Foxglove's protocol has no token, its SDK checks no origin, and any web page in a browser of this
computer may open a WebSocket to it. So the SDK listens where no page finds it, and the gate passes
on the connections that name the secret in the path of their address.
"""

from __future__ import annotations

import asyncio
import hmac
import secrets
import sys
import threading
from contextlib import suppress

from swarmd.core.errors import NetworkError

MAX_HEAD = 16 * 1024  # bytes of an HTTP request
HEAD_TIMEOUT = 5.0  # s
MAX_CLIENTS = 64
_END = b"\r\n\r\n"
_CHUNK = 64 * 1024


def hidden_host() -> str:
    """A random address of loopback, 1 of 16 million; 127.0.0.1 where the system has no other."""
    if not sys.platform.startswith("linux"):
        return "127.0.0.1"
    return f"127.{1 + secrets.randbelow(254)}.{secrets.randbelow(256)}.{1 + secrets.randbelow(254)}"


class FoxgloveGate:
    """Listens at `host`, and connects who asks for the path `/SECRET` with the server behind."""

    def __init__(self, host: str, port: int, behind: tuple[str, int]) -> None:
        """Listen, on any free port for 0. NetworkError if the address cannot be had."""
        self.secret = secrets.token_urlsafe(16)
        self._behind = behind
        self._loop = asyncio.new_event_loop()
        self._clients: set[asyncio.Task[None]] = set()
        try:
            opening = asyncio.start_server(self._accept, host, port, limit=MAX_HEAD)
            self._server = self._loop.run_until_complete(opening)
        except OSError as error:
            self._loop.close()
            raise NetworkError(
                f"{host}:{port} cannot be listened at: {error.strerror}; choose another port"
            ) from error
        self.port: int = self._server.sockets[0].getsockname()[1]
        self._thread = threading.Thread(target=self._run, name="foxglove-gate", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End all connections."""
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()

    def _run(self) -> None:
        self._loop.run_forever()
        self._loop.run_until_complete(self._end())
        self._loop.close()

    async def _end(self) -> None:
        self._server.close()
        clients = tuple(self._clients)
        for client in clients:
            client.cancel()
        await asyncio.gather(*clients, return_exceptions=True)

    async def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._clients.add(task)
        try:
            await self._pass(reader, writer, is_full=len(self._clients) > MAX_CLIENTS)
        except (OSError, TimeoutError, EOFError, asyncio.LimitOverrunError):
            return
        finally:
            self._clients.discard(task)
            writer.close()

    async def _pass(
        self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, *, is_full: bool
    ) -> None:
        head = await asyncio.wait_for(reader.readuntil(_END), HEAD_TIMEOUT)
        method, _, rest = head.partition(b" ")
        path, _, rest = rest.partition(b" ")
        given = path.partition(b"?")[0].strip(b"/")
        if is_full or not hmac.compare_digest(given, self.secret.encode()):
            status = b"503 Service Unavailable" if is_full else b"403 Forbidden"
            writer.write(
                b"HTTP/1.1 " + status + b"\r\nContent-Length: 0\r\nConnection: close" + _END
            )
            await writer.drain()
            return
        inner_reader, inner_writer = await asyncio.open_connection(*self._behind)
        inner_writer.write(method + b" / " + rest)
        ways = [
            asyncio.ensure_future(_pump(*way))
            for way in ((reader, inner_writer), (inner_reader, writer))
        ]
        try:
            await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for way in ways:
                way.cancel()
            await asyncio.gather(*ways, return_exceptions=True)
            inner_writer.close()


async def _pump(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    with suppress(OSError):
        while content := await reader.read(_CHUNK):
            writer.write(content)
            await writer.drain()
