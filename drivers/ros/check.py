"""`swarmd --check` of a ROS 2 driver: what was seen of the robot, each with the next step. Pure."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass

from swarmd.drivers.ros.advice import (
    shown,
    why_blind,
    why_misleading,
    why_refused,
    why_silent,
    why_unheard,
)
from swarmd.drivers.ros.cdr import name_of
from swarmd.drivers.ros.dialect import Dialect, Endpoint
from swarmd.drivers.ros.hearing import Hearing
from swarmd.drivers.ros.sense import Sense
from swarmd.driving.driver import Finding
from swarmd.values import ScanSpec

ENOUGH = 5
AT_LEAST = 1.0


def has_enough(hearing: Hearing, elapsed: float) -> bool:
    """Whether all that is needed was heard often enough to tell its rate, and the rest at all."""
    senses = hearing.senses.values()
    return elapsed >= AT_LEAST and all(
        sense.count >= (ENOUGH if sense.is_needed else 1) for sense in senses
    )


def unheard(dialect: Dialect, endpoint: str) -> str:
    """Nothing listens at the endpoint."""
    return f"nothing answers at {endpoint}; {dialect.start}, or correct driver_options.endpoint"


@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """What a driver knows of its robot after having looked for a while.

    `graph`: what others announce. `has_taker`: whether anyone listens for commands on the key.
    `others`: how many commands of others came.
    """

    dialect: Dialect
    endpoint: str
    is_connected: bool
    hearing: Hearing
    spec: ScanSpec
    graph: Collection[Endpoint]
    cmd_vel: str
    command: type
    has_taker: bool
    others: int

    def findings(self) -> tuple[Finding, ...]:
        """One line each: the hub, every topic, where commands go, who else commands."""
        if not self.is_connected:
            return (Finding("connection", False, unheard(self.dialect, self.endpoint)),)
        return tuple(self._findings())

    def _findings(self) -> Iterator[Finding]:
        yield Finding("connection", True, f"{self.dialect.hub} at {self.endpoint}")
        for sense in self.hearing.senses.values():
            if sense.is_needed or sense.count or sense.name in ("imu", "battery"):
                yield self._of(sense)
        yield self._taker()
        yield self._rivals()

    def _of(self, sense: Sense) -> Finding:
        fault = self._fault(sense)
        if fault:
            is_wanting = sense.is_needed or sense.count or sense.faults
            text = fault if is_wanting else f"not heard, and not needed to drive: {fault}"
            return Finding(sense.name, not is_wanting, text)
        by_stamp, by_clock = sense.passed()
        kind = name_of(sense.kind)
        rate = f"{sense.rate():.1f} Hz, " if sense.rate() else ""
        clock = f"stamps went on {by_stamp:.1f} s in {by_clock:.1f} s" if rate else ""
        said = ", ".join(part for part in (sense.text, clock) if part)
        return Finding(sense.name, True, f"{sense.topic} ({kind}): {rate}{said}".rstrip(": "))

    def _fault(self, sense: Sense) -> str:
        """What is wrong on one topic; empty if nothing is."""
        if sense.faults:
            return why_refused(sense, self.graph, self.dialect)
        if not sense.count:
            return why_silent(sense, self.graph, self.dialect)
        fault = why_misleading(sense, self.graph, self.dialect)
        if not fault and sense.name != "odometry" and sense.is_needed:
            return self._scan_fault(sense)
        return fault

    def _scan_fault(self, sense: Sense) -> str:
        rate, wanted = sense.rate(), self.spec.rate
        if 0.0 < rate * self.spec.slowest_period < 1.0:
            return (
                f"{sense.topic} comes at {rate:.1f} Hz; the platform's scan.rate is {wanted:g},"
                " so the robot would stop for old scans now and then: correct one of them"
            )
        scan = self.hearing.scan
        return "" if scan is None else why_blind(sense, scan, self.spec)

    def _taker(self) -> Finding:
        fault = why_unheard(
            self.cmd_vel, self.command, self.graph, self.dialect, has_taker=self.has_taker
        )
        well = f"{self.cmd_vel} ({name_of(self.command)}) has a subscriber"
        return Finding("cmd_vel", not fault, fault or well)

    def _rivals(self) -> Finding:
        if self.others:
            return Finding(
                "others",
                False,
                f"{self.others} commands of someone else on {self.cmd_vel}; stop what publishes"
                " them, unless it is this robot's own daemon or stopper",
            )
        said = [
            end.who
            for end in self.graph
            if end.is_publisher and end.topic == self.cmd_vel and end.domain == self.dialect.domain
        ]
        if said:
            text = f"{shown(sorted(said))} may publish {self.cmd_vel} too, but does not now"
            return Finding("others", True, text)
        return Finding("others", True, f"nobody else publishes {self.cmd_vel}")
