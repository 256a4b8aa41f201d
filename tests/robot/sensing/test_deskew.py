"""De-skew: a rolling scan of a moving robot becomes the scan of an instant."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from swarmd.core.values import Array, Odometry, Pose, Scan, ScanSpec, Sweep, Twist
from swarmd.robot.sensing.deskew import Deskewer, TimedRays
from swarmd.robot.sensing.odometry_history import OdometryHistory

N, PERIOD = 360, 0.2
BEARINGS = np.arange(N) * 2.0 * np.pi / N
BEARINGS.flags.writeable = False
HALF_X, HALF_Y = 1.5, 1.2  # m of the room


class Ride:
    """A robot at constant twist in a static room, with a lidar that turns."""

    def __init__(self, sweep: Sweep, twist: Twist, *, offset: float = -0.032) -> None:
        self.spec = ScanSpec(
            BEARINGS, 1.0 / PERIOD, 0.12, 3.5, offset=(offset, 0.0), latency=0.13, sweep=sweep
        )
        self.twist, self.history = twist, OdometryHistory()
        self.deskewer = Deskewer(self.spec, self.history)
        turned = (sweep.direction * (BEARINGS - sweep.start) + 1e-9) % math.tau
        self.ages = (turned.max() - turned) / math.tau * sweep.duration

    def pose(self, time: Array) -> tuple[Array, Array, Array]:
        yaw = self.twist.angular * time
        radius = self.twist.linear / self.twist.angular
        return radius * np.sin(yaw), radius * (1.0 - np.cos(yaw)), yaw

    def ranges(self, time: Array | float, bearings: Array) -> Array:
        """Exact ranges of rays, each at its own time."""
        x, y, yaw = self.pose(np.asarray(time, np.float64))
        x, y = x + self.spec.offset[0] * np.cos(yaw), y + self.spec.offset[0] * np.sin(yaw)
        cos, sin = np.cos(yaw + bearings), np.sin(yaw + bearings)
        ways = (np.copysign(HALF_X, cos) - x) / cos, (np.copysign(HALF_Y, sin) - y) / sin
        return np.minimum(*ways)

    def odometry(self, time: float) -> Odometry:
        x, y, yaw = (float(value) for value in self.pose(np.asarray(time)))
        return Odometry(time, Pose(x, y, math.remainder(yaw, math.tau)), self.twist)

    def scan(self, seq: int, ages: Array | None = None) -> tuple[Scan, float]:
        """The de-skewed scan, and the time of its newest ray."""
        newest, arrival = PERIOD * seq, PERIOD * seq + 0.13 - float(self.ages.mean())
        last = math.floor(arrival / 0.02) * 0.02
        for k in range(12, -1, -1):
            if not last - 0.02 * k <= self.history.latest + 1e-6:
                self.history.take(self.odometry(last - 0.02 * k), arrival)
        ranges = self.ranges(newest - self.ages, BEARINGS)
        raw = Scan(seq, newest, ranges, BEARINGS, 0.12, 3.5, ages, self.spec.latency)
        return self.deskewer.deskew(raw, arrival, arrival - last), newest


SWEEPS = st.builds(
    Sweep,
    start=st.floats(-math.pi, math.pi),
    direction=st.sampled_from((1.0, -1.0)),
    duration=st.just(PERIOD),
)
RATES = st.one_of(st.floats(0.1, 2.8), st.floats(-2.8, -0.1))


@given(sweep=SWEEPS, linear=st.floats(-0.3, 0.3), angular=RATES)
def test_a_static_room_is_seen_as_at_the_time_of_the_newest_ray(
    sweep: Sweep, linear: float, angular: float
) -> None:
    ride = Ride(sweep, Twist(linear, angular))
    for seq in range(1, 4):  # nothing fills the first, and it fills the second
        scan, newest = ride.scan(seq)
    truth = ride.ranges(newest, scan.bearings)
    # Interpolation between readings 20 ms apart follows the chords of an arc of 2.8 rad/s.
    np.testing.assert_allclose(scan.ranges, truth, atol=2e-3)
    rising = np.sort(scan.bearings)
    widest = np.diff(rising, append=rising[0] + math.tau).max()
    assert widest < 3.0 * math.tau / N  # no sector is left unmeasured
    assert scan.ages is not None
    assert len(scan.ages) == len(scan.ranges) == len(scan.bearings)
    assert scan.newest_age == pytest.approx(0.13 - ride.ages.mean())


def test_a_turn_against_the_sensor_is_filled_from_the_scan_before() -> None:
    against, along = (Ride(Sweep(0.0, 1.0, PERIOD), Twist(0.1, rate)) for rate in (-2.0, 2.0))
    for seq in range(1, 4):
        (filled, _), (twice, _) = against.scan(seq), along.scan(seq)
    assert filled.ages is not None
    assert len(filled.ranges) - N == pytest.approx(2.0 * PERIOD / math.tau * N, abs=3.0)
    assert (filled.borrowed, twice.borrowed) == (len(filled.ranges) - N, 0)
    assert filled.filled is None
    assert filled.ages.max() > PERIOD
    assert len(twice.ranges) == N


def test_at_rest_and_without_odometry_the_rays_stay() -> None:
    ride = Ride(Sweep(0.0, 1.0, PERIOD), Twist(0.1, 2.0))
    raw = Scan(1, 0.2, np.full(N, 1.0), BEARINGS, 0.12, 3.5, None, 0.13)
    without = ride.deskewer.deskew(raw, 1.0, None)
    for k in range(40):
        ride.history.take(Odometry(0.02 * k, Pose(1.0, 2.0, 3.0), Twist()), 1.0)
    at_rest = ride.deskewer.deskew(raw, 1.0, 0.01)
    for scan in (without, at_rest):
        assert scan.bearings is BEARINGS
        assert scan.ranges is raw.ranges
        assert scan.ages is not None
        np.testing.assert_allclose(scan.ages, ride.ages, atol=1e-9)


def test_ages_of_the_driver_count_more_than_the_sweep_of_the_platform() -> None:
    ride = Ride(Sweep(0.0, 1.0, PERIOD), Twist(0.1, 2.0))
    ride.scan(1)
    scan, _ = ride.scan(2, np.zeros(N))
    assert scan.bearings is BEARINGS
    assert scan.newest_age == 0.13


def test_a_clock_that_stands_ends_no_history() -> None:
    """The clock of a simulator may stand for two readings: only the first of a time counts."""
    ride = Ride(Sweep(0.0, 1.0, PERIOD), Twist(0.2, 1.0))
    raw = Scan(1, 0.2, np.full(N, 1.0), BEARINGS, 0.12, 3.5, None, 0.13)
    moves = []
    for tick in range(20):
        reading = Odometry(0.1 * (tick // 2), Pose(0.01 * tick, 0.0, 0.05 * tick), ride.twist)
        assert ride.history.take(reading, 0.05 * tick) is (tick % 2 == 0)
        moves.append(ride.deskewer.deskew(raw, 0.05 * tick, 0.0).bearings is not BEARINGS)
    assert all(moves[8:])


def test_a_pose_that_jumps_ends_the_history() -> None:
    """The scan moves again once the readings after the jump reach back over all of it."""
    ride = Ride(Sweep(0.0, 1.0, PERIOD), Twist(0.2, 1.0))
    raw = Scan(1, 0.2, np.full(N, 1.0), BEARINGS, 0.12, 3.5, None, 0.13)
    moves = []
    for tick in range(20):
        x = 0.01 * tick + (5.0 if tick >= 8 else 0.0)
        reading = Odometry(0.05 * tick, Pose(x, 0.0, 0.05 * tick), ride.twist)
        ride.history.take(reading, 0.05 * tick)
        moves.append(ride.deskewer.deskew(raw, 0.05 * tick, 0.0).bearings is not BEARINGS)
    assert moves == [2 <= tick < 8 or tick >= 10 for tick in range(20)]


@pytest.mark.parametrize(
    ("bearings", "spacing"),
    [
        ([0.0], math.tau),
        ([0.5, 0.0], 0.5),
        ([1.0, 0.0, 0.25], 0.5),  # steps of 0.25 and 0.75
        ([0.0, 0.125, 0.375, 1.375], 0.25),  # steps of 0.125, 0.25 and 1
    ],
)
def test_rays_are_spaced_by_the_median_of_their_steps(
    bearings: list[float], spacing: float
) -> None:
    assert TimedRays(np.array(bearings), np.zeros(len(bearings)), None).spacing == spacing
