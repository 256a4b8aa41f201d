"""What driver `ros1` says of what the master tells: pure, needs no ROS."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from msgspec.structs import replace

from swarmd.core.values import Scan, Value
from swarmd.drivers.ros1 import wire
from swarmd.drivers.ros1.adapter import Link, State
from swarmd.drivers.ros1.options import read_options
from swarmd.drivers.ros1.view import SILENCE, View
from swarmd.settings.platforms import load_platform

WELL = State(
    master=True,
    publishers={"/scan": ["/lidar"], "/odom": ["/base"]},
    types={"/scan": wire.LASER_SCAN.name, "/odom": wire.ODOMETRY.name},
    listeners=["/base"],
    connected=1,
)


def view(state: State | None = WELL, *, heard: bool = True, **options: Value) -> View:
    made = View(read_options(options, "r"), load_platform("burger"))
    made.state = state
    if heard:
        for stamp in (1.0, 2.0):
            for sense in made.senses.values():
                sense.hear(stamp, "", 10.0 + 0.2 * stamp)
    return made


def test_nothing_is_missing_where_all_is_there() -> None:
    assert view().missing(10.4) == ""
    assert all(finding.is_well for finding in view().findings(10.4))


def test_a_sense_is_lost_once_it_has_been_silent_for_too_long() -> None:
    assert view().missing(10.4 + SILENCE) == ""
    assert "/lidar publishes /scan, but nothing comes" in view().missing(10.5 + SILENCE)


@pytest.mark.parametrize(
    ("state", "said"),
    [
        (State(master=False, text="refused"), "(refused); start roscore"),
        (replace(WELL, others=["/teleop"]), "/cmd_vel is also published by /teleop; end that node"),
        (replace(WELL, listeners=[], connected=0), "nobody listens on /cmd_vel"),
        (
            replace(WELL, connected=0, wants={"/base": wire.TWIST_STAMPED.name}),
            "/base wants geometry_msgs/TwistStamped on /cmd_vel, not geometry_msgs/Twist",
        ),
    ],
)
def test_what_is_missing_is_named_with_the_next_step(state: State, said: str) -> None:
    assert said in view(state).missing(10.4)
    assert any(said in finding.text for finding in view(state).findings(10.4))


def test_a_base_that_does_not_connect_is_named_though_a_check_cannot_know() -> None:
    made = view(replace(WELL, connected=0))  # who only looks offers nothing to connect to
    assert "does not connect to this machine; look at ROS_IP" in made.missing(10.4)
    assert all(finding.is_well for finding in made.findings(10.4))


@pytest.mark.parametrize(
    ("state", "said"),
    [
        (replace(WELL, publishers={}), "nobody publishes /scan; start the robot's nodes"),
        (
            replace(WELL, types={"/scan": "sensor_msgs/PointCloud"}),
            "/lidar publishes sensor_msgs/PointCloud on /scan; wanted is sensor_msgs/LaserScan",
        ),
        (
            replace(WELL, publishers={}, candidates={wire.LASER_SCAN.name: ["/a/scan", "/b"]}),
            "(sensor_msgs/LaserScan is on /a/scan, /b)",
        ),
    ],
)
def test_a_sense_that_was_never_heard_is_explained(state: State, said: str) -> None:
    assert said in view(state, heard=False).missing(10.4)


def test_another_sum_of_the_same_name_is_another_type() -> None:
    made = view(heard=False)
    made.on_link(Link(0, "/scan", "/lidar", wire.LASER_SCAN.name, "0" * 32))
    assert made.links == {0: None}
    assert f"(md5 {'0' * 32}) on /scan; wanted is" in made.missing(10.0)
    made.on_link(Link(1, "/scan", "/lidar", wire.LASER_SCAN.name, wire.LASER_SCAN.md5sum))
    assert made.links[1] is made.senses["/scan"]


def test_someone_else_is_borne_where_that_is_permitted_but_said() -> None:
    made = view(replace(WELL, others=["/teleop"]), shared_cmd_vel=True)
    assert made.missing(10.4) == ""
    assert any("/teleop, as permitted" in finding.text for finding in made.findings(10.4))


def test_stamps_that_stand_still_and_slow_scans_are_found() -> None:
    made = view(heard=False)
    for now in (10.0, 12.0):
        made.senses["/odom"].hear(5.0, "", now)
        made.senses["/scan"].hear(now, "", now)
    found = {finding.subject: finding for finding in made.findings(12.0)}
    assert not found["odometry"].is_well
    assert "stamps stand still" in found["odometry"].text
    assert not found["scan"].is_well
    assert "0.5 Hz; scan.rate of the platform is 5, so" in found["scan"].text
    assert math.isclose(made.senses["/scan"].period, 2.0)


@pytest.mark.parametrize(("rate", "wanted"), [(10.0, 0.2), (5.0, 0.4), (1.0, 1.0)])
def test_the_slowest_period_is_twice_the_nominal_one_unless_scans_would_be_stale(
    rate: float, wanted: float
) -> None:
    assert dataclasses.replace(load_platform("burger").scan, rate=rate).slowest_period == wanted


@pytest.mark.parametrize(("period", "is_well"), [(0.38, True), (0.42, False)])
def test_scans_at_less_than_half_the_rate_of_the_platform_are_too_slow(
    period: float, is_well: bool
) -> None:
    made = view(heard=False)
    for now in (10.0, 10.0 + period, 10.0 + 2.0 * period):
        made.senses["/scan"].hear(now, "", now)
    found = {finding.subject: finding for finding in made.findings(10.0 + 2.0 * period)}
    assert found["scan"].is_well is is_well


def test_what_is_not_needed_and_not_heard_is_no_fault_but_said() -> None:
    made = view(battery="battery_state", heard=False)
    for name in ("/scan", "/odom"):
        made.senses[name].hear(1.0, "", 10.0)
    found = {finding.subject: finding for finding in made.findings(10.4)}
    assert found["battery"].is_well
    assert "not needed to drive: nobody publishes /battery_state" in found["battery"].text
    made.senses["/battery_state"].hear(1.0, "", 10.0)
    assert not next(f for f in made.findings(20.0) if f.subject == "battery").is_well


def test_what_cannot_be_read_is_named_with_the_next_step() -> None:
    made = view(heard=False)
    made.senses["/scan"].fault = "sensor_msgs/LaserScan: 12 bytes, its lengths say 1002"
    said = "its lengths say 1002; look at that node, or correct namespace or scan"
    assert said in made.missing(10.0)
    assert any(said in finding.text for finding in made.findings(10.0))


def test_a_check_tells_how_the_clocks_went_on() -> None:
    found = {finding.subject: finding.text for finding in view().findings(10.4)}
    assert found["scan"] == (
        "/scan (sensor_msgs/LaserScan) from /lidar: 5 Hz, stamps went on 1.0 s in 0.2 s"
    )


def test_a_check_finds_a_sweep_that_leaves_too_much_unseen() -> None:
    made = view()
    spec = made.platform.scan
    for unseen, is_well in ((0, True), (30, False), (360, False)):
        ranges = np.full(360, 1.0)
        ranges[:unseen] = np.nan
        scan = Scan(1, 1.0, ranges, spec.bearings, spec.range_min, spec.range_max)
        made.senses["/scan"].scan = scan
        found = {finding.subject: finding for finding in made.findings(10.4)}
        assert found["scan"].is_well is is_well
        assert is_well or "look at the sensor, or correct the platform" in found["scan"].text
