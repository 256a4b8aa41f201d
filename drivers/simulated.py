"""A simulated robot of a world process, reached over the `hw/*` keys."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Mapping
from functools import partial
from time import monotonic

import zenoh
from msgspec import Struct

from swarmd.core import keys
from swarmd.core.errors import CodecError
from swarmd.core.finding import Finding
from swarmd.core.threads import hand_over
from swarmd.core.values import ZERO, Odometry, Platform, Scan, ScanSpec, Twist, Value
from swarmd.driver_api import hw_codec
from swarmd.driver_api.command_gate import CommandGate
from swarmd.driver_api.driver import NullSink, Sink, ZeroSenderSpec
from swarmd.drivers.latest_samples import LatestSamples
from swarmd.drivers.scan_content import ENOUGH_SCANS, ScanContent
from swarmd.drivers.scan_delay import scan_delay_finding
from swarmd.network.carriers.session import (
    PROMPT_OPTIONS,
    has_subscriber,
    open_in_thread,
    open_with,
    realtime_publisher,
)
from swarmd.network.settings import parse_endpoint
from swarmd.settings.layered import Layered

DEFAULT_ENDPOINT = "tcp/127.0.0.1:7790"
SENSOR_TIMEOUT = 1.0
"""Seconds without any sample after which the base counts as lost."""

_WATCH_PERIOD = 0.1


class SimulatedOptions(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`endpoint`: where the world listens. `radio`: the world carries the patterns' messages."""

    endpoint: str = DEFAULT_ENDPOINT
    radio: bool = False


class SimulatedDriver:
    """Connects to one robot of a world process through a Zenoh session of its own."""

    is_simulated = True

    def __init__(
        self, *, swarm: str, robot: str, platform: Platform, options: Mapping[str, Value]
    ) -> None:
        """Not connected yet. Options: `SimulatedOptions`."""
        self._robot, self._swarm, self._platform = robot, swarm, platform
        hw_codec.check_measures(platform)
        chosen = Layered(("driver simulated", options)).build(SimulatedOptions)
        self._endpoint, self.carries_messages = chosen.endpoint, chosen.radio
        parse_endpoint(self._endpoint, "driver simulated: endpoint is ", DEFAULT_ENDPOINT)
        self._commands: zenoh.Publisher | None = None
        self._sent: zenoh.Publisher | None = None
        self._gate = CommandGate()
        self._last_sample = -math.inf

    async def run(self, sink: Sink) -> None:
        """Feed the sink until cancelled; the session reconnects by itself."""
        loop = asyncio.get_running_loop()
        sink.state(False, f"no simulated robot yet at {self._endpoint}")
        session = await open_in_thread(partial(_session, self._endpoint, self._robot))
        inbox = LatestSamples(
            loop,
            lambda name, payload: self._take(sink, name, payload),
            lambda what: sink.dropped(f"hw/{what}"),
        )
        try:
            self._commands = realtime_publisher(session, self._key("cmd_vel"))
            for name in hw_codec.INPUTS:
                session.declare_subscriber(self._key(name), inbox.receiver(name, self._key(name)))
            if self.carries_messages:
                self._sent = session.declare_publisher(self._key("sent"))
                received = partial(hand_over, loop, partial(self._take_messages, sink))
                session.declare_subscriber(self._key("received"), received)
            while True:
                await asyncio.sleep(_WATCH_PERIOD)
                self._watch(sink, loop.time())
        finally:
            inbox.close()
            try:
                if self._gate.end():
                    self._put(ZERO, -1, -1)
            finally:  # an open session would keep the process for ever
                self._commands = self._sent = None
                session.close()

    def send(
        self, twist: Twist, scan_seq: int, requested_scan_seq: int, *, is_stopped: bool = False
    ) -> None:
        """Send a safe command; dropped while the base is lost, zero the first time it is back."""
        command = self._gate.filter(twist)
        if command is not None:
            self._put(command, scan_seq, requested_scan_seq)

    def send_message(self, channel: str, payload: bytes) -> None:
        """Send a pattern's message by the simulated radio; dropped while there is no session."""
        if self._sent is not None:
            self._sent.put(hw_codec.encode_message(self._robot, channel, payload))

    async def check(self, seconds: float) -> tuple[Finding, ...]:
        """Whether scans and odometry arrive and commands have a subscriber; moves nothing."""
        seen = _CheckSink(self._platform.scan)
        task = asyncio.create_task(self.run(seen))
        try:
            async with asyncio.timeout(seconds):
                while not (len(seen.scans) >= ENOUGH_SCANS and seen.odometries):
                    await asyncio.sleep(_WATCH_PERIOD)
        except TimeoutError:
            pass  # the findings name what is missing
        finally:
            is_taken = self._commands is not None and has_subscriber(self._commands)
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
        content, scans = seen.content, seen.scans
        has_odometry = bool(seen.odometries)
        arrives = f"{content.text}; the platform has {len(self._platform.scan.bearings)} rays"
        taken = "has a subscriber" if is_taken else f"no simulated robot takes commands; {hint}"
        return (
            Finding(
                "scan",
                content.last is not None and not content.fault,
                content.fault or (arrives if content.last is not None else missing),
            ),
            Finding("odometry", has_odometry, "arrives" if has_odometry else missing),
            Finding("cmd_vel", is_taken, taken),
            scan_delay_finding(scans, seen.odometries, content.last, self._platform.scan),
        )

    def _key(self, name: str) -> str:
        return keys.build(self._swarm, self._robot, "hw", name)

    def _put(self, twist: Twist, scan_seq: int, requested_scan_seq: int) -> None:
        if self._commands is not None:
            self._commands.put(hw_codec.encode_command(twist, scan_seq, requested_scan_seq))

    def _take(self, sink: Sink, name: str, payload: bytes) -> None:
        try:
            value = hw_codec.decode_input(name, payload, self._platform.scan)
        except CodecError:
            sink.dropped(f"hw/{name}")
            return
        self._last_sample = asyncio.get_running_loop().time()
        if not self._gate.is_open:
            self._gate.open()
            sink.state(True, f"simulated robot at {self._endpoint}")
        hw_codec.deliver(sink, value)

    def _take_messages(self, sink: Sink, sample: zenoh.Sample) -> None:
        try:
            wires = hw_codec.decode_messages(sample.payload.to_bytes())
        except CodecError:
            sink.dropped("hw/received")
            return
        for wire in wires:
            sink.message(wire.robot, wire.channel, wire.payload)

    def _watch(self, sink: Sink, now: float) -> None:
        if self._gate.is_open and now - self._last_sample > SENSOR_TIMEOUT:
            if self._gate.close(now):
                self._put(ZERO, -1, -1)
            sink.state(False, f"nothing from {self._endpoint} for {SENSOR_TIMEOUT:g} s")


class SimulatedZeroSender:
    """Sends zero to a simulated robot, from the watchdog's process; reconnects by itself."""

    def __init__(self, swarm: str, robot: str, endpoint: str) -> None:
        self._robot, self._endpoint = robot, endpoint
        self._key = keys.build(swarm, robot, "hw", "cmd_vel")

    def open(self) -> None:
        """Open a session; the robot may come later."""
        self._session = _session(self._endpoint, self._robot)
        self._commands = realtime_publisher(self._session, self._key)

    def send_zero(self) -> None:
        """Send zero once."""
        self._commands.put(hw_codec.encode_command(ZERO, -1, -1))

    def close(self) -> None:
        """Close the session."""
        self._session.close()


class _CheckSink(NullSink):
    """A sink that keeps what scans show, and arrivals and stamps of scans and odometry."""

    def __init__(self, spec: ScanSpec) -> None:
        self.content = ScanContent(spec)
        self.scans: list[tuple[float, float]] = []
        self.odometries: list[tuple[float, float]] = []

    def scan(self, scan: Scan) -> None:
        """Keep it and its stamp."""
        self.content.take(scan)
        self.scans.append((monotonic(), scan.stamp))

    def odometry(self, odometry: Odometry) -> None:
        """Keep its stamp."""
        self.odometries.append((monotonic(), odometry.stamp))


def _session(endpoint: str, robot: str) -> zenoh.Session:
    options: dict[str, object] = {
        **PROMPT_OPTIONS,
        "mode": "peer",
        "listen/endpoints": [],
        "connect/endpoints": [endpoint],
        # Retries for ever, as long as connect/timeout_ms is left alone: 0 there means once.
        "connect/retry": {
            "period_init_ms": 500,
            "period_max_ms": 500,
            "period_increase_factor": 1.0,
        },
        # A world that ends closes its socket; a frozen world keeps its link.
        "transport/link/tx/lease": 60_000,
    }
    return open_with(options, what=f"the simulated robot {robot} at {endpoint}")
