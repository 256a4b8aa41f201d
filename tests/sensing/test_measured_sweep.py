"""In which order a lidar measures its rays: measured while the robot turns."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from msgspec import structs

from swarmd.core.codec import encode
from swarmd.core.values import Array, Scan, ScanSpec
from swarmd.sensing.measured_sweep import AT_ONCE, MeasuredSweep, Order
from swarmd.sensing.scan_pipeline import Deskewer, OdometryHistory, ScanDelay
from tests.support.kernel_forms import long_run
from tests.support.turning_lidar import Lidar, Room, TurningLidar, swinging, wandering

REVERSED = Lidar(Order(-1.0, 0.2), claim=0.2)  # a driver that reverses the rays of rplidar
ERROR = 0.02  # rad of a bearing, once the order is known
SECONDS = 40.0


def turning(lidar: Lidar, seed: int = 1, seconds: float = SECONDS) -> TurningLidar:
    """A robot that swings by up to 1.2 rad/s to both sides, in a room without neighbours."""
    rng = np.random.default_rng(seed)
    return TurningLidar(lidar, swinging(1.2, 5.0, seconds), rng, Room(rng, most_neighbors=0))


def known_after(run: TurningLidar) -> Order | None:
    """Run to the end, or until the order is known."""
    while run.next_scan() and run.order is None:
        pass
    return run.order


def assert_is(order: Order | None, true: Order) -> None:
    assert order is not None
    assert (order.direction, order.start) == (true.direction, 0.0)
    assert order.duration == pytest.approx(true.duration, rel=0.25)


@pytest.mark.parametrize("claim", [0.2, 0.2 / 18.0, 0.0])
@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_returns_of_a_turning_robot_are_where_they_are_once_the_order_is_known(
    direction: float, claim: float
) -> None:
    """Errors were 0.08 to 0.19 rad with the order that time_increment tells."""
    run = turning(replace(REVERSED, order=Order(direction, 0.2), claim=claim))
    before = []
    while run.order is None:
        assert run.next_scan(), "the order is not known"
        if run.order is None:
            before.append(run.error)
            assert run.seen.bearings is run.raw.bearings  # nothing is moved
    after = [run.error, *(run.error for _ in range(50) if run.next_scan())]
    assert_is(run.order, run.lidar.order)
    assert encode(run.delays.summary(run.time))  # no numpy number in a status
    assert 0.08 < max(before) < 0.5 * 1.2 * 0.2 + ERROR  # half of the turn during the scan
    assert max(after) < ERROR


@pytest.mark.short_rows(3)
@long_run
@pytest.mark.parametrize("seed", range(16))
def test_random_lidars_on_random_ways_are_never_deskewed_in_another_order(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rate, direction = float(rng.choice((5.0, 10.0))), float(rng.choice((1.0, -1.0, 0.0)))
    duration = float(rng.uniform(0.9, 1.0)) / rate if direction else 0.0
    lidar = Lidar(
        Order(direction, duration),
        rate,
        rays=int(rng.choice((360, 720))),
        claim=float(rng.choice((0.0, duration, duration / 18.0, 1.0 / rate))),
        step=float(rng.choice((1.0, -1.0))),
        first=float(rng.uniform(-3.0, 3.0)),
        noise=float(rng.choice((0.005, 0.02))),
        dropouts=float(rng.choice((0.0, 0.1))),
        delay=float(rng.choice((0.0, 0.05, 0.15))),
        jitter=float(rng.choice((0.0, 0.08))),
        scan_clock=float(rng.choice((0.0, 77.0))),
        odometry_scale=float(rng.uniform(0.95, 1.05)),
    )
    run = TurningLidar(lidar, wandering(rng, SECONDS), rng)
    while run.next_scan():
        ages = run.seen.ages
        assert ages is not None
        if run.order is None:
            assert run.seen.bearings is run.raw.bearings
            assert run.seen.ranges is run.raw.ranges
            assert ages.min() == ages.max() >= 0.5 * duration
        else:
            assert_is(run.order, lidar.order)


def test_each_ray_counts_as_old_as_the_oldest_while_the_order_is_not_known() -> None:
    """Latency and half a scan: what the oldest ray of a rotating lidar has on arrival."""
    run = turning(REVERSED)
    run.next_scan()
    assert run.seen.newest_age == run.spec.latency
    assert run.seen.ages is not None
    np.testing.assert_allclose(run.seen.ages, 0.1)
    faster = turning(replace(REVERSED, order=Order(-1.0, 0.2 / 18), claim=0.2 / 18))
    faster.next_scan()  # its driver may be wrong: a scan period counts
    assert faster.seen.ages is not None
    np.testing.assert_allclose(faster.seen.ages, 0.1)


@pytest.mark.parametrize("start", [0.1, 0.25, 0.5])
def test_order_that_begins_elsewhere_in_the_message_stays_unknown_and_is_named(
    start: float,
) -> None:
    run = turning(replace(REVERSED, order=Order(1.0, 0.2, start)))
    assert known_after(run) is None
    sweep = run.delays.summary(run.time).sweep
    assert sweep is not None
    assert sweep.direction == ""
    assert sweep.samples > 20
    assert sweep.text


def test_wheels_that_turn_in_the_air_tell_nothing() -> None:
    run = turning(replace(REVERSED, are_wheels_in_the_air=True))
    assert known_after(run) is None


def test_robot_that_turns_to_one_side_only_tells_nothing() -> None:
    run = turning(REVERSED)
    run.yaws = np.cumsum(np.abs(np.diff(run.yaws, append=0.0)))
    run.yaws[-1] = run.yaws[-2]
    assert known_after(run) is None


def test_scans_and_turns_that_stand_still_tell_nothing() -> None:
    run = TurningLidar(REVERSED, np.zeros(2000), np.random.default_rng(1))
    assert known_after(run) is None


def test_order_stays_known_when_clocks_are_set() -> None:
    run = turning(REVERSED)
    known = known_after(run)
    assert known is not None
    run.delays.on_scan(structs.replace(run.raw, stamp=run.raw.stamp - 1000.0), run.time)
    assert run.delays.restarts == 1
    assert run.order is known


def test_another_lidar_is_measured_anew() -> None:
    run = turning(REVERSED)
    assert known_after(run) is not None
    bearings = -run.raw.bearings
    run.delays.on_scan(structs.replace(run.raw, bearings=bearings), run.time)
    assert run.order is None


def test_sensor_that_varies_its_number_of_rays_stays_known() -> None:
    run = turning(REVERSED)
    known = known_after(run)
    step = math.tau / 355
    scan = structs.replace(
        run.raw,
        ranges=np.full(355, 1.0),
        bearings=run.raw.bearings[0] + step * np.arange(355),
        ages=Order(1.0, 0.2).ages(355),
    )
    run.delays.on_scan(scan, run.time)
    assert run.order is known is not None
    assert run.delays.sweep is not None
    assert len(run.delays.sweep.ages(scan)) == 355


def test_later_turns_end_an_order_that_they_contradict() -> None:
    """As when a lidar is mounted upside down while its driver runs."""
    run = turning(REVERSED, seconds=300.0)
    known = known_after(run)
    assert known is not None
    run._ages = Order(1.0, 0.2).ages(360)
    while run.order is known:
        assert run.next_scan()
    known_after(run)
    assert_is(run.order, Order(1.0, 0.2))


def test_measured_order_corrects_the_delay_by_stamps() -> None:
    """A stamp is the time of the oldest ray, half a scan before the mean one."""
    run = turning(replace(REVERSED, claim=0.0))
    while run.time < 3.0:
        run.next_scan()
    assert run.delays.added == pytest.approx(0.1, abs=0.02)
    assert known_after(run) is not None
    while run.next_scan():
        pass
    assert run.delays.added == 0.0


def flat(spec: ScanSpec, ages: Array | None, count: int) -> Scan:
    ranges = np.full(count, 1.0)
    return Scan(1, 0.0, ranges, spec.bearings[:count], spec.range_min, spec.range_max, ages)


def test_driver_that_says_at_once_is_believed() -> None:
    sweep = MeasuredSweep(REVERSED.spec())
    assert sweep.ages(flat(REVERSED.spec(), np.zeros(360), 360)).max() == 0.0
    assert sweep.order == AT_ONCE


@pytest.mark.parametrize("count", [0, 1, 7])
def test_few_rays_stay_unknown_and_count_as_a_period_old(count: int) -> None:
    spec = REVERSED.spec()
    sweep = MeasuredSweep(spec)
    np.testing.assert_allclose(sweep.ages(flat(spec, None, count)), np.full(count, 0.1))
    assert sweep.order is None
    assert "few rays" in sweep.figure().text


def test_platform_that_tells_its_sweep_measures_none() -> None:
    spec = REVERSED.spec(measures_sweep=False)
    assert ScanDelay(spec).sweep is None
    raw = flat(spec, None, 360)
    assert Deskewer(spec, OdometryHistory()).deskew(raw, 1.0, None) is raw
