"""An invalid value gives one line with file, key, value and what was wanted."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import pytest

from swarmd.core.errors import ConfigError

if TYPE_CHECKING:
    from tests.sim.scenarios.conftest import Load

NAN, INF = math.nan, math.inf


def test_the_scenario_that_is_changed_here_is_right(load: Load) -> None:
    assert list(load().robots) == ["red-01", "red-02", "b-one", "b-two"]


@pytest.mark.parametrize(
    ("key", "value", "fault"),
    [
        ("duration", 0, "duration is 0; wanted a number above 0 and up to 1e+06"),
        ("duration", NAN, "duration is nan; wanted a number above 0"),
        ("duration", INF, "duration is inf; wanted"),
        ("duration", True, "duration is True; wanted a number"),
        ("duration", "long", "duration is 'long'; wanted a number"),
        ("trace_rate", 0, "trace_rate is 0; wanted a number above 0 and up to 100"),
        ("lidar_visibility", "Body", "lidar_visibility is 'Body'; wanted body or real"),
        ("description", 5, "description is 5; wanted text (put it in quotes)"),
        ("realism", "perfect", "realism: no preset 'perfect'; there are: ideal, realistic"),
        ("realism", {"lidar": {"bias": -1}}, "realism: lidar.bias is -1; wanted a number"),
        ("realism", 5, "realism is 5; wanted"),
        ("radio.loss", 1.5, "radio.loss is 1.5; wanted a number of at least 0 and up to 1"),
        ("radio.los", True, "radio has no key 'los'; did you mean 'loss'?"),
        ("radio.neighborhood", "range", "radio.range is missing"),
        ("radio.line_of_sight", 1, "radio.line_of_sight is 1; wanted true or false"),
        ("arena.size", [8], "arena.size is [8]; wanted [a number"),
        ("arena.size", [8, -6], "arena.size[1] is -6; wanted a number of at least 0.01"),
        ("arena.walls", 4, "arena has no key 'walls'"),
        ("arena.boxes.0.at", [1, NAN], "arena.boxes[0].at[1] is nan; wanted a number"),
        ("arena.boxes.0.mass", 0, "arena.boxes[0].mass is 0; wanted a number above 0"),
        ("arena.boxes.0.yaw", 0, "arena.boxes[0] has no key 'yaw'; did you mean 'yaw_deg'?"),
        ("arena.boxes.0.at", [4.5, 0], "arena.boxes[0].at is [4.5, 0.0]; wanted within the walls"),
        ("arena.boxes.1.name", "crate", "two boxes named 'crate'"),
        ("arena.boxes.2.at", None, "box block is not in the arena and has no mass"),
        ("arena.poles.0.radius", 0, "arena.poles[0].radius is 0; wanted a number of at least"),
        ("arena.poles.0.at", [0, 3.1], "arena.poles[0].at is [0.0, 3.1]; wanted within the walls"),
        ("arena.segments.0.to", [9, 0], "arena.segments[0].to is [9.0, 0.0]; wanted within"),
        ("arena.segments.0.to", [-3, -2], "arena.segments[0] begins and ends at [-3.0, -2.0]"),
        ("arena.segments.0", {"from": [0, 0]}, "arena.segments[0].to is missing"),
        ("fields.0.kind", "gausian", "fields[0]: no kind of field 'gausian'; did you mean"),
        ("fields.0", {"name": "light"}, "fields[0].kind is missing; wanted gaussian or linear or"),
        ("fields.0.sigma", -1, "fields[0]: sigma is -1; wanted a number"),
        ("fields.0.name", "the light", "fields[0].name is 'the light'; wanted letters"),
        ("fields.0", 5, "fields[0] is 5; wanted keys and values"),
        ("platforms.burger.limits.linear", 0, "platforms.burger: limits.linear is 0; wanted"),
        ("platforms.burgr.limits.linear", 1, "platforms.burgr: no platform 'burgr'; did you mean"),
        ("platforms.slow", {"extends": "burgr"}, "platforms.slow: no platform 'burgr'; did you"),
        ("groups", {}, "groups is empty; wanted one group of robots at least"),
        ("groups.red", {}, "groups.red has no robots; give count, or robots: [ids]"),
        ("groups.red.count", 0, "groups.red.count is 0; wanted a whole number of at least 1"),
        ("groups.red.count", 2.5, "groups.red.count is 2.5; wanted a whole number"),
        ("groups.red.count", True, "groups.red.count is True; wanted a whole number"),
        ("groups.red.cuont", 3, "groups.red has no key 'cuont'; did you mean 'count'?"),
        (
            "groups.red.touch.drive",
            {"half_width_deg": 9},
            "groups.red.touch.drive.speed is missing",
        ),
        ("groups.red.parameters", [1], "groups.red.parameters is [1]; wanted keys and values"),
        ("groups.red.start.spacing", 0, "groups.red.start.spacing is 0; wanted a number of at"),
        (
            "groups.red.start.layout",
            "gird",
            "groups.red.start.layout: no layout 'gird'; did you mean",
        ),
        ("start", "row", "start is 'row'; wanted keys and values: layout, spacing"),
        ("parameters.attraction", 5, "parameters.attraction is 5; wanted keys and values"),
        ("events.0.at", -1, "events[0].at is -1; wanted a number of at least 0"),
        ("events.0.at", NAN, "events[0].at is nan; wanted a number"),
        ("events.0.for", 0, "events[0].for is 0; wanted a number above 0"),
        ("events.0.target", "red", "events[0] has no key 'target'; did you mean 'targets'"),
        ("events.0", {"run": "drive"}, "events[0].at is missing; wanted a number"),
        ("evnets", [], "no key 'evnets'; did you mean 'events'?"),
    ],
)
def test_an_invalid_key_or_value_is_named(load: Load, key: str, value: Any, fault: str) -> None:
    with pytest.raises(ConfigError) as raised:
        load({key: value})
    text = str(raised.value)
    assert text.startswith("here.yaml: ")
    assert fault in text
    assert "\n" not in text
