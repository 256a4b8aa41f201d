"""What an event may say, and to whom."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import pytest

from swarmd.core.errors import ConfigError

if TYPE_CHECKING:
    from tests.sim.scenarios.conftest import Load


@pytest.mark.parametrize(
    ("event", "robots"),
    [
        ({"stop": "all"}, ("red-01", "red-02", "b-one", "b-two")),
        ({"stop": "blue"}, ("b-one", "b-two")),
        ({"stop": "red-02"}, ("red-02",)),
        ({"stop": ["b-one", "red"]}, ("red-01", "red-02", "b-one")),
        ({"run": "drive"}, ("red-01", "red-02", "b-one", "b-two")),
        ({"run": "drive", "targets": ["blue", "b-one"]}, ("b-one", "b-two")),
        ({"param": {"speed": 0.1}, "targets": "b-one"}, ("b-one",)),
    ],
)
def test_is_for_robots_groups_or_all(load: Load, event: Any, robots: tuple[str, ...]) -> None:
    assert load({"events.+": {"at": 20, **event}}).events[-1].robots == robots


def test_says_pattern_parameters_and_how_long(load: Load) -> None:
    event = {"at": 20, "run": "drive", "targets": "red", "parameters": {"speed": 0.1}, "for": 5}
    made = load({"events.+": event}).events[-1]
    assert (made.at, made.action, made.pattern, made.seconds) == (20.0, "run", "drive", 5.0)
    assert made.parameters == {"speed": 0.1}


def test_says_until_when(load: Load) -> None:
    event = {"at": 20, "run": "drive", "targets": "red", "until": ["nearer:0.5", "done"]}
    assert load({"events.+": event}).events[-1].until == ("nearer:0.5", "done")


def test_places_a_box_at_x_y_and_degrees(load: Load) -> None:
    made = load({"events.+": {"at": 20, "place": "spare", "pose": [1, -1, 90]}}).events[-1]
    assert (made.action, made.box, made.robots) == ("place", "spare", ())
    assert made.pose == (1.0, -1.0, math.pi / 2.0)


@pytest.mark.parametrize(
    ("event", "fault"),
    [
        ({}, "events[1] says nothing at 20; wanted one of run, param, stop, estop"),
        ({"stop": "red", "kill": "red"}, "events[1] says stop and kill at 20; wanted one of"),
        ({"stop": "rde"}, "events[1].stop: no robot or group 'rde'; did you mean 'red'?"),
        ({"kill": "b-on"}, "events[1].kill: no robot or group 'b-on'; did you mean 'b-one'?"),
        (
            {"run": "drive", "targets": ["red", "al"]},
            "events[1].targets: no robot or group",
        ),
        ({"stop": []}, "events[1].stop is empty; wanted a robot, a group or all"),
        ({"stop": 5}, "events[1].stop is 5; wanted text"),
        (
            {"stop": "red", "targets": "red"},
            "events[1].targets means nothing beside stop; leave it out",
        ),
        ({"stop": "red", "for": 5}, "events[1].for means nothing beside stop"),
        ({"run": "drive", "until": ["near:1"]}, "events[1].until: no condition 'near'; did you"),
        ({"param": {"speed": 1}, "pose": [0, 0, 0]}, "events[1].pose means nothing beside param"),
        ({"param": {}}, "events[1].param is empty; wanted values by name"),
        ({"place": "spare"}, "events[1].pose is missing; wanted [x, y, degrees]"),
        ({"place": "spare", "pose": [1, 2]}, "events[1].pose is [1, 2]; wanted [a number"),
        ({"place": "spare", "pose": [9, 0, 0]}, "events[1].pose is [9.0, 0.0]; wanted within"),
        ({"place": "spar", "pose": [1, 0, 0]}, "no box with a name and a mass 'spar'; did you"),
        ({"remove": "block"}, "events[1].remove: no box with a name and a mass 'block'"),
        ({"at": 60, "stop": "all"}, "events[1].at is 60; wanted before the end (duration is 60)"),
        ({"at": 99, "stop": "all"}, "events[1].at is 99; wanted before the end"),
    ],
)
def test_says_what_cannot_be(load: Load, event: dict[str, Any], fault: str) -> None:
    with pytest.raises(ConfigError) as raised:
        load({"events.+": {"at": 20, **event}})
    assert str(raised.value).startswith("here.yaml: ")
    assert fault in str(raised.value)
