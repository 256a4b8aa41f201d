"""A base within this process, spoken to in bytes, and a driver for it that is as it should be."""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from swarmd.core.errors import CodecError, ConfigError, unknown
from swarmd.core.events import HazardsInput, OdometryInput, RangesInput, ScanInput
from swarmd.core.finding import Finding
from swarmd.core.hazard import Hazard, HazardKind
from swarmd.core.values import ZERO, Array, Odometry, Pose, Scan, Twist, Value
from swarmd.driver_api.driver import Driver, Sink
from swarmd.driver_api.hw_codec import decode_odometry, decode_scan, encode_odometry, encode_scan
from tests.support.range_ring import with_ring

PLATFORM = with_ring("burger")
SPEC = PLATFORM.scan
assert PLATFORM.ranges is not None
RING = PLATFORM.ranges
SILENCE = 0.5
NOT_HEARD = Hazard(HazardKind.NOT_HEARD, "bumper")
Hearer = Callable[[str, bytes], None]


class Wire:
    """A base within this process, spoken to in bytes: a rig."""

    platform = PLATFORM
    hazard = Hazard(HazardKind.BUMP, "front")
    hazard_options: Mapping[str, Value] = {"hazards": True}

    def __init__(self, kind: type[Good]) -> None:
        self._kind = kind
        self.hearers: list[Hearer] = []
        self._taken: list[Twist] = []
        self._is_there = True
        self._spoken = 0

    def make(self, options: Mapping[str, Value]) -> Driver:
        return self._kind(self, options)

    def take(self, twist: Twist) -> None:
        if self._is_there:
            self._taken.append(twist)

    def publish(self) -> None:
        ranges = np.full(360, 1.5)
        ranges[0] = 1.0 + 0.01 * self._spoken
        self.publish_scan(Scan(self._spoken, 0.1 * self._spoken, ranges, SPEC.bearings, 0.1, 99.0))
        self.publish_odometry()

    def publish_scan(self, scan: Scan) -> None:
        self._emit("scan", encode_scan(scan))

    def publish_ranges(self, ranges: Array) -> None:
        self._spoken += 1
        scan = Scan(self._spoken, 0.1 * self._spoken, ranges, RING.bearings, 0.1, 99.0)
        self._emit("ranges", encode_scan(scan))

    def publish_odometry(self) -> None:
        self._spoken += 1
        odometry = Odometry(0.1 * self._spoken, Pose(), Twist(0.1))
        self._emit("odometry", encode_odometry(odometry))

    def publish_hazard(self, *, is_present: bool) -> None:
        self._emit("bumper", bytes([is_present]))

    def publish_garbage(self) -> None:
        whole = encode_scan(Scan(1, 0.1, np.full(360, 1.5), SPEC.bearings, 0.1, 3.5))
        for name in ("scan", "odometry"):
            for payload in (b"", b"\xff" * 80, whole[: len(whole) // 2]):
                self._emit(name, payload)

    def disconnect(self) -> None:
        self._is_there = False

    def reconnect(self) -> None:
        self._is_there = True

    def commands(self) -> Sequence[Twist]:
        taken, self._taken = self._taken, []
        return taken

    def close(self) -> None:
        self.hearers.clear()

    def _emit(self, name: str, payload: bytes) -> None:
        for hearer in [*self.hearers] if self._is_there else []:
            hearer(name, payload)


class Good:
    """A driver for it that is as it should be, in pieces that others break."""

    is_simulated = False
    silence = SILENCE
    bumper_silence = 0.3

    def __init__(self, wire: Wire, options: Mapping[str, Value]) -> None:
        for name in options.keys() - {"hazards"}:
            self.refuse(name)
        self.has_hazards = "hazards" in options
        self.wire = wire
        self.bumped_at = -math.inf
        self.told: tuple[Hazard, ...] | None = None
        self.fault: Exception | None = None
        self.heard_at = 0.0
        self.is_up = self.has_sent = False
        self.owes_zero = True

    def refuse(self, name: str) -> None:
        raise ConfigError(f"driver wire: {unknown('option', name, ('endpoint',))}")

    async def run(self, sink: Sink) -> None:
        sink.state(False, "nothing heard yet")

        def hear(name: str, payload: bytes) -> None:
            self.hear(sink, name, payload)

        self.wire.hearers.append(hear)
        try:
            await self.watch(sink)
        except BaseException as error:
            self.leave(error)
            raise
        finally:
            with contextlib.suppress(ValueError):
                self.wire.hearers.remove(hear)
            self.is_up, self.owes_zero, self.has_sent = False, True, False

    async def watch(self, sink: Sink) -> None:
        while self.fault is None:
            await asyncio.sleep(0.02)
            if self.is_up and time.monotonic() - self.heard_at > self.silence:
                self.fall(sink)
            if self.has_hazards and time.monotonic() - self.bumped_at > self.bumper_silence:
                self.tell(sink, (NOT_HEARD,))
        raise self.fault

    def leave(self, error: BaseException) -> None:
        if self.has_sent:
            self.put(ZERO)

    def fall(self, sink: Sink) -> None:
        self.is_up = False
        if self.has_sent:
            self.put(ZERO)
        sink.state(False, "nothing heard for a while")

    def tell(self, sink: Sink, hazards: tuple[Hazard, ...]) -> None:
        if self.is_up and self.has_hazards and hazards != self.told:
            self.told = hazards
            sink.take(HazardsInput(hazards))

    def hear(self, sink: Sink, name: str, payload: bytes) -> None:
        if name == "bumper":
            self.bumped_at = time.monotonic()
            self.tell(sink, (Wire.hazard,) if payload[0] else ())
            return
        try:
            heard = self.decode(name, payload)
        except CodecError:
            sink.dropped(name)
            return
        self.reconnect(sink)
        if name == "ranges" and isinstance(heard, Scan):
            self.on_ranges(sink, heard)
        else:
            self.deliver(sink, heard)

    def reconnect(self, sink: Sink) -> None:
        self.heard_at = time.monotonic()
        if not self.is_up:
            self.is_up = self.owes_zero = True
            sink.state(True, "there")
            self.told = None
            self.tell(sink, (NOT_HEARD,))

    def decode(self, name: str, payload: bytes) -> Scan | Odometry:
        if name == "odometry":
            return decode_odometry(payload)
        return decode_scan(payload, SPEC if name == "scan" else RING)

    def deliver(self, sink: Sink, heard: Scan | Odometry) -> None:
        if isinstance(heard, Scan):
            self.on_scan(sink, heard)
        else:
            self.on_odometry(sink, heard)

    def on_scan(self, sink: Sink, scan: Scan) -> None:
        sink.take(ScanInput(scan))

    def on_ranges(self, sink: Sink, scan: Scan) -> None:
        sink.take(RangesInput(scan))

    def on_odometry(self, sink: Sink, odometry: Odometry) -> None:
        sink.take(OdometryInput(odometry))

    def send(
        self, twist: Twist, scan_seq: int, requested_scan_seq: int, *, is_stopped: bool = False
    ) -> None:
        if not self.is_up:
            return
        if self.owes_zero:
            self.owes_zero, twist = False, ZERO
        self.has_sent = True
        self.put(twist)

    def put(self, twist: Twist) -> None:
        self.wire.take(twist)

    async def check(self, seconds: float) -> tuple[Finding, ...]:
        heard: list[str] = []

        def hear(name: str, payload: bytes) -> None:
            heard.append(name)

        self.wire.hearers.append(hear)
        deadline = time.monotonic() + seconds
        while not heard and time.monotonic() < deadline:
            await asyncio.sleep(0.01)
        return (Finding("scan", bool(heard), "arrives" if heard else "none; start the robot"),)
