"""What driver `ros1` knows of its robot: what is missing, and the next step; pure.

Times in s on the loop's clock, handed in.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from difflib import SequenceMatcher

from swarmd.core.messages import Reason
from swarmd.core.values import Platform, Scan, ScanSpec
from swarmd.driver_api.driver import Finding
from swarmd.drivers.ros1 import wire
from swarmd.drivers.ros1.adapter import Link, State
from swarmd.drivers.ros1.options import Ros1Options
from swarmd.sensing.conditioning import ScanConditioner

SILENCE = 2.5
"""Seconds without a message after which a sense counts as lost; scans may come at 1 Hz."""


@dataclass(slots=True)
class Sense:
    """One topic that is subscribed to, and what has come of it.

    `index` is that of one of the range sensors that make a scan. `wrong`: the latest publisher of
    another type; `fault`: why no message has been read since. `stamp` is the latest, `steps`
    counts those that were later than the one before; `began` is the first. `scan` is the latest
    that it made or completed.
    """

    name: str
    topic: str
    kind: wire.Kind
    is_needed: bool
    option: str
    index: int = 0
    first: float = math.nan
    last: float = -math.inf
    count: int = 0
    began: float = math.nan
    stamp: float = math.nan
    steps: int = 0
    detail: str = ""
    scan: Scan | None = None
    wrong: Link | None = None
    fault: str = ""

    def hear(self, stamp: float, detail: str, now: float) -> None:
        """A message has come and could be read."""
        if not self.count:
            self.first, self.began = now, stamp
        self.count += 1
        self.last = now
        self.steps += stamp > self.stamp
        self.stamp, self.detail = stamp, detail
        self.wrong, self.fault = None, ""

    def is_fresh(self, now: float) -> bool:
        """Whether a message has come lately."""
        return now - self.last <= SILENCE

    @property
    def period(self) -> float:
        """Mean seconds between messages; NaN before the second."""
        return (self.last - self.first) / (self.count - 1) if self.count > 1 else math.nan


@dataclass(slots=True)
class View:
    """All that the adapter has told, in one of its lives; `note` is what to say before that."""

    options: Ros1Options
    platform: Platform
    note: str = "its adapter is starting"
    state: State | None = None
    links: dict[int, Sense | None] = field(default_factory=dict)
    senses: dict[str, Sense] = field(default_factory=dict)

    def __post_init__(self) -> None:
        options, provides = self.options, self.platform.provides
        for name, option, kind in (
            ("scan", "scan", wire.LASER_SCAN),
            ("odometry", "odometry", wire.ODOMETRY),
            ("imu", "imu", wire.IMU),
            ("battery", "battery", wire.BATTERY),
        ):
            given = getattr(options, option)
            if given is not None and not (name == "scan" and options.ranges):
                topic = options.topic(given)
                self.senses[topic] = Sense(name, topic, kind, name in provides, option)
        for index, given in enumerate(options.ranges):
            topic, is_needed = options.topic(given), "scan" in provides
            self.senses[topic] = Sense("range", topic, wire.RANGE, is_needed, "ranges", index)

    @property
    def command_topic(self) -> str:
        """Where commands go."""
        return self.options.topic(self.options.cmd_vel)

    def on_link(self, link: Link) -> None:
        """A publisher says what it sends; its messages are not taken if that is another type."""
        sense = self.senses.get(link.topic)
        if sense is not None and link.md5sum != sense.kind.md5sum:
            sense.wrong, sense = link, None
        self.links[link.link] = sense

    def missing(self, now: float) -> str:
        """Why this robot cannot be driven, and the next step; empty if it can."""
        state = self.state
        if state is None:
            return self.note
        if not state.master:
            return self._no_master(state)
        if state.others and not self.options.shared_cmd_vel:
            return self._someone_else(state)
        for sense in self.senses.values():
            if sense.is_needed and not sense.is_fresh(now):
                return self._not_heard(sense, state)
        if not state.connected:
            return self._no_taker(state)
        return ""

    def findings(self, now: float) -> Iterator[Finding]:
        """The lines of `--check`."""
        state = self.state
        if state is None:
            yield Finding("adapter", False, self.note)
            return
        uri = self.options.master_uri
        yield Finding("master", state.master, uri if state.master else self._no_master(state))
        if not state.master:
            return
        for sense in self.senses.values():
            yield self._finding(sense, state, now)
        if state.others:
            text, may = self._someone_else(state), self.options.shared_cmd_vel
            who = f"{self.command_topic} is also published by {_all(state.others)}, as permitted"
            yield Finding("others", may, who if may else text)
        if not state.listeners or self._refused(state):
            yield Finding("cmd_vel", False, self._no_taker(state))
        else:
            text = f"{_all(state.listeners)} listens on {self.command_topic}"
            yield Finding("cmd_vel", True, f"{text}, {self.options.command.name}")

    def _finding(self, sense: Sense, state: State, now: float) -> Finding:
        if not sense.is_fresh(now):
            text, is_wanting = self._not_heard(sense, state), sense.is_needed or sense.count
            text = text if is_wanting else f"not heard, and not needed to drive: {text}"
            return Finding(sense.name, not is_wanting, text)
        nodes = _all(state.publishers.get(sense.topic, []))
        rate = f"{1.0 / sense.period:.3g} Hz" if sense.period > 0.0 else "one message"
        text = f"{sense.topic} ({sense.kind.name}) from {nodes}: {rate}{sense.detail}"
        if sense.count > 1 and not sense.steps:
            return Finding(
                sense.name, False, f"{text}; its stamps stand still: look at the sensor's node"
            )
        spec = self.platform.scan
        if sense.name in ("scan", "range") and sense.period > spec.slowest_period:
            slow = f"scan.rate of the platform is {spec.rate:g}, so the robot would stop for old"
            return Finding(sense.name, False, f"{text}; {slow} scans now and then: correct one")
        if sense.scan is not None and _leaves_gaps(sense.scan, spec):
            gaps = "too wide a sector is unseen; look at the sensor, or correct the platform's scan"
            return Finding(sense.name, False, f"{text}; {gaps}")
        by_stamp, by_clock = sense.stamp - sense.began, sense.last - sense.first
        clock = f", stamps went on {by_stamp:.1f} s in {by_clock:.1f} s" if sense.steps else ""
        return Finding(sense.name, True, text + clock)

    def _no_master(self, state: State) -> str:
        return (
            f"no ROS master at {self.options.master_uri} ({state.text}); start roscore, or correct"
            " driver_options.master (or ROS_MASTER_URI)"
        )

    def _someone_else(self, state: State) -> str:
        is_daemon = any(node.startswith("/swarmd_") for node in state.others)
        return (
            f"someone else may drive this robot: {self.command_topic} is also published by"
            f" {_all(state.others)}; end that {'daemon' if is_daemon else 'node'}, or set"
            " shared_cmd_vel if the base has a multiplexer"
        )

    def _not_heard(self, sense: Sense, state: State) -> str:
        topic, wanted = sense.topic, sense.kind.name
        nodes = state.publishers.get(topic, [])
        correct = f"correct namespace or {sense.option} of driver_options"
        correct += self._elsewhere(sense, state)
        wrong = sense.wrong
        if wrong is not None:
            theirs = f"{wrong.type} (md5 {wrong.md5sum})"
            mine = f"{wanted} (md5 {sense.kind.md5sum})"
            return f"{wrong.node} publishes {theirs} on {topic}; wanted is {mine}: {correct}"
        if not nodes:
            return f"nobody publishes {topic}; start the robot's nodes, or {correct}"
        if sense.fault:
            return (
                f"what {_all(nodes)} sends on {topic} cannot be read: {sense.fault}; look at that"
                f" node, or {correct}"
            )
        kind = state.types.get(topic, "")
        if kind not in (wanted, "*", ""):
            return f"{_all(nodes)} publishes {kind} on {topic}; wanted is {wanted}: {correct}"
        return (
            f"{_all(nodes)} publishes {topic}, but nothing comes; look at the sensor, at whether"
            " that node still runs, and at ROS_IP on both machines"
        )

    def _elsewhere(self, sense: Sense, state: State) -> str:
        found = [
            topic for topic in state.candidates.get(sense.kind.name, []) if topic != sense.topic
        ]
        found.sort(
            key=lambda topic: SequenceMatcher(None, topic, sense.topic).ratio(), reverse=True
        )
        return f" ({sense.kind.name} is on {_all(found)})" if found else ""

    def _refused(self, state: State) -> str:
        """A listener that wants another type than we send; empty if there is none."""
        mine = self.options.command.name
        wrong = [(n, kind) for n, kind in state.wants.items() if kind not in (mine, "*", "")]
        is_any_right = any(kind == mine for kind in state.wants.values())
        if not wrong or is_any_right:
            return ""
        node, kind = wrong[0]
        return f"{node} wants {kind} on {self.command_topic}, not {mine}; correct cmd_vel_type"

    def _no_taker(self, state: State) -> str:
        if not state.listeners:
            return (
                f"nobody listens on {self.command_topic}; start the base's node, or correct"
                " namespace or cmd_vel of driver_options"
            )
        nodes = _all(state.listeners)
        return self._refused(state) or (
            f"{nodes} listens on {self.command_topic}, but does not connect to this machine; look"
            " at ROS_IP here"
        )


def _leaves_gaps(scan: Scan, spec: ScanSpec) -> bool:
    return ScanConditioner(spec).take(scan, None, 0.0) is Reason.INVALID_SCAN


def _all(names: list[str]) -> str:
    """Names in a line, few enough to read."""
    if not names:
        return "nobody"
    more = f" and {len(names) - 3} more" if len(names) > 3 else ""
    return ", ".join(names[:3]) + more
