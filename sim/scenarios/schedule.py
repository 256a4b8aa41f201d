"""The schedule of a scenario: its events in order of time, checked against each other.

`read_event` checks an event by itself; `schedule_of` follows all robots through the events.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace

from swarmd.core.errors import ConfigError, unknown
from swarmd.kit.conditions import parse_conditions
from swarmd.settings.layered import Keys, Layered
from swarmd.sim.scenarios.environment import blamed, check_inside, fields_of
from swarmd.sim.scenarios.groups import ALL, Groups
from swarmd.sim.scenarios.scenario import Action, ScheduledEvent
from swarmd.sim.scenarios.schema import EventSection, ScenarioFile, Values
from swarmd.sim.world.faults import fault_of
from swarmd.sim.world.scalar_fields import channels_of

OF_ROBOTS: tuple[Action, ...] = ("stop", "estop", "reset", "join", "leave", "kill")
"""Actions whose value is their targets."""

ACTIONS: tuple[Action, ...] = ("run", "param", *OF_ROBOTS, "place", "remove", "fields", "fault")
_BESIDES = {
    "run": ("targets", "parameters", "for", "until"),
    "param": ("targets",),
    "place": ("pose",),
    "fault": ("robots", "for"),
}


def read_event(layers: Layered, file: ScenarioFile, groups: Groups, index: int) -> ScheduledEvent:
    """The event at `index` in the file; ConfigError if the event is invalid by itself.

    The action of an event is its key beside `at`. `place` is an action of a movable box, `fields`
    of the scalar fields. `remove` is an action of a box or of robots (`_removes_box`). All further
    actions are of robots.
    """
    section = file.events[index]
    keys = ("events", index)
    action = _action(layers, section, keys)
    if section.at >= file.duration:
        raise layers.error(
            (*keys, "at"),
            f"events[{index}].at is {section.at:g}; expected before the end"
            f" (duration is {file.duration:g})",
        )
    if action == "fields":
        return _field_event(layers, file, section, (*keys, action))
    movable = [box.name for box in file.arena.boxes if box.mass is not None and box.name]
    if action == "place" or (action == "remove" and _removes_box(section, movable, groups)):
        return _box_event(layers, file, section, (*keys, action), movable)
    if action == "fault":
        return _fault_event(layers, file, groups, section, (*keys, action))
    # An event of robots: its action names the robots (`stop: all`), or else the key `targets`.
    target_key = action if action in (*OF_ROBOTS, "remove") else "targets"
    # The conditions of `until` are parsed only to find faults: the event keeps their texts.
    with blamed(layers, *keys, "until", prefix=f"events[{index}].until: "):
        if section.until is not None:
            parse_conditions(section.until)
    values = section.param if action == "param" else section.parameters
    return ScheduledEvent(
        at=section.at,
        action=action,
        robots=_robots(layers, groups, (*keys, target_key), targets_of(section, action)),
        pattern=section.run or "",
        parameters=values or {},
        seconds=section.seconds,
        until=tuple(section.until or ()),
    )


def _removes_box(section: EventSection, movable: Sequence[str], groups: Groups) -> bool:
    """Whether `remove` means a box, not robots. `movable`: the names of the movable boxes.

    A movable box has precedence over a robot or group of the same name. An unknown name counts as
    that of a box, so that `_box_event` raises the error.
    """
    return section.remove in movable or not groups.named(section.remove or "")


def targets_of(section: EventSection, action: Action) -> Sequence[str]:
    """The targets of an event as written; `all` without any."""
    is_named = action in (*OF_ROBOTS, "remove")
    targets = getattr(section, action) if is_named else section.targets or section.robots
    if targets is None:
        return (ALL,)
    return (targets,) if isinstance(targets, str) else targets


def _action(layers: Layered, section: EventSection, keys: Keys) -> Action:
    name = f"events[{keys[1]}]"
    given = [action for action in ACTIONS if getattr(section, action) is not None]
    if len(given) != 1:
        text = f"{name} has {' and '.join(given) or 'nothing'} at {section.at:g}"
        raise layers.error(keys, f"{text}; expected one of {', '.join(ACTIONS)}")
    for key, field_name in zip(
        EventSection.__struct_encode_fields__, EventSection.__struct_fields__, strict=True
    ):
        is_known = key in ("at", *ACTIONS, *_BESIDES.get(given[0], ()))
        if not is_known and getattr(section, field_name) is not None:
            text = f"{name}.{key} means nothing beside {given[0]}; leave it out"
            raise layers.error((*keys, key), text)
    if given[0] == "param" and not section.param:
        text = f"{name}.param is empty; expected values by name, such as {{speed: 0.1}}"
        raise layers.error((*keys, "param"), text)
    return given[0]


def _box_event(
    layers: Layered, file: ScenarioFile, section: EventSection, keys: Keys, movable: Sequence[str]
) -> ScheduledEvent:
    name = f"events[{keys[1]}]"
    box = section.place or section.remove or ""
    if box not in movable:
        fault = unknown("box with a name and a mass", box, movable)
        raise layers.error(keys, f"{name}.{keys[2]}: {fault}")
    if section.remove is not None:
        return ScheduledEvent(at=section.at, action="remove", box=box)
    if section.pose is None:
        raise layers.error(keys, f"{name}.pose is missing; expected [x, y, degrees]")
    x, y, degrees = section.pose
    check_inside(layers, file.arena, ("events", keys[1], "pose"), (x, y))
    pose = (x, y, math.radians(degrees))
    return ScheduledEvent(at=section.at, action="place", box=box, pose=pose)


def _field_event(
    layers: Layered, file: ScenarioFile, section: EventSection, keys: Keys
) -> ScheduledEvent:
    """The event that replaces fields by name; ConfigError for a reading that is not known yet.

    Robots have sensors for the scenario's own fields alone.
    """
    known = {name for field in fields_of(layers, file.fields) for name in channels_of(field)}
    fields = fields_of(layers, section.fields or (), keys)
    name = f"events[{keys[1]}].fields"
    if not fields:
        raise layers.error(keys, f"{name} is empty; expected a field at least")
    for index, new_field in enumerate(fields):
        for channel in channels_of(new_field):
            if channel not in known:
                text = f"{name}[{index}]: {unknown('reading of a field', channel, known)}"
                raise layers.error((*keys, index), text)
    return ScheduledEvent(at=section.at, action="fields", fields=fields)


def _fault_event(
    layers: Layered, file: ScenarioFile, groups: Groups, section: EventSection, keys: Keys
) -> ScheduledEvent:
    """The event that begins a fault; ConfigError for a robot that cannot have the fault."""
    name = f"events[{keys[1]}]"
    fault = fault_of(section.fault or {}, str(layers.error(keys, f"{name}.fault")))
    if section.robots is None:
        raise layers.error(keys, f"{name}.robots is missing; expected a robot, a group or all")
    robots = _robots(layers, groups, (*keys[:2], "robots"), targets_of(section, "fault"))
    for robot in robots:
        platform = groups.robots[robot]
        is_posed = bool(file.layers or "pose" in platform.provides or file.radio.places)
        if misfit := fault.misfit(platform, is_posed=is_posed):
            raise layers.error(keys, f"{name}.fault: {fault.text}: {robot} {misfit}")
    # A killed daemon is the same as by the event `kill`.
    action: Action = "kill" if fault.ends_daemon else "fault"
    return ScheduledEvent(
        at=section.at, action=action, robots=robots, seconds=section.seconds, fault=fault
    )


def _with_ends(events: Iterable[ScheduledEvent]) -> Iterator[ScheduledEvent]:
    """The events, and behind each fault with a duration the event that ends it."""
    for event in events:
        yield event
        if event.fault is not None and event.seconds is not None:
            action: Action = "join" if event.action == "kill" else "mend"
            # Rounded: 0.1 + 0.2 is 0.3. At least 1 ns, since ends precede begins of one time.
            yield replace(
                event,
                at=round(event.at + max(event.seconds, 1e-9), 9),
                action=action,
                seconds=None,
            )


def _robots(layers: Layered, groups: Groups, keys: Keys, words: Sequence[str]) -> tuple[str, ...]:
    """The targeted robots in the order of the scenario."""
    meant: dict[str, None] = {}
    name = f"events[{keys[1]}].{keys[2]}"
    for word in words:
        robots = groups.named(word)
        if not robots:
            raise layers.error(keys, f"{name}: {unknown('robot or group', word, groups.names)}")
        meant.update(dict.fromkeys(robots))
    if not meant:
        raise layers.error(keys, f"{name} is empty; expected a robot, a group or all")
    return tuple(robot for robot in groups.robots if robot in meant)


_MEMBERSHIP = ("join", "leave", "kill")


@dataclass(frozen=True, slots=True)
class Preflight:
    """A pattern that a robot will run with these parameters; `keys` is its place in the file."""

    keys: Keys
    robot: str
    pattern: str
    parameters: Values


@dataclass(frozen=True, slots=True)
class Schedule:
    """Events in order of time, robots that join later, and the patterns to check."""

    events: tuple[ScheduledEvent, ...]
    absent: frozenset[str]
    preflights: tuple[Preflight, ...]


def schedule_of(layers: Layered, file: ScenarioFile, groups: Groups) -> Schedule:
    """The schedule of a file; ConfigError names the first impossible event.

    At time 0 groups start their patterns first. Simultaneous events keep the order of the file.
    """
    read = [
        (index, event)
        for index in range(len(file.events))
        for event in _with_ends([read_event(layers, file, groups, index)])
    ]
    # A fault that begins when another of its kind ends begins after this end.
    ordered = sorted(read, key=lambda one: (one[1].at, one[1].action != "mend"))
    # The first action that lets a robot join or leave; a robot that joins is absent until then.
    first: dict[str, str] = {}
    for _, event in ordered:
        if event.action in _MEMBERSHIP:
            first = {**dict.fromkeys(event.robots, event.action), **first}
    absent = frozenset(robot for robot, action in first.items() if action == "join")
    checker = _ScheduleChecker(layers, file, groups, absent)
    events = []
    for name, group in file.groups.items():
        robots = tuple(robot for robot in groups.groups[name] if robot not in absent)
        if group.pattern is not None and robots:
            event = ScheduledEvent(at=0.0, action="run", robots=robots, pattern=group.pattern)
            checker.run(("groups", name, "pattern"), event)
            events.append(event)
    for index, event in ordered:
        checker.apply(("events", index, "fault" if event.fault else event.action), event)
        events.append(event)
    return Schedule(tuple(events), absent, tuple(checker.preflights))


@dataclass(slots=True)
class _Robot:
    """The state of a robot at the time of an event."""

    is_there: bool  # has a daemon
    is_out: bool = False  # was taken out of the arena
    is_estopped: bool = False
    pattern: str = ""  # of the present run; empty without a run
    parameters: Values = field(default_factory=dict)
    until: float = math.inf  # the end of the run in s
    faults: dict[str, float] = field(default_factory=dict)  # the end of each in s


class _ScheduleChecker:
    """Follows the state of each robot through the events in order of time."""

    def __init__(
        self, layers: Layered, file: ScenarioFile, groups: Groups, absent: frozenset[str]
    ) -> None:
        self._layers = layers
        self._sections = file.events
        self._movable_boxes = {box.name: box.at is not None for box in file.arena.boxes}
        self._robots = {robot: _Robot(is_there=robot not in absent) for robot in groups.robots}
        self.preflights: list[Preflight] = []

    def apply(self, keys: Keys, event: ScheduledEvent) -> None:
        """Apply an event; ConfigError if it is impossible."""
        if event.fields or event.action == "mend":
            return
        if event.box:
            if event.action == "remove" and not self._movable_boxes[event.box]:
                raise self._error(keys, f"{event.box} is not in the arena at {event.at:g} s")
            self._movable_boxes[event.box] = event.action == "place"
        elif event.action in (*_MEMBERSHIP, "remove"):
            self._come_or_go(keys, event)
        elif event.fault is not None:
            self._begin_fault(keys, event)
        else:
            self._check_there(keys, event)
            act = {"run": self.run, "param": self._set}.get(event.action, self._halt)
            act(keys, event)

    def run(self, keys: Keys, event: ScheduledEvent) -> None:
        """Start the event's pattern on its robots."""
        for robot, state in self._present(event):
            if state.is_estopped:
                raise self._error(keys, f"{robot} is estopped at {event.at:g} s; reset it before")
            state.pattern = event.pattern
            state.parameters = dict(event.parameters)
            state.until = event.at + (event.seconds or math.inf)
            self.preflights.append(Preflight(keys, robot, event.pattern, state.parameters))

    def _set(self, keys: Keys, event: ScheduledEvent) -> None:
        for robot, state in self._present(event):
            if not state.pattern or event.at >= state.until:
                raise self._error(keys, f"{robot} runs nothing at {event.at:g} s; run a pattern")
            state.parameters = {**state.parameters, **event.parameters}
            self.preflights.append(Preflight(keys, robot, state.pattern, state.parameters))

    def _begin_fault(self, keys: Keys, event: ScheduledEvent) -> None:
        """Check that no earlier fault of the kind is on, whose end would end this one, too."""
        assert event.fault is not None
        for robot in event.robots:
            has_fault = self._robots[robot].faults
            if event.at < has_fault.get(event.fault.text, 0.0):
                text = f"{robot} has {event.fault.text} already at {event.at:g} s"
                raise self._error(keys, f"{text}; end it before, with `for`")
            has_fault[event.fault.text] = round(event.at + (event.seconds or math.inf), 9)

    def _halt(self, keys: Keys, event: ScheduledEvent) -> None:
        for _, state in self._present(event):
            if event.action in ("estop", "reset"):
                state.is_estopped = event.action == "estop"
            if event.action != "reset":
                state.pattern = ""

    def _come_or_go(self, keys: Keys, event: ScheduledEvent) -> None:
        is_joining = event.action == "join"
        is_removed = event.action == "remove"
        for robot in event.robots:
            state = self._robots[robot]
            fault = ""
            if state.is_out:
                fault = "not in the arena"
            elif state.is_there == is_joining and not is_removed:
                fault = "there already" if is_joining else "not there"
            if fault:
                raise self._error(keys, f"{robot} is {fault} at {event.at:g} s")
            state.is_there = is_joining
            state.is_out = is_removed
            state.pattern = ""

    def _present(self, event: ScheduledEvent) -> list[tuple[str, _Robot]]:
        return [(r, self._robots[r]) for r in event.robots if self._robots[r].is_there]

    def _check_there(self, keys: Keys, event: ScheduledEvent) -> None:
        """Check that a named robot is present, and that a group has a robot that is."""
        words = targets_of(self._sections[int(keys[1])], event.action)
        away = [robot for robot in event.robots if not self._robots[robot].is_there]
        missing = away if len(away) == len(event.robots) else [r for r in away if r in words]
        if missing:
            raise self._error(keys, f"{missing[0]} is not there at {event.at:g} s")

    def _error(self, keys: Keys, text: str) -> ConfigError:
        return self._layers.error(keys, f"events[{keys[1]}].{keys[2]}: {text}")
