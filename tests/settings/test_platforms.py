"""Platform files: the shipped ones, and every way one of them can be wrong."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from swarmd.core.errors import ConfigError
from swarmd.driver_api.driver import Stopping
from swarmd.plugins import driver_names, load_driver
from swarmd.settings.driver_options import BaseOptions, base_options
from swarmd.settings.platforms import load_platform, platform_names

GOOD: dict[str, Any] = {
    "description": "a test robot",
    "limits": {"linear": 0.26, "angular": 1.82},
    "footprint": [[-0.2, -0.15], [0.1, -0.15], [0.1, 0.15], [-0.2, 0.15]],
    "scan": {
        "rays": 4,
        "rate": 5.0,
        "range_min": 0.12,
        "range_max": 3.5,
        "offset": [-0.064, 0.0],
        "zero": "lds",
        "max_gap_deg": 90.0,
    },
    "provides": ["scan", "odometry", "reading:light"],
    "protection": {
        "mode": "potential_field",
        "preset": "paper",
        "presets": {
            "paper": {"threshold": 0.5, "rays": 5, "forward_bias": 2.0},
            "repo": {"threshold": 0.3, "rays": 5, "forward_bias": 2.0},
        },
    },
    "patterns": {"attraction": {"range_max": 2.0}},
    "drivers": {"simulated": {"endpoint": "tcp/127.0.0.1:1"}},
    "body": {"mass": 1.8},
}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def write(folder: Path, data: dict[str, Any], name: str = "x.yaml") -> str:
    (folder / name).write_text(yaml.safe_dump(data, sort_keys=False))
    return name


def with_value(path: str, value: object) -> dict[str, Any]:
    """GOOD with the value at a dotted path replaced."""
    data: dict[str, Any] = yaml.safe_load(yaml.safe_dump(GOOD))
    at = data
    *above, last = path.split(".")
    for key in above:
        at = at[key]
    at[last] = value
    return data


@pytest.mark.parametrize("name", ["burger", "waffle_pi", "jackal", "waffle_pi_lds02"])
def test_shipped_platforms_load(name: str) -> None:
    platform = load_platform(name)
    assert name in platform_names()
    assert platform.name == name
    assert platform.limits.linear > 0.0
    assert platform.scan.range_min < float(platform.protection["threshold"]) < 4.0


def test_gives_every_value_in_its_type(folder: Path) -> None:
    platform = load_platform(write(folder, GOOD))
    assert platform.name == "x"
    assert (platform.limits.linear, platform.limits.lateral) == (0.26, 0.0)
    assert platform.footprint.shape == (4, 2)
    assert platform.footprint.dtype == np.float64
    assert platform.scan.offset == (-0.064, 0.0)
    assert platform.scan.max_gap == pytest.approx(math.pi / 2)
    assert platform.scan.zero == "lds"
    assert platform.provides == {"scan", "odometry", "reading:light"}
    assert platform.patterns == {"attraction": {"range_max": 2.0}}
    assert platform.drivers == {"simulated": {"endpoint": "tcp/127.0.0.1:1"}}
    assert platform.body == {"mass": 1.8}


def test_spreads_rays_evenly_from_the_first_bearing_within_half_a_turn(folder: Path) -> None:
    platform = load_platform(write(folder, with_value("scan.first_bearing_deg", 45.0)))
    assert np.degrees(platform.scan.bearings) == pytest.approx([45.0, 135.0, -135.0, -45.0])


def test_flattens_the_preset_in_force(folder: Path) -> None:
    platform = load_platform(write(folder, with_value("protection.preset", "repo")))
    assert platform.protection == {
        "mode": "potential_field",
        "preset": "repo",
        "threshold": 0.3,
        "rays": 5,
        "forward_bias": 2.0,
        "barrier": None,
        "stop_zone": {"stop": 0.1, "slow": 0.25, "slow_share": 0.3},
    }


def test_a_variant_changes_only_what_it_says(folder: Path) -> None:
    write(folder, GOOD)
    variant = {"extends": "./x.yaml", "limits": {"linear": 0.1}, "protection": {"preset": "repo"}}
    platform = load_platform(write(folder, variant, "slow.yaml"))
    assert (platform.name, platform.limits.linear, platform.limits.angular) == ("slow", 0.1, 1.82)
    assert platform.protection["threshold"] == 0.3


def test_a_variant_of_a_shipped_platform(folder: Path) -> None:
    variant = {"extends": "waffle_pi", "limits": {"linear": 0.05}}
    platform = load_platform(write(folder, variant, "slow.yaml"))
    assert platform.limits.linear == 0.05
    assert platform.limits.angular == load_platform("waffle_pi").limits.angular


def test_a_fault_in_the_base_names_the_base(folder: Path) -> None:
    write(folder, with_value("limits.linear", -0.2))
    write(folder, {"extends": "x.yaml", "description": "variant"}, "slow.yaml")
    with pytest.raises(ConfigError, match=r"^x\.yaml: limits\.linear is -0\.2; wanted a number"):
        load_platform("slow.yaml")


def test_refuses_circles_of_extends(folder: Path) -> None:
    write(folder, {"extends": "b.yaml"}, "a.yaml")
    write(folder, {"extends": "a.yaml"}, "b.yaml")
    with pytest.raises(ConfigError, match=r"a\.yaml -> b\.yaml -> a\.yaml; take one of them out"):
        load_platform("a.yaml")


def test_refuses_an_unknown_base(folder: Path) -> None:
    with pytest.raises(ConfigError, match=r"^x\.yaml: extends: no platform 'wafle_pi'; did you me"):
        load_platform(write(folder, {"extends": "wafle_pi"}))


@pytest.mark.parametrize(
    ("path", "value", "fault"),
    [
        ("limits.linear", -0.2, "limits.linear is -0.2; wanted a number above 0"),
        ("limits.linear", math.nan, "limits.linear is nan; wanted a number above 0"),
        ("limits.liner", 0.2, "limits has no key 'liner'; did you mean 'linear'?"),
        ("scan.range_min", 4.0, "scan.range_min is 4; wanted less than scan.range_max (3.5)"),
        ("scan.zero", "lsd", "scan.zero is 'lsd'; wanted "),
        ("scan.rays", 0, "scan.rays is 0; wanted a whole number of at least 1"),
        ("scan.offset", [0.0], "scan.offset is [0.0]; wanted [a number"),
        ("provides", ["scam"], "provides: no word 'scam'; did you mean 'scan'?"),
        ("provides", ["reading:"], "provides: no word 'reading:'"),
        (
            "protection.mode",
            "of",
            "protection.mode is 'of'; wanted barrier or off or potential_field",
        ),
        ("protection.preset", "papr", "protection.preset: no preset 'papr'; did you mean 'paper'?"),
        (
            "protection.presets.repo.threshold",
            3.5,
            "protection.presets.repo.threshold is 3.5; wanted a range the sensor can measure, "
            "between 0.12 and 3.5",
        ),
        (
            "protection.presets.paper.threshold",
            0.1,
            "protection.presets.paper.threshold is 0.1; wanted a range the sensor can measure",
        ),
        (
            "protection.mode",
            "barrier",
            "protection.mode is barrier, which needs protection.barrier; give it others_speed and",
        ),
        ("protection.barrier", {"others_speed": 0.3}, "protection.barrier.unseen_extent is missi"),
        (
            "protection.barrier",
            {"others_speed": 0.3, "unseen_extent": 0.1, "keep_out": 0.12},
            "protection.barrier.keep_out is 0.12; wanted a range the sensor can measure, between",
        ),
        (
            "protection.stop_zone",
            {"stop": 0.3, "slow": 0.2},
            "protection.stop_zone.slow is 0.2; wanted at least stop (0.3)",
        ),
        ("patterns.attraction", 3, "patterns.attraction is 3; wanted keys and values"),
        ("patterns.attraction.range_max", math.inf, "patterns.attraction.range_max is inf"),
        ("drivers.simulated.endpoint", math.nan, "drivers.simulated.endpoint is nan"),
        ("body.mass", "heavy", "body.mass is 'heavy'; wanted a number"),
        ("footprint", [[0, 0], [1, 0]], "footprint has 2 corners; wanted a convex polygon"),
        ("footprint", [[0, 0], [0, 1], [1, 1], [1, 0]], "footprint runs clockwise; wanted"),
        ("footprint", [[0, 0], [1, 0], [1, 0], [0, 1]], "footprint has the same corner twice"),
        (
            "footprint",
            [[0, 0], [2, 0], [1, 0.5], [2, 2], [0, 2]],
            "footprint does not turn left at corner 2; wanted",
        ),
        ("footprint", [[0, 0], [1, 0], [2, 0], [0, 1]], "footprint does not turn left at corner 1"),
        (
            "footprint",
            [[math.cos(a), math.sin(a)] for a in (0.0, 2.513, 5.027, 7.540, 10.053)],
            "footprint crosses itself; wanted",
        ),
    ],
)
def test_refuses_in_one_line(folder: Path, path: str, value: object, fault: str) -> None:
    with pytest.raises(ConfigError) as caught:
        load_platform(write(folder, with_value(path, value)))
    assert str(caught.value).startswith(f"x.yaml: {fault}")
    assert "\n" not in str(caught.value)


def test_the_barrier_is_refused_where_nothing_tells_how_the_robot_moves(folder: Path) -> None:
    data = with_value("protection.mode", "barrier")
    data["protection"]["barrier"] = {"others_speed": 0.3, "unseen_extent": 0.1}
    assert load_platform(write(folder, data)).protection["mode"] == "barrier"
    data["provides"] = ["scan"]
    with pytest.raises(
        ConfigError, match=r"^x\.yaml: protection\.mode is barrier, which needs odo"
    ):
        load_platform(write(folder, data))


def test_refuses_a_sensor_that_loses_what_its_zeros_tell(folder: Path) -> None:
    data = with_value("scan.zero", "too_close")
    data["scan"]["near"] = "lost"
    with pytest.raises(
        ConfigError, match=r"^x\.yaml: scan\.near is lost, but scan\.zero is too_cl"
    ):
        load_platform(write(folder, data))


@pytest.mark.parametrize("name", ["burger", "waffle_pi", "jackal"])
def test_shipped_lidars_lose_what_is_nearer_than_they_measure(name: str) -> None:
    assert load_platform(name).scan.near == "lost"


@pytest.mark.parametrize("key", ["limits", "footprint", "scan", "provides", "protection"])
def test_refuses_a_file_that_lacks_a_section(folder: Path, key: str) -> None:
    data = {name: value for name, value in GOOD.items() if name != key}
    with pytest.raises(ConfigError, match=rf"^x\.yaml: {key} is missing; wanted"):
        load_platform(write(folder, data))


@pytest.mark.parametrize("name", ["wafle_pi", "Waffle_Pi", "../platforms/waffle_pi", ""])
def test_refuses_unknown_names(name: str) -> None:
    with pytest.raises(ConfigError, match=rf"^no platform '{name}'; "):
        load_platform(name)


def test_a_zone_that_its_sensor_cannot_see_stops_nothing(folder: Path) -> None:
    zone = {"stop": 0.3, "slow": 0.9}
    blind = {"extends": "jackal", "protection": {"mode": "stop_zone", "stop_zone": zone}}
    with pytest.raises(ConfigError) as caught:
        load_platform(write(folder, blind))
    assert str(caught.value).startswith(
        "x.yaml: protection.mode is stop_zone, whose stop is 0.3 m from the outline, where the"
        " sensor sees nothing yet; wanted is protection.stop_zone.stop of at least 0.59"
    )
    zone["stop"] = 0.59
    assert load_platform(write(folder, blind)).protection["mode"] == "stop_zone"


def test_a_footprint_that_is_none_is_told_in_every_mode(folder: Path) -> None:
    corners = [[0, 0], [1, 0], [1, 0], [0, 1]]
    bad = {"extends": "burger", "footprint": corners, "protection": {"mode": "stop_zone"}}
    with pytest.raises(ConfigError, match="footprint has the same corner twice"):
        load_platform(write(folder, bad))


@pytest.mark.parametrize("name", platform_names())
def test_what_shipped_files_say_of_drivers_is_what_these_take(name: str) -> None:
    platform = load_platform(name)
    for driver, options in platform.drivers.items():
        if driver not in driver_names():  # this installation lacks it
            continue
        base = base_options(options, driver)
        rest = {k: v for k, v in options.items() if k not in BaseOptions.__struct_fields__}
        make = load_driver(driver)
        made = make(swarm="s", robot="r-1", platform=platform, options=rest)
        assert made.is_simulated or base.command_timeout is not None, f"{driver}: how does it stop?"
        assert base.command_timeout != "none" or isinstance(made, Stopping)


@pytest.mark.parametrize("name", ["burger_lds02", "waffle_pi_lds02"])
def test_an_lds_02_is_the_same_robot_with_other_eyes(name: str) -> None:
    variant, base = load_platform(name), load_platform(name.removesuffix("_lds02"))
    assert np.array_equal(variant.footprint, base.footprint)
    assert (variant.scan.range_min, variant.scan.range_max) == (0.16, 8.0)
    assert variant.scan.offset == base.scan.offset
    assert variant.scan.zero == "lds"


def test_rays_may_go_wherever_a_sensor_has_them(folder: Path) -> None:
    data = with_value("scan.bearings_deg", [40, 0, -40, 190])
    del data["scan"]["rays"]
    bearings = load_platform(write(folder, data)).scan.bearings
    assert np.degrees(bearings) == pytest.approx([40.0, 0.0, -40.0, -170.0])
    data["scan"]["first_bearing_deg"] = 10.0
    bearings = load_platform(write(folder, data)).scan.bearings
    assert np.degrees(bearings) == pytest.approx([50.0, 10.0, -30.0, -160.0])


def test_a_sensor_has_either_a_number_of_rays_or_their_bearings(folder: Path) -> None:
    with pytest.raises(ConfigError, match=r"^x\.yaml: scan\.rays is 4 beside bearings_deg; want"):
        load_platform(write(folder, with_value("scan.bearings_deg", [0.0, 90.0])))
    data = with_value("scan.rays", None)
    with pytest.raises(ConfigError, match=r"^x\.yaml: scan\.rays is missing; wanted is one of"):
        load_platform(write(folder, data))


def test_a_fault_in_how_a_base_stops_names_the_file(folder: Path) -> None:
    with pytest.raises(ConfigError, match=r"^x\.yaml: drivers\.ros1: command_timeout"):
        load_platform(write(folder, with_value("drivers.ros1", {"command_timeout": "never"})))
    silent = {"command_timeout": "none", "idle_output": "silent"}
    with pytest.raises(ConfigError, match=r"^x\.yaml: drivers\.ros1: idle_output is silent, but"):
        load_platform(write(folder, with_value("drivers.ros1", silent)))
