"""Option `readings`: a number in messages of any known type, named by topic and field."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter, itemgetter
from typing import Annotated, Any, Literal

from msgspec import Meta, Struct
from rosbags.interfaces import Nodetype
from rosbags.typesys.base import normalize_fieldname

from swarmd.core.errors import ConfigError, unknown
from swarmd.core.events import ReadingsInput
from swarmd.core.values import sensor_names
from swarmd.drivers.ros.absence import why_absent
from swarmd.drivers.ros.cdr import name_of
from swarmd.drivers.ros.message_types import MessageTypes
from swarmd.drivers.ros.topic_inputs import TopicEntry, TopicInputs, faults_of

IMU: tuple[str, ...] = ("yaw",)
BATTERY: tuple[str, ...] = ("battery", "battery_voltage")
"""The readings of the options `imu` and `battery`."""

READING = "readings."
"""Prefix of the option of a reading, such as `readings.light`."""

_OWN = (*IMU, *BATTERY)
_ANY = "*"
MAX_SENSORS = 64
"""Sensors in one entry of `readings`."""

_TEXTS = ("string", "wstring", "wchar")
_LENGTH = "length"
Step = Callable[[Any], Any]

StaleAfter = Annotated[float, Meta(ge=0.1, le=3600.0)] | Literal["never"]
Text = Annotated[str, Meta(min_length=1, max_length=200)]


class ReadingOptions(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One entry of the option `readings`.

    `field`: the number in a message of `type`, by names and indices separated by dots, such as
    `vector.x` or `data.0`; `data.length` is the number of items of the list `data`. `unit`: for
    display only. `stale_after`: s without a message after which the reading has no value. `never`
    is for a topic that is published on change: its last message counts while its publisher is
    there.

    An entry with several sensors, such as `ground`, gives the readings `ground_1`, `ground_2` ...
    and their mean `ground`. The sensors are several topics (a list in `topic`), or `count` items of
    a list in one message, whose index is `*` in `field`, such as `data.*`.
    """

    topic: Text | Annotated[tuple[Text, ...], Meta(min_length=2, max_length=MAX_SENSORS)]
    type: Annotated[str, Meta(min_length=3, max_length=200)]
    field: Text = "data"
    unit: Annotated[str, Meta(max_length=32)] = ""
    stale_after: StaleAfter = 1.0
    count: Annotated[int, Meta(ge=1, le=MAX_SENSORS)] | None = None

    def topics(self, name: str) -> dict[str, str]:
        """The topics of the entry `name`, each by the option that messages name."""
        if isinstance(self.topic, str):
            return {f"{READING}{name}": self.topic}
        return {f"{READING}{name}_{i}": topic for i, topic in enumerate(self.topic, start=1)}


@dataclass(frozen=True, slots=True)
class TopicReading(TopicEntry):
    """A number in the messages of a topic."""

    mean_of: str  # the name of the mean of several sensors; empty for a single sensor
    field: str
    path: tuple[Step, ...]  # the steps from a message to the field
    unit: str

    def value(self, message: Any) -> float:
        """The number in a message; NaN if the message has none (`lacks`)."""
        return math.nan if self.lacks(message) else float(value_at(message, self.path))

    def lacks(self, message: Any) -> str:
        """Why a message has no number for this reading; empty if the message has the number.

        The number is not measured, not finite, or beyond the end of a list.
        """
        try:
            number = float(value_at(message, self.path))
        except IndexError:
            return f"the message has no item {self.field}"
        is_finite = math.isfinite(number)
        return why_absent(message, self.field, number) or ("" if is_finite else "it is not finite")


def topic_readings(
    name: str, options: ReadingOptions, full_name: Callable[[str], str], types: MessageTypes
) -> tuple[TopicReading, ...]:
    """The readings of the entry `name` of option `readings`: one for each sensor of the entry.

    `full_name(topic)` returns the full name of a topic. `types`: the known message types.
    ConfigError names the key that is wrong.
    """
    option = f"{READING}{name}"
    # 1. The name, and the type of the messages.
    if not name.isidentifier() or len(name) > 63:
        raise ConfigError(f"{option}: expected a name of at most 63 letters, digits and _")
    if name in _OWN:
        raise ConfigError(f"{option}: options imu and battery give {', '.join(_OWN)}; rename it")
    with faults_of(f"{option}.type"):
        message_type = types.kind(options.type)
    # 2. The fields of a message: `count` items of a list, or a single field.
    has_any_index = _ANY in options.field.split(".")
    fields_with_index = f"a field with the index {_ANY}, such as data.{_ANY}"
    if has_any_index and options.count is None:
        raise ConfigError(f"{option}.count is missing beside {fields_with_index}")
    if options.count is not None and not has_any_index:
        raise ConfigError(f"{option}.count needs {fields_with_index}")
    fields = [options.field.replace(_ANY, str(index)) for index in range(options.count or 1)]
    with faults_of(f"{option}.field is {options.field!r}"):
        paths = {field: number_path(types, message_type, field) for field in fields}
    # 3. A sensor for each topic and field. Several sensors are numbered, and have a mean with the
    # name of the entry, which is the first of `sensor_names`.
    topics = options.topics(name)
    sensors = [(topic_option, field) for topic_option in topics for field in paths]
    is_single = options.count is None and len(topics) == 1
    names = (name,) if is_single else sensor_names(name, len(sensors))[1:]
    stale_after = seconds(options.stale_after)
    return tuple(
        TopicReading(
            name=sensor_name,
            option=topic_option,
            topic=full_name(topics[topic_option]),
            message_type=message_type,
            stale_after=stale_after,
            mean_of="" if is_single else name,
            field=field,
            path=paths[field],
            unit=options.unit,
        )
        for sensor_name, (topic_option, field) in zip(names, sensors, strict=True)
    )


def seconds(stale_after: float | Literal["never"]) -> float:
    """The option `stale_after` in s; infinite for `never`."""
    return math.inf if stale_after == "never" else stale_after


def number_path(types: MessageTypes, message_type: type, field: str) -> tuple[Step, ...]:
    """The steps to a number in messages of a type; ConfigError if the field is no number."""
    steps, node = path_of(types, message_type, field)
    if fault := _end_fault(types.fielddefs, *node):
        raise ConfigError(fault)
    # rosbags reads a `byte` as signed, as in ROS 1; in ROS 2 it is unsigned.
    is_octet = node[1][0] == "byte" and not types.is_ros1
    return (*steps, lambda value: int(value) & 0xFF) if is_octet else steps


def path_of(
    types: MessageTypes, message_type: type, field: str
) -> tuple[tuple[Step, ...], tuple[Any, Any]]:
    """The steps to a field in messages of a type, and rosbags' node of the field's type.

    ConfigError if there is no such field.
    """
    steps: list[Step] = []
    node: tuple[Any, Any] = (Nodetype.NAME, name_of(message_type))
    for part in field.split("."):
        step, node = _step(types.fielddefs, *node, part)
        steps.append(step)
    return tuple(steps), node


def value_at(message: Any, path: Sequence[Step]) -> Any:
    """The value of a message's field by the steps of `path_of`; IndexError beyond a list's end."""
    for step in path:
        message = step(message)
    return message


def _step(fielddefs: Mapping[str, Any], node: Any, detail: Any, part: str) -> tuple[Step, Any]:
    """The step from a value to its part `part`, and the type of the part.

    A part is a field of a message, an item of a list, or its length. rosbags describes a type by a
    pair: `node` (a message, a list or a base type) and `detail`. ConfigError without such a part.
    """
    if node is Nodetype.NAME:
        fields = dict(fielddefs[detail][1])
        if part not in fields:
            raise ConfigError(unknown(f"field of {detail.replace('/msg/', '/')}", part, fields))
        return attrgetter(normalize_fieldname(part)), fields[part]
    if node is Nodetype.BASE:
        raise ConfigError(f"expected nothing below a number, not {part!r}")
    if part == _LENGTH:
        return len, (Nodetype.BASE, ("uint32", 0))
    if not part.isdecimal():
        raise ConfigError(f"expected an index, such as .0, or {_LENGTH}, not {part!r}")
    index = int(part)
    if node is Nodetype.ARRAY and index >= detail[1]:
        raise ConfigError(f"expected an index below {detail[1]}, not {index}")
    return itemgetter(index), detail[0]


def _end_fault(fielddefs: Mapping[str, Any], node: Any, detail: Any) -> str:
    """Why a field of this type is no number; empty if it is a number."""
    if node is Nodetype.NAME:
        names = [name for name, _ in fielddefs[detail][1]]
        return f"a {detail.replace('/msg/', '/')}, not a number; add one of {', '.join(names)}"
    if node is not Nodetype.BASE:
        return f"a list, not a number; add an index, such as .0, or .{_LENGTH}"
    return f"a {detail[0]}; expected a number" if detail[0] in _TEXTS else ""


class Readings(TopicInputs[TopicReading, float]):
    """The present values of all readings, including those of the options `imu` and `battery`."""

    def __init__(self, entries: Mapping[str, TopicReading]) -> None:
        super().__init__(entries)
        self._groups: dict[str, list[str]] = {}  # the sensors of each mean
        for name, reading in entries.items():
            if reading.mean_of:
                self._groups.setdefault(reading.mean_of, []).append(name)
        self._own: dict[str, float] = {}
        self._reported_stale = frozenset[str]()
        self._is_changed = False

    def take_own(self, names: Collection[str], values: Mapping[str, float]) -> None:
        """Replace the readings `names` of `imu` or `battery` by `values`, which are never stale."""
        self._is_changed = True
        self._own = {n: v for n, v in self._own.items() if n not in names} | {**values}

    def take(self, name: str, message: Any, now: float, *, is_kept: bool = False) -> str:
        """See `TopicInputs`."""
        reading = self._entries[name]
        value = reading.value(message)
        self._is_changed = True
        if is_kept and name in self._values:
            return self._text(reading, self._values[name][0])
        if math.isnan(value):
            if reading.is_never_stale:
                self._values.pop(name, None)
            return f"{name} has no value: {reading.lacks(message)}"
        self._values[name] = value, now
        return self._text(reading, value)

    def forget(self, topic: str | None = None) -> None:
        """As `TopicInputs.forget`; without a topic drop `imu` and `battery`, too."""
        self._own = {} if topic is None else self._own
        super().forget(topic)

    def input(self, now: float, *, again: bool = False) -> ReadingsInput | None:
        """All readings; NaN for each without a value that is fresh enough."""
        stale = frozenset(reading.name for reading in self._stale(now))
        is_due = again and (self._entries or self._own)
        if not (is_due or self._is_changed or stale != self._reported_stale):
            return None
        self._reported_stale = stale
        self._is_changed = False
        fresh = {n: v for n, (v, _) in self._values.items() if n not in stale}
        means = {
            name: math.fsum(fresh.get(sensor, math.nan) for sensor in sensors) / len(sensors)
            for name, sensors in self._groups.items()
        }
        values = {**self._own, **means, **fresh, **dict.fromkeys(sorted(stale), math.nan)}
        return ReadingsInput(values)

    def _text(self, reading: TopicReading, value: float) -> str:
        return f"{reading.name} {value:.4g} {reading.unit}".rstrip()
