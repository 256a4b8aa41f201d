"""Missing, frozen and invalid scans, and a lost driver, stop the robot with the right reason."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import pytest
from msgspec.structs import replace

from swarmd.core.clock import boottime
from swarmd.core.codec import encode
from swarmd.core.messages import Reason, ScanWire, State
from swarmd.core.values import Array, Platform, Scan, ScanSpec, Twist
from swarmd.testing.scans import trembling
from tests.support.fake_body import Body

if TYPE_CHECKING:
    from tests.faults.conftest import Bench

pytestmark = pytest.mark.integration

ScanSource = Callable[[ScanSpec, int, float], Scan | bytes | None]

SCAN_REASONS = frozenset(
    {Reason.NO_SCAN, Reason.STALE_SCAN, Reason.INVALID_SCAN, Reason.FROZEN_SCAN}
)


def scan_of(spec: ScanSpec, seq: int, stamp: float, ranges: Array) -> Scan:
    return Scan(seq, stamp, trembling(ranges, seq), spec.bearings, spec.range_min, spec.range_max)


def none(spec: ScanSpec, seq: int, stamp: float) -> None:
    return None


def frozen(spec: ScanSpec, seq: int, stamp: float) -> Scan:
    return scan_of(spec, 1, 0.05, np.full(len(spec.bearings), 3.0))


def of_different_length(spec: ScanSpec, seq: int, stamp: float) -> bytes:
    ranges = np.full(len(spec.bearings) - 7, 3.0)
    bearings = spec.bearings.astype("<f4").tobytes()
    return encode(ScanWire(seq, stamp, ranges.astype("<f4").tobytes(), bearings))


def garbage(spec: ScanSpec, seq: int, stamp: float) -> bytes:
    return bytes(range(seq % 200, seq % 200 + 50))


def changing_rays(spec: ScanSpec, seq: int, stamp: float) -> Scan:
    n = len(spec.bearings) - 10 + 5 * (seq % 5)
    bearings = np.linspace(0.0, 2.0 * math.pi, n, endpoint=False)
    return replace(scan_of(spec, seq, stamp, np.full(n, 3.0)), bearings=bearings)


def source_of(
    platform: Platform, source: ScanSource
) -> Callable[[int, float], Scan | bytes | None]:
    return lambda seq, stamp: source(platform.scan, seq, stamp)


@pytest.mark.parametrize(
    ("source", "reason"),
    [
        (none, Reason.STALE_SCAN),
        (frozen, Reason.FROZEN_SCAN),
        (of_different_length, Reason.INVALID_SCAN),
        (garbage, Reason.STALE_SCAN),
    ],
)
def test_bad_scans_stop_a_robot_and_good_scans_do_not_start_it(
    robot: Bench, source: ScanSource, reason: Reason
) -> None:
    moving = robot.drive()
    robot.body.scans = source_of(robot.body.platform, source)
    broken = boottime()

    held = robot.await_reason(reason, broken)
    zero = robot.body.wait_zero(held.at)
    stopped = robot.await_state(State.STOPPED, reason, held.at)
    print(f"zero after {zero.at - broken:.3f} s, stopped after {stopped.at - broken:.3f} s")
    assert held.status.state is State.RUNNING
    assert moving.at < held.at < stopped.at

    robot.body.scans = robot.body.clear
    robot.moves_not(zero.at)
    status = robot.status()
    assert (status.state, status.reason) == (State.STOPPED, reason)


def test_repeated_scans_of_a_noisy_sensor_are_frozen(robot: Bench) -> None:
    robot.drive()
    robot.body.odometry = Twist()
    first = robot.body.clear(1, 0.0)
    begun = boottime()
    robot.body.scans = lambda seq, stamp: replace(first, seq=seq, stamp=stamp)
    held = robot.await_reason(Reason.FROZEN_SCAN, begun)
    zero = robot.body.wait_zero(held.at)  # on a loaded machine another hold may come first
    print(f"zero {zero.at - begun:.3f} s after the first identical scan")
    stopped = robot.await_state(State.STOPPED, Reason.FROZEN_SCAN, held.at)
    assert held.status.state is State.RUNNING
    assert begun < held.at < stopped.at
    robot.body.scans = robot.body.clear
    robot.moves_not(zero.at)


def test_garbage_instead_of_scans_is_counted(robot: Bench) -> None:
    status = robot.status()
    instance, before = status.epoch.instance, status.health.dropped.get("driver/hw/scan", 0)
    robot.body.scans = source_of(robot.body.platform, garbage)
    robot.witness.wait(
        "garbage counted",
        lambda status: status.health.dropped.get("driver/hw/scan", 0) >= before + 3,
        boottime(),
    )
    assert robot.status().epoch.instance == instance


def test_scans_of_changing_length_do_not_stop_a_robot(robot: Bench) -> None:
    robot.body.scans = source_of(robot.body.platform, changing_rays)
    moving = robot.drive()
    robot.body.wait(lambda command: command.scan_seq >= moving.scan_seq + 20, moving.at)
    assert robot.status().state is State.RUNNING
    said = {heard.status.reason for heard in robot.witness.heard if heard.at > moving.at}
    # A body that stood still sent no scans.
    late = {Reason.STALE_SCAN} if robot.body.was_late(moving.at) else set[Reason]()
    assert not said & (SCAN_REASONS - late)
    used = {c.scan_seq for c in robot.body.commands if c.at > moving.at and not c.twist.is_zero}
    assert len(used) >= 18


@pytest.mark.parametrize("is_stopped", [True, False])
def test_returned_driver_first_gets_zero_and_starts_no_robot(
    robot: Bench, is_stopped: bool
) -> None:
    robot.drive()
    gone = boottime()
    robot.body.close()
    robot.await_reason(Reason.DRIVER_LOST, gone)
    if is_stopped:
        robot.await_state(State.STOPPED, Reason.DRIVER_LOST, gone)
    robot.replace_body(same_place(robot.body))
    assert robot.body.wait(lambda command: True).twist.is_zero
    if is_stopped:
        robot.moves_not(0.0)
        status = robot.status()
        assert (status.state, status.reason) == (State.STOPPED, Reason.DRIVER_LOST)
        robot.drive()


def same_place(body: Body) -> Body:
    return Body(body.platform, swarm=body.swarm, robot=body.robot, endpoint=body.endpoint)
