"""An invalid value gives one line with file and key."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import pytest

from swarmd.core.errors import ConfigError
from swarmd.settings.layered import dotted

if TYPE_CHECKING:
    from tests.sim.scenarios.conftest import Load

NAN, INF = math.nan, math.inf


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("duration", 0),
        ("duration", NAN),
        ("duration", INF),
        ("duration", True),
        ("trace_rate", 0),
        ("lidar_visibility", "Body"),
        ("realism", "perfect"),
        ("realism", 5),
        ("radio.loss", 1.5),
        ("arena.size", [8]),
        ("arena.boxes.0.mass", 0),
        ("arena.boxes.0.at", [4.5, 0]),
        ("arena.poles.0.radius", 0),
        ("arena.poles.0.at", [0, 3.1]),
        ("arena.segments.0.to", [9, 0]),
        ("fields.0", 5),
        ("groups", {}),
        ("groups.red", {}),
        ("groups.red.count", 0),
        ("groups.red.count", 2.5),
        ("groups.red.parameters", [1]),
        ("groups.red.start.spacing", 0),
        ("groups.red.start.layout", "gird"),
        ("start", "row"),
        ("platforms.burgr.limits.linear", 1),
        ("platforms.slow", {"extends": "burgr"}),
        ("events.0.at", -1),
        ("events.0.for", 0),
    ],
)
def test_an_invalid_value_is_named(load: Load, key: str, value: Any) -> None:
    words = [int(word) if word.isdecimal() else word for word in key.split(".")]
    subject = dotted(words[:2] if words[0] == "platforms" else words)
    assert fault_of(load, key, value).startswith(f"here.yaml: {subject}")


@pytest.mark.parametrize(
    ("key", "value", "subjects"),
    [
        ("evnets", [], ("'evnets'", "'events'")),
        ("radio.los", True, ("radio", "'los'", "'loss'")),
        ("radio.neighborhood", "range", ("radio.range",)),
        ("realism", {"lidar": {"bias": -1}}, ("realism: lidar.bias",)),
        ("arena.size", [8, -6], ("arena.size[1]",)),
        ("arena.boxes.0.yaw", 0, ("arena.boxes[0]", "'yaw_deg'")),
        ("arena.boxes.0.at", [1, NAN], ("arena.boxes[0].at[1]",)),
        ("arena.boxes.1.name", "crate", ("arena.boxes", "'crate'")),
        ("arena.boxes.2.at", None, ("arena.boxes", "block", "mass")),
        ("arena.segments.0.to", [-3, -2], ("arena.segments[0]",)),
        ("arena.segments.0", {"from": [0, 0]}, ("arena.segments[0].to",)),
        ("fields.0.kind", "gausian", ("fields[0]", "'gaussian'")),
        ("fields.0", {"name": "light"}, ("fields[0].kind",)),
        ("fields.0.sigma", -1, ("fields[0]", "sigma")),
        ("fields.0.name", "the light", ("fields[0]", "name")),
        ("platforms.burger.limits.linear", 0, ("platforms.burger", "limits.linear")),
        ("groups.red.cuont", 3, ("groups.red", "'count'")),
        ("groups.red.touch.drive", {"half_width_deg": 9}, ("groups.red.touch.drive.speed",)),
        ("events.0.target", "red", ("events[0]", "'targets'")),
        ("events.0", {"run": "drive"}, ("events[0].at",)),
    ],
)
def test_an_invalid_key_or_item_is_named(
    load: Load, key: str, value: Any, subjects: tuple[str, ...]
) -> None:
    fault = fault_of(load, key, value)
    assert [subject for subject in subjects if subject not in fault] == []


def fault_of(load: Load, key: str, value: Any) -> str:
    with pytest.raises(ConfigError) as raised:
        load({key: value})
    fault = str(raised.value)
    assert fault.startswith("here.yaml: ")
    assert "\n" not in fault
    return fault
