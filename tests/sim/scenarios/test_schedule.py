"""Events of a scenario, each by itself and in order of time."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import pytest

from swarmd.core.errors import ConfigError

if TYPE_CHECKING:
    from tests.sim.scenarios.conftest import Load


Events = list[dict[str, Any]]


def test_groups_start_their_patterns_before_any_event(load: Load) -> None:
    script = load({"events": [{"at": 0, "stop": "red"}]}).events
    assert [(event.at, event.action) for event in script] == [(0.0, "run"), (0.0, "stop")]
    assert (script[0].pattern, script[0].robots) == ("attraction", ("red-01", "red-02"))


def test_events_are_in_order_of_time_and_then_of_the_file(load: Load) -> None:
    events: Events = [
        {"at": 30, "stop": "blue"},
        {"at": 10, "run": "drive", "targets": "blue"},
        {"at": 30, "run": "drive", "targets": "blue"},
        {"at": 20, "stop": "red"},
    ]
    script = load({"events": events}).events[1:]
    assert [(e.at, e.action) for e in script] == [
        *((10.0, "run"), (20.0, "stop"), (30.0, "stop"), (30.0, "run"))
    ]


def test_a_robot_that_first_joins_is_absent_before(load: Load) -> None:
    scenario = load({"events": [{"at": 30, "leave": "red-02"}, {"at": 20, "join": "red-02"}]})
    assert scenario.absent == {"red-02"}
    assert scenario.events[0].robots == ("red-01",)


def test_a_robot_that_first_leaves_is_present_before(load: Load) -> None:
    events: Events = [{"at": 20, "kill": "red"}, {"at": 30, "join": "red"}]
    assert load({"events": events}).absent == frozenset()


def test_a_group_may_have_absent_members(load: Load) -> None:
    events: Events = [{"at": 5, "leave": "red-01"}, {"at": 8, "run": "drive", "targets": "red"}]
    assert load({"events": events}).events[-1].robots == ("red-01", "red-02")


@pytest.mark.parametrize(
    ("events", "fault"),
    [
        (
            [{"at": 20, "join": "red-01"}, {"at": 15, "run": "drive", "targets": "red-01"}],
            "events[1].run: red-01 is not there at 15 s",
        ),
        (
            [{"at": 20, "kill": "red"}, {"at": 25, "stop": "red"}],
            "events[1].stop: red-01 is not there at 25 s",
        ),
        (
            [{"at": 20, "leave": "red-01"}, {"at": 25, "kill": "red"}],
            "events[1].kill: red-01 is not there at 25 s",
        ),
        (
            [{"at": 5, "join": "red"}, {"at": 25, "join": "red-02"}],
            "events[1].join: red-02 is there already at 25 s",
        ),
        ([{"at": 5, "param": {"speed": 0.1}}], "events[0].param: b-one runs nothing at 5 s"),
        (
            [{"at": 5, "stop": "red"}, {"at": 6, "param": {"speed": 0.1}, "targets": "red"}],
            "events[1].param: red-01 runs nothing at 6 s",
        ),
        (
            [
                {"at": 5, "run": "drive", "targets": "blue", "for": 3},
                {"at": 8, "param": {"speed": 0.1}, "targets": "blue"},
            ],
            "events[1].param: b-one runs nothing at 8 s",
        ),
        (
            [{"at": 5, "estop": "red-02"}, {"at": 9, "run": "drive"}],
            "events[1].run: red-02 is estopped at 9 s; reset it before",
        ),
        ([{"at": 5, "remove": "spare"}], "events[0].remove: spare is not in the arena at 5 s"),
        (
            [{"at": 5, "remove": "red"}, {"at": 6, "remove": "red-01"}],
            "events[1].remove: red-01 is not in the arena at 6 s",
        ),
        (
            [{"at": 5, "remove": "red-01"}, {"at": 6, "join": "red-01"}],
            "events[1].join: red-01 is not in the arena at 6 s",
        ),
        (
            [{"at": 5, "remove": "red-01"}, {"at": 6, "run": "drive", "targets": "red-01"}],
            "events[1].run: red-01 is not there at 6 s",
        ),
    ],
)
def test_an_impossible_sequence_is_refused(load: Load, events: Events, fault: str) -> None:
    with pytest.raises(ConfigError) as raised:
        load({"events": events})
    assert str(raised.value).startswith("here.yaml: ")
    assert fault in str(raised.value)


def test_an_estopped_robot_runs_again_after_a_reset(load: Load) -> None:
    events: Events = [
        {"at": 5, "estop": "all"},
        {"at": 6, "reset": "all"},
        {"at": 6, "run": "drive"},
        {"at": 7, "param": {"speed": 0.1}},
        {"at": 8, "place": "spare", "pose": [0, 2, 0]},
        {"at": 9, "remove": "spare"},
    ]
    assert len(load({"events": events}).events) == 7


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
def test_targets_are_robots_groups_or_all(load: Load, event: Any, robots: tuple[str, ...]) -> None:
    assert load({"events.+": {"at": 20, **event}}).events[-1].robots == robots


def test_a_run_has_pattern_parameters_and_duration(load: Load) -> None:
    event = {"at": 20, "run": "drive", "targets": "red", "parameters": {"speed": 0.1}, "for": 5}
    made = load({"events.+": event}).events[-1]
    assert (made.at, made.action, made.pattern, made.seconds) == (20.0, "run", "drive", 5.0)
    assert made.parameters == {"speed": 0.1}


def test_a_run_has_end_conditions(load: Load) -> None:
    event = {"at": 20, "run": "drive", "targets": "red", "until": ["nearer:0.5", "done"]}
    assert load({"events.+": event}).events[-1].until == ("nearer:0.5", "done")


def test_places_a_box_at_x_y_and_degrees(load: Load) -> None:
    made = load({"events.+": {"at": 20, "place": "spare", "pose": [1, -1, 90]}}).events[-1]
    assert (made.action, made.box, made.robots) == ("place", "spare", ())
    assert made.pose == (1.0, -1.0, math.pi / 2.0)


@pytest.mark.parametrize(
    ("event", "fault"),
    [
        ({}, "events[1] has nothing"),
        ({"stop": "red", "kill": "red"}, "events[1] has stop and kill"),
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
def test_an_invalid_event_is_refused(load: Load, event: dict[str, Any], fault: str) -> None:
    with pytest.raises(ConfigError) as raised:
        load({"events.+": {"at": 20, **event}})
    assert str(raised.value).startswith("here.yaml: ")
    assert fault in str(raised.value)
