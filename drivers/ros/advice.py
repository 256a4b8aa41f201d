"""The next step where a topic is silent, going by what the others announce. Pure."""

from __future__ import annotations

from collections.abc import Collection, Iterable

from swarmd.drivers.ros.cdr import name_of
from swarmd.drivers.ros.dialect import Dialect, Endpoint
from swarmd.drivers.ros.sense import Sense

_SHOWN = 4


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
    alike = sorted({end.topic for end in here if end.type == wanted})
    if alike:
        return (
            f"no {topic}, but {shown(alike)} of that type; correct driver_options.namespace"
            f" or {option}"
        )
    if here:
        names = sorted({end.topic for end in here})
        return f"no {topic} among {shown(names)}; start the sensor, or correct {option}"
    domains = sorted({end.domain for end in said if end.domain is not None})
    if domains:
        return (
            f"no topic in domain {dialect.domain}, but in {shown(map(str, domains))}; correct"
            " driver_options.domain"
        )
    return f"no {topic}, and {dialect.hub} announces no topic at all; {dialect.silent}"


def shown(names: Iterable[str]) -> str:
    """The first few, and how many more."""
    listed = list(names)
    more = f" and {len(listed) - _SHOWN} more" if len(listed) > _SHOWN else ""
    return ", ".join(listed[:_SHOWN]) + more
