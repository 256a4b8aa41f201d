"""The time line as a whole: in order, and nothing asked of who is not there."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from swarmd.core.errors import ConfigError

if TYPE_CHECKING:
    from tests.sim.scenarios.conftest import Load

Events = list[dict[str, Any]]


def test_groups_begin_their_patterns_before_anything_else(load: Load) -> None:
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


def test_who_joins_before_leaving_is_absent_at_first_and_does_not_begin(load: Load) -> None:
    scenario = load({"events": [{"at": 30, "leave": "red-02"}, {"at": 20, "join": "red-02"}]})
    assert scenario.absent == {"red-02"}
    assert scenario.events[0].robots == ("red-01",)


def test_who_leaves_first_is_there_and_may_come_back(load: Load) -> None:
    events: Events = [{"at": 20, "kill": "red"}, {"at": 30, "join": "red"}]
    assert load({"events": events}).absent == frozenset()


def test_a_group_may_have_members_who_are_not_there(load: Load) -> None:
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
def test_says_what_could_not_be_carried_out(load: Load, events: Events, fault: str) -> None:
    with pytest.raises(ConfigError) as raised:
        load({"events": events})
    assert str(raised.value).startswith("here.yaml: ")
    assert fault in str(raised.value)


def test_what_is_estopped_runs_again_after_a_reset(load: Load) -> None:
    events: Events = [
        {"at": 5, "estop": "all"},
        {"at": 6, "reset": "all"},
        {"at": 6, "run": "drive"},
        {"at": 7, "param": {"speed": 0.1}},
        {"at": 8, "place": "spare", "pose": [0, 2, 0]},
        {"at": 9, "remove": "spare"},
    ]
    assert len(load({"events": events}).events) == 7
