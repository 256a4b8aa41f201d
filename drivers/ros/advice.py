"""What is wrong with a topic and the next step, going by what the others announce. Pure."""

from __future__ import annotations

from collections.abc import Collection, Iterable

from swarmd.drivers.ros.cdr import name_of
from swarmd.drivers.ros.dialect import Dialect, Endpoint
from swarmd.drivers.ros.sense import Sense
from swarmd.messages import Reason
from swarmd.scans.conditioning import ScanConditioner
from swarmd.values import Scan, ScanSpec

_SHOWN = 4
_COMMANDS = {
    "geometry_msgs/msg/Twist": "cmd_vel_type: twist",
    "geometry_msgs/msg/TwistStamped": "cmd_vel_type: twist_stamped",
}


def why_silent(sense: Sense, graph: Collection[Endpoint], dialect: Dialect) -> str:
    """Why nothing comes on a topic, in one line with the next step."""
    wanted, topic, option = name_of(sense.kind), sense.topic, f"driver_options.{sense.option}"
    said = [end for end in graph if end.is_publisher]
    here = [end for end in said if end.domain == dialect.domain]
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
            f"no {what} in domain {dialect.domain}, but in {shown(map(str, domains))}; correct"
            " driver_options.domain"
        )
    return f"no {topic}, and {dialect.hub} announces no topic at all; {dialect.silent}"


def why_refused(sense: Sense, graph: Collection[Endpoint], dialect: Dialect) -> str:
    """What came on a topic and could not be taken, in one line with the next step."""
    wanted, topic = name_of(sense.kind), sense.topic
    types = {end.type for end in _publishing(topic, graph, dialect)}
    if types and wanted not in types:
        return why_silent(sense, graph, dialect)
    return (
        f"{topic}: {sense.fault}; correct driver_options.{sense.option}, or look at what publishes"
        f" it: ros2 topic info -v {topic}"
    )


def why_misleading(sense: Sense, graph: Collection[Endpoint], dialect: Dialect) -> str:
    """Why what comes on a topic cannot be relied on, with the next step; empty if it can."""
    topic = sense.topic
    if not sense.advances():
        return (
            f"{topic}: messages come, all with the stamp {sense.stamps[-1]:.12g}; look at the"
            " sensor, which is frozen, or at its publisher, which fills in none"
        )
    said = _publishing(topic, graph, dialect)
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
    topic: str, command: type, graph: Collection[Endpoint], dialect: Dialect, *, has_taker: bool
) -> str:
    """Why commands lead nowhere, with the next step; empty if they have a taker.

    `has_taker`: whether anyone at all listens on the key, announced or not.
    """
    wanted = name_of(command)
    heard = [end for end in graph if not end.is_publisher and end.domain == dialect.domain]
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


def _publishing(topic: str, graph: Iterable[Endpoint], dialect: Dialect) -> list[Endpoint]:
    return [
        end
        for end in graph
        if end.is_publisher and end.topic == topic and end.domain == dialect.domain
    ]
