"""A scripted body: speaks like the simulated world, but does what a test tells it.

It listens on loopback for the daemon's simulated driver. Scans and odometry are published from a
thread of its own at their nominal rates; `scans` makes each scan and can be replaced at any time.
"""

from __future__ import annotations

import math
import select
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from types import TracebackType

from swarmd.core.clock import boottime
from swarmd.core.errors import CodecError
from swarmd.core.values import Odometry, Platform, Pose, Scan, Twist
from swarmd.driver_api.hw_codec import decode_command, encode_odometry, encode_scan
from swarmd.link.carriers.robot_link import RobotServer
from swarmd.settings.platforms import load_platform
from swarmd.testing.scans import empty_scan

CAP = 60.0
ODOMETRY_RATE = 20.0
IN_FLIGHT = 3
LATE = 0.2
"""s between two messages of odometry, meant 0.05 s apart, of a body that a stall has stopped."""
LOST = 2.0
"""s after such a stall, in which zeros of a lost base may be read."""
ScanScript = Callable[[int, float], Scan | bytes | None]


@dataclass(frozen=True, slots=True)
class Commanded:
    """A command as it arrived. `at` on CLOCK_BOOTTIME in s."""

    at: float
    twist: Twist
    scan_seq: int
    requested_scan_seq: int


class Body:
    """One robot's body; a context manager.

    `endpoint` is where the daemon's driver finds it; one that is given is that of a body which
    was there before and returns.
    """

    def __init__(
        self,
        platform: Platform,
        *,
        swarm: str,
        robot: str,
        rate: float | None = None,
        endpoint: str | None = None,
    ) -> None:
        self.platform = platform
        self.robot = robot
        self.scans: ScanScript = self.clear
        self.odometry: Twist | None = Twist()
        self.commands: list[Commanded] = []
        self.swarm = swarm
        self._period = 1.0 / (rate or platform.scan.rate)
        self._changed = threading.Condition()
        self._late_at, self._turned_at = 0.0, math.inf
        self._stopping = threading.Event()
        self._threads = [
            threading.Thread(target=run, name=f"body {robot}", daemon=True)
            for run in (self._publish, self._receive)
        ]
        self._server = RobotServer(endpoint or "tcp/127.0.0.1:0", swarm, (robot,), "the body")
        self._sending = threading.Lock()
        self.endpoint = self._server.endpoint

    def __enter__(self) -> Body:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Be gone, as a body whose plug is pulled; harmless if it is already."""
        if not self._stopping.is_set():
            self._stopping.set()
            for thread in self._threads:
                if thread.ident is not None:
                    thread.join(CAP)
            self._server.close()

    def clear(self, seq: int, stamp: float, distance: float = 3.0) -> Scan:
        """A scan in which every ray returns `distance` m."""
        return empty_scan(self.platform, seq, stamp, distance)

    def put(self, name: str, payload: bytes) -> None:
        """Send any frame to whoever is linked to this body, and lose nothing of it."""
        while not self._send(name, payload) and not self._stopping.is_set():
            self._stopping.wait(0.002)

    def _send(self, name: str, payload: bytes) -> bool:
        with self._sending:
            return self._server.send(self.robot, name, payload)

    def wait(self, what: Callable[[Commanded], bool], since: float = 0.0) -> Commanded:
        """The first command after `since` for which `what` holds; AssertionError after a minute."""
        deadline = time.monotonic() + CAP
        with self._changed:
            while True:
                for command in self.commands:
                    if command.at > since and what(command):
                        return command
                left = deadline - time.monotonic()
                assert left > 0.0, f"no such command; the last were {self.commands[-3:]}"
                self._changed.wait(left)

    def wait_moving(self, since: float = 0.0) -> Commanded:
        """The first command that moves."""
        return self.wait(lambda command: not command.twist.is_zero, since)

    def wait_stepped(self, since: float = 0.0) -> Commanded:
        """The first command that moves as a pattern requested after it had seen a scan."""
        return self.wait(
            lambda command: not command.twist.is_zero and command.requested_scan_seq >= 0, since
        )

    def wait_zero(self, since: float = 0.0) -> Commanded:
        """The first command that is exactly zero."""
        return self.wait(lambda command: command.twist.is_zero, since)

    def moved_since(self, since: float) -> bool:
        """True if any command after `since` moves."""
        with self._changed:
            return any(one.at > since and not one.twist.is_zero for one in self.commands)

    def moved_anew(self, thawed: float) -> list[Commanded]:
        """The commands after the thaw of a daemon that move, and were not on their way before.

        What was on its way when it froze the network sends on at the thaw, before all others: at
        most IN_FLIGHT commands, which rest on the scan of the last one that came by then, or on
        the one after.
        """
        with self._changed:
            newest = max((one.scan_seq for one in self.commands if one.at <= thawed), default=-1)
            since = [one for one in self.commands if one.at > thawed]
            late = 0
            while late < min(IN_FLIGHT, len(since)) and since[late].scan_seq <= newest + 1:
                late += 1
            return [one for one in since[late:] if not one.twist.is_zero]

    def was_late(self, since: float) -> bool:
        """True if this process stood still after `since`: the times of commands tell nothing."""
        return self._late_at > since or boottime() - self._turned_at > LATE

    def ran_since(self, moving: Commanded) -> bool:
        """True if from then on every command was of a running pattern, held up or not.

        `moving`: a command to move that a scan caused (see `wait_stepped`). After a stall of this
        process the driver may have lost its base; the zeros of a lost base have no scan.
        """
        with self._changed:
            return all(
                min(one.scan_seq, one.requested_scan_seq) >= 0
                or (one.scan_seq == one.requested_scan_seq and self._late_at > moving.at - LOST)
                for one in self.commands
                if one.at >= moving.at
            )

    def _receive(self) -> None:
        while not self._stopping.is_set():
            if not select.select([self._server], [], [], 0.05)[0]:
                continue
            with self._sending:
                received = self._server.receive()
            for _, name, payload, _ in received:
                if name == "cmd_vel":
                    self._on_command(payload)

    def _on_command(self, payload: bytes) -> None:
        try:
            wire = decode_command(payload)
        except CodecError:
            return
        twist = Twist(wire.linear, wire.angular, wire.lateral)
        with self._changed:
            self.commands.append(
                Commanded(boottime(), twist, wire.scan_seq, wire.requested_scan_seq)
            )
            self._changed.notify_all()

    def _publish(self) -> None:
        begin, seq, next_scan = boottime(), 0, 0.0
        self._turned_at = begin
        while not self._stopping.wait(1.0 / ODOMETRY_RATE):
            now = boottime()
            if now - self._turned_at > LATE:
                self._late_at = now
            self._turned_at = now
            stamp = now - begin
            if self.odometry is not None:
                odometry = Odometry(stamp, Pose(), self.odometry)
                self._send("odometry", encode_odometry(odometry))
            if stamp < next_scan:
                continue
            next_scan = max(next_scan + self._period, stamp)
            seq += 1
            scan = self.scans(seq, stamp)
            if scan is not None:
                payload = scan if isinstance(scan, bytes) else encode_scan(scan)
                self._send("scan", payload)


def resting_body(swarm: str, robot: str, endpoint: str | None = None) -> Body:
    """A body that rests, without a lidar: its robot acknowledges a stop and never moves."""
    body = Body(load_platform("waffle_pi"), swarm=swarm, robot=robot, endpoint=endpoint)
    body.scans = lambda seq, stamp: None
    return body
