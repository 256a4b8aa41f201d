"""A robot that protection keeps in place says so after 10 s, and no earlier."""

from __future__ import annotations

import math

import numpy as np
import pytest
from msgspec.structs import replace

from swarmd.core.avoided import Avoided
from swarmd.core.messages import Reason
from swarmd.core.values import ZERO, Platform, Pose, Scan, Twist
from swarmd.robot.protection.decision import Decision
from swarmd.robot.standing import StandingWatch
from swarmd.settings.platforms import load_platform
from swarmd.testing.scans import empty_scan
from tests.support.robot_harness import RobotHarness
from tests.support.stub_patterns import PATTERNS

TURTLEBOT4 = load_platform("turtlebot4")
HERE = Pose(1.0, 2.0, 0.5)
HELD = Decision("barrier", Twist(0.3), ZERO, Reason.PROTECTION, True, (), 0.3, 0.1, 1)
WANTED = 10.0
"""s after which docs/trouble.md says that a robot names the cause."""


def beside_wall(platform: Platform, gap: float) -> Scan:
    """A wall on the left, `gap` m from the outline and parallel to it; nothing else."""
    scan = empty_scan(platform, 1, 0.0)
    wall = platform.footprint[:, 1].max() + gap - platform.scan.offset[1]
    with np.errstate(divide="ignore"):
        ranges = wall / np.sin(scan.bearings)
    is_seen = (ranges > 0.0) & (ranges < 4.0)
    return replace(scan, ranges=np.where(is_seen, ranges, np.inf))


def boxed_in(platform: Platform) -> Scan:
    """Returns all around, within 0.2 m of the outline."""
    scan = empty_scan(platform, 1, 0.0)
    return replace(scan, ranges=np.full(len(scan.bearings), 0.4))


def watched(
    watch: StandingWatch,
    scan: Scan,
    seconds: float,
    *,
    begin: float = 0.0,
    decision: Decision = HELD,
) -> list[float]:
    """The times at which the watch tells, of updates every second."""
    times = np.arange(begin, begin + seconds + 0.5).tolist()
    return [time for time in times if watch.update(decision, HERE, scan, time)]


@pytest.mark.parametrize("gap", [0.02, 0.1, 0.3])
def test_a_robot_beside_a_wall_is_told_once_after_ten_seconds(gap: float) -> None:
    watch = StandingWatch(TURTLEBOT4)
    assert watched(watch, beside_wall(TURTLEBOT4, gap), 30.0) == [WANTED]
    assert watch.held_for(30.0) == pytest.approx(30.0)


def test_a_robot_that_is_boxed_in_has_no_free_floor() -> None:
    watch = StandingWatch(TURTLEBOT4)
    assert watched(watch, boxed_in(TURTLEBOT4), 30.0) == []
    assert watch.held_for(30.0) is None


@pytest.mark.parametrize(
    "other",
    [
        replace(HELD, reason=None, safe=Twist(0.01)),
        replace(HELD, reason=Reason.NO_REQUESTED_COMMAND, requested=ZERO),
        replace(HELD, reason=Reason.STALE_SCAN),
        replace(HELD, avoided=Avoided(0.0, 1.0)),
    ],
)
def test_motion_rest_holds_and_waiting_for_others_begin_the_time_anew(other: Decision) -> None:
    watch = StandingWatch(TURTLEBOT4)
    scan = beside_wall(TURTLEBOT4, 0.3)
    assert watched(watch, scan, 9.0) == []
    assert not watch.update(other, HERE, scan, 9.5)
    assert watched(watch, scan, 12.0, begin=10.0) == [10.0 + WANTED]


@pytest.mark.parametrize(
    ("pose", "is_moved"),
    [
        (Pose(1.03, 2.0, 0.5), True),
        (Pose(1.0, 2.0, 0.5 + math.radians(20.0)), True),
        (Pose(1.005, 2.0, 0.52), False),
    ],
)
def test_a_robot_that_has_moved_is_not_held(pose: Pose, is_moved: bool) -> None:
    watch = StandingWatch(TURTLEBOT4)
    scan = beside_wall(TURTLEBOT4, 0.3)
    assert watched(watch, scan, 12.0) == [WANTED]
    watch.update(HELD, pose, scan, 13.0)
    assert (watch.held_for(13.0) is None) is is_moved


def test_without_odometry_or_scan_nothing_is_claimed() -> None:
    watch = StandingWatch(TURTLEBOT4)
    scan = beside_wall(TURTLEBOT4, 0.3)
    for time in range(30):
        assert not watch.update(HELD, None, scan, float(time))
        assert not watch.update(HELD, HERE, None, float(time))
    assert watch.held_for(30.0) is None


def test_the_status_and_one_event_of_a_running_robot_say_so() -> None:
    """A Jackal keeps 0.92 m around its lidar free, and may not creep: it stands at 0.3 m."""
    jackal = load_platform("jackal")
    harness = RobotHarness("jackal", patterns=PATTERNS)

    def scans(seq: int, now: float) -> Scan:
        wall = beside_wall(jackal, 0.3 + 1e-4 * seq)  # scans that repeat hold a robot, too
        is_measured = wall.ranges >= jackal.scan.range_min
        return replace(wall, seq=seq, stamp=now, ranges=np.where(is_measured, wall.ranges, np.inf))

    harness.scans = scans
    harness.odometry = ZERO
    harness.advance(1.0)
    harness.ask("run", pattern="forward", params={"recovery": False})
    harness.advance(WANTED - 1.0)
    assert (harness.status.held_for, harness.status.reason) == (None, Reason.PROTECTION)
    harness.advance(4.0)
    held_for = harness.status.held_for
    assert held_for is not None
    assert WANTED <= held_for <= WANTED + 3.0
    assert sum("protection has held" in one.text for one in harness.status.events) == 1
    harness.ask("stop")
    harness.advance(0.5)
    assert harness.status.held_for is None
