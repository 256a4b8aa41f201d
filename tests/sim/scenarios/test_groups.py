"""Groups of robots and their platforms."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from swarmd.core.errors import ConfigError
from swarmd.core.values import TouchZone
from swarmd.kit.touch import granted_zones
from swarmd.settings.platforms import load_platform
from swarmd.sim.scenarios.scenariofile import scenario_of

if TYPE_CHECKING:
    from tests.sim.scenarios.conftest import Load


def test_robots_are_named_by_group_prefix_or_list(load: Load) -> None:
    scenario = load({"groups.red.prefix": "tb3"})
    assert scenario.groups == {"red": ("tb3-01", "tb3-02"), "blue": ("s-one", "s-two")}
    assert tuple(scenario.robots) == ("s-one", "s-two", "tb3-01", "tb3-02")


def test_a_hundred_robots_still_sort_by_name(load: Load) -> None:
    scenario = load({"groups.red.count": 100, "groups.red.start": {"layout": "random"}})
    assert scenario.groups["red"][0] == "red-001"
    assert sorted(scenario.groups["red"]) == list(scenario.groups["red"])


def test_a_platform_gets_the_sensors_of_the_scenario(load: Load) -> None:
    robot = load().robots["red-01"]
    assert robot.limits == load_platform("burger").limits
    places = {"neighbors.distance", "neighbors.bearing", "neighbors.heading"}
    by_kin = {"kin", *places}
    assert robot.provides == {"scan", "odometry", "neighbors", "reading:light", *by_kin}
    for radio in ({"range_and_bearing": True}, {"places": "shared"}):
        near = load({"radio": radio}).robots["red-01"].provides
        assert near == robot.provides - {"kin"}


def test_values_of_a_platform_can_be_changed_for_one_scenario(load: Load) -> None:
    scenario = load({"platforms": {"burger": {"protection": {"preset": "repo"}}}})
    assert scenario.robots["red-01"].protection["threshold"] == 0.22
    assert scenario.robots["s-one"].protection["threshold"] == 0.5


def test_a_group_grants_its_robots_where_a_pattern_may_touch(load: Load) -> None:
    granted = {"attraction": {"bearing_deg": 90, "half_width_deg": 9, "speed": 0.1}, "drive": None}
    scenario = load({"groups.red.touch": granted})
    zone = TouchZone(math.radians(90.0), math.radians(9.0), 0.1)
    assert granted_zones(scenario.settings["red-02"].touch) == {"attraction": zone}
    assert scenario.settings["s-one"].touch == {}
    assert scenario_of(scenario.effective).settings == scenario.settings


def test_the_touch_of_a_scenario_is_that_of_all_robots_and_of_a_group_prevails(load: Load) -> None:
    def zone(degrees: float) -> dict[str, float]:
        return {"half_width_deg": degrees, "speed": 0.1}

    touch = {"attraction": zone(20), "drive": zone(20)}
    scenario = load({"touch": touch, "groups.red.touch": {"attraction": zone(9), "drive": None}})
    red, single = (granted_zones(scenario.settings[name].touch) for name in ("red-01", "s-one"))
    assert {name: zone.half_width for name, zone in red.items()} == {"attraction": math.radians(9)}
    assert {name: zone.half_width for name, zone in single.items()} == dict.fromkeys(
        touch, math.radians(20)
    )
    with pytest.raises(ConfigError, match=r"touch\.drvie: .*'drive'"):
        load({"touch": {"drvie": zone(20)}})


def test_a_platform_can_be_made_from_another(load: Load) -> None:
    slow = {"extends": "burger", "limits": {"linear": 0.1}}
    robot = load({"platforms": {"slow": slow}, "groups.red.platform": "slow"}).robots["red-01"]
    assert (robot.name, robot.limits.linear, robot.limits.angular) == ("slow", 0.1, 2.84)


def test_a_platform_can_be_a_file_beside_the_scenario(load: Load, tmp_path: Path) -> None:
    (tmp_path / "mine.yaml").write_text("extends: burger\nlimits: {linear: 0.1}")
    robot = load({"groups.red.platform": "mine.yaml"}).robots["red-01"]
    assert (robot.name, robot.limits.linear) == ("mine", 0.1)


@pytest.mark.parametrize(
    ("changes", "fault"),
    [
        ({"groups.red.platform": "burgr"}, "groups.red.platform.*'burger'"),
        (
            {"platforms": {"slow": {"extends": "burger"}}, "groups.red.platform": "slo"},
            "groups.red.platform.*'slow'",
        ),
        ({"groups.red.platform": "no.yaml"}, "groups.red.platform.*no.yaml"),
        (
            {"groups.red.platform": "a/burger.yaml", "groups.blue.platform": "burger"},
            "groups.blue.platform",
        ),
        ({"groups.blue.robots": []}, "groups.blue.robots"),
        ({"groups.blue.count": 2}, "groups.blue"),
        ({"groups.blue.robots": ["a", "red-02"]}, "'red-02'.*'red'"),
        ({"groups.blue.robots": ["a", "a"]}, "groups.blue: .*'a'"),
        ({"groups.blue.robots": ["red", "a"]}, "'red'"),
        ({"groups.blue.robots": ["all", "a"]}, "'all'"),
        ({"groups.blue.robots": ["B 1", "a"]}, "groups.blue: .*'B 1'"),
        ({"groups.red.prefix": "TB3"}, "groups.red: .*'TB3-01'"),
        ({"groups.Red": {"count": 1}}, "'Red'"),
        ({"groups.all": {"count": 1}}, "groups.all"),
    ],
)
def test_an_invalid_group_is_named(load: Load, changes: dict[str, Any], fault: str) -> None:
    with pytest.raises(ConfigError, match=rf"^here\.yaml: .*{fault}"):
        load(changes)
