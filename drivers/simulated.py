"""A simulated robot of a world process, reached over a `robot_link`."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Iterable, Mapping, Sequence
from time import monotonic
from typing import NamedTuple

from msgspec import Struct

from swarmd.core.errors import CodecError
from swarmd.core.events import OdometryInput, RangesInput, ScanInput, SensorInput
from swarmd.core.finding import Finding
from swarmd.core.values import ZERO, Platform, Twist, Value
from swarmd.driver_api import hw_codec
from swarmd.driver_api.command_gate import CommandGate
from swarmd.driver_api.driver import NullSink, Sink, TakeLate, ZeroSenderSpec
from swarmd.link.carriers.robot_link import (
    Connection,
    Frame,
    Hello,
    RobotClient,
    dial,
    read_endpoint,
)
from swarmd.link.settings import Endpoint
from swarmd.robot.protection.footprint import Footprint
from swarmd.robot.sensing.scan_content import ENOUGH_SCANS, ScanContent
from swarmd.robot.sensing.scan_delay_finding import scan_delay_finding
from swarmd.settings.layered import Layered

DEFAULT_ENDPOINT = "tcp/127.0.0.1:7790"
SENSOR_TIMEOUT = 1.0
"""Seconds without any sample after which the base counts as lost."""

_WATCH_PERIOD = 0.1
_SCAN = "scan"
_ODOMETRY = "odometry"
_DIAL_TIME = 0.04  # s: a zero sender waits no longer than a tick


class SimulatedOptions(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The options of driver `simulated`.

    - `endpoint`: the address at which the simulated world listens.
    - `radio`: the world carries the messages of patterns.
    - `detections`: the world sends the objects that the robot recognises.
    """

    endpoint: str = DEFAULT_ENDPOINT
    radio: bool = False
    detections: bool = False


class _Batch(NamedTuple):
    """What is common to the frames of one read."""

    take_late: TakeLate | None
    last: Frame  # in the order of arrival; the link measures for how long it waited
    last_read: float  # when frames were read before, which was before these frames arrived


class SimulatedDriver:
    """Connects to one robot of a world process."""

    is_simulated = True

    def __init__(
        self, *, swarm: str, robot: str, platform: Platform, options: Mapping[str, Value]
    ) -> None:
        """Not connected yet. Options: `SimulatedOptions`."""
        self._robot = robot
        self._swarm = swarm
        self._platform = platform
        chosen = Layered(("driver simulated", options)).build(SimulatedOptions)
        self._endpoint = chosen.endpoint
        self.carries_messages = chosen.radio
        self._where = _read(self._endpoint)
        self._link: RobotClient | None = None
        self._gate = CommandGate()
        self._last_sample = -math.inf  # s on the loop's clock
        self._gatherer: TakeLate | None = None  # of the daemon, for gathered odometry
        self._take_late: TakeLate | None = None  # the same while odometry waits in the socket
        self._scan_size = 0  # bytes of the smallest frame of a scan
        self._kinds: set[str] = set()  # kinds of sensor inputs that have come
        self._lag = -math.inf  # s, arrival minus stamp of the last gathered reading
        self._last_read = -math.inf  # of the socket
        self._is_taking = False  # within `_take_frames`

    async def run(self, sink: Sink) -> None:
        """Feed the sink until cancelled; the link reconnects by itself."""
        loop = asyncio.get_running_loop()
        sink.state(False, f"no simulated robot yet at {self._endpoint}")
        hello = Hello(self._swarm, self._robot)
        link = self._link = RobotClient(
            self._where, hello, lambda frames: self._take_frames(sink, frames)
        )
        linking = loop.create_task(link.run())
        try:
            while not linking.done():
                left = self._last_sample + SENSOR_TIMEOUT - loop.time()
                await asyncio.wait({linking}, timeout=max(left, _WATCH_PERIOD))
                self._watch(sink, loop.time())
            linking.result()
        finally:
            if self._gate.end():
                self._put(ZERO, -1, -1)  # decided with no scan
            self._link = None
            linking.cancel()
            await asyncio.gather(linking, return_exceptions=True)

    def send(
        self, twist: Twist, scan_seq: int, requested_scan_seq: int, *, is_stopped: bool = False
    ) -> None:
        """Send a safe command; dropped while the base is lost, zero the first time it is back."""
        command = self._gate.filter(twist)
        if command is not None:
            self._put(command, scan_seq, requested_scan_seq)

    def gather(self, take_late: TakeLate) -> None:
        """Leave odometry in the socket, as soon and as long as scans and odometry alone arrive.

        A scan still wakes the daemon: the socket becomes readable with the bytes of a scan.
        """
        self._gatherer = take_late
        self._settle_gathering()

    def read(self) -> None:
        """Hand over the frames that have arrived, unless frames are being handed over now."""
        if self._link is not None and not self._is_taking:
            self._link.read()

    def send_message(self, channel: str, payload: bytes) -> None:
        """Send a pattern's message by the simulated radio; dropped while there is no link."""
        if self._link is not None:
            self._link.send("sent", hw_codec.encode_message(self._robot, channel, payload))

    def grip(self, is_closed: bool) -> None:
        """Close or open the simulated gripper; dropped while there is no link."""
        if self._link is not None:
            self._link.send("grip", hw_codec.encode_grip(is_closed))

    async def check(self, seconds: float) -> tuple[Finding, ...]:
        """Whether scans and odometry arrive and a robot takes commands; moves nothing."""
        seen = _CheckSink(self._platform)
        task = asyncio.create_task(self.run(seen))
        try:
            async with asyncio.timeout(seconds):
                while not (len(seen.scans) >= ENOUGH_SCANS and seen.odometries and seen.has_ring):
                    await asyncio.sleep(_WATCH_PERIOD)
        except TimeoutError:
            pass  # the findings name what is missing
        finally:
            is_taken = self._link is not None and self._link.is_known
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)
        return self._findings(seen, is_taken)

    def zero_sender(self) -> ZeroSenderSpec:
        """How the watchdog sends zero to this base."""
        where = {"swarm": self._swarm, "robot": self._robot, "endpoint": self._endpoint}
        return ZeroSenderSpec(f"{__name__}:SimulatedZeroSender", where)

    def _findings(self, seen: _CheckSink, is_taken: bool) -> tuple[Finding, ...]:
        hint = "start the world first (swarmctl sim up), or correct driver_options.endpoint"
        missing = f"none from {self._robot} of swarm {self._swarm} at {self._endpoint}; {hint}"
        content = seen.content
        scans = seen.scans
        has_odometry = bool(seen.odometries)
        arrives = f"{content.text}; the platform has {len(self._platform.scan.bearings)} rays"
        taken = "is taken" if is_taken else f"no simulated robot takes commands; {hint}"
        ring = Finding("ranges", seen.has_ring, "arrive" if seen.has_ring else missing)
        return (
            Finding(
                "scan",
                content.last is not None and not content.fault,
                content.fault or (arrives if content.last is not None else missing),
            ),
            Finding("odometry", has_odometry, "arrives" if has_odometry else missing),
            *(() if self._platform.ranges is None else (ring,)),
            Finding("cmd_vel", is_taken, taken),
            scan_delay_finding(scans, seen.odometries, content.last, self._platform.scan),
        )

    def _put(self, twist: Twist, scan_seq: int, requested_scan_seq: int) -> None:
        if self._link is not None:
            command = hw_codec.encode_command(twist, scan_seq, requested_scan_seq)
            self._link.send("cmd_vel", command)

    def _take_frames(self, sink: Sink, frames: list[Frame]) -> None:
        """Take the inputs and messages of `frames`, which one read of the socket gave, in order."""
        take_late = self._take_late  # kept, since a message of `frames` may end the gathering
        chosen = self._chosen(sink, frames, is_gathered=take_late is not None)
        batch = _Batch(take_late, frames[-1], self._last_read)
        self._last_read = monotonic()
        self._is_taking = True  # `_take` may lead to a call of `read`, which then does nothing
        try:
            for frame in chosen:
                self._take(sink, frame, batch)
        finally:
            self._is_taking = False
        self._settle_gathering()

    def _settle_gathering(self) -> None:
        """Begin or end to leave odometry in the socket, also of a new connection."""
        is_gathering = self._gatherer is not None and self._kinds == {_SCAN, _ODOMETRY}
        self._take_late = self._gatherer if is_gathering else None
        if self._link is not None:
            self._link.wait_for(self._scan_size if is_gathering else 1)

    def _chosen(self, sink: Sink, frames: Sequence[Frame], *, is_gathered: bool) -> Iterable[Frame]:
        """The newest frame of each kind of input, and before these all odometry if `is_gathered`.

        Odometry comes before a scan, so that the decision on the scan uses the newest reading. An
        input with a newer input of its kind is reported as dropped, except gathered odometry.
        Hands over all messages of patterns.
        """
        odometry: list[Frame] = []
        newest: dict[str, Frame] = {}
        for frame in frames:
            name = frame.name
            if name == "received":
                self._kinds.add(name)
                self._take_messages(sink, frame.payload)
            elif name not in hw_codec.KINDS:
                sink.dropped("hw/unknown")
            elif is_gathered and name == _ODOMETRY:
                odometry.append(frame)
            else:
                if name in newest:
                    sink.dropped(f"hw/{name}:overtaken")
                newest[name] = frame
        return *odometry, *newest.values()

    def _take(self, sink: Sink, frame: Frame, batch: _Batch) -> None:
        try:
            input = hw_codec.decode_input(frame.name, frame.payload, self._platform)
        except CodecError:
            sink.dropped(f"hw/{frame.name}")
            return
        self._kinds.add(frame.name)
        age = 0.0
        if isinstance(input, ScanInput):
            size = len(frame.payload)
            self._scan_size = min(self._scan_size or size, size)
        elif isinstance(input, OdometryInput) and batch.take_late is not None:
            age = self._age(input.odometry.stamp, frame, batch)
        self._last_sample = self._last_read - age
        if not self._gate.is_open:
            self._gate.open()
            sink.state(True, f"simulated robot at {self._endpoint}")
        if batch.take_late is not None and isinstance(input, OdometryInput):
            batch.take_late(input, age)
        else:
            sink.take(input)

    def _age(self, stamp: float, frame: Frame, batch: _Batch) -> float:
        """Seconds since a reading of gathered odometry arrived.

        `stamp`: s, of the reading. If the link does not know how long `frame` has waited in the
        socket, the time from stamp to arrival is assumed to be that of the reading before (`_lag`).
        """
        now = self._last_read
        arrival = stamp + self._lag
        if frame is batch.last and self._link is not None:
            arrival = now - self._link.age
        arrival = min(max(arrival, batch.last_read), now)
        self._lag = arrival - stamp
        return now - arrival

    def _take_messages(self, sink: Sink, payload: bytes) -> None:
        if not self.carries_messages:
            return
        try:
            wires = hw_codec.decode_messages(payload)
        except CodecError:
            sink.dropped("hw/received")
            return
        for wire in wires:
            sink.message(wire.robot, wire.channel, wire.payload)

    def _watch(self, sink: Sink, now: float) -> None:
        if now - self._last_sample > SENSOR_TIMEOUT and self._take_late is not None:
            self.read()  # what waits in the socket is not missing
        if self._gate.is_open and now - self._last_sample > SENSOR_TIMEOUT:
            if self._gate.close(now):
                self._put(ZERO, -1, -1)
            sink.state(False, f"nothing from {self._endpoint} for {SENSOR_TIMEOUT:g} s")


class SimulatedZeroSender:
    """Sends zero to a simulated robot, from the watchdog's process; reconnects by itself."""

    def __init__(self, swarm: str, robot: str, endpoint: str) -> None:
        self._where = _read(endpoint)
        self._hello = Hello(swarm, robot, listens=False)
        self._link: Connection | None = None

    def open(self) -> None:
        """Connect; the robot may come later."""
        self._link = dial(self._where, self._hello, _DIAL_TIME)

    def send_zero(self) -> None:
        """Send zero once."""
        link = self._link
        if link is not None:
            link.receive()  # finds the end of the connection
        if link is None or not link.is_open:
            self.close()
            self.open()
        if self._link is not None:
            self._link.send("cmd_vel", hw_codec.encode_command(ZERO, -1, -1))

    def close(self) -> None:
        """Close the connection."""
        if self._link is not None:
            self._link.close()


class _CheckSink(NullSink):
    """A sink that keeps what scans show, and arrivals and stamps of scans and odometry."""

    def __init__(self, platform: Platform) -> None:
        self.content = ScanContent(platform.scan, gaps=Footprint(platform.footprint).gaps)
        self.has_ring = platform.ranges is None
        self.scans: list[tuple[float, float]] = []
        self.odometries: list[tuple[float, float]] = []

    def take(self, input: SensorInput) -> None:
        """Keep a scan, the stamp of an odometry, and that the ring has measured."""
        match input:
            case ScanInput(scan=scan):
                self.content.take(scan)
                self.scans.append((monotonic(), scan.stamp))
            case RangesInput():
                self.has_ring = True
            case OdometryInput(odometry=odometry):
                self.odometries.append((monotonic(), odometry.stamp))


def _read(endpoint: str) -> Endpoint:
    return read_endpoint(endpoint, "driver simulated: endpoint is ", DEFAULT_ENDPOINT)
