"""Platform files: the shipped ones, and every way one of them can be wrong."""

from __future__ import annotations

import math
import re
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from swarmd.core.errors import ConfigError
from swarmd.driver_api.driver import ZeroSenderProvider
from swarmd.plugins import DRIVERS, load_driver
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


def test_gives_the_places_of_sensors_with_nan_for_all_directions(folder: Path) -> None:
    sensors = {"ground": [{"at": [0.1, 0.05]}], "light": [{"at": [0, 0.1], "bearing_deg": 90}]}
    platform = load_platform(write(folder, {**GOOD, "sensors": sensors}))
    np.testing.assert_array_equal(platform.sensors["ground"], [[0.1, 0.05, math.nan]])
    np.testing.assert_allclose(platform.sensors["light"], [[0.0, 0.1, math.pi / 2.0]])
    with pytest.raises(ConfigError, match=r"sensors\.ground"):
        load_platform(write(folder, {**GOOD, "sensors": {"ground": [{"x": 1}]}}))


def test_spreads_rays_evenly_from_the_first_bearing_within_half_a_turn(folder: Path) -> None:
    platform = load_platform(write(folder, with_value("scan.first_bearing_deg", 45.0)))
    assert np.degrees(platform.scan.bearings) == pytest.approx([45.0, 135.0, -135.0, -45.0])


def test_flattens_the_preset_in_force(folder: Path) -> None:
    platform = load_platform(write(folder, with_value("protection.preset", "repo")))
    assert platform.protection == {
        "mode": "potential_field",
        "avoidance": "orca",
        "preset": "repo",
        "threshold": 0.3,
        "rays": 5,
        "forward_bias": 2.0,
        "barrier": None,
        "stop_zone": {"stop": 0.1, "slow": 0.25},
    }


def test_a_variant_overrides_only_its_keys(folder: Path) -> None:
    write(folder, GOOD)
    variant = {"extends": "./x.yaml", "limits": {"linear": 0.1}, "protection": {"preset": "repo"}}
    platform = load_platform(write(folder, variant, "slow.yaml"))
    assert (platform.name, platform.limits.linear, platform.limits.angular) == ("slow", 0.1, 1.82)
    assert platform.protection["threshold"] == 0.3


def test_a_fault_in_the_base_names_the_base(folder: Path) -> None:
    write(folder, with_value("limits.linear", -0.2))
    write(folder, {"extends": "x.yaml", "description": "variant"}, "slow.yaml")
    with pytest.raises(ConfigError, match=r"^x\.yaml: limits\.linear"):
        load_platform("slow.yaml")


def test_refuses_circles_of_extends(folder: Path) -> None:
    write(folder, {"extends": "b.yaml"}, "a.yaml")
    write(folder, {"extends": "a.yaml"}, "b.yaml")
    with pytest.raises(ConfigError, match=r"a\.yaml -> b\.yaml -> a\.yaml"):
        load_platform("a.yaml")


def test_refuses_an_unknown_base(folder: Path) -> None:
    with pytest.raises(ConfigError, match=r"^x\.yaml: extends: .*'wafle_pi'"):
        load_platform(write(folder, {"extends": "wafle_pi"}))


DENTED = [[0, 0], [2, 0], [1, 0.5], [2, 2], [0, 2]]
STAR = [[math.cos(a), math.sin(a)] for a in (0.0, 2.513, 5.027, 7.540, 10.053)]


@pytest.mark.parametrize(
    ("path", "value", "subjects"),
    [
        ("limits.linear", -0.2, ["limits.linear is -0.2", "above 0"]),
        ("limits.linear", math.nan, ["limits.linear is nan"]),
        ("limits.liner", 0.2, ["limits has no key 'liner'; did you mean 'linear'?"]),
        ("scan.mask", [[80, 100]], ["scan.mask leaves 3 of 4 rays", "180.0 deg", "90.0 deg"]),
        ("scan.mask", [[0, 90], [180, 181]], ["scan.mask leaves 1 of 4 rays"]),
        ("scan.mask", [[0, 359.5]], ["scan.mask leaves 0 of 4 rays", "360.0 deg"]),
        *(
            ("scan.mask", [circle], ["scan.mask leaves 0 of 4 rays", "360.0 deg"])
            for circle in (
                [0, 360],
                [-180, 180],
                [-360, 360],
                [-0.5, 359.6],
                [360, 0],
                [180, -180],
                [360, -360],
            )
        ),
        ("scan.mask", [[1]], ["scan.mask"]),
        ("scan.mask", [[math.nan, 1.0]], ["scan.mask"]),
        ("scan.range_min", 4.0, ["scan.range_min is 4", "scan.range_max (3.5)"]),
        ("scan.zero", "lsd", ["scan.zero is 'lsd'"]),
        ("scan.rays", 0, ["scan.rays is 0", "at least 1"]),
        ("scan.rays", None, ["scan.rays"]),
        ("scan.bearings_deg", [0.0, 90.0], ["scan.rays is 4", "bearings_deg"]),
        ("scan.offset", [0.0], ["scan.offset is [0.0]"]),
        ("provides", ["scam"], ["provides[0]", "'scam'", "'scan'"]),
        ("provides", ["reading:"], ["provides[0]", "'reading:'"]),
        ("protection.mode", "of", ["protection.mode is 'of'", "barrier", "off"]),
        ("protection.mode", "barrier", ["protection.mode", "protection.barrier"]),
        ("protection.preset", "papr", ["protection.preset", "'papr'", "'paper'"]),
        ("protection.presets.repo.threshold", 3.5, ["repo.threshold is 3.5", "0.12 and 3.5"]),
        ("protection.presets.paper.threshold", 0.1, ["paper.threshold is 0.1", "0.12 and 3.5"]),
        ("protection.barrier", {"others_speed": 0.3}, ["protection.barrier.unseen_extent"]),
        (
            "protection.barrier",
            {"others_speed": 0.3, "unseen_extent": 0.1, "keep_out": 0.12},
            ["protection.barrier.keep_out is 0.12", "0.12 and 3.5"],
        ),
        ("protection.stop_zone", {"stop": 0.3, "slow": 0.2}, ["stop_zone.slow is 0.2", "0.3"]),
        ("patterns.attraction", 3, ["patterns.attraction is 3"]),
        ("patterns.attraction.range_max", math.inf, ["patterns.attraction.range_max is inf"]),
        ("drivers.simulated.endpoint", math.nan, ["drivers.simulated.endpoint is nan"]),
        ("drivers.ros1", {"command_timeout": "never"}, ["drivers.ros1: command_timeout", "never"]),
        (
            "drivers.ros1",
            {"command_timeout": "none", "idle_output": "silent"},
            ["drivers.ros1: idle_output", "command_timeout"],
        ),
        ("body.mass", "heavy", ["body.mass is 'heavy'"]),
        ("footprint", [[0, 0], [1, 0]], ["footprint has 2 corners"]),
        ("footprint", [[0, 0], [0, 1], [1, 1], [1, 0]], ["footprint runs clockwise"]),
        ("footprint", [[0, 0], [1, 0], [1, 0], [0, 1]], ["footprint has the same corner twice"]),
        ("footprint", DENTED, ["footprint does not turn left at corner 2"]),
        ("footprint", [[0, 0], [1, 0], [2, 0], [0, 1]], ["footprint", "corner 1"]),
        ("footprint", STAR, ["footprint crosses itself"]),
    ],
)
def test_a_wrong_value_is_refused_in_one_line(
    folder: Path, path: str, value: object, subjects: list[str]
) -> None:
    with pytest.raises(ConfigError) as caught:
        load_platform(write(folder, with_value(path, value)))
    text = str(caught.value)
    assert text.startswith("x.yaml: ")
    assert all(subject in text for subject in subjects)
    assert "\n" not in text


def test_the_barrier_is_refused_without_odometry(folder: Path) -> None:
    data = with_value("protection.mode", "barrier")
    data["protection"]["barrier"] = {"others_speed": 0.3, "unseen_extent": 0.1}
    assert load_platform(write(folder, data)).protection["mode"] == "barrier"
    data["provides"] = ["scan"]
    with pytest.raises(ConfigError, match="odometry"):
        load_platform(write(folder, data))


SHORT_SIGHTED: list[dict[str, Any]] = [
    {"scan": {"range_max": 1.0}},
    {"limits": {"linear": 2.0}},
    {"limits": {"linear": 0.22, "lateral": 2.0}},
    {"scan": {"range_max": 1.2, "latency": 0.5}},
    {"scan": {"range_max": 1.2, "rate": 2.0}},
    {"scan": {"range_max": 1.2, "sweep": {"duration": 1.0}}},
    {"protection": {"barrier": {"others_speed": 2.0}}},
    {"protection": {"barrier": {"braking_linear": 0.03}}},
]


@pytest.mark.parametrize("changes", SHORT_SIGHTED)
def test_a_sensor_that_sees_less_far_than_the_robot_needs_is_refused(
    folder: Path, changes: dict[str, Any]
) -> None:
    given = changes.get("scan", {}).get("range_max", 3.5)
    needed = with_sight(folder, changes)
    assert needed > given
    scan = {**changes.get("scan", {}), "range_max": needed}
    load_platform(write(folder, {"extends": "burger", **changes, "scan": scan}))
    scan["range_max"] = needed - 0.02
    assert with_sight(folder, {**changes, "scan": scan}) == pytest.approx(needed)
    protection = {**changes.get("protection", {}), "mode": "stop_zone"}  # promises less
    load_platform(write(folder, {"extends": "burger", **changes, "protection": protection}))


def with_sight(folder: Path, changes: dict[str, Any]) -> float:
    """How far the refused Burger with these changes needs to see, by its one line."""
    with pytest.raises(ConfigError) as caught:
        load_platform(write(folder, {"extends": "burger", **changes}))
    text = str(caught.value)
    given = changes.get("scan", {}).get("range_max", 3.5)
    source = "x.yaml" if "range_max" in changes.get("scan", {}) else "burger.yaml"
    assert re.match(rf"\S*{source}: scan\.range_max is {given:g};", text)
    assert "\n" not in text
    return float(re.search(r"at least ([\d.]+)", text)[1])  # type: ignore[index]


def test_the_speed_that_a_short_sight_allows_is_named(folder: Path) -> None:
    def burger(linear: float) -> str:
        return write(folder, {"extends": "burger", "limits": {"linear": linear}})

    with pytest.raises(ConfigError) as caught:
        load_platform(burger(2.0))
    (found,) = re.findall(r"limits\.linear of at most ([\d.]+)", str(caught.value))
    assert 0.22 < float(found) < 2.0
    load_platform(burger(float(found)))
    with pytest.raises(ConfigError):
        load_platform(burger(float(found) + 0.02))


@pytest.mark.parametrize("mode", ["barrier", "stop_zone"])
def test_a_scan_rate_at_which_each_scan_is_stale_is_refused(folder: Path, mode: str) -> None:
    def burger(rate: float) -> str:
        changes = {"scan": {"rate": rate}, "protection": {"mode": mode}}
        return write(folder, {"extends": "burger", **changes})

    load_platform(burger(1.5))
    with pytest.raises(ConfigError, match=r"scan\.rate is 1.4; expected at least 1.5"):
        load_platform(burger(1.4))


def test_refuses_near_lost_with_zeros_that_mean_too_close(folder: Path) -> None:
    data = with_value("scan.zero", "too_close")
    data["scan"]["near"] = "lost"
    with pytest.raises(ConfigError, match=r"scan\.near"):
        load_platform(write(folder, data))


@pytest.mark.parametrize("name", ["wafle_pi", "Waffle_Pi", "../platforms/waffle_pi", ""])
def test_refuses_unknown_names(name: str) -> None:
    with pytest.raises(ConfigError, match=rf"^no platform '{name}'; "):
        load_platform(name)


def test_a_stop_zone_below_range_min_is_refused(folder: Path) -> None:
    zone = {"stop": 0.3, "slow": 0.9}
    blind = {"extends": "jackal", "protection": {"mode": "stop_zone", "stop_zone": zone}}
    with pytest.raises(ConfigError, match=r"stop_zone\.stop .* 0\.59"):
        load_platform(write(folder, blind))
    zone["stop"] = 0.59
    assert load_platform(write(folder, blind)).protection["mode"] == "stop_zone"


def test_a_wrong_footprint_is_refused_in_every_mode(folder: Path) -> None:
    corners = [[0, 0], [1, 0], [1, 0], [0, 1]]
    bad = {"extends": "burger", "footprint": corners, "protection": {"mode": "stop_zone"}}
    with pytest.raises(ConfigError, match="footprint has the same corner"):
        load_platform(write(folder, bad))


@pytest.mark.parametrize("name", platform_names())
def test_drivers_accept_the_options_of_shipped_platforms(name: str) -> None:
    platform = load_platform(name)
    for driver, options in platform.drivers.items():
        if driver not in entry_points(group=DRIVERS).names:  # this installation lacks it
            continue
        base = base_options(options, driver)
        rest = {k: v for k, v in options.items() if k not in BaseOptions.__struct_fields__}
        make = load_driver(driver)
        made = make(swarm="s", robot="r-1", platform=platform, options=rest)
        assert made.is_simulated or base.command_timeout is not None, f"{driver}: how does it stop?"
        assert base.command_timeout != "none" or isinstance(made, ZeroSenderProvider)


@pytest.mark.parametrize(
    ("scan", "is_unknown"),
    [({}, True), ({"sweep": "unknown"}, True), ({"sweep": None}, False), ({"sweep": {}}, False)],
)
def test_sweep_that_the_platform_does_not_tell_is_unknown(
    folder: Path, scan: dict[str, Any], is_unknown: bool
) -> None:
    spec = load_platform(write(folder, {**GOOD, "scan": {**GOOD["scan"], **scan}})).scan
    assert spec.is_sweep_unknown is is_unknown
    assert (spec.sweep is None) is (scan != {"sweep": {}})


def test_a_file_that_leaves_the_sweep_to_the_robot_says_what_to_run(folder: Path) -> None:
    """Versions before measured it while the robot drove."""
    bad = {**GOOD, "scan": {**GOOD["scan"], "sweep": "measured"}}
    with pytest.raises(ConfigError, match=r"scan\.sweep is measured.*unknown.*swarmctl calibrate"):
        load_platform(write(folder, bad))


def test_bearings_may_be_given_one_by_one(folder: Path) -> None:
    data = with_value("scan.bearings_deg", [40, 0, -40, 190])
    del data["scan"]["rays"]
    bearings = load_platform(write(folder, data)).scan.bearings
    assert np.degrees(bearings) == pytest.approx([40.0, 0.0, -40.0, -170.0])
    data["scan"]["first_bearing_deg"] = 10.0
    bearings = load_platform(write(folder, data)).scan.bearings
    assert np.degrees(bearings) == pytest.approx([50.0, 10.0, -30.0, -160.0])


ROOT = Path(__file__).resolve().parents[2]
RING = {"bearings_deg": [60, 0, -60], "rate": 20.0, "range_min": 0.05, "range_max": 0.5}


def test_the_ring_of_the_documentation_loads_and_fits_its_topics(tmp_path: Path) -> None:
    text = (ROOT / "docs" / "configuration.md").read_text()
    (block,) = [one for one in re.findall(r"```yaml\n(.*?)```", text, re.S) if "\nranges:" in one]
    (tmp_path / "ring.yaml").write_text(block)
    platform, burger = load_platform("ring.yaml", tmp_path), load_platform("burger")
    assert platform.ranges is not None
    assert np.degrees(platform.ranges.bearings).tolist() == pytest.approx([60, 30, 0, -30, -60])
    assert (platform.ranges.latency, platform.ranges.is_noisy) == (0.025, False)
    assert platform.scan.range_max == burger.scan.range_max
    options = platform.drivers["ros2dds"]["ranges"]
    assert list(options.values()) == [60, 30, 0, -30, -60]  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("changes", "subject"),
    [
        ({"near": "lost"}, "ranges.near is lost"),
        ({"sweep": {"direction": "cw"}}, "ranges.sweep is given"),
        ({"rate": 1.0}, "ranges.rate is 1"),
        ({"range_max": 0.05}, "less than ranges.range_max"),
        ({"rays": 3}, "ranges.rays is 3 beside bearings_deg"),
        ({"colour": 1}, "ranges"),
    ],
)
def test_a_wrong_ring_is_refused_in_one_line(
    folder: Path, changes: dict[str, Any], subject: str
) -> None:
    data = {"extends": "burger", "ranges": {**RING, **changes}}
    with pytest.raises(ConfigError, match=re.escape(subject)) as caught:
        load_platform(write(folder, data))
    assert "\n" not in str(caught.value)


def test_a_variant_may_leave_the_ring_out(folder: Path) -> None:
    write(folder, {"extends": "burger", "ranges": RING}, "ring.yaml")
    assert load_platform(write(folder, {"extends": "ring.yaml", "ranges": None})).ranges is None


def test_a_platform_without_a_ring_cannot_provide_its_ranges(folder: Path) -> None:
    data = {"extends": "burger", "provides": ["scan", "ranges", "odometry"]}
    with pytest.raises(ConfigError, match=r"provides names ranges"):
        load_platform(write(folder, data))
    assert "ranges" in load_platform(write(folder, {**data, "ranges": RING})).provides


def test_a_wide_beam_needs_an_unseen_extent_that_covers_it(folder: Path) -> None:
    data: dict[str, Any] = {"extends": "crazyflie", "protection": {"barrier": {}}}
    barrier = data["protection"]["barrier"]
    barrier["unseen_extent"] = 0.05
    with pytest.raises(
        ConfigError, match=r"unseen_extent is 0\.05; expected at least 0\.1\d"
    ) as told:
        load_platform(write(folder, data))
    assert "scan.cone_deg 27" in str(told.value)
    least = float(re.findall(r"at least (0\.\d+)", str(told.value))[0])
    barrier["unseen_extent"] = least - 0.01
    with pytest.raises(ConfigError, match="cone_deg"):
        load_platform(write(folder, data))
    barrier["unseen_extent"] = least
    load_platform(write(folder, data))
