"""A driver for a base that speaks MessagePack over UDP, such as a microcontroller's.

The base sends `{"is": "scan", "stamp": s, "ranges": [m ...]}`, with rays evenly around, and `{"is":
"odometry", "stamp": s, "x": m, "y": m, "yaw": rad, "linear": m/s, "angular": rad/s}` to the address
of the last hello. The base takes commands `{"linear": m/s, "angular": rad/s}`. A hello, `{}`, moves
nothing.
"""

from __future__ import annotations

import asyncio
import math
import socket
from collections import Counter
from collections.abc import Callable, Mapping

import msgspec
import numpy as np
from msgspec import Struct

from swarmd.core.errors import ConfigError, unknown
from swarmd.core.events import OdometryInput, ScanInput, SensorInput, tag_of
from swarmd.core.finding import Finding
from swarmd.core.values import (
    ZERO,
    Odometry,
    Platform,
    Pose,
    Scan,
    ScanSpec,
    Twist,
    Value,
)
from swarmd.driver_api.command_gate import CommandGate
from swarmd.driver_api.driver import NullSink, Sink, ZeroSenderSpec

SILENCE_TIMEOUT = 1.0
HELLO_PERIOD = 0.2


class ScanMessage(Struct, tag_field="is", tag="scan"):
    """Ranges in m: infinite for no return, NaN for unknown."""

    stamp: float
    ranges: list[float]


class OdometryMessage(Struct, tag_field="is", tag="odometry"):
    """Pose since the base was switched on, and velocities."""

    stamp: float
    x: float
    y: float
    yaw: float
    linear: float
    angular: float


_messages = msgspec.msgpack.Decoder(ScanMessage | OdometryMessage)


class UdpDriver:
    """Talks to the base at option `base`, `host:port`."""

    is_simulated = False

    def __init__(
        self, *, swarm: str, robot: str, platform: Platform, options: Mapping[str, Value]
    ) -> None:
        """Not connected yet; ConfigError for options it does not know."""
        for name in options:
            if name != "base":
                raise ConfigError(f"driver udp: {unknown('option', name, ['base'])}")
        self._base = str(options.get("base"))
        self._address = address_of(self._base)
        self._spec = platform.scan
        self._link: asyncio.DatagramTransport | None = None
        self._heard = -math.inf
        self._seq = 0
        self._gate = CommandGate()

    async def run(self, sink: Sink) -> None:
        """Feed the sink until cancelled; at the end send zero."""
        loop = asyncio.get_running_loop()
        sink.state(False, f"nothing heard yet from {self._base}")
        self._link, _ = await loop.create_datagram_endpoint(
            lambda: _Link(lambda data: self._take(sink, data)), remote_addr=self._address
        )
        try:
            while True:
                self._link.sendto(msgspec.msgpack.encode({}))
                await asyncio.sleep(HELLO_PERIOD)
                if self._gate.is_open and loop.time() - self._heard > SILENCE_TIMEOUT:
                    if self._gate.close(loop.time()):
                        self._put(ZERO)
                    sink.state(False, f"nothing from {self._base} for {SILENCE_TIMEOUT:g} s")
        finally:
            if self._gate.end():
                self._put(ZERO)
            self._link.close()
            self._link = None

    def send(
        self, twist: Twist, scan_seq: int, requested_scan_seq: int, *, is_stopped: bool = False
    ) -> None:
        """Send a safe command: dropped while the base is lost, zero the first time it is back."""
        command = self._gate.filter(twist)
        if command is not None:
            self._put(command)

    async def check(self, seconds: float) -> tuple[Finding, ...]:
        """Whether scans and odometry arrive; sends no command."""
        seen = _CountingSink()
        task = asyncio.create_task(self.run(seen))
        try:
            async with asyncio.timeout(seconds):
                while not (seen.count["scan"] and seen.count["odometry"]):
                    await asyncio.sleep(0.05)
        except TimeoutError:
            pass  # the findings name what is missing
        finally:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)
        nothing = f"none from {self._base}; switch the base on, or correct driver_options.base"
        return tuple(
            Finding(what, bool(seen.count[what]), "heard" if seen.count[what] else nothing)
            for what in ("scan", "odometry")
        )

    def zero_sender(self) -> ZeroSenderSpec:
        """How the watchdog sends zero, for a base with `command_timeout: none`."""
        return ZeroSenderSpec(f"{__name__}:UdpZeroSender", {"base": self._base})

    def _take(self, sink: Sink, data: bytes) -> None:
        try:
            input = self._input(_messages.decode(data))
        except (msgspec.DecodeError, ValueError):
            sink.dropped("garbage")
            return
        self._heard = asyncio.get_running_loop().time()
        if not self._gate.is_open:
            self._gate.open()
            sink.state(True, f"base at {self._base}")
        sink.take(input)

    def _input(self, message: ScanMessage | OdometryMessage) -> SensorInput:
        """The message as an input of the core; ValueError if it is not finite."""
        if isinstance(message, ScanMessage):
            self._seq += 1
            return ScanInput(scan_of(message, self._seq, self._spec))
        pose, twist = (
            Pose(message.x, message.y, message.yaw),
            Twist(message.linear, message.angular),
        )
        if not (math.isfinite(pose.x + pose.y + pose.yaw) and twist.is_finite):
            raise ValueError("odometry that is not finite")
        return OdometryInput(Odometry(message.stamp, pose, twist))

    def _put(self, twist: Twist) -> None:
        if self._link is not None:
            self._link.sendto(command_of(twist))


class UdpZeroSender:
    """A second connection, in the watchdog's process."""

    def __init__(self, base: str) -> None:
        """Not connected yet."""
        self._address = address_of(base)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

    def open(self) -> None:
        """Nothing to connect: it is UDP."""
        self._socket.setblocking(False)

    def send_zero(self) -> None:
        """Command zero once, now."""
        self._socket.sendto(command_of(ZERO), self._address)

    def close(self) -> None:
        """Disconnect."""
        self._socket.close()


def address_of(base: str) -> tuple[str, int]:
    """Host and port of `host:port`; ConfigError if it has another form."""
    host, _, port = base.rpartition(":")
    if not host or not port.isdecimal():
        raise ConfigError(f"driver udp: base is {base}; expected a value such as 10.0.0.7:9000")
    return host, int(port)


def command_of(twist: Twist) -> bytes:
    """The command as the base takes it."""
    return msgspec.msgpack.encode({"linear": twist.linear, "angular": twist.angular})


def scan_of(message: ScanMessage, seq: int, spec: ScanSpec) -> Scan:
    """A scan with rays evenly around, from the platform's first bearing."""
    ranges = np.asarray(message.ranges, dtype=np.float64)
    turn = np.linspace(0.0, 2.0 * np.pi, len(ranges), endpoint=False, dtype=np.float64)
    bearings = turn + float(spec.bearings[0])
    return Scan(seq, message.stamp, ranges, bearings, spec.range_min, spec.range_max)


class _Link(asyncio.DatagramProtocol):
    """Passes datagrams on; ignores errors of a base that is not up yet."""

    def __init__(self, take: Callable[[bytes], None]) -> None:
        self._take = take

    def datagram_received(self, data: bytes, address: object) -> None:
        self._take(data)


class _CountingSink(NullSink):
    """A sink that counts, for `check`."""

    def __init__(self) -> None:
        self.count = Counter[str]()

    def take(self, input: SensorInput) -> None:
        self.count[tag_of(input)] += 1
