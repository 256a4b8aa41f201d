"""A server of Foxglove's WebSocket protocol that offers channels and takes no messages.

Source: the server of Foxglove's SDK for the subprotocol `foxglove.sdk.v1`
(github.com/foxglove/foxglove-sdk, rust/foxglove/src/websocket). That server accepts every origin
and has no token: any web page in a browser of the computer could read the data. This server refuses
a connection without the secret before the handshake.
"""

from __future__ import annotations

import asyncio
import base64
import hmac
import http
import logging
import secrets
import struct
import threading
import time
from collections.abc import Coroutine, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, TypeVar

import msgspec
from websockets.asyncio.server import Server, ServerConnection, broadcast, serve
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.typing import Subprotocol

from swarmd.core.errors import NetworkError
from swarmd.view.server import limited

log = logging.getLogger(__name__)
Result = TypeVar("Result")

SUBPROTOCOL = Subprotocol("foxglove.sdk.v1")
MAX_CLIENTS = 16
MAX_MESSAGE = 256 * 1024
MAX_BACKLOG = 2**20
"""Bytes that wait for a client; with more of them it gets no further message."""
_BATCH = 100  # channels of one message
_CLOSE_TIME = 1.0  # s for a client to close its connection
_DATA = struct.Struct("<BIQ")  # kind 1, subscription, time in ns


@dataclass(slots=True, eq=False)
class Channel:
    """A channel of messages: its topic, and the encoding of its messages."""

    topic: str
    encoding: str
    schema_name: str
    schema_encoding: str
    schema: str
    subscriptions: dict[ServerConnection, int] = field(default_factory=dict)
    """The number under which each client gets the messages."""

    @property
    def is_read(self) -> bool:
        """True if a client subscribes."""
        return bool(self.subscriptions)


def protobuf_channel(topic: str, kind: Any) -> Channel:
    """A channel for a message class of the SDK; its content is `encode` of such a message."""
    schema = kind.get_schema()
    text = base64.b64encode(schema.data).decode()
    return Channel(topic, "protobuf", schema.name, "protobuf", text)


class _Subscription(msgspec.Struct, rename="camel"):
    id: int
    channel_id: int


class _Ask(msgspec.Struct, rename="camel"):
    """A request of a client; operations other than `subscribe` and `unsubscribe` are ignored."""

    op: str
    subscriptions: list[_Subscription] = []
    subscription_ids: list[int] = []


_ask = msgspec.json.Decoder(_Ask)


class FoxgloveSocket:
    """Serves channels until `close`, from its own thread. `address` has the secret."""

    def __init__(self, name: str, host: str, port: int) -> None:
        """Listen; port 0: any free port. NetworkError if the address cannot be bound."""
        self._name = name
        self._secret = secrets.token_urlsafe(16)
        self._session = str(time.time_ns() // 1_000_000)
        self._channels: list[Channel] = []  # the number of a channel is its place, from 1 on
        self._clients: set[ServerConnection] = set()
        self._waiting: dict[ServerConnection, None] = {}
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="foxglove", daemon=True)
        self._thread.start()
        try:
            self._server = self._run(self._listen(host, port))
        except OSError as error:
            self._end_thread()
            raise NetworkError(
                f"{host}:{port} cannot be listened at: {error.strerror}; choose another port"
            ) from error
        bound = next(iter(self._server.sockets)).getsockname()
        self.address = f"ws://{host}:{bound[1]}/{self._secret}"

    def close(self) -> None:
        """End all connections, and the thread."""
        self._run(self._end())
        self._end_thread()

    def add(self, channels: Iterable[Channel]) -> None:
        """Offer further channels, also to connected clients."""
        self._loop.call_soon_threadsafe(self._offer, tuple(channels))

    def send(self, channel: Channel, payload: bytes) -> None:
        """Send a message to the subscribers; a subscriber that reads too slowly misses it."""
        self._loop.call_soon_threadsafe(self._send, channel, time.time_ns(), payload)

    def _run(self, work: Coroutine[Any, Any, Result]) -> Result:
        return asyncio.run_coroutine_threadsafe(work, self._loop).result()

    def _end_thread(self) -> None:
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    async def _listen(self, host: str, port: int) -> Server:
        return await serve(
            self._talk,
            host,
            port,
            process_request=self._admit,
            create_connection=limited(self._waiting),
            subprotocols=[SUBPROTOCOL],
            max_size=MAX_MESSAGE,
            close_timeout=_CLOSE_TIME,
            compression=None,
            logger=log,
        )

    async def _end(self) -> None:
        for connection in [*self._waiting]:
            connection.transport.abort()
        self._server.close()
        try:
            await asyncio.wait_for(self._server.wait_closed(), 2.0 * _CLOSE_TIME)
        except TimeoutError:  # a client reads nothing
            for connection in self._clients:
                connection.transport.abort()
            await self._server.wait_closed()

    def _admit(self, connection: ServerConnection, request: Request) -> Response | None:
        """None for a request with the secret, else the refusal."""
        given = request.path.partition("?")[0].removeprefix("/")
        if hmac.compare_digest(given.encode(errors="replace"), self._secret.encode()):
            return None
        return connection.respond(
            http.HTTPStatus.FORBIDDEN, "the address lacks the secret; take the printed one\n"
        )

    async def _talk(self, connection: ServerConnection) -> None:
        self._waiting.pop(connection, None)
        if len(self._clients) >= MAX_CLIENTS:
            return
        head = {"op": "serverInfo", "name": self._name, "capabilities": [], "metadata": {}}
        try:
            await connection.send(_json(head | {"sessionId": self._session}))
            self._clients.add(connection)
            for text in self._offers(range(len(self._channels))):
                broadcast([connection], text)
            async for message in connection:
                self._take(connection, message)
        except ConnectionClosed:
            pass
        finally:
            self._clients.discard(connection)
            for channel in self._channels:
                channel.subscriptions.pop(connection, None)

    def _take(self, connection: ServerConnection, message: str | bytes) -> None:
        with suppress(msgspec.MsgspecError, RecursionError):  # an invalid message is ignored
            ask = _ask.decode(message)
            if ask.op == "subscribe":
                for subscription in ask.subscriptions:
                    is_known = 1 <= subscription.channel_id <= len(self._channels)
                    if is_known and 0 <= subscription.id < 1 << 32:
                        self._channels[subscription.channel_id - 1].subscriptions[connection] = (
                            subscription.id
                        )
            elif ask.op == "unsubscribe":
                for channel in self._channels:
                    if channel.subscriptions.get(connection) in ask.subscription_ids:
                        del channel.subscriptions[connection]

    def _offer(self, channels: tuple[Channel, ...]) -> None:
        first = len(self._channels)
        self._channels += channels
        for text in self._offers(range(first, len(self._channels))):
            broadcast(self._clients, text)

    def _offers(self, places: range) -> Iterator[str]:
        """The messages that offer the channels with these indices."""
        for start in range(0, len(places), _BATCH):
            some = [self._plain(place) for place in places[start : start + _BATCH]]
            yield _json({"op": "advertise", "channels": some})

    def _plain(self, place: int) -> dict[str, Any]:
        channel = self._channels[place]
        return {
            "id": place + 1,
            "topic": channel.topic,
            "encoding": channel.encoding,
            "schemaName": channel.schema_name,
            "schemaEncoding": channel.schema_encoding,
            "schema": channel.schema,
        }

    def _send(self, channel: Channel, at: int, payload: bytes) -> None:
        for connection, subscription in channel.subscriptions.items():
            if connection.transport.get_write_buffer_size() < MAX_BACKLOG:
                broadcast([connection], _DATA.pack(1, subscription, at) + payload)


def _json(content: Any) -> str:
    return msgspec.json.encode(content).decode()
