"""The link of a simulated robot and its daemon: named frames on a TCP connection of their own.

The daemon dials the process that simulates the robot. The daemon's first frame is a `Hello`. Each
frame has a name, such as `scan` or `cmd_vel`, and a payload (`driver_api/hw_codec.py`). Neither
process waits for the other: a frame for which the send buffer has no room is dropped. Receivers use
the newest frame of a name.

A frame on the wire: the length of its name (1 byte), the length of its payload (4 bytes,
little-endian), the name, the payload.
"""

from __future__ import annotations

import errno
import select
import socket
import struct
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import TYPE_CHECKING, NamedTuple

from msgspec import Struct

from swarmd.core.bounds import Name
from swarmd.core.codec import Decoder, encode
from swarmd.core.errors import CodecError, ConfigError, NetworkError
from swarmd.link.carriers.arrival_time import ROOM, SO_TIMESTAMPNS, waited
from swarmd.link.settings import Endpoint, parse_endpoint

if TYPE_CHECKING:
    import asyncio

HELLO = "hello"
RETRY_PERIOD = 0.5  # s between two attempts to connect
CONNECT_TIMEOUT = 3.0  # s; the kernel itself would retry with pauses that grow to a minute
MAX_PAYLOAD = 1 << 20  # bytes; a longer frame ends its connection
MAX_CONNECTIONS_OF_ROBOT = 4
MAX_STRANGERS = 16  # connections without a `Hello` so far
_BACKLOG = 128  # connections that wait to be accepted
_HEAD = struct.Struct("<BI")
_CHUNK = 1 << 16
_READS = 16  # chunks that one call reads at most, so that a flood does not hold the reader
_SEND_BUFFER = 1 << 16  # bytes for a frozen receiver, besides those of its own buffer
_KEEPALIVE = ((socket.TCP_KEEPIDLE, 10), (socket.TCP_KEEPINTVL, 5), (socket.TCP_KEEPCNT, 4))  # s
GIVE_UP = 30.0
"""Seconds after which a host that vanished is given up, or a process that reads nothing.

Keepalive asks on a connection without bytes on their way only.
"""


class Hello(Struct, frozen=True, array_like=True):
    """The first frame of a daemon, which the server sends back as its answer."""

    swarm: Name
    robot: Name
    listens: bool = True  # the daemon wants sensor frames


_hello = Decoder(Hello)


class Frame(NamedTuple):
    """A named payload."""

    name: str
    payload: bytes


class Received(NamedTuple):
    """A frame from the daemon of `robot`."""

    robot: str
    name: str
    payload: bytes
    arrival: float  # s on the clock of the server


class Connection:
    """Frames on a connected TCP socket; no method waits or raises."""

    def __init__(self, connected: socket.socket, *, is_timed: bool = False) -> None:
        self.socket = connected
        self.is_open = True  # False from the end of the connection on; then call `close`
        self.age = 0.0  # s for which the newest frame waited before `receive`, if `is_timed`
        # bytes; see `wait_for`
        self._wanted = 1
        self._least = 1
        self._room = ROOM if is_timed else 0
        self._received = bytearray()
        self._unsent = b""
        connected.setblocking(False)
        with suppress(OSError):  # the connection has ended already
            connected.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            connected.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER)
            connected.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, is_timed)
            connected.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
            for option, value in _KEEPALIVE:
                connected.setsockopt(socket.IPPROTO_TCP, option, value)
            give_up = round(1e3 * GIVE_UP)
            connected.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, give_up)

    def send(self, name: str, payload: bytes) -> bool:
        """Send a frame; False if the frame is dropped for lack of room or connection."""
        try:
            while self._unsent:  # the rest of a frame that was sent in part
                self._unsent = self._unsent[self.socket.send(self._unsent) :]
            word = name.encode()
            frame = b"".join((_HEAD.pack(len(word), len(payload)), word, payload))
            self._unsent = frame[self.socket.send(frame) :]
        except BlockingIOError:
            return False
        except OSError:
            self.is_open = False
            with suppress(OSError):  # so that the receiving loop sees the end
                self.socket.shutdown(socket.SHUT_RDWR)
            return False
        return True

    def receive(self) -> list[Frame]:
        """The frames that have arrived; a frame that is too long ends the connection.

        After _READS full chunks the rest is left to the next call.
        """
        try:
            for _ in range(_READS):
                data, ancillary, _, _ = self.socket.recvmsg(_CHUNK, self._room)
                self._received += data
                self.age = waited(ancillary)
                self.is_open = bool(data)
                if len(data) < _CHUNK:
                    break
        except BlockingIOError:
            pass
        except OSError:
            self.is_open = False
        frames = self._take_frames()
        self._wake_with(1 if self._received else self._wanted)
        return frames

    def wait_for(self, size: int) -> None:
        """Let the socket become readable with `size` bytes, or at the end of the connection.

        While a part of a frame has been received, a single byte makes the socket readable.
        """
        self._wanted = size
        self._wake_with(1 if self._received else size)

    def _wake_with(self, size: int) -> None:
        if size != self._least:
            self._least = size
            with suppress(OSError):  # the connection has ended already
                self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVLOWAT, size)

    def close(self) -> None:
        """Close the connection; the kernel still sends the frames that `send` has taken."""
        self.is_open = False
        with suppress(OSError):
            self.socket.shutdown(socket.SHUT_WR)
            # Unread bytes would make `close` send a reset, which discards the last frame.
            for _ in range(_READS):
                if not self.socket.recv(_CHUNK):
                    break
        self.socket.close()

    def _take_frames(self) -> list[Frame]:
        frames: list[Frame] = []
        buffer = self._received
        at = 0
        while len(buffer) - at >= _HEAD.size:
            name_size, payload_size = _HEAD.unpack_from(buffer, at)
            if payload_size > MAX_PAYLOAD:
                self.is_open = False
                break
            begin = at + _HEAD.size + name_size  # where the payload begins
            end = begin + payload_size
            if end > len(buffer):
                break
            name = buffer[at + _HEAD.size : begin].decode(errors="replace")
            frames.append(Frame(name, bytes(buffer[begin:end])))
            at = end
        del buffer[:at]
        return frames


class RobotServer:
    """The simulator's side: accepts the connections of the robots' daemons.

    `dropped`: the count of frames that were dropped, in either direction. `endpoint`: the address
    in use, with the port that the kernel chose for port 0. One thread must call all methods except
    `send`.
    """

    def __init__(
        self,
        endpoint: str,
        swarm: str,
        robots: Iterable[str],
        what: str,
        *,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Listen on TCP at `endpoint` for the daemons of `robots`.

        A daemon connects and sends a hello with its robot's name. `what` names the server in
        errors. `clock` gives the arrival times of frames, in s. Raises NetworkError if the server
        cannot listen there, ConfigError if `endpoint` cannot be read.
        """
        address = read_endpoint(endpoint, "endpoint is ")
        self.dropped = 0
        self._swarm = swarm
        self._clock = clock
        # By robot: the connections of its daemons that want sensor frames.
        self._listeners: dict[str, tuple[Connection, ...]] = dict.fromkeys(robots, ())
        self._robots: dict[Connection, str] = {}  # connections whose `Hello` was accepted
        self._connections: dict[int, Connection] = {}  # all connections, by descriptor
        self._emptied_at = clock()  # the end of the last `receive`
        family = socket.AF_INET6 if ":" in address.host else socket.AF_INET
        self._socket = socket.socket(family, socket.SOCK_STREAM | socket.SOCK_NONBLOCK)
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self._socket.bind((address.host, address.port))
            self._socket.listen(_BACKLOG)
        except OSError as error:
            self._socket.close()
            is_in_use = error.errno == errno.EADDRINUSE
            reason = "is in use on this machine" if is_in_use else f"{error.strerror}"
            raise NetworkError(f"{what} cannot listen: {endpoint} {reason}") from error
        port = self._socket.getsockname()[1]  # the kernel chooses a port for port 0
        self.endpoint = f"{endpoint.rpartition(':')[0]}:{port}"
        self._poll = select.epoll()
        self._poll.register(self._socket, select.EPOLLIN)

    def fileno(self) -> int:
        """A descriptor that becomes readable when `receive` has something to do."""
        return self._poll.fileno()

    def send(self, robot: str, name: str, payload: bytes) -> bool:
        """Send a frame to the listening daemons of a robot; False if it is dropped for one."""
        is_sent = True
        for connection in self._listeners[robot]:
            if not connection.send(name, payload):
                is_sent = False
                self.dropped += 1
        return is_sent

    def receive(self) -> list[Received]:
        """The frames since the last call; does not wait."""
        received: list[Received] = []
        for file, _ in self._poll.poll(0.0):
            connection = self._connections.get(file)
            if connection is None:
                self._accept(received)
            else:
                self._take(file, connection, received)
        self._emptied_at = self._clock()
        return received

    def close(self) -> None:
        """Close all connections."""
        for file, connection in list(self._connections.items()):
            self._forget(file, connection)
        self._poll.close()
        self._socket.close()

    def _take(self, file: int, connection: Connection, received: list[Received]) -> None:
        frames = connection.receive()
        now = self._clock()
        # The age is measured on the wall clock, which may be set: the age is at most the time since
        # the last call.
        arrival = now - min(max(connection.age, 0.0), max(now - self._emptied_at, 0.0))
        for name, payload in frames:
            if connection in self._robots:
                received.append(Received(self._robots[connection], name, payload, arrival))
            else:
                self._welcome(connection, name, payload)
        if not connection.is_open:
            self._forget(file, connection)

    def _accept(self, received: list[Received]) -> None:
        """Accept all waiting connections and read their hellos.

        A stranger is a connection without a hello. At most MAX_STRANGERS strangers are kept: a new
        connection ends the oldest stranger, so that strangers keep no daemon out.
        """
        for _ in range(_BACKLOG):
            try:
                accepted, _ = self._socket.accept()
            except OSError:  # no connection waits, or no descriptor is free
                return
            strangers = [
                file for file, known in self._connections.items() if known not in self._robots
            ]
            if len(strangers) >= MAX_STRANGERS:  # close the oldest stranger
                self._forget(strangers[0], self._connections[strangers[0]])
            connection = Connection(accepted, is_timed=True)
            self._connections[accepted.fileno()] = connection
            self._poll.register(accepted, select.EPOLLIN)
            self._take(accepted.fileno(), connection, received)

    def _welcome(self, connection: Connection, name: str, payload: bytes) -> None:
        """Answer the first frame of a connection, a hello; end the connection if it is refused.

        Refused are a first frame that is no hello, a hello to another swarm or to an unknown robot,
        and a connection beyond MAX_CONNECTIONS_OF_ROBOT.
        """
        try:
            hello = _hello(payload)
        except CodecError:
            hello = None
        listeners = None if hello is None else self._listeners.get(hello.robot)
        count = 0 if hello is None else [*self._robots.values()].count(hello.robot)
        is_full = count >= MAX_CONNECTIONS_OF_ROBOT
        is_hello = name == HELLO and hello is not None and hello.swarm == self._swarm
        if not is_hello or hello is None or listeners is None or is_full:
            self.dropped += 1
            connection.is_open = False
            return
        self._robots[connection] = hello.robot
        connection.send(HELLO, payload)
        if hello.listens:
            self._listeners[hello.robot] = (*listeners, connection)

    def _forget(self, file: int, connection: Connection) -> None:
        del self._connections[file]
        robot = self._robots.pop(connection, None)
        if robot is not None:
            self._listeners[robot] = tuple(
                listener for listener in self._listeners[robot] if listener is not connection
            )
        connection.close()


class RobotClient:
    """The daemon's side of the link: `run` keeps a TCP connection, on an asyncio loop.

    `hello`: the first frame, which names swarm and robot. `on_frames` gets the frames of the
    simulator in the order of arrival. `is_known`: the simulator has accepted the hello.
    """

    def __init__(
        self, endpoint: Endpoint, hello: Hello, on_frames: Callable[[list[Frame]], None]
    ) -> None:
        self._endpoint = endpoint
        self._on_frames = on_frames
        self._hello = encode(hello)
        self._connection: Connection | None = None
        self._read_now: Callable[[], None] | None = None
        self.is_known = False

    async def run(self) -> None:
        """Keep a connection until cancelled, then close it."""
        import asyncio  # a zero sender has no loop, and does not import it

        loop = asyncio.get_running_loop()
        host = self._endpoint.host
        port = self._endpoint.port
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        while True:
            made = socket.socket(family, socket.SOCK_STREAM | socket.SOCK_NONBLOCK)
            try:
                # wait_for of Python 3.11 loses a cancellation that comes with a refusal.
                async with asyncio.timeout(CONNECT_TIMEOUT):
                    await loop.sock_connect(made, (host, port))
                # TCP self-connect: where nothing listens, the kernel may give the socket the very
                # port to which it connects.
                if made.getsockname() != made.getpeername():
                    await self._use(Connection(made, is_timed=True), loop)
            except OSError:  # nothing listens or answers there now
                pass
            finally:
                made.close()
            await asyncio.sleep(RETRY_PERIOD)

    async def _use(self, connection: Connection, loop: asyncio.AbstractEventLoop) -> None:
        """Send the hello, and hand frames to `on_frames` until the connection ends; then close it.

        While the connection lasts, `_read_now` reads at once what the event loop would read later.
        """
        ended: asyncio.Future[None] = loop.create_future()
        descriptor = connection.socket.fileno()

        def on_readable() -> None:
            frames = connection.receive()
            if not connection.is_open and not ended.done():
                loop.remove_reader(descriptor)
                ended.set_result(None)
            self._take(frames)

        self._connection = connection
        self._read_now = on_readable
        connection.send(HELLO, self._hello)
        loop.add_reader(descriptor, on_readable)
        try:
            await ended
        finally:
            # `on_readable` has removed the reader only if it saw the end of the connection.
            has_seen_end = ended.done() and not ended.cancelled()
            if not has_seen_end:
                loop.remove_reader(descriptor)
            self._connection = None
            self._read_now = None
            self.is_known = False
            connection.close()

    def _take(self, frames: list[Frame]) -> None:
        """Hand frames to `on_frames`, without the server's first frame, which answers the hello."""
        if frames and not self.is_known:
            self.is_known = True
            del frames[0]
        if frames:
            self._on_frames(frames)

    @property
    def age(self) -> float:
        """Seconds for which the last frame had waited when it was handed over, by the wall clock.

        The wall clock may be set meanwhile.
        """
        return 0.0 if self._connection is None else self._connection.age

    def wait_for(self, size: int) -> None:
        """Read by itself only once `size` bytes have arrived; 1: at once. See `read`."""
        if self._connection is not None:
            self._connection.wait_for(size)

    def read(self) -> None:
        """Hand over the frames that have arrived, without waiting for the event loop."""
        if self._read_now is not None:
            self._read_now()

    def send(self, name: str, payload: bytes) -> bool:
        """Send a frame; False if the frame is dropped for lack of room or connection."""
        connection = self._connection
        return connection is not None and connection.is_open and connection.send(name, payload)


def dial(endpoint: Endpoint, hello: Hello, timeout: float) -> Connection | None:
    """A connection for a process without asyncio, which has sent `hello`.

    None if nothing answers at the endpoint within `timeout` s.
    """
    try:
        made = socket.create_connection((endpoint.host, endpoint.port), timeout)
    except OSError:
        return None
    connection = Connection(made)
    if connection.send(HELLO, encode(hello)):
        return connection
    connection.close()
    return None


def read_endpoint(text: str, prefix: str, example: str = "tcp/127.0.0.1:0") -> Endpoint:
    """The TCP host and port of a link. Raises ConfigError with `prefix`, `text` and `example`."""
    endpoint = parse_endpoint(text, prefix, example)
    if endpoint.protocol != "tcp" or endpoint.suffix:
        raise ConfigError(f"{prefix}{text!r}; expected a value such as {example}")
    return endpoint
