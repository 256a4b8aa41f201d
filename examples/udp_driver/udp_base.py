"""A driver of one's own: a base that speaks MessagePack over UDP, such as a microcontroller's.

It says `{"is": "scan", "stamp": s, "ranges": [m ...]}`, evenly around, and `{"is": "odometry",
"stamp": s, "x": m, "y": m, "yaw": rad, "linear": m/s, "angular": rad/s}` to whoever has said hello
last, and takes `{"linear": m/s, "angular": rad/s}`. A hello, `{}`, moves nothing.
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
from swarmd.core.values import (
    ZERO,
    Neighbor,
    Odometry,
    Platform,
    Pose,
    Scan,
    ScanSpec,
    Twist,
    Value,
)
from swarmd.driver_api.command_gate import CommandGate
from swarmd.driver_api.driver import Finding, Sink, ZeroSenderSpec

SILENCE = 1.0
HELLO = 0.2


class Sweep(Struct, tag_field="is", tag="scan"):
    """Ranges in m: infinite where nothing is seen, NaN where nothing is known."""

    stamp: float
    ranges: list[float]


class Moved(Struct, tag_field="is", tag="odometry"):
    """Pose since the base was switched on, and its velocities."""

    stamp: float
    x: float
    y: float
    yaw: float
    linear: float
    angular: float


_said = msgspec.msgpack.Decoder(Sweep | Moved)


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
        """Feed the sink until cancelled; zero on the way out."""
        loop = asyncio.get_running_loop()
        sink.state(False, f"nothing heard yet from {self._base}")
        self._link, _ = await loop.create_datagram_endpoint(
            lambda: _Link(lambda data: self._take(sink, data)), remote_addr=self._address
        )
        try:
            while True:
                self._link.sendto(msgspec.msgpack.encode({}))
                await asyncio.sleep(HELLO)
                if self._gate.is_open and loop.time() - self._heard > SILENCE:
                    if self._gate.close(loop.time()):
                        self._put(ZERO)
                    sink.state(False, f"nothing from {self._base} for {SILENCE:g} s")
        finally:
            if self._gate.end():
                self._put(ZERO)
            self._link.close()
            self._link = None

    def send(self, twist: Twist, scan_seq: int, requested_scan_seq: int) -> None:
        """Send a safe command: dropped while the base is lost, zero the first time it is back."""
        command = self._gate.filter(twist)
        if command is not None:
            self._put(command)

    async def check(self, seconds: float) -> tuple[Finding, ...]:
        """Whether scans and odometry come; commands nothing."""
        seen = _Seen()
        task = asyncio.create_task(self.run(seen))
        try:
            async with asyncio.timeout(seconds):
                while not (seen.count["scan"] and seen.count["odometry"]):
                    await asyncio.sleep(0.05)
        except TimeoutError:
            pass  # what is missing stands in the findings
        finally:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)
        nothing = f"none from {self._base}; switch the base on, or correct driver_options.base"
        return tuple(
            Finding(what, bool(seen.count[what]), "heard" if seen.count[what] else nothing)
            for what in ("scan", "odometry")
        )

    def zero_sender(self) -> ZeroSenderSpec:
        """How a stopper says zero, for a base with `deadman: none`."""
        return ZeroSenderSpec(f"{__name__}:UdpZeroSender", {"base": self._base})

    def _take(self, sink: Sink, data: bytes) -> None:
        try:
            value = self._value(_said.decode(data))
        except (msgspec.DecodeError, ValueError):
            sink.dropped("garbage")
            return
        self._heard = asyncio.get_running_loop().time()
        if not self._gate.is_open:
            self._gate.open()
            sink.state(True, f"base at {self._base}")
        if isinstance(value, Scan):
            sink.scan(value)
        else:
            sink.odometry(value)

    def _value(self, said: Sweep | Moved) -> Scan | Odometry:
        """What was said in the core's terms; ValueError if that is impossible."""
        if isinstance(said, Sweep):
            self._seq += 1
            return scan_of(said, self._seq, self._spec)
        pose, twist = Pose(said.x, said.y, said.yaw), Twist(said.linear, said.angular)
        if not (math.isfinite(pose.x + pose.y + pose.yaw) and twist.is_finite):
            raise ValueError("odometry that is not finite")
        return Odometry(said.stamp, pose, twist)

    def _put(self, twist: Twist) -> None:
        if self._link is not None:
            self._link.sendto(command_of(twist))


class UdpZeroSender:
    """A second connection, in the stopper's process."""

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
    """Host and port of `host:port`; ConfigError if it is none."""
    host, _, port = base.rpartition(":")
    if not host or not port.isdecimal():
        raise ConfigError(f"driver udp: base is {base}; wanted is such as 10.0.0.7:9000")
    return host, int(port)


def command_of(twist: Twist) -> bytes:
    """What the base takes."""
    return msgspec.msgpack.encode({"linear": twist.linear, "angular": twist.angular})


def scan_of(sweep: Sweep, seq: int, spec: ScanSpec) -> Scan:
    """A sweep evenly around, from the first bearing of the platform's."""
    ranges = np.asarray(sweep.ranges, dtype=np.float64)
    turn = np.linspace(0.0, 2.0 * np.pi, len(ranges), endpoint=False, dtype=np.float64)
    bearings = turn + float(spec.bearings[0])
    return Scan(seq, sweep.stamp, ranges, bearings, spec.range_min, spec.range_max)


class _Link(asyncio.DatagramProtocol):
    """Hands on what comes; errors are those of a base that is not there yet."""

    def __init__(self, take: Callable[[bytes], None]) -> None:
        self._take = take

    def datagram_received(self, data: bytes, address: object) -> None:
        self._take(data)


class _Seen:
    """A sink that counts, for who only looks."""

    def __init__(self) -> None:
        self.count = Counter[str]()

    def scan(self, scan: Scan) -> None:
        self.count["scan"] += 1

    def odometry(self, odometry: Odometry) -> None:
        self.count["odometry"] += 1

    def neighbors(self, neighbors: tuple[Neighbor, ...]) -> None:
        pass

    def readings(self, values: Mapping[str, float]) -> None:
        pass

    def state(self, is_up: bool, text: str) -> None:
        pass

    def dropped(self, what: str) -> None:
        pass
