"""Texts of the faults of a ROS robot, each with the next step. Pure.

`swarmd --check` and the report of a lost base show these texts, in ROS 1 and ROS 2. A `Middleware`
has the names of its tools. A `Graph` has the topics that other nodes announce. A function that
returns the text of a fault returns an empty text without a fault.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from difflib import SequenceMatcher
from typing import Protocol

from msgspec.structs import replace

from swarmd.core.finding import Finding
from swarmd.core.messages import Reason
from swarmd.core.values import ScanSpec
from swarmd.drivers.ros.command_type import wanted_type
from swarmd.drivers.ros.endpoints import Endpoint, is_listener, nodes_of
from swarmd.drivers.ros.foreign_commands import ForeignCommands
from swarmd.drivers.ros.namespaces import Candidates, Namespaces
from swarmd.drivers.ros.options import TopicOptions
from swarmd.drivers.ros.subscriptions import Subscriptions
from swarmd.drivers.ros.topic_stats import FAULT_TIMEOUT, TopicStats
from swarmd.robot.sensing.conditioning import ScanConditioner
from swarmd.robot.sensing.scan_content import ScanContent
from swarmd.robot.sensing.scan_delay_finding import scan_delay_finding
from swarmd.robot.timeouts import ODOMETRY_TIMEOUT

LAST_WORD = "docs/last_word.md"
ENOUGH_MESSAGES = 5
MIN_CHECK_TIME = 1.0
WAKE_TIME = 12.0
"""Seconds that a check waits longer for a sensor that sleeps until a node subscribes.

A lidar spins up within 4 to 8 s (`auto_standby` of a TurtleBot 4).
"""
MAX_RATE = 1.5
MIN_GAPS = 7
"""More than MAX_RATE times the declared rate of scans means two publishers; over MIN_GAPS gaps."""

_MAX_LISTED = 4
# The clock of the stamps to real time; arrivals of a second scatter by less.
_LEAST_CLOCK_RATIO = 0.8
_MAX_CLOCK_RATIO = 1.25
_COMMAND_OPTIONS = {"Twist": "cmd_vel_type: twist", "TwistStamped": "cmd_vel_type: twist_stamped"}


@dataclass(frozen=True, slots=True)
class Conflict:
    """Why a robot must not move although its base is connected, and the next step."""

    reason: Reason
    text: str


class Middleware(Protocol):
    """The phrases of error messages about one ROS middleware."""

    hub: str  # the process to which the driver connects
    start: str  # the step that starts the hub
    endpoint_option: str  # the driver option with the hub's address
    silent: str  # that the hub announces no topic, and the next step
    silent_topic: str
    """What to check if an announced topic carries no messages; the topic's name is appended."""
    topic_info: str  # the command that lists the publishers of a topic
    crashed: str  # what happens to the entry of a crashed node that is back
    lease: float  # s after which the hub has forgotten a node that died
    domain: int | None  # ROS_DOMAIN_ID; None: not known

    def type_name(self, message_type: type) -> str:
        """Such as `sensor_msgs/msg/LaserScan`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Graph:
    """The endpoints that other nodes announce, and the texts of their faults."""

    middleware: Middleware
    endpoints: Collection[Endpoint] = ()
    strays: Collection[Endpoint] = ()  # DDS readers of no ROS node, or of another bridge
    nodeless: Collection[Endpoint] = ()  # DDS ends of ROS processes whose nodes no bridge can read
    options: TopicOptions = field(default_factory=TopicOptions)  # name this robot's topics
    heard: Collection[str] = ()  # this robot's topics that carried messages
    now: float = math.inf  # s on the clock of `Endpoint.since` and of arrivals; inf: unknown

    def publishers(self, topic: str) -> list[Endpoint]:
        """The publishers of a topic in the driver's domain."""
        return [end for end in self._in_domain(is_publisher=True) if end.topic == topic]

    def subscribers(self, topic: str) -> list[Endpoint]:
        """The subscribers of a topic in the driver's domain."""
        return [end for end in self._in_domain(is_publisher=False) if end.topic == topic]

    def bases(self, topic: str) -> list[Endpoint]:
        """The subscribers of a topic of commands that may be bases; listeners are left out."""
        return [end for end in self.subscribers(topic) if not self._is_listener(end)]

    def silence(self, stats: TopicStats) -> str:
        """Why no message arrives on a topic, and the next step; `stats`: of the topic.

        The first reason that applies: a node that is silent or publishes on change, another message
        type, a topic that the hub (bridge, router or ROS master) does not pass on, another ROS
        domain, no node that publishes the topic.
        """
        topic = stats.topic
        wanted_type = self.middleware.type_name(stats.message_type)
        publishers = self._in_domain(is_publisher=True)
        types = sorted({end.type for end in publishers if end.topic == topic})
        if wanted_type in types and stats.is_never_stale:  # published on change only
            return f"{topic} is announced and not latched: no value before its next change"
        if wanted_type in types:
            return f"{topic} is announced but silent; {self.middleware.silent_topic} {topic}"
        if types:
            option = f"driver_options.{stats.option}"
            return f"{topic} carries {', '.join(types)}; expected {wanted_type}: correct {option}"
        fault = self._unrouted(topic, is_publisher=True) or self._undecoded(
            topic, is_publisher=True
        )
        return fault or self._unpublished(stats, publishers)

    def _unpublished(self, stats: TopicStats, publishers: Collection[Endpoint]) -> str:
        """The text for a topic that no node of this domain publishes.

        `publishers`: all publishers of this domain. The text names the domains that have the topic.
        If no domain has the topic, and this domain has no topics at all, the text names all domains
        with topics, since the option `domain` may be wrong.
        """
        middleware = self.middleware
        topic = stats.topic
        wanted = (topic, middleware.type_name(stats.message_type))
        announced = [end for end in self.endpoints if end.is_publisher and end.is_routed]
        domains = _domains(announced)
        domains_of_topic = _domains(end for end in announced if (end.topic, end.type) == wanted)
        if publishers and domains_of_topic:
            return self._in_domains(topic, domains_of_topic)
        if publishers:
            return self._missing(stats, publishers)
        if domains:
            return self._in_domains("topic", domains_of_topic or domains)
        return f"no {topic}, and {middleware.hub} {middleware.silent}"

    def _in_domains(self, missing: str, domains: Iterable[int]) -> str:
        return (
            f"no {missing} in domain {self.middleware.domain}, but in {listed(map(str, domains))};"
            " correct driver_options.domain"
        )

    def _missing(self, stats: TopicStats, publishers: Collection[Endpoint]) -> str:
        """Why no node publishes the topic; `publishers`: of all other topics of the domain."""
        topic = stats.topic
        option = f"driver_options.{stats.option}"
        if stats.count:
            return f"no {topic} any more, which was heard before; start its node again"
        wanted_type = self.middleware.type_name(stats.message_type)
        spaces = self._namespaces()
        candidates = spaces.candidates({end.topic for end in publishers if end.type == wanted_type})
        if candidates.topics:
            return (
                f"no {topic}, but {listed(_nearest_first(topic, candidates.topics))} of that type;"
                f" correct driver_options.namespace or {option}"
            )
        if candidates.namespaces:
            return f"no {topic}; {self._namespace_request(spaces, candidates, option)}"
        names = sorted(
            {end.topic for end in publishers if not spaces.is_of_another_robot(end.topic)}
        )
        among = f" among {listed(names)}" if names else ""
        return f"no {topic}{among}; start the sensor, or correct {option}"

    def _namespace_request(self, spaces: Namespaces, candidates: Candidates, option: str) -> str:
        """The request to set this robot's namespace: several are in use, or its own is not."""
        names = listed(candidates.namespaces)
        if spaces.own:
            return (
                f"nothing of namespace {spaces.own} is there: start this robot's nodes; if it has"
                f" another namespace, correct driver_options.namespace (in use: {names})"
            )
        return (
            f"more than one namespace is in use: {names}; set driver_options.namespace to this"
            f" robot's own, or correct {option}"
        )

    def unreadable(self, stats: TopicStats) -> str:
        """Why the messages of a topic cannot be used."""
        types = {end.type for end in self.publishers(stats.topic)}
        if types and self.middleware.type_name(stats.message_type) not in types:
            return self.silence(stats)
        return (
            f"{stats.topic}: {stats.fault}; correct driver_options.{stats.option}, or look at what"
            f" publishes it: {self._info_command(stats.topic)}"
        )

    def unreliable(self, stats: TopicStats, spec: ScanSpec) -> str:
        """Why the messages of a topic cannot be relied on; empty if they can."""
        topic = stats.topic
        longest = spec.slowest_period if stats.is_scan else ODOMETRY_TIMEOUT
        if stats.is_needed and stats.standstill() > longest:
            return (
                f"{topic}: several messages in a row have one stamp, of which the first counts: too"
                f" few; look at what stamps them: {self._info_command(topic)}"
            )
        if not stats.stamps_advance():
            return (
                f"{topic}: messages come, all with the stamp {stats.stamps[-1]:.12g}; look at the"
                " sensor, which is frozen, or at its publisher, which fills in none"
            )
        return self.second_publisher(stats, spec) or self._set_clock(stats)

    def doubt(self, topics: Iterable[TopicStats], spec: ScanSpec) -> str:
        """Why the messages of a needed topic cannot be relied on, or contradict themselves."""
        needed = [stats for stats in topics if stats.is_needed]
        doubts = (self.unreliable(stats, spec) or contradiction(stats) for stats in needed)
        return next(filter(None, doubts), "")

    def _set_clock(self, stats: TopicStats) -> str:
        """The text if the stamps of a topic go back although a single node publishes it."""
        node = self._only_node(stats.topic)
        if not (node and stats.stamps_go_back()):
            return ""
        return (
            f"the stamps of {stats.topic} go back again and again, and {node} alone publishes it:"
            " its clock was set; let it set its clock (NTP) before the node starts"
        )

    def _only_node(self, topic: str) -> str:
        """The name of the only node that publishes a topic; empty for several or unknown nodes."""
        names = {end.node for end in self.publishers(topic)}
        return names.pop() if len(names) == 1 else ""

    def conflict(self, topics: Iterable[TopicStats], spec: ScanSpec) -> Conflict | None:
        """Why the robot must not move; None without a conflict.

        A conflict is a second base on the topic of commands, or a second publisher of scans or
        odometry. Two announced nodes of one name may be a crashed node and its successor. Scans
        that come too often show that these are two living robots with one name.
        """
        needed = [stats for stats in topics if stats.is_needed]
        are_alive = any(too_fast(stats, spec) for stats in needed)
        bases = self._several_nodes(
            self.bases(self.command_topic), f"take {self.command_topic}", are_alive=are_alive
        )
        if bases := bases or self._stray_text():
            bases += "; name those that only listen in driver_options.cmd_vel_listeners"
            return Conflict(Reason.BASE_CONFLICT, bases)
        for stats in needed:
            if text := self.second_publisher(stats, spec):
                reason = Reason.SCAN_CONFLICT if stats.is_scan else Reason.BASE_CONFLICT
                return Conflict(reason, text)
        return None

    def second_publisher(self, stats: TopicStats, spec: ScanSpec) -> str:
        """Why more than one node seems to publish a needed topic; empty without such a sign.

        The first sign that applies: several announced nodes, several bridges, stamps that go back,
        or messages that come too often for `spec.rate`.
        """
        topic = stats.topic
        publishers = self.publishers(stats.topic)
        if not stats.is_needed:
            return ""
        # Of two announced nodes with one name, one may have crashed. Messages that come too often
        # show that both are alive.
        is_too_fast = bool(too_fast(stats, spec))
        if several := self._several_nodes(publishers, f"publish {topic}", are_alive=is_too_fast):
            return several
        bridges = {end.zid for end in publishers}  # by the id of the Zenoh session
        if len(bridges) > 1:
            return (
                f"{len(bridges)} bridges hand on what {publishers[0].owner} publishes on {topic}:"
                " they are in one domain; end all but one, or give each robot a domain"
            )
        is_silent = FAULT_TIMEOUT < self.now - stats.last_arrival() < math.inf
        if is_silent or self._only_node(topic):
            # Stamps and rate show no second node then: they are those of the time before the
            # silence, the clock of this node was set, or the platform's rate is wrong.
            return ""
        if stats.stamps_go_back():
            return (
                f"the stamps of {topic} go back again and again: two publish it, or a clock was"
                f" set; look at {self._info_command(topic)}"
            )
        if is_too_fast:
            return (  # without the rate: a text that varies would be news again and again
                f"{topic} comes more than {MAX_RATE:g} times as often as the platform's scan.rate"
                f" of {spec.rate:g} Hz: two publish it, or correct scan.rate; look at"
                f" {self._info_command(topic)}"
            )
        return ""

    def qualities(self, topic: str, *, is_publisher: bool) -> list[str]:
        """The different qualities of service (QoS) that the ends of a topic announce, sorted."""
        ends = self._in_domain(is_publisher=is_publisher)
        return sorted({end.quality for end in ends if end.topic == topic and end.quality})

    def is_reliable(self, topic: str) -> bool:
        """True if each known publisher of a topic is reliable."""
        ends = self.publishers(topic)
        return bool(ends) and all(end.quality.startswith("reliable") for end in ends)

    def nodes(self, topic: str) -> list[str]:
        """The nodes that publish a topic, as far as they are known."""
        return sorted({end.node for end in self.publishers(topic) if end.node})

    def command_type(self, topic: str, allowed: Sequence[type]) -> type | None:
        """The message class of commands, by the subscriptions of bases; None if not clear.

        `allowed`: the message classes that the options allow; a single class is returned at once.
        """
        types = {end.type for end in self.bases(topic)}
        return wanted_type(allowed, types, self.middleware.type_name)

    def no_subscriber(self, topic: str, allowed: Sequence[type], *, has_subscriber: bool) -> str:
        """Why no base receives the commands on `topic`; empty if a base receives them.

        A base is a subscriber that moves the robot, unlike a listener such as a recorder.
        `allowed`: the message classes that the options allow for commands. `has_subscriber`: a node
        subscribes to the commands, though perhaps no announcement names the node.
        """
        if self.bases(topic):
            return self._wrong_type(topic, allowed)
        if listening := {end.owner for end in self.subscribers(topic)}:
            only = listed(sorted(listening))
            return f"only {only} takes {topic}, which moves nothing; start the base"
        if unrouted := self._unrouted(topic, is_publisher=False):
            return unrouted
        if undecoded := self._undecoded(topic, is_publisher=False):
            return undecoded
        if not has_subscriber:
            return self._no_base(topic)
        # A node subscribes without an announcement. Only the options can tell its message class.
        if self.command_type(topic, allowed) is None:
            return (
                f"a node subscribes to {topic}, and nothing announces the type that it wants; set"
                " driver_options.cmd_vel_type"
            )
        return ""

    def _wrong_type(self, topic: str, allowed: Sequence[type]) -> str:
        """Why the announced bases cannot read the commands on `topic`; empty if they can.

        `allowed`: the message classes that the options allow for commands.
        """
        allowed_names = [self.middleware.type_name(kind) for kind in allowed]
        bases = self.bases(topic)
        base_types = sorted({end.type for end in bases})
        if not set(allowed_names) & set(base_types):
            option = _COMMAND_OPTIONS.get(_short(base_types[0]), "cmd_vel, or cmd_vel_type")
            return (
                f"{topic} wants {listed(base_types)}, not {' or '.join(allowed_names)}; set"
                f" driver_options.{option}"
            )
        if self.command_type(topic, allowed) is not None:
            return ""
        wants = listed(sorted(f"{end.owner} wants {end.type}" for end in bases))
        return (
            f"the type of commands on {topic} is not clear: {wants}; end one of them, or set"
            " driver_options.cmd_vel_type"
        )

    def _no_base(self, topic: str) -> str:
        """The text for a topic of commands without a subscriber, with proposals of other topics."""
        here = self._in_domain(is_publisher=False)
        spaces = self._namespaces()
        option = "driver_options.cmd_vel"
        candidates = spaces.candidates(
            {end.topic for end in here if _short(end.type) in _COMMAND_OPTIONS}
        )
        if candidates.topics:
            return (
                f"no node subscribes to {topic}, but to {listed(sorted(candidates.topics))};"
                f" correct driver_options.namespace or {option}"
            )
        if candidates.namespaces:
            request = self._namespace_request(spaces, candidates, option)
            return f"no node subscribes to {topic}; {request}"
        return f"no node subscribes to {topic}; start the base, or correct {option}"

    @property
    def command_topic(self) -> str:
        """The full name of the topic of commands."""
        return self.options.topic(self.options.cmd_vel)

    def listeners(self) -> list[str]:
        """The names of the nodes that subscribe to the commands and move no base, sorted."""
        ends = [*self.subscribers(self.command_topic), *self._strays()]
        return sorted({end.node for end in ends if self._is_listener(end)})

    def _strays(self) -> list[Endpoint]:
        return [end for end in self.strays if end.topic == self.command_topic]

    def _stray_text(self) -> str:
        """The text for DDS readers of the commands that are no ROS nodes and no listeners."""
        names = sorted({end.owner for end in self._strays() if not self._is_listener(end)})
        if not names:
            return ""
        return (
            f"{listed(names)} takes {self.command_topic}: a reader in DDS without a ROS node, or"
            " another bridge, perhaps of another base; end it, or give each robot a domain of its"
            " own"
        )

    def _is_listener(self, end: Endpoint) -> bool:
        return bool(end.node) and is_listener(end.node, self.options.cmd_vel_listeners)

    def _several_nodes(self, ends: Collection[Endpoint], action: str, *, are_alive: bool) -> str:
        """The text for ends that belong to more than one node; empty if they belong to one node.

        `action`: the verb and topic for the text, such as `publish /scan`. `are_alive`: nodes with
        one name are known to be all alive. Otherwise the older node may have crashed: the
        middleware announces a crashed node until the end of the node's lease.
        """
        nodes = [*nodes_of(ends).values()]
        names = sorted({end.owner for end in nodes})
        remedy = "give each robot a namespace or a domain of its own"
        if len(nodes) < 2:
            return ""
        if len(names) > 1:
            return f"{len(nodes)} nodes {action}: {listed(names)}; end all but one, or {remedy}"
        age = self.now - max(end.since for end in nodes)
        if are_alive or age > self.middleware.lease:
            return (
                f"{len(nodes)} living nodes named {names[0]} {action}, of several robots: end all"
                f" but one, or {remedy}"
            )
        return (
            f"{len(nodes)} nodes named {names[0]} {action}: it crashed and is back"
            f" ({self.middleware.crashed}), or two robots have it: {remedy}"
        )

    def _unrouted(self, topic: str, *, is_publisher: bool) -> str:
        """The text for a topic of nodes that a bridge lists, but does not route to this driver."""
        names = sorted(
            {
                end.owner
                for end in self.endpoints
                if not end.is_routed
                and (end.is_publisher, end.topic) == (is_publisher, topic)
                and not (not is_publisher and self._is_listener(end))
            }
        )
        if not names:
            return ""
        does = "publishes" if is_publisher else "takes"
        hub = self.middleware.hub
        return (
            f"{listed(names)} {does} {topic}, but {hub} does not hand it on: start that again, or"
            " look at what it allows"
        )

    def _undecoded(self, topic: str, *, is_publisher: bool) -> str:
        """The text for a topic of ROS processes whose nodes a bridge cannot read; empty without.

        Up to Humble a node announces its ends in DDS in another form than from Iron on. A bridge
        reads one of both forms, by its ROS_DISTRO.
        """
        ends = [end for end in self.nodeless if end.topic == topic]
        if not any(end.is_publisher is is_publisher for end in ends):
            return ""
        does = "publishes" if is_publisher else "takes"
        hub = self.middleware.hub
        return (
            f"a ROS process {does} {topic} in DDS, but {hub} cannot read its node: it has another"
            f" ROS distribution than ROS_DISTRO of {hub}; run all nodes and {hub} with Humble or"
            " older, or all with Iron or newer"
        )

    def check_time(self, subscriptions: Subscriptions, seconds: float) -> float:
        """How long a check lasts in s: `seconds`, and WAKE_TIME more while a sensor may wake.

        Such a sensor is announced and silent while other topics are heard. It starts when a node
        subscribes, as a check does.
        """
        topics = subscriptions.topics.values()
        stats = [one for one in topics if one.is_needed or one.has_only_entries]
        may_wake = any(one.count for one in stats) and any(map(self._may_sleep, stats))
        return seconds + (WAKE_TIME if may_wake else 0.0)

    def _may_sleep(self, stats: TopicStats) -> bool:
        """True for a topic that is announced with its type, and has not enough messages."""
        enough = ENOUGH_MESSAGES if stats.is_needed else 1
        types = {end.type for end in self.publishers(stats.topic)}
        is_announced = self.middleware.type_name(stats.message_type) in types
        is_silent = stats.count < enough and not stats.faults
        return is_announced and is_silent and not stats.is_never_stale

    def _namespaces(self) -> Namespaces:
        domain = self.middleware.domain
        ends = (end for end in self.endpoints if end.domain == domain and end.is_routed)
        return Namespaces(self.options, ends, self.heard)

    def _in_domain(self, *, is_publisher: bool) -> list[Endpoint]:
        domain = self.middleware.domain
        return [
            end
            for end in self.endpoints
            if end.is_publisher is is_publisher and end.domain == domain and end.is_routed
        ]

    def _info_command(self, topic: str) -> str:
        return f"{self.middleware.topic_info} {topic}"


def unreachable(middleware: Middleware, endpoint: str, fault: str = "") -> str:
    """The text for an endpoint where nothing answers; `fault`: the error of the connection."""
    why = f" ({fault})" if fault else ""
    return (
        f"nothing answers at {endpoint}{why}; {middleware.start}, or correct"
        f" {middleware.endpoint_option}"
    )


def contradiction(stats: TopicStats) -> str:
    """How the last messages of a topic contradict themselves; empty if they do not."""
    return f"{stats.topic}: {stats.doubt}" if stats.doubt else ""


def incomplete(stats: TopicStats, content: ScanContent) -> str:
    """Why the last scan leaves too much unseen; empty if it does not."""
    scan = content.last
    if scan is None:
        return ""
    if ScanConditioner(content.spec).take(scan, None, 0.0) is not Reason.INVALID_SCAN:
        return ""
    return (
        f"{stats.topic}: {content.encoding}; {len(scan.ranges)} rays that leave too wide a"
        " sector unseen; look at the sensor, and at what its driver sends: inf means no return"
        " (REP 117)"
    )


def too_slow(stats: TopicStats, content: ScanContent) -> str:
    """Why scans come too rarely for the platform; empty if they do not."""
    rate = stats.rate()
    spec = content.spec
    if not 0.0 < rate * spec.slowest_period < 1.0:
        return ""
    text = (
        f"{stats.topic} comes at {rate:.1f} Hz; the platform's {content.section}.rate is"
        f" {spec.rate:g}, so the robot would stop for old scans now and then"
    )
    by_stamp, by_clock = stats.elapsed()
    if 0.0 < by_stamp < _LEAST_CLOCK_RATIO * by_clock:
        return f"{text}: {_clock_text(stats)}; let the simulator, or that clock, run in real time"
    # A lower rate would let the robot drive on with older scans.
    return (
        f"{text}: look at the sensor's mode, its power and the network; its data sheet has the rate"
    )


def rare_odometry(stats: TopicStats) -> str:
    """Why odometry comes too rarely to drive; empty if it does not."""
    rate = stats.rate()
    if not 0.0 < rate * ODOMETRY_TIMEOUT < 1.0:
        return ""
    return (
        f"{stats.topic} comes at {rate:.2g} Hz; a robot stands while its odometry is older than"
        f" {ODOMETRY_TIMEOUT:g} s: look at the rate of what publishes it"
    )


def _clock_text(stats: TopicStats) -> str:
    """How fast the clock of a topic's stamps runs; empty before the second message."""
    by_stamp, by_clock = stats.elapsed()
    if by_clock <= 0.0:
        return ""
    ratio = by_stamp / by_clock
    late = (
        f", so that the robot reacts {ratio:.1f} times as late" if ratio > _MAX_CLOCK_RATIO else ""
    )
    return f"its stamps run at {ratio:.2f} of real time{late}"


def too_fast(stats: TopicStats, spec: ScanSpec) -> str:
    """Why scans come too often for one sensor; empty if they do not.

    The time span of the scans is measured by arrivals and by stamps, and the longer span counts.
    Delayed messages of one sensor may arrive together, but their stamps keep the rate.
    """
    (by_stamp, by_clock) = stats.elapsed()
    gaps = len(stats.times) - 1
    most = MAX_RATE * spec.rate * max(by_stamp, by_clock)
    if stats.option != "scan" or gaps < MIN_GAPS or by_stamp <= 0.0 or gaps <= most:
        return ""
    return (
        f"{stats.topic} comes at {stats.rate():.1f} Hz; the platform's scan.rate is {spec.rate:g}"
    )


def also_published(topic: str, publishers: Iterable[str], *, is_heard: bool) -> str:
    """The text for a topic of commands that other nodes of ROS 1 publish, too.

    In ROS 1 a node that the master lists as a publisher counts as driving even while silent.
    `is_heard`: a command of these nodes has arrived.
    """
    return (
        f"someone else {'drives' if is_heard else 'may drive'}: {topic} is also published by"
        f" {listed(publishers)}; end that node, or set driver_options.shared_cmd_vel if the base"
        " has a multiplexer"
    )


def driven_by_others(topic: str, publishers: Iterable[str] = ()) -> str:
    """The text for a base for which commands of other nodes arrive on `topic`.

    `publishers`: the other nodes that announce the topic; perhaps none of them is known.
    """
    names = listed(publishers)
    return (
        f"someone else drives: commands on {topic} that are not this driver's"
        f"{f', published by {names}' if names else ''}; stop what publishes them, and this driver"
        " takes over 2 s later"
    )


def unlisted(middleware: Middleware) -> str:
    """The text for a hub that does not list the nodes of a topic."""
    return (
        f"{middleware.hub} does not list its nodes: it is not known whether a second base takes the"
        f" commands; look at {middleware.topic_info} on the robot"
    )


def driven_by_action(action: str, nodes: Iterable[str], cancel: str) -> str:
    """The text for a goal of an action that moves the base; `cancel`: the command to end it."""
    names = listed(nodes)
    return (
        f"someone else drives: action {action}{f' of {names}' if names else ''} has a goal, which"
        f" zeros do not end; cancel it ({cancel}), and this driver takes over 2 s later"
    )


def driven(foreign: ForeignCommands, graph: Graph, now: float) -> str:
    """Why the base belongs to another node now; empty if it does not."""
    topic = foreign.source(now)
    action = foreign.actions.get(topic, "")
    if action:
        return driven_by_action(action, graph.nodes(topic), foreign.protocol.cancel.format(action))
    return driven_by_others(topic, graph.nodes(topic)) if topic else ""


def unconnected(topic: str, nodes: Iterable[str]) -> str:
    """The text for a ROS 1 base that subscribes, but opens no connection to this machine."""
    return (
        f"{listed(nodes)} subscribes to {topic}, but does not connect to this machine; look at"
        " ROS_IP here"
    )


def has_enough(subscriptions: Subscriptions, elapsed: float) -> bool:
    """True once each needed topic has ENOUGH_MESSAGES, and each other topic a message."""
    return elapsed >= MIN_CHECK_TIME and all(
        stats.count >= (ENOUGH_MESSAGES if stats.is_needed else 1)
        for stats in subscriptions.topics.values()
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class DriverCheck:
    """The state of a robot that a driver has checked, and the findings that follow."""

    graph: Graph
    endpoint: str
    connection_fault: str = ""  # empty if the hub answers
    subscriptions: Subscriptions
    spec: ScanSpec
    cmd_vel: str  # the full name of the topic of commands
    command_types: Sequence[type]  # the message classes that commands may have
    has_subscriber: bool  # any node subscribes to the commands
    foreign: ForeignCommands  # commands and goals of other nodes
    foreign_publishers: Collection[str] = ()  # other nodes that may publish commands
    now: float  # s on the clock of arrivals
    is_exclusive: bool = False  # another publisher of commands is a fault even while silent
    unpassed: Mapping[str, str] = field(default_factory=dict)
    """By topic: why its messages do not pass the hub."""
    unlisted: str = ""
    """Why the nodes of the topics are not known; empty if they are."""

    def findings(self) -> tuple[Finding, ...]:
        """A finding for the hub, each topic, the subscriber of commands, and other publishers."""
        if self.connection_fault:
            return (Finding("connection", False, self.connection_fault),)
        return tuple(self._findings())

    def _findings(self) -> Iterator[Finding]:
        """The findings of a check whose hub answers."""
        yield Finding("connection", True, f"{self.graph.middleware.hub} at {self.endpoint}")
        for option, content in self.subscriptions.contents.items():
            if content.last is not None:
                yield self._values(option, content)
        for stats in self.subscriptions.topics.values():
            yield from self._of_topic(stats)
        ring = self.subscriptions.contents.get("ranges")
        if ring is not None and ring.last is not None:
            yield Finding("ranges", not ring.fault, ring.fault or ring.text)
        yield self._scan_delay()
        sweep = self.subscriptions.sweep_finding()
        if sweep is not None:
            yield sweep
        yield self._commands()
        if self.unlisted:
            yield Finding("nodes", True, self.unlisted, is_measured=False)
        yield self._last_word()

    def _of_topic(self, stats: TopicStats) -> Iterator[Finding]:
        """The findings of a topic: under its own name, and under each further entry that reads it.

        A topic has a finding of its own in three cases: the robot needs the topic, the user has
        named the topic, or a message has come.
        """
        # The user names a topic by an entry, or by one of the options `imu` and `battery`.
        is_named = stats.has_only_entries or stats.name in ("imu", "battery")
        has_come = bool(stats.count or stats.faults)  # readable messages, or unreadable ones
        if stats.is_needed or is_named or has_come:
            yield self._topic(stats)
        for entry_option in stats.further:
            yield replace(self._topic(stats, is_entry=True), subject=entry_option)

    def _values(self, option: str, content: ScanContent) -> Finding:
        """What the rays without a distance are, and how fast the clock of the stamps runs."""
        topics = self.subscriptions.topics.values()
        stats = next(one for one in topics if one.option == option)
        encoding = content.encoding or "each ray has a distance"
        text = "; ".join(part for part in (encoding, _clock_text(stats)) if part)
        return Finding(f"{content.section} values", True, text)

    def _commands(self) -> Finding:
        """The finding of the topic of commands, with the first fault that applies.

        A fault is: no base, a second base, or a hub that does not pass the commands on.
        """
        fault = self.graph.no_subscriber(
            self.cmd_vel, self.command_types, has_subscriber=self.has_subscriber
        )
        conflict = self.graph.conflict(self.subscriptions.topics.values(), self.spec)
        # A SCAN_CONFLICT, a second publisher of scans, is a fault of its topic (`_topic`).
        if not fault and conflict is not None and conflict.reason is Reason.BASE_CONFLICT:
            fault = conflict.text
        fault = fault or self.unpassed.get(self.cmd_vel, "")
        return Finding("cmd_vel", not fault, fault or self._subscriber())

    def _scan_delay(self) -> Finding:
        topics = self.subscriptions.topics
        option = "scan" if "scan" in topics else "ranges"
        scans = [
            pair for stats in topics.values() if stats.option == option for pair in stats.pairs
        ]
        return scan_delay_finding(
            scans, topics["odometry"].pairs, self.subscriptions.scan, self.spec
        )

    def _topic(self, stats: TopicStats, *, is_entry: bool = False) -> Finding:
        """The finding of a topic; `is_entry`: for an entry (topic_entries.py) that shares it."""
        fault = self._fault(stats)
        goes_stale = stats.has_only_entries or is_entry
        if fault:
            # A silent topic is no fault of a robot that does not need it, unless an entry reads it.
            is_fault = stats.is_needed or goes_stale or stats.count or stats.faults
            text = fault if is_fault else f"no message, and not needed to drive: {fault}"
            return Finding(stats.name, not is_fault, text)
        age = self.now - stats.last_arrival()
        if goes_stale and age > stats.stale_after:
            text = f"{stats.topic}: the last message is {age:.1f} s old, stale after"
            return Finding(stats.name, False, f"{text} {stats.stale_after:g} s; look at the sensor")
        by_stamp, by_clock = stats.elapsed()
        rate = f"{stats.rate():.1f} Hz" if stats.rate() else ""
        if goes_stale:
            clock = f"{age:.1f} s ago"
        else:
            clock = f"stamps advanced by {by_stamp:.1f} s in {by_clock:.1f} s" if rate else ""
        content = self.subscriptions.contents["scan"].text if stats.name == "scan" else ""
        details = ", ".join(part for part in (rate, content, stats.summary, clock) if part)
        type_name = self.graph.middleware.type_name(stats.message_type)
        kind = ", ".join((type_name, *self.graph.qualities(stats.topic, is_publisher=True)))
        return Finding(stats.name, True, f"{stats.topic} ({kind}): {details}".rstrip(": "))

    def _fault(self, stats: TopicStats) -> str:
        """The first fault of a topic; empty without a fault."""
        if stats.faults:
            return self.graph.unreadable(stats)
        if not stats.count:
            return self.unpassed.get(stats.topic) or self.graph.silence(stats)
        fault = self.graph.unreliable(stats, self.spec)
        if not fault and stats.name == "odometry":
            fault = contradiction(stats) or (rare_odometry(stats) if stats.is_needed else "")
        if fault or not stats.is_needed or stats.name == "odometry":
            return fault
        content = self.subscriptions.contents[stats.option]
        fast = too_fast(stats, self.spec)
        fault = f"{fast}; look for a second publisher" if fast else ""
        fault = fault or too_slow(stats, content)
        if not fault and stats.name == "scan" and content.fault:
            fault = f"{stats.topic}: {content.fault}"
        return fault or incomplete(stats, content) or contradiction(stats)

    def _subscriber(self) -> str:
        kind = self.graph.command_type(self.cmd_vel, self.command_types)
        assert kind is not None  # otherwise there is a fault
        qualities = self.graph.qualities(self.cmd_vel, is_publisher=False)
        details = ", ".join((self.graph.middleware.type_name(kind), *qualities))
        names = listed(sorted({end.node for end in self.graph.bases(self.cmd_vel) if end.node}))
        listening = listed(self.graph.listeners())
        beside = f" ({listening} only listens)" if listening else ""
        return f"{self.cmd_vel} ({details}) has a subscriber{names and ': '}{names}{beside}"

    def _last_word(self) -> Finding:
        """The finding on other nodes that command the base, or may command the base.

        A fault if another node commands the base now. With `is_exclusive` (ROS 1 without the option
        `shared_cmd_vel`) a silent publisher of commands is a fault, too.
        """
        if fault := self._heard():
            return Finding("last_word", False, fault)
        if self.foreign_publishers and self.is_exclusive:
            text = also_published(self.cmd_vel, sorted(self.foreign_publishers), is_heard=False)
            return Finding("last_word", False, text)
        return Finding("last_word", True, self._silent_publishers() + self._actions())

    def _silent_publishers(self) -> str:
        """The text on nodes that publish no commands now but may do so, and on a multiplexer.

        A multiplexer decides whose commands reach the base. A subscriber of the commands with `mux`
        in its name counts as a multiplexer.
        """
        own_topic, *further_topics = self.foreign.topics
        owners_of = {own_topic: sorted(self.foreign_publishers)}
        owners_of |= {topic: self._owners(topic) for topic in further_topics}
        silent_texts = [
            f"{listed(owners)} may publish {topic}" for topic, owners in owners_of.items() if owners
        ]
        nodes = {end.node for end in self.graph.subscribers(self.cmd_vel)}
        multiplexer = listed(sorted(node for node in nodes if "mux" in node))
        priority = f"give swarmd the highest priority there ({LAST_WORD})"
        mux_text = f"{multiplexer} takes {self.cmd_vel}: {priority}" if multiplexer else ""
        if not silent_texts:
            return mux_text or f"no other node publishes {listed(self.foreign.topics)}"
        advice = mux_text or f"then it has the last word, not swarmd ({LAST_WORD})"
        return f"{', '.join(silent_texts)} too, but does not now; {advice}"

    def _heard(self) -> str:
        """The text for commands or goals of other nodes that were heard; empty without any."""
        goal = self.foreign.source(self.now)
        if goal in self.foreign.actions:
            return driven(self.foreign, self.graph, self.now)
        heard = [
            f"{count} commands of another node on {topic}"
            for topic, count in self.foreign.counts.items()
        ]
        if not heard:
            return ""
        return (
            f"{listed(heard)}; stop what publishes them, or give swarmd"
            f" the last word ({LAST_WORD}), unless it is this robot's own daemon or watchdog"
        )

    def _actions(self) -> str:
        """Which actions that may move the base have a server."""
        text = ""
        for status, action in self.foreign.actions.items():
            owners = self._owners(status)
            served = f"action {action} of {listed(owners)} has no goal"
            text += f"; {served}" if owners else f"; no node serves action {action}"
        return text

    def _owners(self, topic: str) -> list[str]:
        return sorted({end.owner for end in self.graph.publishers(topic)})


def listed(names: Iterable[str]) -> str:
    """The first _MAX_LISTED names, and the number of further names."""
    known = list(names)
    more = f" and {len(known) - _MAX_LISTED} more" if len(known) > _MAX_LISTED else ""
    return ", ".join(known[:_MAX_LISTED]) + more


def _nearest_first(topic: str, names: Collection[str]) -> list[str]:
    return sorted(names, key=lambda name: (-SequenceMatcher(None, topic, name).ratio(), name))


def _short(type_name: str) -> str:
    return type_name.rpartition("/")[2]


def _domains(ends: Iterable[Endpoint]) -> list[int]:
    return sorted({end.domain for end in ends if end.domain is not None})
