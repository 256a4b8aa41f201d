"""Option `hazards`: numbers in messages of a robot's topics that mean a hazard."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from msgspec import Meta, Struct
from rosbags.interfaces import Nodetype

from swarmd.core.errors import ConfigError, unknown
from swarmd.core.events import HazardsInput
from swarmd.core.hazard import Hazard, HazardKind
from swarmd.drivers.ros.absence import why_absent
from swarmd.drivers.ros.message_types import MessageTypes
from swarmd.drivers.ros.topic_inputs import TopicEntry, TopicInputs, faults_of
from swarmd.drivers.ros.topic_readings import (
    StaleAfter,
    Step,
    Text,
    number_path,
    path_of,
    seconds,
    value_at,
)

_KINDS = tuple(kind for kind in HazardKind if kind is not HazardKind.NOT_HEARD)
_MAX_ITEMS = 64  # of a list in a message
_MAX_PLACE = 64  # characters
_WORD = re.compile(r"[A-Za-z0-9]+")
_NO_PLACE = frozenset({"base", "link", "sensor"})

Meaning = Annotated[str, Meta(min_length=1, max_length=100)]


class HazardOptions(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One entry of the option `hazards`.

    - `field`: the number in a message of `type`, by names and indices with dots: `data.0`.
    - `list`: a list in the message, each of whose items has the field.
    - `means`: the hazard, by its kind and, if known, its place: `bump`, or `bump front left`. The
      hazard is present while the number is above `above` or below `below`; without `above` and
      `below`, while the number is not zero. For several hazards `means` is a mapping from whole
      numbers to hazards.
    - `place_field`: a text in the message that names the place, such as `header.frame_id`.
    - `stale_after`: s without a message after which the robot is held, as for a hazard. `never` is
      for a topic that is published on change: its last message counts while its publisher is there,
      and the robot is held before the first message.
    """

    topic: Text
    type: Annotated[str, Meta(min_length=3, max_length=200)]
    means: Meaning | dict[int | str, Meaning]
    field: Text = "data"
    list: Text | None = None
    place_field: Text | None = None
    above: float | None = None
    below: float | None = None
    stale_after: StaleAfter = 1.0

    def topics(self, name: str) -> dict[str, str]:
        """The topic of the entry `name`, by the option that messages name."""
        return {f"hazards.{name}": self.topic}


@dataclass(frozen=True, slots=True)
class TopicHazard(TopicEntry):
    """Reads the hazards in messages, of the message itself or of the items of a list in it."""

    items: tuple[Step, ...] | None  # the steps to the list; None: the message is the only item
    field: str
    number: tuple[Step, ...]  # the steps from an item to the number
    place: tuple[Step, ...] | None  # the steps from an item to the text of the place
    any_number: Hazard | None  # of each number outside `limits`; None: `means` has it
    means: Mapping[int, Hazard]  # by number
    limits: tuple[float, float] | None  # from the first to the second is no hazard; None: only 0

    def read(self, message: Any) -> tuple[Hazard, ...] | str:
        """The hazards in a message; a text with the reason if a number is not measured.

        A number above the upper limit counts even if the message marks the number as not measured.
        A floor sensor, for instance, has no return over a cliff.
        """
        items = [message] if self.items is None else value_at(message, self.items)[:_MAX_ITEMS]
        hazards: dict[Hazard, None] = {}
        for item in items:
            try:
                number = float(value_at(item, self.number))
            except IndexError:
                return f"the message has no item {self.field}"
            if math.isnan(number) or (self.limits is None and math.isinf(number)):
                return "it is not finite"
            is_beyond = self.limits is not None and number > self.limits[1]
            if not is_beyond and (lacks := why_absent(item, self.field, number)):
                return lacks
            hazard = self._hazard(number)
            if hazard is not None:
                hazards[self._placed(hazard, item)] = None
        return tuple(hazards)

    def _hazard(self, number: float) -> Hazard | None:
        if self.any_number is None:
            return self.means.get(round(number))
        low, high = self.limits or (0.0, 0.0)
        return None if low <= number <= high else self.any_number

    def _placed(self, hazard: Hazard, item: Any) -> Hazard:
        """The hazard with the place in the item's text, unless the hazard has a place."""
        if self.place is None or hazard.place:
            return hazard
        left_out = _NO_PLACE | set(hazard.kind.split("_"))
        words = _WORD.findall(str(value_at(item, self.place)))
        place = " ".join(word for word in words if word.lower() not in left_out)
        return Hazard(hazard.kind, place[:_MAX_PLACE])


def topic_hazard(
    name: str, options: HazardOptions, full_name: Callable[[str], str], types: MessageTypes
) -> tuple[TopicHazard]:
    """The reader of the entry `name` of option `hazards`, as `EntryKind.read` returns readers.

    `full_name(topic)` returns the full name of a topic. `types`: the known message types.
    ConfigError names the key that is wrong.
    """
    option = f"hazards.{name}"
    with faults_of(f"{option}.type"):
        message_type = item_type = types.kind(options.type)
    items = None
    place = None
    if options.list is not None:
        with faults_of(f"{option}.list is {options.list!r}"):
            items, item_type = _list_path(types, message_type, options.list)
    with faults_of(f"{option}.field is {options.field!r}"):
        number = number_path(types, item_type, options.field)
    if options.place_field is not None:
        with faults_of(f"{option}.place_field is {options.place_field!r}"):
            place = _text_path(types, item_type, options.place_field)
    with faults_of(f"{option}.means"):
        any_number = _of_any_number(options)
        means = {} if any_number is not None else _by_number(options)
    entry = TopicHazard(
        name=name,
        option=option,
        topic=full_name(options.topic),
        message_type=message_type,
        stale_after=seconds(options.stale_after),
        items=items,
        field=options.field,
        number=number,
        place=place,
        any_number=any_number,
        means=means,
        limits=_limits(option, options),
    )
    return (entry,)


def _list_path(
    types: MessageTypes, message_type: type, field: str
) -> tuple[tuple[Step, ...], type]:
    steps, (node, detail) = path_of(types, message_type, field)
    if node not in (Nodetype.ARRAY, Nodetype.SEQUENCE) or detail[0][0] is not Nodetype.NAME:
        raise ConfigError("expected a list of messages; leave it out for a field of the message")
    return steps, types.kind(detail[0][1])


def _text_path(types: MessageTypes, message_type: type, field: str) -> tuple[Step, ...]:
    steps, (node, detail) = path_of(types, message_type, field)
    if node is not Nodetype.BASE or detail[0] != "string":
        raise ConfigError("expected a text, such as header.frame_id")
    return steps


def _limits(option: str, options: HazardOptions) -> tuple[float, float] | None:
    """The lowest and the highest number without a hazard; None without `above` and `below`."""
    with faults_of(f"{option}.above is {options.above}"):
        high = _limit(options.above, math.inf)
    with faults_of(f"{option}.below is {options.below}"):
        low = _limit(options.below, -math.inf)
        if low > high:
            raise ConfigError(f"expected at most .above, which is {high:g}")
    return None if options.above is None and options.below is None else (low, high)


def _limit(given: float | None, default: float) -> float:
    if given is not None and not math.isfinite(given):
        raise ConfigError("expected a finite number")
    return default if given is None else given


def _of_any_number(options: HazardOptions) -> Hazard | None:
    """The hazard that each number outside the limits means; None if there is one a number."""
    return _meaning(options.means) if isinstance(options.means, str) else None


def _by_number(options: HazardOptions) -> Mapping[int, Hazard]:
    """The hazards by the number that means them."""
    given = options.means
    assert not isinstance(given, str)
    if options.above is not None or options.below is not None:
        raise ConfigError("expected one hazard beside above or below, not one for each number")
    if not given:
        raise ConfigError("expected the hazard of at least one number")
    if bad := [number for number in given if not str(number).isdecimal()]:
        raise ConfigError(f"expected a hazard for each whole number, not for {bad[0]!r}")
    # The keys are numbers in YAML, and texts in JSON.
    return {int(number): _meaning(text) for number, text in given.items()}


def _meaning(text: str) -> Hazard:
    """The hazard of a text of kind and place, such as `wheel_drop left`."""
    kind, _, place = text.strip().partition(" ")
    if kind not in _KINDS:
        raise ConfigError(unknown("hazard", kind, _KINDS))
    return Hazard(HazardKind(kind), place.strip())


class Hazards(TopicInputs[TopicHazard, tuple[Hazard, ...]]):
    """The present hazards of a robot's topics.

    A topic that was silent for longer than its `stale_after`, or never heard, is the hazard
    NOT_HEARD.
    """

    def __init__(self, entries: Mapping[str, TopicHazard]) -> None:
        super().__init__(entries)
        self._reported: tuple[Hazard, ...] | None = None if entries else ()

    def take(self, name: str, message: Any, now: float, *, is_kept: bool = False) -> str:
        """See `TopicInputs`."""
        is_known = is_kept and name in self._values
        found = self._values[name][0] if is_known else self._entries[name].read(message)
        if isinstance(found, str):
            if self._entries[name].is_never_stale:
                self._values.pop(name, None)
            return f"not known: {found}"
        self._values[name] = found, now
        return ", ".join(one.text for one in found) or "no hazard"

    def input(self, now: float, *, again: bool = False) -> HazardsInput | None:
        """All present hazards, each once."""
        present = tuple(dict.fromkeys(self._present(now))) if self._entries else ()
        if present == self._reported and not (again and self._entries):
            return None
        self._reported = present
        return HazardsInput(present)

    def awaited(self, now: float) -> tuple[str, ...]:
        """The topics that are silent for too long, or were never heard."""
        return tuple(entry.topic for entry in self._stale(now))

    def _present(self, now: float) -> Iterator[Hazard]:
        for name, (found, at) in self._values.items():
            if now - at <= self._entries[name].stale_after:
                yield from found
        for topic in self.awaited(now):
            yield Hazard(HazardKind.NOT_HEARD, topic)
