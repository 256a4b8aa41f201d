"""Drivers for the wire, each broken in one way."""

from __future__ import annotations

import asyncio
import contextlib
import os
import subprocess
import sys
import threading
import time
from dataclasses import replace

import numpy as np

from swarmd.core.errors import CodecError
from swarmd.core.values import ZERO, Odometry, Pose, Scan, Twist
from swarmd.driver_api.driver import Finding, Sink
from tests.support.wire import SPEC, Good

# Beginnings


class HandsOnTooEarly(Good):
    def hear(self, sink: Sink, name: str, payload: bytes) -> None:
        with contextlib.suppress(CodecError):
            self.deliver(sink, self.decode(name, payload))
        super().hear(sink, name, payload)


class NeverSaysThere(Good):
    def reconnect(self, sink: Sink) -> None:
        self.is_up = True


class ThereFromTheFirst(Good):
    async def run(self, sink: Sink) -> None:
        sink.state(True, "surely there")
        self.is_up, self.heard_at = True, time.monotonic() + 60.0
        await super().run(sink)


class KeepsForLater(Good):
    late: Twist | None = None

    def send(self, twist: Twist, scan_seq: int, requested_scan_seq: int) -> None:
        if not self.is_up:
            self.late = twist
        super().send(twist, scan_seq, requested_scan_seq)

    def reconnect(self, sink: Sink) -> None:
        super().reconnect(sink)
        if self.late is not None:
            self.put(self.late)


class BeginsAsTold(Good):
    def send(self, twist: Twist, scan_seq: int, requested_scan_seq: int) -> None:
        self.owes_zero = False
        super().send(twist, scan_seq, requested_scan_seq)


class OwesZeroForEver(Good):
    def put(self, twist: Twist) -> None:
        super().put(ZERO)


class TurnsTheOtherWay(Good):
    def put(self, twist: Twist) -> None:
        super().put(Twist(twist.linear, -twist.angular))


# Losses


class NeverLosesIt(Good):
    silence = 1e9


class LosesItWithoutAWord(Good):
    def fall(self, sink: Sink) -> None:
        self.is_up = False
        self.put(ZERO)
        sink.state(False, "")


class GoesOnWhenItIsBack(Good):
    was_up = False

    def reconnect(self, sink: Sink) -> None:
        super().reconnect(sink)
        if self.was_up:
            self.owes_zero = False
        self.was_up = True


class FallsWithoutZero(Good):
    def fall(self, sink: Sink) -> None:
        self.is_up = False
        sink.state(False, "nothing heard for a while")


class EndsWhenItIsLost(Good):
    def fall(self, sink: Sink) -> None:
        super().fall(sink)
        self.fault = RuntimeError("lost")


class CallsASlowSensorSilent(Good):
    def on_odometry(self, sink: Sink, odometry: Odometry) -> None:
        super().on_odometry(sink, odometry)
        if time.monotonic() - self.last_scan > 0.7:
            self.heard_at = 0.0

    last_scan = 0.0

    def on_scan(self, sink: Sink, scan: Scan) -> None:
        self.last_scan = time.monotonic()
        super().on_scan(sink, scan)


class HearsOneInThree(Good):
    count = 0

    def on_scan(self, sink: Sink, scan: Scan) -> None:
        self.count += 1
        if self.count % 3 == 0 or scan.seq < 1000:
            super().on_scan(sink, scan)


# Ends


class StopsOnlyIfCancelled(Good):
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
    def send(self, twist: Twist, scan_seq: int, requested_scan_seq: int) -> None:
        if self.has_ended:
            self.put(twist)
        super().send(twist, scan_seq, requested_scan_seq)

    has_ended = False

    def leave(self, error: BaseException) -> None:
        super().leave(error)
        self.has_ended = True


class RepeatsItself(Good):
    """A helper of its own says the last command again and again, a little longer than `run`."""

    last = ZERO

    def put(self, twist: Twist) -> None:
        super().put(twist)
        if not twist.is_zero:
            self.last = twist

    def leave(self, error: BaseException) -> None:
        super().leave(error)
        asyncio.get_running_loop().call_later(0.1, self.put, self.last)


class WaitsForTheBase(Good):
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


# What it hears


class DiesOfGarbage(Good):
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


class TakesGarbage(Good):
    def hear(self, sink: Sink, name: str, payload: bytes) -> None:
        super().hear(sink, name, payload)
        if name == "scan" and len(payload) > 100 and payload[0] != 0xFF:
            with contextlib.suppress(CodecError):
                self.decode(name, payload)
                return
            sink.scan(Scan(0, 0.0, np.ones(360), SPEC.bearings, SPEC.range_min, SPEC.range_max))


class TakesUnknownForNothing(Good):
    def on_scan(self, sink: Sink, scan: Scan) -> None:
        ranges = np.where(np.isnan(scan.ranges), np.inf, scan.ranges)
        sink.scan(replace(scan, ranges=ranges))


class DropsBlindSweeps(Good):
    def on_scan(self, sink: Sink, scan: Scan) -> None:
        if np.isfinite(scan.ranges).any():
            sink.scan(scan)


class KnowsHowManyRays(Good):
    def on_scan(self, sink: Sink, scan: Scan) -> None:
        ranges = np.resize(scan.ranges, 360)
        sink.scan(replace(scan, ranges=ranges, bearings=SPEC.bearings))


class KnowsTheBearings(Good):
    def on_scan(self, sink: Sink, scan: Scan) -> None:
        bearings = np.resize(SPEC.bearings, len(scan.ranges))
        sink.scan(replace(scan, bearings=bearings))


class CountsNothing(Good):
    def on_scan(self, sink: Sink, scan: Scan) -> None:
        sink.scan(replace(scan, seq=1))


class HasNoClock(Good):
    def on_scan(self, sink: Sink, scan: Scan) -> None:
        sink.scan(replace(scan, stamp=1.0))


class IsHalfPrecise(Good):
    def on_scan(self, sink: Sink, scan: Scan) -> None:
        sink.scan(replace(scan, ranges=scan.ranges.astype(np.float32)))


class BelievesTheMessage(Good):
    def on_scan(self, sink: Sink, scan: Scan) -> None:
        sink.scan(replace(scan, range_max=100.0))


class IsNowhere(Good):
    def on_odometry(self, sink: Sink, odometry: Odometry) -> None:
        sink.odometry(Odometry(odometry.stamp, Pose(np.nan, 0.0, 0.0), odometry.twist))


class StandsStillInTime(Good):
    def on_odometry(self, sink: Sink, odometry: Odometry) -> None:
        sink.odometry(Odometry(1.0, odometry.pose, odometry.twist))


class SpeaksFromAThread(Good):
    def on_scan(self, sink: Sink, scan: Scan) -> None:
        thread = threading.Thread(target=sink.scan, args=(scan,))
        thread.start()
        thread.join()


# Looking, and options


class MovesWhenItLooks(Good):
    async def check(self, seconds: float) -> tuple[Finding, ...]:
        self.put(ZERO)
        return await super().check(seconds)


class SeesWhatIsNotThere(Good):
    async def check(self, seconds: float) -> tuple[Finding, ...]:
        return (Finding("scan", True, "arrives"),)


class SeesNothing(Good):
    async def check(self, seconds: float) -> tuple[Finding, ...]:
        return (Finding("scan", False, "none; start the robot"),)


class SaysNoWhy(Good):
    async def check(self, seconds: float) -> tuple[Finding, ...]:
        return tuple(Finding(f.subject, f.is_well, "") for f in await super().check(seconds))


class TakesAnyOption(Good):
    def refuse(self, name: str) -> None:
        pass
