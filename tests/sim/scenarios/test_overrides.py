"""Overrides: values read as in a file, at existing keys."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from swarmd.core.errors import ConfigError
from swarmd.sim.scenarios.overrides import nested, parse_override

if TYPE_CHECKING:
    from tests.sim.scenarios.conftest import Load


@pytest.mark.parametrize(
    ("text", "override"),
    [
        ("duration=30", ("duration", 30)),
        ("radio.loss=1e-3", ("radio.loss", 0.001)),
        ("arena.size=[6, 4.5]", ("arena.size", [6, 4.5])),
        ("groups.all.pattern=null", ("groups.all.pattern", None)),
        ("groups.all.pattern=", ("groups.all.pattern", None)),
        ("description=a=b", ("description", "a=b")),
        (" duration = 30", ("duration", 30)),
    ],
)
def test_a_value_is_read_as_in_a_file(text: str, override: tuple[str, Any]) -> None:
    assert parse_override(text) == override


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("duration", "'duration'"),
        ("=5", "'=5'"),
        ("groups..count=5", r"groups\.\.count"),
        ("arena.size=[6", "arena.size"),
        ("x={a: 1, a: 2}", "a: 2"),
    ],
)
def test_a_malformed_override_is_refused(text: str, fault: str) -> None:
    with pytest.raises(ConfigError, match=f"^--set.*{fault}"):
        parse_override(text)


@given(st.text(max_size=20))
def test_any_text_is_read_or_refused_in_one_line(text: str) -> None:
    fault = ""
    try:
        parse_override(f"key={text}")
    except ConfigError as error:
        fault = str(error)
    assert "\n" not in fault


def test_changes_what_it_names_and_nothing_else(load: Load) -> None:
    overrides = {
        "groups.red.count": 3,
        "groups.red.parameters.law": "paper",
        "arena.boxes.0.mass": 4.0,
        "events.0.at": 12,
        "realism.lidar.bias": 0.0,
        "platforms.burger.limits.linear": 0.1,
    }
    scenario = load({}, overrides)
    assert scenario.groups["red"] == ("red-01", "red-02", "red-03")
    layers = scenario.parameters["red-01"].layers("attraction", ())
    assert layers == (("group red", {"law": "paper"}),)
    assert [box.mass for box in scenario.arena.boxes] == [4.0, 2.0, None]
    assert scenario.arena.boxes[0].name == "crate"
    assert (scenario.events[1].at, scenario.events[1].pattern) == (12.0, "drive")
    assert scenario.realism.lidar.bias == 0.0
    assert scenario.realism.lidar.far_sd == load().realism.lidar.far_sd > 0.0
    assert scenario.robots["red-01"].limits.linear == 0.1
    assert scenario.duration == 60.0


@pytest.mark.parametrize(
    ("overrides", "fault"),
    [
        ({"duraton": 5}, "--set: .*'duration'"),
        ({"groups.rde.count": 5}, "--set: groups.rde.count.*'red'"),
        ({"groups.red.conut": 5}, "--set: groups.red.*'count'"),
        ({"groups.red.count": "5"}, "--set: groups.red.count"),
        ({"extends": "mixed"}, "--set: extends"),
        ({"duration.x": 5}, "--set: duration"),
        ({"duration": 5, "duration.x": 5}, "--set: duration.x"),
        ({"events.1.at": 5}, "--set: events.1.at"),
        ({"events.first.at": 5}, "--set: events.first.at"),
        ({"groups.red.count": 90}, "here.yaml: groups.red.start: red-01"),
    ],
)
def test_an_impossible_override_is_refused(
    load: Load, overrides: Mapping[str, Any], fault: str
) -> None:
    with pytest.raises(ConfigError, match=f"^{fault}"):
        load({}, overrides)


def test_two_overrides_of_one_list_both_count() -> None:
    base = {"events": [{"at": 1}, {"at": 2, "stop": "all"}]}
    over = nested({"events.0.at": 5, "events.1.at": 6}, base)
    assert over == {"events": [{"at": 5}, {"at": 6, "stop": "all"}]}
    assert base == {"events": [{"at": 1}, {"at": 2, "stop": "all"}]}
