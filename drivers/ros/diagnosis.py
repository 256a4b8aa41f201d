"""What is wrong with a topic and the next step, going by what the others announce. Pure.

`swarmd --check` of a ROS 2 driver: what was seen of the robot, each with the next step. Pure.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass

from swarmd.core.messages import Reason
from swarmd.core.values import Scan, ScanSpec
from swarmd.driver_api.driver import Finding
from swarmd.drivers.ros.cdr import name_of
from swarmd.drivers.ros.topic_stats import Sense
from swarmd.drivers.ros2.key_scheme import Endpoint, KeyScheme
from swarmd.drivers.ros2.subscriptions import Subscriptions
from swarmd.sensing.conditioning import ScanConditioner

_SHOWN = 4
_COMMANDS = {
    "geometry_msgs/msg/Twist": "cmd_vel_type: twist",
    "geometry_msgs/msg/TwistStamped": "cmd_vel_type: twist_stamped",
}


def why_silent(sense: Sense, graph: Collection[Endpoint], scheme: KeyScheme) -> str:
    """Why nothing comes on a topic, in one line with the next step."""
    wanted, topic, option = name_of(sense.kind), sense.topic, f"driver_options.{sense.option}"
    said = [end for end in graph if end.is_publisher]
    here = [end for end in said if end.domain == scheme.domain]
    types = sorted({end.type for end in here if end.topic == topic})
    if wanted in types:
        return f"{topic} is announced but silent; look at the sensor: ros2 topic hz {topic}"
    if types:
        return f"{topic} carries {', '.join(types)}; wanted is {wanted}: correct {option}"
    domains = _domains(end for end in said if (end.topic, end.type) == (topic, wanted))
    if here and not domains:
        alike = sorted({end.topic for end in here if end.type == wanted})
        if alike:
            return (
                f"no {topic}, but {shown(alike)} of that type; correct driver_options.namespace"
                f" or {option}"
            )
        names = sorted({end.topic for end in here})
        return f"no {topic} among {shown(names)}; start the sensor, or correct {option}"
    domains = domains or _domains(said)
    if domains:
        what = topic if here else "topic"
        return (
            f"no {what} in domain {scheme.domain}, but in {shown(map(str, domains))}; correct"
            " driver_options.domain"
        )
    return f"no {topic}, and {scheme.hub} announces no topic at all; {scheme.silent}"


def why_refused(sense: Sense, graph: Collection[Endpoint], scheme: KeyScheme) -> str:
    """What came on a topic and could not be taken, in one line with the next step."""
    wanted, topic = name_of(sense.kind), sense.topic
    types = {end.type for end in _publishing(topic, graph, scheme)}
    if types and wanted not in types:
        return why_silent(sense, graph, scheme)
    return (
        f"{topic}: {sense.fault}; correct driver_options.{sense.option}, or look at what publishes"
        f" it: ros2 topic info -v {topic}"
    )


def why_misleading(sense: Sense, graph: Collection[Endpoint], scheme: KeyScheme) -> str:
    """Why what comes on a topic cannot be relied on, with the next step; empty if it can."""
    topic = sense.topic
    if not sense.advances():
        return (
            f"{topic}: messages come, all with the stamp {sense.stamps[-1]:.12g}; look at the"
            " sensor, which is frozen, or at its publisher, which fills in none"
        )
    said = _publishing(topic, graph, scheme)
    if len(said) > 1 and sense.is_needed:
        whose = shown(sorted({end.who for end in said}))
        return (
            f"{len(said)} publish {topic}: {whose}; end all but one, or give each robot a namespace"
        )
    if sense.goes_back():
        return (
            f"the stamps of {topic} go back again and again: two publish it, or a clock is being"
            f" set; look at ros2 topic info -v {topic}"
        )
    return ""


def why_blind(sense: Sense, scan: Scan, spec: ScanSpec) -> str:
    """Why this sweep alone shows too little, with the next step; empty if it shows enough."""
    if ScanConditioner(spec).take(scan, None, 0.0) is not Reason.INVALID_SCAN:
        return ""
    return (
        f"{sense.topic}: {len(scan.ranges)} rays that leave too wide a sector unseen; look at the"
        " sensor, or correct the platform's scan"
    )


def why_unheard(
    topic: str, command: type, graph: Collection[Endpoint], scheme: KeyScheme, *, has_taker: bool
) -> str:
    """Why commands lead nowhere, with the next step; empty if they have a taker.

    `has_taker`: whether anyone at all listens on the key, announced or not.
    """
    wanted = name_of(command)
    heard = [end for end in graph if not end.is_publisher and end.domain == scheme.domain]
    types = sorted({end.type for end in heard if end.topic == topic})
    if types and wanted not in types:
        option = _COMMANDS.get(types[0], "cmd_vel, or cmd_vel_type")
        return f"{topic} wants {shown(types)}, not {wanted}; set driver_options.{option}"
    if types or has_taker:
        return ""
    alike = sorted({end.topic for end in heard if end.type in _COMMANDS})
    if alike:
        return (
            f"nobody subscribes to {topic}, but to {shown(alike)}; correct driver_options.namespace"
            " or driver_options.cmd_vel"
        )
    return f"nobody subscribes to {topic}; start the base, or correct driver_options.cmd_vel"


def shown(names: Iterable[str]) -> str:
    """The first few, and how many more."""
    listed = list(names)
    more = f" and {len(listed) - _SHOWN} more" if len(listed) > _SHOWN else ""
    return ", ".join(listed[:_SHOWN]) + more


def _domains(ends: Iterable[Endpoint]) -> list[int]:
    return sorted({end.domain for end in ends if end.domain is not None})


def _publishing(topic: str, graph: Iterable[Endpoint], scheme: KeyScheme) -> list[Endpoint]:
    return [
        end
        for end in graph
        if end.is_publisher and end.topic == topic and end.domain == scheme.domain
    ]


ENOUGH = 5
AT_LEAST = 1.0


def has_enough(hearing: Subscriptions, elapsed: float) -> bool:
    """Whether all that is needed was heard often enough to tell its rate, and the rest at all."""
    senses = hearing.senses.values()
    return elapsed >= AT_LEAST and all(
        sense.count >= (ENOUGH if sense.is_needed else 1) for sense in senses
    )


def unheard(scheme: KeyScheme, endpoint: str) -> str:
    """Nothing listens at the endpoint."""
    return f"nothing answers at {endpoint}; {scheme.start}, or correct driver_options.endpoint"


@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """What a driver knows of its robot after having looked for a while.

    `graph`: what others announce. `has_taker`: whether anyone listens for commands on the key.
    `others`: how many commands of others came.
    """

    scheme: KeyScheme
    endpoint: str
    is_connected: bool
    hearing: Subscriptions
    spec: ScanSpec
    graph: Collection[Endpoint]
    cmd_vel: str
    command: type
    has_taker: bool
    others: int

    def findings(self) -> tuple[Finding, ...]:
        """One line each: the hub, every topic, where commands go, who else commands."""
        if not self.is_connected:
            return (Finding("connection", False, unheard(self.scheme, self.endpoint)),)
        return tuple(self._findings())

    def _findings(self) -> Iterator[Finding]:
        yield Finding("connection", True, f"{self.scheme.hub} at {self.endpoint}")
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
            return why_refused(sense, self.graph, self.scheme)
        if not sense.count:
            return why_silent(sense, self.graph, self.scheme)
        fault = why_misleading(sense, self.graph, self.scheme)
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
            self.cmd_vel, self.command, self.graph, self.scheme, has_taker=self.has_taker
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
            if end.is_publisher and end.topic == self.cmd_vel and end.domain == self.scheme.domain
        ]
        if said:
            text = f"{shown(sorted(said))} may publish {self.cmd_vel} too, but does not now"
            return Finding("others", True, text)
        return Finding("others", True, f"nobody else publishes {self.cmd_vel}")
