"""What is wrong with a ROS robot, each with the next step: for `--check` and for a lost base. Pure.

Both ROS: a `Middleware` names the tools, and the graph is the topics that other nodes announce.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass
from difflib import SequenceMatcher
from typing import Protocol

from swarmd.core.messages import Reason
from swarmd.core.values import Scan, ScanSpec
from swarmd.driver_api.driver import Finding
from swarmd.drivers.ros.subscriptions import Subscriptions
from swarmd.drivers.ros.topic_stats import TopicStats
from swarmd.drivers.scan_delay import scan_delay_finding
from swarmd.sensing.conditioning import ScanConditioner

LAST_WORD = "docs/robots/last_word.md"
ENOUGH_MESSAGES = 5
MIN_CHECK_TIME = 1.0

_MAX_LISTED = 4
_COMMAND_OPTIONS = {"Twist": "cmd_vel_type: twist", "TwistStamped": "cmd_vel_type: twist_stamped"}


@dataclass(frozen=True, slots=True)
class Endpoint:
    """One end of a topic, as it is announced: a publisher or a subscription.

    `topic` such as `/tb3_01/scan`, `type` such as `sensor_msgs/msg/LaserScan`; `domain` is None and
    `node` empty where the announcement does not tell them. `zid` is the Zenoh session that
    announced it; empty in ROS 1.
    """

    is_publisher: bool
    topic: str
    type: str
    zid: str = ""
    domain: int | None = None
    node: str = ""

    @property
    def owner(self) -> str:
        """The node; without one, the bridge that announces the endpoint."""
        return self.node or f"a node behind bridge {self.zid[:8]}"


class Middleware(Protocol):
    """The phrases of error messages about one ROS middleware.

    `hub` is what the driver connects to, `start` the step that starts it, and `endpoint_option` the
    option that says where it listens. `silent` says that the hub announces no topic, and the next
    step. `silent_topic` says what to look at when an announced topic carries no messages; it ends
    in a command to which the topic's name is appended. `topic_info` is the command that names the
    publishers of a topic.
    """

    hub: str
    start: str
    endpoint_option: str
    silent: str
    silent_topic: str
    topic_info: str
    domain: int | None

    def type_name(self, message_type: type) -> str:
        """Such as `sensor_msgs/msg/LaserScan`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Graph:
    """The endpoints that other nodes announce, in the words of their middleware."""

    middleware: Middleware
    endpoints: Collection[Endpoint] = ()

    def publishers(self, topic: str) -> list[Endpoint]:
        """The publishers of a topic in the driver's domain."""
        return [end for end in self._here(is_publisher=True) if end.topic == topic]

    def subscribers(self, topic: str) -> list[Endpoint]:
        """The subscribers of a topic in the driver's domain."""
        return [end for end in self._here(is_publisher=False) if end.topic == topic]

    def silence(self, stats: TopicStats) -> str:
        """Why no message arrives on a topic."""
        middleware, topic = self.middleware, stats.topic
        wanted, option = middleware.type_name(stats.message_type), f"driver_options.{stats.option}"
        announced = [end for end in self.endpoints if end.is_publisher]
        here = self._here(is_publisher=True)
        types = sorted({end.type for end in here if end.topic == topic})
        if wanted in types:
            return f"{topic} is announced but silent; {middleware.silent_topic} {topic}"
        if types:
            return f"{topic} carries {', '.join(types)}; expected {wanted}: correct {option}"
        domains = _domains(end for end in announced if (end.topic, end.type) == (topic, wanted))
        if here and not domains:
            alike = {end.topic for end in here if end.type == wanted}
            if alike:
                return (
                    f"no {topic}, but {listed(_nearest_first(topic, alike))} of that type; correct"
                    f" driver_options.namespace or {option}"
                )
            names = sorted({end.topic for end in here})
            return f"no {topic} among {listed(names)}; start the sensor, or correct {option}"
        domains = domains or _domains(announced)
        if domains:
            what = topic if here else "topic"
            return (
                f"no {what} in domain {middleware.domain}, but in {listed(map(str, domains))};"
                " correct driver_options.domain"
            )
        return f"no {topic}, and {middleware.hub} {middleware.silent}"

    def unreadable(self, stats: TopicStats) -> str:
        """Why the messages of a topic cannot be used."""
        types = {end.type for end in self.publishers(stats.topic)}
        if types and self.middleware.type_name(stats.message_type) not in types:
            return self.silence(stats)
        return (
            f"{stats.topic}: {stats.fault}; correct driver_options.{stats.option}, or look at what"
            f" publishes it: {self._info(stats.topic)}"
        )

    def unreliable(self, stats: TopicStats) -> str:
        """Why the messages of a topic cannot be relied on; empty if they can."""
        topic = stats.topic
        if not stats.stamps_advance():
            return (
                f"{topic}: messages come, all with the stamp {stats.stamps[-1]:.12g}; look at the"
                " sensor, which is frozen, or at its publisher, which fills in none"
            )
        return self.rival(stats)

    def rival(self, stats: TopicStats) -> str:
        """Why more than one node seems to publish a needed topic; empty without a sign of that."""
        topic, publishers = stats.topic, self.publishers(stats.topic)
        if len(publishers) > 1 and stats.is_needed:
            owners = listed(sorted({end.owner for end in publishers}))
            return (
                f"{len(publishers)} publish {topic}: {owners}; end all but one, or give each robot"
                " a namespace"
            )
        if stats.stamps_go_back():
            return (
                f"the stamps of {topic} go back again and again: two publish it, or a clock is"
                f" being set; look at {self._info(topic)}"
            )
        return ""

    def no_subscriber(self, topic: str, command_type: type, *, has_subscriber: bool) -> str:
        """Why no base receives the commands; empty if one does.

        `has_subscriber`: whether any node subscribes to the commands, announced or not.
        """
        wanted = self.middleware.type_name(command_type)
        here = self._here(is_publisher=False)
        types = sorted({end.type for end in here if end.topic == topic})
        if types and wanted not in types:
            option = _COMMAND_OPTIONS.get(_short(types[0]), "cmd_vel, or cmd_vel_type")
            return f"{topic} wants {listed(types)}, not {wanted}; set driver_options.{option}"
        if types or has_subscriber:
            return ""
        alike = sorted({end.topic for end in here if _short(end.type) in _COMMAND_OPTIONS})
        if alike:
            return (
                f"no node subscribes to {topic}, but to {listed(alike)}; correct"
                " driver_options.namespace or driver_options.cmd_vel"
            )
        return f"no node subscribes to {topic}; start the base, or correct driver_options.cmd_vel"

    def _here(self, *, is_publisher: bool) -> list[Endpoint]:
        domain = self.middleware.domain
        return [e for e in self.endpoints if e.is_publisher is is_publisher and e.domain == domain]

    def _info(self, topic: str) -> str:
        return f"{self.middleware.topic_info} {topic}"


def unreachable(middleware: Middleware, endpoint: str, fault: str = "") -> str:
    """Nothing answers at the endpoint; `fault` is the connection's own error."""
    why = f" ({fault})" if fault else ""
    return (
        f"nothing answers at {endpoint}{why}; {middleware.start}, or correct"
        f" {middleware.endpoint_option}"
    )


def incomplete(stats: TopicStats, scan: Scan, spec: ScanSpec) -> str:
    """Why this scan leaves too much unseen; empty if it does not."""
    if ScanConditioner(spec).take(scan, None, 0.0) is not Reason.INVALID_SCAN:
        return ""
    return (
        f"{stats.topic}: {len(scan.ranges)} rays that leave too wide a sector unseen; look at the"
        " sensor, or correct the platform's scan"
    )


def too_slow(stats: TopicStats, spec: ScanSpec) -> str:
    """Why scans come too rarely for the platform; empty if they do not."""
    rate = stats.rate()
    if not 0.0 < rate * spec.slowest_period < 1.0:
        return ""
    return (
        f"{stats.topic} comes at {rate:.1f} Hz; the platform's scan.rate is {spec.rate:g}, so the"
        " robot would stop for old scans now and then: correct one of them"
    )


def scan_conflict(graph: Graph, topics: Iterable[TopicStats]) -> str:
    """Why the scans seem to come from more than one node; empty without a sign of that."""
    return next(filter(None, (graph.rival(stats) for stats in topics if stats.is_scan)), "")


def driven_by_others(topic: str, publishers: Iterable[str] = (), *, is_heard: bool = True) -> str:
    """Another node publishes commands. `publishers`: the nodes, where they are known.

    `is_heard`: commands of theirs have been heard.
    """
    names = listed(publishers)
    if names:
        return (
            f"someone else {'drives' if is_heard else 'may drive'}: {topic} is also published by"
            f" {names}; end that node, or set driver_options.shared_cmd_vel if the base has a"
            " multiplexer"
        )
    return (
        f"someone else drives: commands on {topic} that are not this driver's; stop what publishes"
        " them, and this driver takes over 2 s later"
    )


def unconnected(topic: str, nodes: Iterable[str]) -> str:
    """The base subscribes in ROS 1 and opens no connection to this machine."""
    return (
        f"{listed(nodes)} subscribes to {topic}, but does not connect to this machine; look at"
        " ROS_IP here"
    )


def has_enough(subscriptions: Subscriptions, elapsed: float) -> bool:
    """True once all needed topics tell their rate, and each other topic has a message."""
    return elapsed >= MIN_CHECK_TIME and all(
        stats.count >= (ENOUGH_MESSAGES if stats.is_needed else 1)
        for stats in subscriptions.topics.values()
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """What a driver found out about its robot during a check.

    `connection_fault` is empty if the hub answers. `has_subscriber`: whether any node subscribes to
    the commands. `foreign_commands`: commands of other nodes that arrived. `is_exclusive`: whether
    another publisher of commands is a fault although it publishes nothing. `now`: the time in s on
    the clock of arrivals.
    """

    graph: Graph
    endpoint: str
    connection_fault: str = ""
    subscriptions: Subscriptions
    spec: ScanSpec
    cmd_vel: str
    command_type: type
    has_subscriber: bool
    foreign_commands: int = 0
    foreign_publishers: Collection[str] = ()
    now: float
    is_exclusive: bool = False

    def findings(self) -> tuple[Finding, ...]:
        """One line each: hub, topics, the subscriber of commands, who has the last word on them."""
        if self.connection_fault:
            return (Finding("connection", False, self.connection_fault),)
        return tuple(self._findings())

    def _findings(self) -> Iterator[Finding]:
        middleware = self.graph.middleware
        yield Finding("connection", True, f"{middleware.hub} at {self.endpoint}")
        for stats in self.subscriptions.topics.values():
            is_named = stats.is_reading or stats.name in ("imu", "battery")
            if stats.is_needed or stats.count or is_named:
                yield self._topic(stats)
        fault = self.graph.no_subscriber(
            self.cmd_vel, self.command_type, has_subscriber=self.has_subscriber
        )
        yield self._scan_delay()
        sweep = self.subscriptions.sweep_finding()
        if sweep is not None:
            yield sweep
        well = f"{self.cmd_vel} ({middleware.type_name(self.command_type)}) has a subscriber"
        yield Finding("cmd_vel", not fault, fault or well)
        yield self._last_word()

    def _scan_delay(self) -> Finding:
        topics = self.subscriptions.topics
        scans = [pair for stats in topics.values() if stats.is_scan for pair in stats.pairs]
        return scan_delay_finding(
            scans, topics["odometry"].pairs, self.subscriptions.scan, self.spec
        )

    def _topic(self, stats: TopicStats) -> Finding:
        fault = self._fault(stats)
        if fault:
            is_fault = stats.is_needed or stats.is_reading or stats.count or stats.faults
            text = fault if is_fault else f"no message, and not needed to drive: {fault}"
            return Finding(stats.name, not is_fault, text)
        by_stamp, by_clock = stats.elapsed()
        kind = self.graph.middleware.type_name(stats.message_type)
        rate = f"{stats.rate():.1f} Hz" if stats.rate() else ""
        clock = f"stamps advanced by {by_stamp:.1f} s in {by_clock:.1f} s" if rate else ""
        age = self.now - stats.last_arrival()
        if stats.is_reading and age > stats.stale_after:
            text = f"{stats.topic}: the last message is {age:.1f} s old, stale after"
            return Finding(stats.name, False, f"{text} {stats.stale_after:g} s; look at the sensor")
        clock = f"{age:.1f} s ago" if stats.is_reading else clock
        details = ", ".join(part for part in (rate, stats.summary, clock) if part)
        return Finding(stats.name, True, f"{stats.topic} ({kind}): {details}".rstrip(": "))

    def _fault(self, stats: TopicStats) -> str:
        """What is wrong on one topic; empty if nothing is."""
        if stats.faults:
            return self.graph.unreadable(stats)
        if not stats.count:
            return self.graph.silence(stats)
        fault = self.graph.unreliable(stats)
        if fault or not stats.is_needed or stats.name == "odometry":
            return fault
        scan = self.subscriptions.scan
        return too_slow(stats, self.spec) or (incomplete(stats, scan, self.spec) if scan else "")

    def _last_word(self) -> Finding:
        """Who else may command the base, and how swarmd gets the last word."""
        topic, names = self.cmd_vel, sorted(self.foreign_publishers)
        if self.foreign_commands:
            return Finding(
                "last_word",
                False,
                f"{self.foreign_commands} commands of another node on {topic}; stop what publishes"
                f" them, or give swarmd the last word ({LAST_WORD}), unless it is this robot's own"
                " daemon or watchdog",
            )
        if names and self.is_exclusive:
            return Finding("last_word", False, driven_by_others(topic, names, is_heard=False))
        takers = [end.node for end in self.graph.subscribers(topic)]
        mux = listed(sorted({node for node in takers if "mux" in node}))
        how = f": give swarmd the highest priority there ({LAST_WORD})" if mux else ""
        if names:
            how = how or f"; then it has the last word, not swarmd ({LAST_WORD})"
            text = f"{listed(names)} may publish {topic} too, but does not now"
            return Finding("last_word", True, f"{text}; {mux} takes it{how}" if mux else text + how)
        if mux:
            return Finding("last_word", True, f"{mux} takes {topic}{how}")
        return Finding("last_word", True, f"no other node publishes {topic}")


def listed(names: Iterable[str]) -> str:
    """The first few names, and how many more."""
    known = list(names)
    more = f" and {len(known) - _MAX_LISTED} more" if len(known) > _MAX_LISTED else ""
    return ", ".join(known[:_MAX_LISTED]) + more


def _nearest_first(topic: str, names: Collection[str]) -> list[str]:
    return sorted(names, key=lambda name: (-SequenceMatcher(None, topic, name).ratio(), name))


def _short(type_name: str) -> str:
    return type_name.rpartition("/")[2]


def _domains(ends: Iterable[Endpoint]) -> list[int]:
    return sorted({end.domain for end in ends if end.domain is not None})
