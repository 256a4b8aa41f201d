"""The time line: what the events of a file mean, checked against who is there when."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from swarmd.errors import ConfigError, unknown
from swarmd.layered import Keys, Layered
from swarmd.sim.lab.cast import ALL, Cast
from swarmd.sim.lab.scenario import Action, Event
from swarmd.sim.lab.scenery import check_inside
from swarmd.sim.lab.schema import EventSection, ScenarioFile, Values, Who

MEMBERSHIP: tuple[Action, ...] = ("join", "leave", "kill")
_TO_ROBOTS: tuple[Action, ...] = ("stop", "estop", "reset", *MEMBERSHIP)
ACTIONS: tuple[Action, ...] = ("run", "param", *_TO_ROBOTS, "place", "remove")
_BESIDES = {"run": ("who", "parameters", "seconds"), "param": ("who",), "place": ("pose",)}
_NAMES = {"seconds": "for"}


@dataclass(frozen=True, slots=True)
class Rehearsal:
    """A pattern that a robot is to run with these parameters; `keys` is where that is said."""

    keys: Keys
    robot: str
    pattern: str
    parameters: Values


@dataclass(frozen=True, slots=True)
class Script:
    """Events in order of time, who joins only later, and what there is to rehearse."""

    events: tuple[Event, ...]
    absent: frozenset[str]
    rehearsals: tuple[Rehearsal, ...]


@dataclass(slots=True)
class _Robot:
    """What is known of a robot at a time. `until`: when what it runs ends."""

    is_there: bool = True
    is_estopped: bool = False
    pattern: str = ""
    parameters: Values = field(default_factory=dict)
    until: float = math.inf


def script_of(layers: Layered, file: ScenarioFile, cast: Cast) -> Script:
    """The script of a file; ConfigError names the first event that cannot be."""
    read = [_read(layers, file, cast, index) for index in range(len(file.events))]
    order = sorted(range(len(read)), key=lambda index: read[index].at)
    absent = _absent([read[index] for index in order])
    walk = _Walk(layers, file, cast, absent)
    events = [*_beginning(file, cast, absent, walk)]
    events += [walk.checked(index, read[index], file.events[index]) for index in order]
    return Script(tuple(events), absent, tuple(walk.rehearsals))


def _beginning(
    file: ScenarioFile, cast: Cast, absent: frozenset[str], walk: _Walk
) -> Iterator[Event]:
    for name, group in file.groups.items():
        robots = tuple(robot for robot in cast.groups[name] if robot not in absent)
        if group.pattern is not None and robots:
            event = Event(at=0.0, action="run", robots=robots, pattern=group.pattern)
            walk.run(("groups", name, "pattern"), event)
            yield event


def _absent(events: Sequence[Event]) -> frozenset[str]:
    """Those whose first coming or going is to come."""
    first: dict[str, str] = {}
    for event in events:
        if event.action in MEMBERSHIP:
            for robot in event.robots:
                first.setdefault(robot, event.action)
    return frozenset(robot for robot, action in first.items() if action == "join")


def _read(layers: Layered, file: ScenarioFile, cast: Cast, index: int) -> Event:
    section, keys = file.events[index], ("events", index)
    action = _action(layers, section, keys)
    if section.at >= file.duration:
        text = f"events[{index}].at is {section.at:g}; wanted before the end"
        raise layers.error((*keys, "at"), f"{text} (duration is {file.duration:g})")
    if action in ("place", "remove"):
        thing, pose = getattr(section, action), section.pose
        movable = [box.name for box in file.arena.boxes if box.mass is not None and box.name]
        if thing not in movable:
            fault = unknown("box with a name and a mass", thing, movable)
            raise layers.error((*keys, action), f"events[{index}].{action}: {fault}")
        if action == "remove":
            return Event(at=section.at, action=action, thing=thing)
        if pose is None:
            raise layers.error(keys, f"events[{index}].pose is missing; wanted [x, y, degrees]")
        check_inside(layers, file.arena, (*keys, "pose"), pose[:2])
        pose = (pose[0], pose[1], math.radians(pose[2]))
        return Event(at=section.at, action=action, thing=thing, pose=pose)
    who = getattr(section, action) if action in _TO_ROBOTS else section.who
    robots = _robots(layers, cast, (*keys, action if action in _TO_ROBOTS else "who"), who)
    values = section.param if action == "param" else section.parameters
    return Event(
        at=section.at,
        action=action,
        robots=robots,
        pattern=section.run or "",
        parameters=values or {},
        seconds=section.seconds,
    )


def _action(layers: Layered, section: EventSection, keys: Keys) -> Action:
    name = f"events[{keys[1]}]"
    given = [action for action in ACTIONS if getattr(section, action) is not None]
    if len(given) != 1:
        text = f"{name} says {' and '.join(given) or 'nothing'} at {section.at:g}"
        raise layers.error(keys, f"{text}; wanted one of {', '.join(ACTIONS)}")
    for key in ("who", "parameters", "seconds", "pose"):
        shown = _NAMES.get(key, key)
        if getattr(section, key) is not None and key not in _BESIDES.get(given[0], ()):
            text = f"{name}.{shown} means nothing beside {given[0]}; leave it out"
            raise layers.error((*keys, shown), text)
    if section.param is not None and not section.param:
        raise layers.error(
            (*keys, "param"), f"{name}.param is empty; wanted such as {{speed: 0.1}}"
        )
    return given[0]


def _robots(layers: Layered, cast: Cast, keys: Keys, who: Who | None) -> tuple[str, ...]:
    """Those meant, in the order of the scenario."""
    names = [ALL] if who is None else [who] if isinstance(who, str) else who
    meant: dict[str, None] = {}
    name = f"events[{keys[1]}].{keys[2]}"
    for word in names:
        robots = cast.named(word)
        if not robots:
            raise layers.error(keys, f"{name}: {unknown('robot or group', word, cast.names)}")
        meant.update(dict.fromkeys(robots))
    if not meant:
        raise layers.error(keys, f"{name} is empty; wanted a robot, a group or all")
    return tuple(robot for robot in cast.robots if robot in meant)


class _Walk:
    """Goes through the events in order of time and knows what each robot is doing."""

    def __init__(
        self, layers: Layered, file: ScenarioFile, cast: Cast, absent: frozenset[str]
    ) -> None:
        self._layers = layers
        self._things = {box.name for box in file.arena.boxes if box.at is not None}
        self._robots = {robot: _Robot(is_there=robot not in absent) for robot in cast.robots}
        self.rehearsals: list[Rehearsal] = []

    def checked(self, index: int, event: Event, section: EventSection) -> Event:
        """The event with only the robots that are there; ConfigError if it cannot be."""
        keys = ("events", index, event.action)
        if event.action in ("place", "remove"):
            self._put_or_take(keys, event)
            return event
        if event.action in MEMBERSHIP:
            self._come_or_go(keys, event)
            return event
        named = getattr(section, event.action) if event.action in _TO_ROBOTS else section.who
        words = [named] if isinstance(named, str) else named or []
        robots = tuple(robot for robot in event.robots if self._robots[robot].is_there)
        missing = [r for r in event.robots if r not in robots and (r in words or not robots)]
        if missing:
            raise self._error(keys, f"{missing[0]} is not there at {event.at:g} s")
        event = Event(
            at=event.at,
            action=event.action,
            robots=robots,
            pattern=event.pattern,
            parameters=event.parameters,
            seconds=event.seconds,
        )
        if event.action == "run":
            self.run(keys, event)
        elif event.action == "param":
            self._set(keys, event)
        else:
            for robot in robots:
                state = self._robots[robot]
                state.pattern = state.pattern if event.action == "reset" else ""
                if event.action != "stop":
                    state.is_estopped = event.action == "estop"
        return event

    def run(self, keys: Keys, event: Event) -> None:
        """The event's robots begin to run its pattern."""
        for robot in event.robots:
            state = self._robots[robot]
            if state.is_estopped:
                text = f"{robot} is estopped at {event.at:g} s; reset it before"
                raise self._error(keys, text)
            state.pattern, state.parameters = event.pattern, dict(event.parameters)
            state.until = event.at + (event.seconds or math.inf)
            self.rehearsals.append(Rehearsal(keys, robot, event.pattern, state.parameters))

    def _set(self, keys: Keys, event: Event) -> None:
        for robot in event.robots:
            state = self._robots[robot]
            if not state.pattern or event.at >= state.until:
                raise self._error(keys, f"{robot} runs nothing at {event.at:g} s; run a pattern")
            state.parameters = {**state.parameters, **event.parameters}
            self.rehearsals.append(Rehearsal(keys, robot, state.pattern, state.parameters))

    def _put_or_take(self, keys: Keys, event: Event) -> None:
        if event.action == "place":
            self._things.add(event.thing)
        elif event.thing in self._things:
            self._things.remove(event.thing)
        else:
            raise self._error(keys, f"{event.thing} is not in the arena at {event.at:g} s")

    def _come_or_go(self, keys: Keys, event: Event) -> None:
        is_joining = event.action == "join"
        for robot in event.robots:
            state = self._robots[robot]
            if state.is_there == is_joining:
                there = "already there" if is_joining else "not there"
                raise self._error(keys, f"{robot} is {there} at {event.at:g} s")
            state.is_there, state.pattern = is_joining, ""

    def _error(self, keys: Keys, text: str) -> ConfigError:
        return self._layers.error(keys, f"events[{keys[1]}].{keys[2]}: {text}")
