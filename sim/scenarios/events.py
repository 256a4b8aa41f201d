"""What the events of a file mean, each by itself."""

from __future__ import annotations

import math
from collections.abc import Sequence

from swarmd.errors import ConfigError, unknown
from swarmd.mission.conditions import parse_conditions
from swarmd.settings.layered import Keys, Layered
from swarmd.sim.scenarios.cast import ALL, Cast
from swarmd.sim.scenarios.scenario import Action, Event
from swarmd.sim.scenarios.scenery import check_inside
from swarmd.sim.scenarios.schema import EventSection, ScenarioFile

OF_ROBOTS: tuple[Action, ...] = ("stop", "estop", "reset", "join", "leave", "kill")
"""Actions whose value is who they happen to."""

ACTIONS: tuple[Action, ...] = ("run", "param", *OF_ROBOTS, "place", "remove")
_BESIDES = {"run": ("who", "parameters", "for", "until"), "param": ("who",), "place": ("pose",)}


def read_event(layers: Layered, file: ScenarioFile, cast: Cast, index: int) -> Event:
    """The event of that index; ConfigError if it cannot be, whatever else happens."""
    section, keys = file.events[index], ("events", index)
    action = _action(layers, section, keys)
    if section.at >= file.duration:
        text = f"events[{index}].at is {section.at:g}; wanted before the end"
        raise layers.error((*keys, "at"), f"{text} (duration is {file.duration:g})")
    things = [box.name for box in file.arena.boxes if box.mass is not None and box.name]
    is_robot = action == "remove" and bool(cast.named(section.remove or ""))
    if action == "place" or (action == "remove" and (section.remove in things or not is_robot)):
        return _of_thing(layers, file, section, (*keys, action), things)
    key = action if action in OF_ROBOTS or is_robot else "who"
    values = section.param if action == "param" else section.parameters
    return Event(
        at=section.at,
        action=action,
        robots=_robots(layers, cast, (*keys, key), words_of(section, action)),
        pattern=section.run or "",
        parameters=values or {},
        seconds=section.seconds,
        until=_until(layers, section, (*keys, "until")),
    )


def _until(layers: Layered, section: EventSection, keys: Keys) -> tuple[str, ...]:
    """The conditions of which any ends the run, each checked."""
    if section.until is None:
        return ()
    try:
        parse_conditions(section.until)
    except ConfigError as error:
        raise layers.error(keys, f"events[{keys[1]}].until: {error}") from error
    return tuple(section.until)


def words_of(section: EventSection, action: Action) -> Sequence[str]:
    """Who an event is for, as it is written; all if nothing is."""
    who = getattr(section, action) if action in (*OF_ROBOTS, "remove") else section.who
    return (ALL,) if who is None else (who,) if isinstance(who, str) else who


def _action(layers: Layered, section: EventSection, keys: Keys) -> Action:
    name = f"events[{keys[1]}]"
    given = [action for action in ACTIONS if getattr(section, action) is not None]
    if len(given) != 1:
        text = f"{name} says {' and '.join(given) or 'nothing'} at {section.at:g}"
        raise layers.error(keys, f"{text}; wanted one of {', '.join(ACTIONS)}")
    besides = {
        "who": section.who,
        "parameters": section.parameters,
        "for": section.seconds,
        "until": section.until,
        "pose": section.pose,
    }
    for key, value in besides.items():
        if value is not None and key not in _BESIDES.get(given[0], ()):
            text = f"{name}.{key} means nothing beside {given[0]}; leave it out"
            raise layers.error((*keys, key), text)
    if given[0] == "param" and not section.param:
        text = f"{name}.param is empty; wanted values by name, such as {{speed: 0.1}}"
        raise layers.error((*keys, "param"), text)
    return given[0]


def _of_thing(
    layers: Layered, file: ScenarioFile, section: EventSection, keys: Keys, movable: Sequence[str]
) -> Event:
    name = f"events[{keys[1]}]"
    thing = section.place or section.remove or ""
    if thing not in movable:
        fault = unknown("box with a name and a mass", thing, movable)
        raise layers.error(keys, f"{name}.{keys[2]}: {fault}")
    if section.remove is not None:
        return Event(at=section.at, action="remove", thing=thing)
    if section.pose is None:
        raise layers.error(keys, f"{name}.pose is missing; wanted [x, y, degrees]")
    x, y, degrees = section.pose
    check_inside(layers, file.arena, ("events", keys[1], "pose"), (x, y))
    return Event(at=section.at, action="place", thing=thing, pose=(x, y, math.radians(degrees)))


def _robots(layers: Layered, cast: Cast, keys: Keys, words: Sequence[str]) -> tuple[str, ...]:
    """Those meant, in the order of the scenario."""
    meant: dict[str, None] = {}
    name = f"events[{keys[1]}].{keys[2]}"
    for word in words:
        robots = cast.named(word)
        if not robots:
            raise layers.error(keys, f"{name}: {unknown('robot or group', word, cast.names)}")
        meant.update(dict.fromkeys(robots))
    if not meant:
        raise layers.error(keys, f"{name} is empty; wanted a robot, a group or all")
    return tuple(robot for robot in cast.robots if robot in meant)
