"""The adapter of driver `ros1` as a child process, and the socket to it."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import socket
import subprocess
import time
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import msgspec
from msgspec import Struct

from swarmd.core.errors import DriverError
from swarmd.core.processes import how_it_ended
from swarmd.drivers.ros1 import adapter_process

ALIVE_TIMEOUT = 1.0
"""Seconds without a sign of life after which an adapter is killed."""
START_TIMEOUT = 20.0
"""Seconds until the first sign of life; importing rospy takes a second on a small machine."""
MAX_MESSAGE_AGE = 0.5
"""Seconds after which a message that waited in the socket is dropped."""

_BUFFER = 1 << 20
_MAX_FRAME = 1 << 19
_LEAVE_TIMEOUT = 2.5
_END_TIMEOUT = 1.0
_MAX_LINES = 20


class MasterState(Struct, frozen=True, tag_field="event", tag="state"):
    """What the ROS master knows of the driver's topics."""

    master: bool  # False: the master does not answer
    text: str = ""  # why the master does not answer
    publishers: dict[str, list[str]] = {}  # nodes by topic
    types: dict[str, str] = {}  # type by topic
    candidates: dict[str, list[str]] = {}  # published topics by type, of the driver's types
    taken_topics: dict[str, list[str]] = {}  # topics with subscribers, by type of commands
    others: list[str] = []  # other nodes that publish on the topic of commands
    listeners: list[str] = []  # nodes that subscribe to the topic of commands
    connected: int = 0  # listeners with a connection to the adapter
    wants: dict[str, str] = {}  # type by listener; only while a listener has no connection
    command_type: str = ""  # of the published commands; empty: no base's type is known


class ForeignMessage(Struct, frozen=True, tag_field="event", tag="foreign"):
    """`node` publishes `topic` with another type or definition; its messages are dropped."""

    topic: str
    node: str
    type: str
    md5sum: str


class AdapterEnd(Struct, frozen=True, tag_field="event", tag="end"):
    """Why the adapter ends.

    `kind`: `fatal`, rospy cannot be loaded; `restart`, the ROS master was restarted; `end`, any
    other cause.
    """

    kind: str
    text: str


class PublisherGone(Struct, frozen=True, tag_field="event", tag="gone"):
    """The publisher of the last message of a kept topic has ended; `topic`: the topic's index."""

    topic: int


Event = MasterState | ForeignMessage | AdapterEnd | PublisherGone

_events: msgspec.json.Decoder[Event] = msgspec.json.Decoder(Event)


class AdapterListener(Protocol):
    """Receives what the adapter sends; called on the loop's thread."""

    def on_event(self, event: Event) -> None:
        """Take an event."""

    def on_message(self, topic: int, data: bytes) -> None:
        """Take the newest message of a topic; `topic`: its index in the configuration."""

    def on_dropped(self, what: str) -> None:
        """Count a packet that was dropped."""


class AdapterProcess:
    """An adapter process, which outlives its daemon and then sends zeros."""

    def __init__(
        self,
        script: str,
        python: str,
        config: Mapping[str, Any],
        environ: Mapping[str, str],
        listener: AdapterListener,
    ) -> None:
        """Start the process, and watch its socket and error output in the running loop.

        `script`: the path of `adapter_process.py`. `python`: an interpreter that has rospy.
        `config` is passed as JSON. `environ`: the environment of the process. `listener` gets the
        messages and events. Raises DriverError if the process cannot start.
        """
        self._listener = listener
        self._kept = frozenset(config["kept_topics"])
        self._loop = asyncio.get_running_loop()
        self._ended = asyncio.Event()
        # The adapter counts as alive until ALIVE_TIMEOUT after `_alive_at`. Before the first sign
        # of life it has START_TIMEOUT, so `_alive_at` is in the future at first.
        self._alive_at = self._loop.time() + START_TIMEOUT - ALIVE_TIMEOUT
        self._error_lines: deque[str] = deque(maxlen=_MAX_LINES)
        self._buffer = memoryview(bytearray(_MAX_FRAME))
        command_line = [python, script, json.dumps(config)]
        self._socket, self._process = _started(command_line, environ)
        assert self._process.stderr is not None
        self._error_pipe = self._process.stderr.fileno()
        os.set_blocking(self._error_pipe, False)
        self._socket.setblocking(False)
        self._loop.add_reader(self._socket, self._on_readable)
        self._loop.add_reader(self._error_pipe, self._on_error_output)

    @property
    def pid(self) -> int:
        """Its process id."""
        pid: int = self._process.pid
        return pid

    def send(self, command: bytes, kind: bytes = adapter_process.COMMAND) -> None:
        """Send a serialised command, or state; never blocks, dropped if the socket is full."""
        with contextlib.suppress(OSError):
            self._socket.send(adapter_process.COMMAND_HEAD.pack(kind, time.monotonic()) + command)

    async def until_end(self, seconds: float) -> bool:
        """Wait at most `seconds`; True once the process has ended, or was killed as silent."""
        try:
            async with asyncio.timeout(seconds):
                await self._ended.wait()
        except TimeoutError:
            self._on_readable()  # packets that came while this process was frozen
            if self._loop.time() - self._alive_at > ALIVE_TIMEOUT and not self._ended.is_set():
                self._error_lines.append(f"did not answer for {ALIVE_TIMEOUT:g} s")
                self._process.kill()
                self._hang_up()
        return self._ended.is_set()

    async def close(self, *, politely: bool) -> str:
        """End the adapter process, and return how it ended.

        `politely`: the process may send its zero and exit. It is killed only if it does not exit.
        """
        try:
            if politely and not self._ended.is_set():
                with contextlib.suppress(OSError):
                    self._socket.send(adapter_process.FAREWELL)
                await self._wait(_LEAVE_TIMEOUT)
            elif politely:
                await self._wait(_END_TIMEOUT)
        finally:
            self._hang_up()
            if self._process.poll() is None:
                self._process.kill()
                self._process.wait()
            self._on_error_output()
            self._loop.remove_reader(self._error_pipe)
            assert self._process.stderr is not None
            self._process.stderr.close()
        last = self._error_lines[-1] if self._error_lines else ""
        return how_it_ended(self._process.returncode) + (f": {last}" if last else "")

    async def _wait(self, seconds: float) -> None:
        deadline = self._loop.time() + seconds
        while self._process.poll() is None and self._loop.time() < deadline:
            await asyncio.sleep(0.01)

    def _on_readable(self) -> None:
        """Read all waiting packets; hand on only the newest message of each topic."""
        newest: dict[int, bytes] = {}
        while not self._ended.is_set():
            try:
                size = self._socket.recv_into(self._buffer)
            except BlockingIOError:
                break
            except OSError:
                size = 0
            if not size:
                self._hang_up()
                break
            self._take(bytes(self._buffer[:size]), newest)
        for topic, data in newest.items():
            self._listener.on_message(topic, data)

    def _take(self, frame: bytes, newest: dict[int, bytes]) -> None:
        """Take a packet; messages are collected in `newest`, by the index of their topic."""
        kind = frame[:1]
        if kind == adapter_process.DATA and len(frame) >= adapter_process.DATA_HEAD.size:
            _, topic, arrival = adapter_process.DATA_HEAD.unpack_from(frame)
            is_late = not abs(time.monotonic() - arrival) < MAX_MESSAGE_AGE  # also NaN
            is_old = is_late and topic not in self._kept
            if is_old or topic in newest:
                self._listener.on_dropped("overtaken")
            if not is_old:
                newest[topic] = frame[adapter_process.DATA_HEAD.size :]
        elif kind == adapter_process.EVENT:
            try:
                event = _events.decode(frame[1:])
            except (msgspec.DecodeError, UnicodeDecodeError):
                self._listener.on_dropped("garbage")
                return
            if isinstance(event, PublisherGone):
                newest.pop(event.topic, None)
            self._listener.on_event(event)
        elif frame != adapter_process.ALIVE:
            self._listener.on_dropped("garbage")
            return
        self._alive_at = self._loop.time()

    def _on_error_output(self) -> None:
        try:
            text = os.read(self._error_pipe, 65536)
        except BlockingIOError:
            return
        if not text:
            self._loop.remove_reader(self._error_pipe)
        for line in text.decode(errors="replace").splitlines():
            if line.strip():
                self._error_lines.append(line.strip()[:300])

    def _hang_up(self) -> None:
        """Close the socket, and note the end of the process."""
        if not self._ended.is_set():
            self._ended.set()
            self._loop.remove_reader(self._socket)
            self._socket.close()


def _started(
    command_line: Sequence[str], environ: Mapping[str, str]
) -> tuple[socket.socket, subprocess.Popen[bytes]]:
    """Start an adapter process; returns the driver's end of a socket to it, and the process.

    The socket keeps the bounds of packets (SOCK_SEQPACKET). The end of the process is its standard
    input. DriverError if the socket or the process cannot be made.
    """
    try:
        own_end, child_end = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    except OSError as error:
        raise DriverError(
            f"driver ros1: no socket to an adapter: {error.strerror}; is the machine full?"
        ) from None
    try:
        for end in (own_end, child_end):
            end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _BUFFER)
        process = subprocess.Popen(
            command_line,
            stdin=child_end.fileno(),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            env=environ,
            cwd="/",
            start_new_session=True,  # Ctrl-C in a terminal must not reach it
        )
    except OSError as error:
        own_end.close()
        raise DriverError(
            f"driver ros1: {command_line[0]} cannot be started ({error.strerror}); set"
            " driver_options.python to a Python that has rospy"
        ) from None
    finally:
        child_end.close()
    return own_end, process
