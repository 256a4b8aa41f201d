"""Drivers for the wire, each broken in one way."""

from __future__ import annotations

import asyncio
import contextlib
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable

import numpy as np
from msgspec import structs
from msgspec.structs import replace

from swarmd.core.errors import CodecError
from swarmd.core.events import OdometryInput, RangesInput, ScanInput
from swarmd.core.finding import Finding
from swarmd.core.hazard import Hazard
from swarmd.core.values import ZERO, Odometry, Pose, Scan, Twist
from swarmd.driver_api.driver import Sink
from tests.support.wire import SPEC, Good

# Beginnings


class DeliversTooEarly(Good):
    def hear(self, sink: Sink, name: str, payload: bytes) -> None:
        with contextlib.suppress(CodecError):
            self.deliver(sink, self.decode(name, payload))
        super().hear(sink, name, payload)


class NeverReportsUp(Good):
    def reconnect(self, sink: Sink) -> None:
        self.is_up = True


class ReportsUpAtOnce(Good):
    async def run(self, sink: Sink) -> None:
        sink.state(True, "surely there")
        self.is_up, self.heard_at = True, time.monotonic() + 60.0
        await super().run(sink)


class QueuesCommands(Good):
    late: Twist | None = None

    def send(
        self, twist: Twist, scan_seq: int, requested_scan_seq: int, *, is_stopped: bool = False
    ) -> None:
        if not self.is_up:
            self.late = twist
        super().send(twist, scan_seq, requested_scan_seq, is_stopped=is_stopped)

    def reconnect(self, sink: Sink) -> None:
        super().reconnect(sink)
        if self.late is not None:
            self.put(self.late)


class TakesSilenceForNoHazard(Good):
    bumper_silence = 1e9


class NeverTellsTheEndOfAHazard(Good):
    def tell(self, sink: Sink, hazards: tuple[Hazard, ...]) -> None:
        if hazards:
            super().tell(sink, hazards)


class TellsHazardsAfterTheFirstScan(Good):
    def reconnect(self, sink: Sink) -> None:
        has_hazards, self.has_hazards = self.has_hazards, False
        super().reconnect(sink)
        self.has_hazards = has_hazards


class DeliversTheRingAsScan(Good):
    def on_ranges(self, sink: Sink, scan: Scan) -> None:
        sink.take(ScanInput(scan))


class RepeatsTheStampOfTheRing(Good):
    def on_ranges(self, sink: Sink, scan: Scan) -> None:
        sink.take(RangesInput(replace(scan, stamp=1.0)))


class DropsCommandsOfStoppedRobots(Good):
    def send(
        self, twist: Twist, scan_seq: int, requested_scan_seq: int, *, is_stopped: bool = False
    ) -> None:
        if not is_stopped:
            super().send(twist, scan_seq, requested_scan_seq)


class StartsWithoutZero(Good):
    def send(
        self, twist: Twist, scan_seq: int, requested_scan_seq: int, *, is_stopped: bool = False
    ) -> None:
        self.owes_zero = False
        super().send(twist, scan_seq, requested_scan_seq, is_stopped=is_stopped)


class SendsOnlyZero(Good):
    def put(self, twist: Twist) -> None:
        super().put(ZERO)


class ReversesTurns(Good):
    def put(self, twist: Twist) -> None:
        super().put(Twist(twist.linear, -twist.angular))


# Losses


class NeverReportsLost(Good):
    silence = 1e9


class ReportsLostWithoutReason(Good):
    def fall(self, sink: Sink) -> None:
        self.is_up = False
        self.put(ZERO)
        sink.state(False, "")


class ResumesWithoutZero(Good):
    was_up = False

    def reconnect(self, sink: Sink) -> None:
        super().reconnect(sink)
        if self.was_up:
            self.owes_zero = False
        self.was_up = True


class IsLostWithoutZero(Good):
    def fall(self, sink: Sink) -> None:
        self.is_up = False
        sink.state(False, "nothing heard for a while")


class EndsWhenLost(Good):
    def fall(self, sink: Sink) -> None:
        super().fall(sink)
        self.fault = RuntimeError("lost")


class LosesSlowSensors(Good):
    def on_odometry(self, sink: Sink, odometry: Odometry) -> None:
        super().on_odometry(sink, odometry)
        if time.monotonic() - self.last_scan > 0.7:
            self.heard_at = 0.0

    last_scan = 0.0

    def on_scan(self, sink: Sink, scan: Scan) -> None:
        self.last_scan = time.monotonic()
        super().on_scan(sink, scan)


class DropsTwoScansOfThree(Good):
    count = 0

    def on_scan(self, sink: Sink, scan: Scan) -> None:
        self.count += 1
        if self.count % 3 == 0 or scan.seq < 1000:
            super().on_scan(sink, scan)


# Ends


class SendsZeroOnlyIfCancelled(Good):
    def leave(self, error: BaseException) -> None:
        if isinstance(error, asyncio.CancelledError):
            super().leave(error)

    def fall(self, sink: Sink) -> None:
        self.is_up = False
        try:
            sink.state(False, "nothing heard for a while")
        except RuntimeError as error:
            self.fault = error
        else:
            self.put(ZERO)


class SendsAfterItsEnd(Good):
    def send(
        self, twist: Twist, scan_seq: int, requested_scan_seq: int, *, is_stopped: bool = False
    ) -> None:
        if self.has_ended:
            self.put(twist)
        super().send(twist, scan_seq, requested_scan_seq, is_stopped=is_stopped)

    has_ended = False

    def leave(self, error: BaseException) -> None:
        super().leave(error)
        self.has_ended = True


class RepeatsAfterItsEnd(Good):
    """A timer of its own sends the last command once more, 0.1 s after the end of `run`."""

    last = ZERO

    def put(self, twist: Twist) -> None:
        super().put(twist)
        if not twist.is_zero:
            self.last = twist

    def leave(self, error: BaseException) -> None:
        super().leave(error)
        asyncio.get_running_loop().call_later(0.1, self.put, self.last)


class BlocksInSend(Good):
    def put(self, twist: Twist) -> None:
        time.sleep(0.02)
        super().put(twist)


class RunsOnce(Good):
    has_run = False

    async def run(self, sink: Sink) -> None:
        if self.has_run:
            raise RuntimeError("has ended")
        self.has_run = True
        await super().run(sink)


class LeavesATask(Good):
    async def run(self, sink: Sink) -> None:
        self.task = asyncio.create_task(asyncio.sleep(60.0))
        await super().run(sink)


class LeavesASocket(Good):
    async def run(self, sink: Sink) -> None:
        self.ends = [*getattr(self, "ends", []), os.open("/dev/null", os.O_RDONLY)]
        await super().run(sink)


class LeavesAProcess(Good):
    async def run(self, sink: Sink) -> None:
        code = "import os, time; os.fork() and os._exit(0); time.sleep(6)"
        subprocess.run([sys.executable, "-c", code], start_new_session=True, check=True)
        await super().run(sink)


# Inputs


class EndsOnGarbage(Good):
    def hear(self, sink: Sink, name: str, payload: bytes) -> None:
        try:
            self.decode(name, payload)
        except CodecError as error:
            self.fault = error
        super().hear(sink, name, payload)


class CountsNoGarbage(Good):
    def hear(self, sink: Sink, name: str, payload: bytes) -> None:
        with contextlib.suppress(CodecError):
            self.decode(name, payload)
            super().hear(sink, name, payload)


class DeliversGarbage(Good):
    def hear(self, sink: Sink, name: str, payload: bytes) -> None:
        super().hear(sink, name, payload)
        if name == "scan" and len(payload) > 100 and payload[0] != 0xFF:
            with contextlib.suppress(CodecError):
                self.decode(name, payload)
                return
            scan = Scan(0, 0.0, np.ones(360), SPEC.bearings, SPEC.range_min, SPEC.range_max)
            sink.take(ScanInput(scan))


def with_scans(name: str, change: Callable[[Scan], Scan]) -> type[Good]:
    def on_scan(self: Good, sink: Sink, scan: Scan) -> None:
        sink.take(ScanInput(change(scan)))

    return type(name, (Good,), {"on_scan": on_scan})


def with_odometry(name: str, change: Callable[[Odometry], Odometry]) -> type[Good]:
    def on_odometry(self: Good, sink: Sink, odometry: Odometry) -> None:
        sink.take(OdometryInput(change(odometry)))

    return type(name, (Good,), {"on_odometry": on_odometry})


def with_findings(name: str, change: Callable[[Finding], Finding]) -> type[Good]:
    async def check(self: Good, seconds: float) -> tuple[Finding, ...]:
        return tuple(map(change, await Good.check(self, seconds)))

    return type(name, (Good,), {"check": check})


WRONG_SCANS = [
    with_scans("same sequence", lambda scan: replace(scan, seq=1)),
    with_scans("same stamp", lambda scan: replace(scan, stamp=1.0)),
    with_scans("float32", lambda scan: replace(scan, ranges=scan.ranges.astype(np.float32))),
    with_scans("range limit of the message", lambda scan: replace(scan, range_max=100.0)),
]
NAN_AS_INFINITY = with_scans(
    "NaN as infinity",
    lambda scan: replace(scan, ranges=np.where(np.isnan(scan.ranges), np.inf, scan.ranges)),
)
FIXED_COUNT = with_scans(
    "fixed count of rays",
    lambda scan: replace(scan, ranges=np.resize(scan.ranges, 360), bearings=SPEC.bearings),
)
FIXED_BEARINGS = with_scans(
    "fixed bearings",
    lambda scan: replace(scan, bearings=np.resize(SPEC.bearings, len(scan.ranges))),
)
WRONG_ODOMETRY = [
    with_odometry("NaN pose", lambda one: Odometry(one.stamp, Pose(np.nan, 0.0, 0.0), one.twist)),
    with_odometry("same stamp", lambda one: Odometry(1.0, one.pose, one.twist)),
]
ALWAYS_WELL = with_findings("always well", lambda one: structs.replace(one, is_well=True))
NEVER_WELL = with_findings("never well", lambda one: structs.replace(one, is_well=False))
NO_REASON = with_findings("no reason", lambda one: structs.replace(one, text=""))


class DropsScansWithoutReturns(Good):
    def on_scan(self, sink: Sink, scan: Scan) -> None:
        if np.isfinite(scan.ranges).any():
            sink.take(ScanInput(scan))


class DeliversFromAThread(Good):
    def on_scan(self, sink: Sink, scan: Scan) -> None:
        thread = threading.Thread(target=sink.take, args=(ScanInput(scan),))
        thread.start()
        thread.join()


# Checks, and options


class SendsDuringCheck(Good):
    async def check(self, seconds: float) -> tuple[Finding, ...]:
        self.put(ZERO)
        return await super().check(seconds)


class AcceptsAnyOption(Good):
    def refuse(self, name: str) -> None:
        pass
