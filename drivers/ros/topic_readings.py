"""Readings of a robot's own topics: a number in a message of any known type, by its field."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from msgspec import Meta, Struct
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores

from swarmd.core.errors import ConfigError, unknown
from swarmd.drivers.ros.cdr import store

_OWN = ("yaw", "battery", "battery_voltage")
_NUMBERS = ("bool", "float", "int", "uint")
Path = tuple[str | int, ...]


class ReadingOptions(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One entry of the option `readings`.

    `field`: the place of the number in a message of `type`: names and indices between dots, such as
    `vector.x` or `data.0`. `unit` is for people. `stale_after`: s without a message after which the
    reading has no value.
    """

    topic: Annotated[str, Meta(min_length=1, max_length=200)]
    type: Annotated[str, Meta(min_length=3, max_length=200)]
    field: Annotated[str, Meta(min_length=1, max_length=200)] = "data"
    unit: Annotated[str, Meta(max_length=32)] = ""
    stale_after: Annotated[float, Meta(ge=0.1, le=3600.0)] = 1.0


@dataclass(frozen=True, slots=True)
class TopicReading:
    """A reading `name` that messages of `message_type` carry at `path`."""

    name: str
    topic: str
    message_type: type
    path: Path
    unit: str
    stale_after: float

    def value(self, message: Any) -> float:
        """The number in a message; NaN if it is not finite, or beyond the end of a list."""
        found = message
        try:
            for step in self.path:
                found = found[step] if isinstance(step, int) else getattr(found, step)
        except IndexError:
            return math.nan
        number = float(found)
        return number if math.isfinite(number) else math.nan


def topic_reading(name: str, options: ReadingOptions, topic: str, distro: Stores) -> TopicReading:
    """The reading of an entry; ConfigError names the key that is wrong.

    `topic` is the full name. `distro` has the definitions of the message types.
    """
    known = store(distro)
    where = f"readings.{name}"
    if not name.isidentifier() or len(name) > 63:
        raise ConfigError(f"{where}: expected a name of at most 63 letters, digits and _")
    if name in _OWN:
        raise ConfigError(f"{where}: options imu and battery give {', '.join(_OWN)}; rename it")
    full = _full_name(options.type)
    if full not in known.types:
        names = [one.replace("/msg/", "/") for one in known.types]
        fault = unknown("message type", options.type.replace("/msg/", "/"), names)
        raise ConfigError(f"{where}.type: {fault}")
    path = tuple(int(s) if s.isdecimal() else s for s in options.field.split("."))
    if fault := _field_fault(known.fielddefs, full, path):
        raise ConfigError(f"{where}.field is {options.field!r}: {fault}")
    kind: type = known.types[full]
    return TopicReading(name, topic, kind, path, options.unit, options.stale_after)


def _full_name(type_name: str) -> str:
    """`sensor_msgs/msg/Temperature` for `sensor_msgs/Temperature`."""
    package, _, rest = type_name.partition("/")
    return f"{package}/msg/{rest.removeprefix('msg/')}"


def _field_fault(fielddefs: Mapping[str, Any], type_name: str, path: Path) -> str:
    """Why there is no number at the path; empty if there is one."""
    kind: Any = (Nodetype.NAME, type_name)
    for step in path:
        node, detail = kind
        if node is Nodetype.NAME:
            fields = dict(fielddefs[detail][1])
            if step not in fields:
                return unknown(f"field of {detail.replace('/msg/', '/')}", str(step), fields)
            kind = fields[step]
        elif node is Nodetype.BASE or not isinstance(step, int):
            wanted = "nothing below a number" if node is Nodetype.BASE else "an index, such as .0"
            return f"expected {wanted}, not {step!r}"
        elif node is Nodetype.ARRAY and step >= detail[1]:
            return f"expected an index below {detail[1]}, not {step}"
        else:
            kind = detail[0]
    return _end_fault(fielddefs, kind)


def _end_fault(fielddefs: Mapping[str, Any], kind: Any) -> str:
    node, detail = kind
    if node is Nodetype.NAME:
        names = [name for name, _ in fielddefs[detail][1]]
        return f"a {detail.replace('/msg/', '/')}, not a number; add one of {', '.join(names)}"
    if node is not Nodetype.BASE:
        return "a list, not a number; add an index, such as .0"
    is_number = str(detail[0]).startswith(_NUMBERS)
    return "" if is_number else f"a {detail[0]}; expected a number"


class Readings:
    """The present values of a robot's readings, each with its age; times in s of the caller."""

    def __init__(self, readings: Mapping[str, TopicReading]) -> None:
        self._readings = readings
        self._own: dict[str, float] = {}
        self._values: dict[str, tuple[float, float]] = {}  # value and arrival
        self._stale = frozenset[str]()

    def take_own(self, values: Mapping[str, float]) -> None:
        """Take in values of the options `imu` and `battery`, which do not become stale."""
        self._own = {**self._own, **values}

    def take(self, name: str, message: Any, now: float) -> str:
        """Take in a message that carries a reading; the value as text."""
        reading = self._readings[name]
        value = reading.value(message)
        if math.isnan(value):
            return f"{name} has no finite value"
        self._values[name] = value, now
        return f"{name} {value:.4g} {reading.unit}".rstrip()

    def at(self, now: float) -> dict[str, float]:
        """All readings; NaN for each without a value that is fresh enough."""
        stale = frozenset(self._stale_at(now))
        self._stale = stale
        fresh = {n: v for n, (v, _) in self._values.items() if n not in stale}
        return {**self._own, **fresh, **dict.fromkeys(sorted(stale), math.nan)}

    def changed(self, now: float) -> dict[str, float] | None:
        """All readings, if one has become stale since the last look; else None."""
        return None if frozenset(self._stale_at(now)) == self._stale else self.at(now)

    def _stale_at(self, now: float) -> Iterator[str]:
        for name, reading in self._readings.items():
            if now - self._values.get(name, (0.0, -math.inf))[1] > reading.stale_after:
                yield name
