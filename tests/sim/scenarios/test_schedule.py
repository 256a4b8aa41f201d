"""Events of a scenario, each by itself and in order of time."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import pytest

from swarmd.core.errors import ConfigError
from swarmd.sim.world.faults import NoisyScan
from swarmd.sim.world.scalar_fields import UniformField

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
            "[1].run: red-01",
        ),
        ([{"at": 20, "kill": "red"}, {"at": 25, "stop": "red"}], "[1].stop: red-01"),
        ([{"at": 20, "leave": "red-01"}, {"at": 25, "kill": "red"}], "[1].kill: red-01"),
        ([{"at": 5, "join": "red"}, {"at": 25, "join": "red-02"}], "[1].join: red-02"),
        ([{"at": 5, "param": {"speed": 0.1}}], "[0].param: s-one"),
        (
            [{"at": 5, "stop": "red"}, {"at": 6, "param": {"speed": 0.1}, "targets": "red"}],
            "[1].param: red-01",
        ),
        (
            [
                {"at": 5, "run": "drive", "targets": "blue", "for": 3},
                {"at": 8, "param": {"speed": 0.1}, "targets": "blue"},
            ],
            "[1].param: s-one",
        ),
        ([{"at": 5, "estop": "red-02"}, {"at": 9, "run": "drive"}], "[1].run: red-02"),
        ([{"at": 5, "remove": "spare"}], "[0].remove: spare"),
        ([{"at": 5, "remove": "red"}, {"at": 6, "remove": "red-01"}], "[1].remove: red-01"),
        ([{"at": 5, "remove": "red-01"}, {"at": 6, "join": "red-01"}], "[1].join: red-01"),
        (
            [{"at": 5, "remove": "red-01"}, {"at": 6, "run": "drive", "targets": "red-01"}],
            "[1].run: red-01",
        ),
    ],
)
def test_an_impossible_sequence_is_refused(load: Load, events: Events, fault: str) -> None:
    with pytest.raises(ConfigError) as raised:
        load({"events": events})
    assert str(raised.value).startswith(f"here.yaml: events{fault}")


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


def test_a_fault_with_a_duration_has_an_end(load: Load) -> None:
    event = {"at": 20, "fault": {"scan": "noise", "sd": 0.3}, "robots": "red", "for": 15}
    events = load({"events": [event, {"at": 30, "stop": "all"}]}).events[1:]
    assert [(e.at, e.action) for e in events] == [(20, "fault"), (30, "stop"), (35, "mend")]
    fault = events[0].fault
    assert isinstance(fault, NoisyScan)
    assert (fault.sd, events[0].robots) == (0.3, ("red-01", "red-02"))


def test_a_killed_process_is_the_event_kill_and_its_end_a_join(load: Load) -> None:
    event = {"at": 20, "fault": {"process": "killed"}, "robots": "red-01", "for": 15}
    made = load({"events": [event]})
    assert [(e.at, e.action) for e in made.events[1:]] == [(20, "kill"), (35, "join")]
    assert made.absent == frozenset()


def test_a_second_fault_of_a_kind_is_refused_until_the_first_ends(load: Load) -> None:
    def events(second: float, word: str) -> Events:
        first = {"at": 20, "fault": {"scan": "frozen"}, "robots": "red", "for": 10}
        return [first, {"at": second, "fault": {"scan": word}, "robots": "red-02"}]

    assert len(load({"events": events(25, "mirrored")}).events) == 4
    assert len(load({"events": events(30, "frozen")}).events) == 4
    with pytest.raises(ConfigError, match=r"^here\.yaml: events\[1\]\.fault: red-02 .*25 s"):
        load({"events": events(25, "frozen")})


@pytest.mark.parametrize(
    ("event", "robots"),
    [
        ({"stop": "all"}, ("red-01", "red-02", "s-one", "s-two")),
        ({"stop": "blue"}, ("s-one", "s-two")),
        ({"stop": "red-02"}, ("red-02",)),
        ({"stop": ["s-one", "red"]}, ("red-01", "red-02", "s-one")),
        ({"run": "drive"}, ("red-01", "red-02", "s-one", "s-two")),
        ({"run": "drive", "targets": ["blue", "s-one"]}, ("s-one", "s-two")),
        ({"param": {"speed": 0.1}, "targets": "s-one"}, ("s-one",)),
    ],
)
def test_targets_are_robots_groups_or_all(load: Load, event: Any, robots: tuple[str, ...]) -> None:
    assert load({"events.+": {"at": 20, **event}}).events[-1].robots == robots


def test_a_run_has_pattern_parameters_duration_and_end_conditions(load: Load) -> None:
    event = {"at": 20, "run": "drive", "targets": "red", "parameters": {"speed": 0.1}, "for": 5}
    made = load({"events.+": {**event, "until": ["nearer:0.5", "done"]}}).events[-1]
    assert (made.at, made.action, made.pattern, made.seconds) == (20.0, "run", "drive", 5.0)
    assert made.parameters == {"speed": 0.1}
    assert made.until == ("nearer:0.5", "done")


def test_places_a_box_at_x_y_and_degrees(load: Load) -> None:
    made = load({"events.+": {"at": 20, "place": "spare", "pose": [1, -1, 90]}}).events[-1]
    assert (made.action, made.box, made.robots) == ("place", "spare", ())
    assert made.pose == (1.0, -1.0, math.pi / 2.0)


def test_an_event_changes_the_fields_of_a_name(load: Load) -> None:
    fields = [{"kind": "uniform", "name": "light", "value": 3}]
    made = load({"events.+": {"at": 20, "fields": fields}})
    assert (made.events[-1].action, made.events[-1].robots) == ("fields", ())
    assert made.events[-1].fields == (UniformField(name="light", value=3.0),)
    assert made.effective["events"][-1]["fields"] == fields


@pytest.mark.parametrize(("at", "seconds", "again"), [(20, 15, 35), (2.1, 0.2, 2.3)])
@pytest.mark.parametrize("is_first_in_file", [True, False])
def test_a_fault_that_begins_at_the_end_of_the_same_fault_stays(
    load: Load, at: float, seconds: float, again: float, is_first_in_file: bool
) -> None:
    assert 2.1 + 0.2 > 2.3
    times: tuple[dict[str, float], ...] = ({"at": again}, {"at": at, "for": seconds})
    pair = [{"fault": {"scan": "frozen"}, "robots": "red", **one} for one in times]
    events = load({"events": pair if is_first_in_file else pair[::-1]}).events
    assert [e.action for e in events if e.fault] == ["fault", "mend", "fault"]


def test_a_short_fault_ends(load: Load) -> None:
    event = {"at": 20, "fault": {"scan": "frozen"}, "robots": "red", "for": 1e-15}
    events = load({"events": [event]}).events
    assert [e.action for e in events if e.fault] == ["fault", "mend"]


@pytest.mark.parametrize(
    ("event", "fault"),
    [
        ({"fields": []}, ".fields is empty"),
        ({"fields": [{"kind": "uniform", "name": "ligth", "value": 1}]}, ".*'ligth'.*'light'"),
        ({"fields": [{"kind": "unifrm", "name": "light", "value": 1}]}, ".*'unifrm'"),
        ({"fields": [{"kind": "floor", "name": "light", "colour": [1, 0, 0]}]}, ".*'light_red'"),
        ({}, ""),
        ({"stop": "red", "kill": "red"}, ".*stop and kill"),
        ({"stop": "rde"}, ".stop: .*'red'"),
        ({"kill": "b-on"}, ".kill: .*'s-one'"),
        ({"run": "drive", "targets": ["red", "al"]}, ".targets: .*'al'"),
        ({"stop": []}, ".stop"),
        ({"stop": 5}, ".stop"),
        ({"stop": "red", "targets": "red"}, ".targets.*stop"),
        ({"stop": "red", "for": 5}, ".for.*stop"),
        ({"run": "drive", "until": ["near:1"]}, ".until: .*'near'"),
        ({"param": {"speed": 1}, "pose": [0, 0, 0]}, ".pose.*param"),
        ({"param": {}}, ".param"),
        ({"place": "spare"}, ".pose"),
        ({"place": "spare", "pose": [1, 2]}, ".pose"),
        ({"place": "spare", "pose": [9, 0, 0]}, ".pose"),
        ({"place": "spar", "pose": [1, 0, 0]}, ".place: .*'spare'"),
        ({"remove": "block"}, ".remove: .*'block'"),
        ({"at": 60, "stop": "all"}, ".at"),
        ({"fault": {"scan": "frozen"}}, ".robots"),
        ({"fault": {"scan": "frozen"}, "robots": "rde"}, ".robots: .*'red'"),
        ({"fault": {"scan": "frozen"}, "targets": "red"}, ".targets.*fault"),
        ({"stop": "red", "robots": "red"}, ".robots.*stop"),
        ({"fault": {"scan": "frosen"}, "robots": "red"}, ".fault: .*'frozen'"),
        ({"fault": {"scan": "noise", "sd": -1}, "robots": "red"}, ".fault: sd"),
        ({"fault": {"battery": "low"}, "robots": "red"}, ".fault: .*red-01 has no battery"),
        ({"fault": {"pose": "frozen"}, "robots": "red"}, ".fault: .*red-01 has no pose"),
    ],
)
def test_an_invalid_event_is_refused(load: Load, event: dict[str, Any], fault: str) -> None:
    with pytest.raises(ConfigError, match=rf"^here\.yaml: events\[1\]{fault}"):
        load({"events.+": {"at": 20, **event}})
