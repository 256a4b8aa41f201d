"""ROS messages as the core's values: which pass unchanged, are turned, or are refused."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from swarmd.core.errors import CodecError
from swarmd.core.values import Scan, Sweep, Twist
from swarmd.drivers.ros import cdr, messages
from swarmd.drivers.ros import from_ros as conversion
from tests.drivers.ros2 import robots
from tests.support import ros2_types as dds

SPEC = robots.PLATFORM.scan


def read(kind: Any, message: Any) -> Any:
    return cdr.decode(kind, message.serialize())


def swept(message: dds.LaserScan, yaw: float = 0.0) -> Scan:
    return conversion.scan_of(read(messages.LaserScan, message), 7, SPEC, yaw)


def test_ranges_pass_as_the_sensor_gave_them() -> None:
    given = [0.0, 0.05, 1.25, math.inf, -math.inf, math.nan, 100.0]
    scan = swept(robots.scan(12.25, given))
    np.testing.assert_array_equal(scan.ranges, np.array(given, dtype=np.float32))
    assert (scan.seq, scan.stamp) == (7, 12.25)
    assert scan.ranges.dtype == scan.bearings.dtype == np.float64
    assert (scan.range_min, scan.range_max) == (SPEC.range_min, SPEC.range_max)


@pytest.mark.parametrize("hangs", [False, True])
@pytest.mark.parametrize(
    ("first", "step", "yaw"),
    [
        (0.0, 0.5, 0.0),
        (math.pi - 0.75, 0.5, 0.0),
        (1.0, -0.5, 0.0),
        (0.0, 0.5, math.pi / 2.0),
        (-math.pi, 0.5, math.pi / 2.0),
        (0.0, 0.5, -math.pi / 2.0),
    ],
)
def test_bearings_are_those_of_the_base(first: float, step: float, yaw: float, hangs: bool) -> None:
    message = robots.scan(1.0, [1.0] * 4, angle_min=first, angle_increment=step)
    decoded = read(messages.LaserScan, message)
    scan = conversion.scan_of(decoded, 7, SPEC, yaw, is_upside_down=hangs)
    # A base transforms such a frame by a roll of half a turn and then the yaw.
    angles = first + step * np.arange(4)
    x, y = np.cos(angles), np.sin(angles) * (-1.0 if hangs else 1.0)
    turned = np.arctan2(
        math.sin(yaw) * x + math.cos(yaw) * y, math.cos(yaw) * x - math.sin(yaw) * y
    )
    np.testing.assert_allclose(np.exp(1j * scan.bearings), np.exp(1j * turned), atol=1e-5)
    assert np.abs(scan.bearings).max() <= math.pi


def test_scans_alike_share_their_bearings() -> None:
    assert swept(robots.scan(1.0)).bearings is swept(robots.scan(2.0)).bearings


@pytest.mark.parametrize(
    "angles",
    [
        {"angle_min": math.nan},
        {"angle_min": math.inf},
        {"angle_increment": math.nan},
        {"angle_increment": 1.0},
        {"angle_min": 1e30},
    ],
)
def test_angles_that_are_none_are_refused(angles: dict[str, float]) -> None:
    with pytest.raises(CodecError, match="one turn at most"):
        swept(robots.scan(1.0, [1.0] * 360, **angles))


def test_too_many_rays_are_refused() -> None:
    message = robots.scan(1.0, [1.0] * 20_001, angle_increment=1e-4)
    with pytest.raises(CodecError, match="at most 20000"):
        swept(message)


def test_an_empty_scan_passes_for_the_core_to_refuse() -> None:
    assert len(swept(robots.scan(1.0, [])).ranges) == 0


def test_odometry_has_pose_yaw_and_twist_of_the_base() -> None:
    message = read(messages.Odometry, robots.odometry(3.5, x=1.5, yaw=-2.0, speed=0.2))
    odometry = conversion.odometry_of(message)
    assert odometry.stamp == 3.5
    assert odometry.pose.x == 1.5
    assert odometry.pose.yaw == pytest.approx(-2.0)
    assert odometry.twist == Twist(0.2, 0.3, 0.02)


@pytest.mark.parametrize("yaw", [-3.0, -0.1, 0.0, 1.0, 3.1])
def test_a_leaning_base_has_a_yaw(yaw: float) -> None:
    roll = 0.2
    cr, sr, cy, sy = math.cos(roll / 2), math.sin(roll / 2), math.cos(yaw / 2), math.sin(yaw / 2)
    leaning = messages.Quaternion(x=sr * cy, y=sr * sy, z=cr * sy, w=cr * cy)
    assert conversion.yaw_of(leaning) == pytest.approx(yaw)


@pytest.mark.parametrize("x", [math.nan, math.inf])
def test_odometry_that_is_not_finite_is_refused(x: float) -> None:
    with pytest.raises(CodecError, match="pose x"):
        conversion.odometry_of(read(messages.Odometry, robots.odometry(1.0, x=x)))


def test_an_orientation_that_is_none_is_refused() -> None:
    with pytest.raises(CodecError, match="unit quaternion"):
        conversion.yaw_of(messages.Quaternion(x=0.0, y=0.0, z=0.0, w=0.0))


def test_imu_gives_yaw_unless_it_has_no_orientation() -> None:
    message = dds.Imu(orientation=dds.Quaternion(z=math.sin(0.25), w=math.cos(0.25)))
    assert conversion.imu_readings(read(messages.Imu, message)) == {"yaw": pytest.approx(0.5)}
    message.orientation_covariance[0] = -1.0
    assert conversion.imu_readings(read(messages.Imu, message)) == {}


PACK = (11.0, 12.6)


@pytest.mark.parametrize(
    ("voltage", "percentage", "wanted"),
    [
        (12.6, 1.135, 1.0), (12.0, 1.081, 0.625), (11.0, 0.99, 0.0), (10.8, 0.97, 0.0),
        (12.7, math.nan, 1.0), (11.8, 0.0, 0.5),
    ],
)  # fmt: skip
def test_a_battery_follows_the_voltage_of_its_pack(
    voltage: float, percentage: float, wanted: float
) -> None:
    """The firmware of a TurtleBot3 with ROS 1 sends voltage / 11.1 as percentage."""
    message = dds.BatteryState(voltage=voltage, percentage=percentage)
    values = conversion.battery_readings(read(messages.BatteryState, message), PACK, "share")
    assert values["battery"] == pytest.approx(wanted, abs=1e-6)


@pytest.mark.parametrize(
    ("stated", "percentage", "wanted"),
    [
        ("share", 0.75, 0.75), ("share", 1.0, 1.0), ("percent", 75.0, 0.75),
        ("percent", 0.75, 0.0075), ("percent", 116.7, 1.0),
    ],
)  # fmt: skip
def test_a_percentage_is_what_the_platform_says(
    stated: str, percentage: float, wanted: float
) -> None:
    message = read(messages.BatteryState, dds.BatteryState(voltage=11.5, percentage=percentage))
    values = conversion.battery_readings(message, None, stated)
    assert values == {"battery": pytest.approx(wanted), "battery_voltage": pytest.approx(11.5)}


@pytest.mark.parametrize(
    ("stated", "percentage", "word"),
    [
        (None, 0.75, "battery_percentage"), (None, 75.0, "battery_volts"), ("share", 75.0, "75"),
        ("percent", math.nan, "not measured"), ("share", -1.0, "-1"),
    ],
)  # fmt: skip
def test_a_percentage_is_never_guessed(stated: str | None, percentage: float, word: str) -> None:
    message = read(messages.BatteryState, dds.BatteryState(voltage=11.5, percentage=percentage))
    assert conversion.battery_readings(message, None, stated) == {"battery_voltage": 11.5}
    assert word in conversion.no_battery(message, None, stated)


@pytest.mark.parametrize("pack", [None, PACK])
def test_what_a_battery_does_not_measure_is_left_out(pack: tuple[float, float] | None) -> None:
    for unknown in (math.nan, math.inf, -1.0):
        message = dds.BatteryState(voltage=unknown, percentage=unknown)
        found = conversion.battery_readings(read(messages.BatteryState, message), pack, "share")
        assert found == {}


def test_commands_are_those_of_the_second_library() -> None:
    twist = Twist(0.1, -0.2, 0.05)
    wanted = dds.Twist(dds.Vector3(0.1, 0.05, 0.0), dds.Vector3(0.0, 0.0, -0.2))
    assert cdr.encode(conversion.command_message(twist, messages.Twist, "x")) == wanted.serialize()
    stamped = dds.TwistStamped(dds.stamped(0.0, "base_link"), wanted)
    assert (
        cdr.encode(conversion.command_message(twist, messages.TwistStamped, "base_link"))
        == stamped.serialize()
    )
    assert conversion.twist_of(conversion.twist_message(twist)) == twist


class TestRangeRingDecoder:
    bearings = tuple(np.radians([-40.0, -20.0, 0.0, 20.0, 40.0, 150.0, -150.0]))

    def ring(self, distance: float = 0.0) -> conversion.RangeRingDecoder:
        return conversion.RangeRingDecoder(self.bearings, [distance] * 7, SPEC)

    def value(self, stamp: float, metres: float) -> messages.Range:
        message = dds.Range(header=dds.stamped(stamp), range=metres)
        value: messages.Range = read(messages.Range, message)
        return value

    def test_each_round_of_seven_sensors_is_one_scan(self) -> None:
        ring = self.ring()
        given = [
            ring.take(i % 7, self.value(1.0 + 0.01 * i, 0.1 + 0.1 * (i % 7))) for i in range(21)
        ]
        assert [i for i, scan in enumerate(given) if scan] == [6, 13, 20]
        made = [scan for scan in given if scan]
        assert [scan.seq for scan in made] == [1, 2, 3]
        assert [scan.stamp for scan in made] == pytest.approx([1.06, 1.13, 1.20])
        for scan in made:
            np.testing.assert_allclose(scan.ranges, 0.1 + 0.1 * np.arange(7), rtol=1e-6)
            np.testing.assert_allclose(scan.bearings, self.bearings)

    def test_a_silent_sensor_is_unknown(self) -> None:
        ring = self.ring()
        for i in range(6):
            assert ring.take(i, self.value(1.0, 0.2)) is None
        scan = ring.take(0, self.value(1.1, 0.3))
        assert scan is not None
        assert np.isnan(scan.ranges[6])
        np.testing.assert_allclose(scan.ranges[:6], 0.2, rtol=1e-6)

    def test_the_distance_from_the_origin_is_added_to_measured_ranges_only(self) -> None:
        ring = self.ring(0.08)
        given = [0.1, 0.0, math.inf, -math.inf, math.nan, 0.2, 0.3]
        scan = None
        for i, metres in enumerate(given):
            scan = ring.take(i, self.value(1.0, metres))
        assert scan is not None
        wanted = [0.18, 0.0, math.inf, -math.inf, math.nan, 0.28, 0.38]
        np.testing.assert_allclose(scan.ranges, wanted, rtol=1e-6)

    def test_a_sensor_with_a_constant_stamp_is_unknown(self) -> None:
        ring = self.ring()
        scans = []
        for count in range(6):
            for i in range(7):
                stamp = 1.0 if i == 2 else 1.0 + 0.1 * count
                scans.append(ring.take(i, self.value(stamp, 0.2)))
        made = [scan for scan in scans if scan is not None]
        assert len(made) > 3
        assert not np.isnan(made[0].ranges).any()
        assert all(np.flatnonzero(np.isnan(scan.ranges)).tolist() == [2] for scan in made[1:])

    def test_sensors_that_restart_are_received_again(self) -> None:
        ring = self.ring()
        scans = [ring.take(i % 7, self.value(9.0 - i // 7, 0.2)) for i in range(21)]
        assert len([scan for scan in scans if scan is not None]) == 3


@pytest.mark.parametrize("field", ["linear", "angular"])
def test_a_twist_that_is_not_finite_is_refused(field: str) -> None:
    message = robots.odometry(1.0)
    setattr(message.twist.twist, field, dds.Vector3(math.nan, 0.0, math.inf))
    with pytest.raises(CodecError, match=r"speed ahead|turn rate"):
        conversion.odometry_of(read(messages.Odometry, message))


TURN, DEGREE = math.tau, math.radians(1.0)


@pytest.mark.parametrize(
    ("count", "first", "step", "last", "words"),
    [
        (360, 0.0, TURN / 360, TURN, ""),  # hls_lfcd_lds_driver: one increment more
        (360, -math.pi, TURN / 359, math.pi, ""),
        (360, math.pi, -TURN / 360, -math.pi, ""),
        (541, -2.356194, 0.00872665, 2.356194, ""),
        (360, 0.0, 0.0175, 6.2657, ""),  # rounded
        (1, 0.3, 0.0, 0.3, ""),
        (0, 0.0, 0.0, 1.0, ""),
        (360, 0.0, DEGREE, 0.0, ""),  # not given
        (2, 0.0, 0.1, 0.1, ""),
        (360, 0.0, -DEGREE, TURN, "mirror"),
        (360, 0.0, DEGREE, -TURN, "mirror"),
        (180, -1.57, -DEGREE, 1.57, "mirror"),
        (2, 0.0, -0.1, 0.1, "mirror"),
        (360, 0.0, DEGREE, math.pi, "angle_max is 3.142 rad"),
        (180, 0.0, DEGREE, TURN, "end at 3.124 rad"),
        (360, 0.0, DEGREE, math.nan, "angle_max is nan rad"),
    ],
)
def test_a_header_that_contradicts_its_rays_is_named_with_both_figures(
    count: int, first: float, step: float, last: float, words: str
) -> None:
    angles = {"angle_min": first, "angle_increment": step, "angle_max": last}
    message = read(messages.LaserScan, robots.scan(1.0, [1.0] * count, **angles))
    fault = conversion.header_fault(message)
    assert bool(fault) is bool(words)
    assert words in fault
    if fault:
        assert f"angle_max is {last:.4g} rad" in fault
        assert f"end at {first + step * (count - 1):.4g} rad" in fault


WITHOUT_SWEEP = replace(SPEC, rate=5.0, sweep=None, is_sweep_unknown=True)
SWEEP = Sweep(start=0.0, direction=-1.0, duration=0.2)
STEP = 0.05  # s, of four rays in 0.2 s


def laser(step: float, angle_increment: float = 1.5) -> Any:
    given = robots.scan(1.0, [1.0] * 4, time_increment=step, angle_increment=angle_increment)
    return read(messages.LaserScan, given)


@pytest.mark.parametrize(
    ("step", "ages"),
    [
        (STEP, [0.15, 0.10, 0.05, 0.0]),
        (-STEP, [0.0, 0.05, 0.10, 0.15]),
        (0.0, None),
        (math.nan, None),
        (math.inf, None),
        (0.1, None),  # 0.4 s at 5 Hz
    ],
)
def test_time_increment_gives_the_ages_of_the_rays(step: float, ages: list[float] | None) -> None:
    scan = conversion.scan_of(laser(step), 7, WITHOUT_SWEEP)
    if ages is None:
        assert scan.ages is None
    else:
        assert scan.ages is not None
        np.testing.assert_allclose(scan.ages, ages, atol=1e-6)
        assert conversion.scan_of(laser(step), 8, WITHOUT_SWEEP).ages is scan.ages


def test_the_sweep_of_the_platform_counts_more_than_time_increment() -> None:
    for sweep in SWEEP, None:
        spec = replace(WITHOUT_SWEEP, sweep=sweep, is_sweep_unknown=False)
        assert conversion.scan_of(laser(STEP), 7, spec).ages is None


@pytest.mark.parametrize(
    ("step", "increment", "sweep", "is_well", "text"),
    [
        (STEP, -1.5, SWEEP, True, "0.2 s, clockwise, as time_increment says"),
        (STEP, 1.5, SWEEP, True, "and counts; time_increment says 0.2 s a scan, counter-clockwise"),
        (-STEP, -1.5, SWEEP, True, "counts; time_increment says 0.2 s a scan, counter-clockwise"),
        (STEP / 18, -1.5, SWEEP, True, "and counts; time_increment says 0.0111 s a scan"),
        (0.0, 1.5, SWEEP, True, "time_increment is 0"),
        (STEP, 1.5, None, True, "all rays count as of one instant; time_increment says 0.2 s"),
        (0.0, 1.5, None, True, "all rays count as of one instant; time_increment is 0"),
        (7.0, 1.5, None, False, "of 7 s is impossible at 5 Hz"),
    ],
)
def test_check_compares_time_increment_with_the_sweep_of_the_platform(
    step: float, increment: float, sweep: Sweep | None, is_well: bool, text: str
) -> None:
    spec = replace(WITHOUT_SWEEP, sweep=sweep, is_sweep_unknown=False)
    finding = conversion.sweep_finding(laser(step, increment), spec, is_upside_down=False)
    assert finding.is_well is is_well
    assert text in finding.text


@pytest.mark.parametrize("step", [STEP, -STEP])
def test_an_upside_down_lidar_turns_the_other_way(step: float) -> None:
    upright, upside_down = (
        conversion.sweep_finding(laser(step), WITHOUT_SWEEP, is_upside_down=is_upside_down).text
        for is_upside_down in (False, True)
    )
    assert (", clockwise" in upright) != (", clockwise" in upside_down)


@pytest.mark.parametrize(("step", "is_well"), [(STEP, True), (0.0, True), (7.0, False)])
def test_check_calls_the_direction_not_known_without_a_sweep_of_the_platform(
    step: float, is_well: bool
) -> None:
    finding = conversion.sweep_finding(laser(step), WITHOUT_SWEEP, is_upside_down=False)
    assert (finding.is_well, finding.is_measured) == (is_well, False)
    assert "not known" in finding.text
