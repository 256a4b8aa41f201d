"""Forwards TCP from loopback to an IPv6 address, since Zenoh 1.10 dials no IPv6 address by TLS.

Zenoh takes the text before the first colon of a TLS endpoint as the server's name. An IPv6 address
has colons, so that this text is no name. The forwarder only moves bytes: TLS runs between Zenoh and
the server.
"""

from __future__ import annotations

import asyncio
import contextlib
import threading
from concurrent.futures import Future

IDLE_TIME = 60.0  # s without a connection after which a forwarder ends
CONNECT_TIMEOUT = 5.0
_PIECE = 65536


def forward_to(host: str, port: int) -> int:
    """The port on 127.0.0.1 from which connections are forwarded to an IPv6 address.

    `host` may end with `%` and a scope. The forwarder ends IDLE_TIME after its last connection.
    """
    bound: Future[int] = Future()
    forwarder = _Forwarder(host, port)
    work = threading.Thread(
        target=lambda: asyncio.run(forwarder.run(bound)), name="swarmd-ipv6", daemon=True
    )
    work.start()
    return bound.result(CONNECT_TIMEOUT)


class _Forwarder:
    def __init__(self, host: str, port: int) -> None:
        self._target = (host, port)
        self._open = 0
        self._idle_since = 0.0

    async def run(self, bound: Future[int]) -> None:
        loop = asyncio.get_running_loop()
        self._idle_since = loop.time()
        try:
            server = await asyncio.start_server(self._serve, "127.0.0.1", 0)
        except OSError as error:
            bound.set_exception(error)
            return
        async with server:
            bound.set_result(server.sockets[0].getsockname()[1])
            while self._open or loop.time() - self._idle_since < IDLE_TIME:
                await asyncio.sleep(1.0)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._open += 1
        try:
            with contextlib.suppress(OSError, TimeoutError):
                host, port = self._target
                far_reader, far_writer = await asyncio.wait_for(
                    asyncio.open_connection(host, port), CONNECT_TIMEOUT
                )
                pumps = {
                    asyncio.ensure_future(_pump(reader, far_writer)),
                    asyncio.ensure_future(_pump(far_reader, writer)),
                }
                await asyncio.wait(pumps, return_when=asyncio.FIRST_COMPLETED)
                for pump in pumps:
                    pump.cancel()
                far_writer.close()
        finally:
            writer.close()
            self._open -= 1
            self._idle_since = asyncio.get_running_loop().time()


async def _pump(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    with contextlib.suppress(OSError):
        while piece := await reader.read(_PIECE):
            writer.write(piece)
            await writer.drain()
