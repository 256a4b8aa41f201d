"""What a robot says of its protection and its sensors."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from swarmd.core.codec import Decoder, encode
from swarmd.core.messages import DecisionSummary, Reason, Status
from swarmd.core.values import Scan
from swarmd.robot.status import MAX_ROWS
from swarmd.testing.scans import empty_scan
from tests.support.robot_harness import RobotHarness
from tests.support.stub_patterns import PATTERNS

decode = Decoder(Status)
BARRIER = "extends: waffle_pi\nprotection: {mode: barrier}\n"


@pytest.fixture
def story(tmp_path: Path) -> RobotHarness:
    """A robot in mode barrier that is asked to drive straight on."""
    path = tmp_path / "careful.yaml"
    path.write_text(BARRIER)
    story = RobotHarness(str(path), patterns=PATTERNS)
    story.advance(0.5)
    return story


def summary(
    story: RobotHarness, bearing_deg: float, distance: float, *, recovery: bool = False
) -> DecisionSummary:
    """What it says after a context with something 20 degrees wide in the way."""

    def scans(seq: int, now: float) -> Scan:
        scan = empty_scan(story.platform, seq, now)
        off = np.abs(
            np.remainder(scan.bearings - math.radians(bearing_deg) + np.pi, 2 * np.pi) - np.pi
        )
        return replace(scan, ranges=np.where(off < 0.17, distance, np.inf))

    story.scans = scans
    story.ask("run", pattern="forward", params={"recovery": recovery})
    story.advance(0.25)
    return story.status.decision


def test_says_what_bounds_the_command_the_tightest_first(story: RobotHarness) -> None:
    said = summary(story, -20.0, 0.45)
    assert (said.mode, said.is_active) == ("barrier", True)
    assert 1 <= len(said.rows) <= MAX_ROWS
    assert [row.cap for row in said.rows] == sorted(row.cap for row in said.rows)
    tightest = said.rows[0]
    assert math.radians(-40.0) < tightest.bearing < math.radians(-5.0)
    assert said.min_gap is not None
    assert tightest.gap == pytest.approx(said.min_gap, abs=0.05)
    assert said.scan_age is not None


def test_a_robot_that_stands_before_an_obstacle_says_so(story: RobotHarness) -> None:
    said = summary(story, 0.0, 0.3)
    assert story.status.reason is Reason.PROTECTION
    assert said.rows[0].bearing == pytest.approx(0.0, abs=0.3)
    assert said.rows[0].cap == 0.0


def test_says_nothing_of_what_bounds_nothing(story: RobotHarness) -> None:
    said = summary(story, 180.0, 2.0)
    assert (said.is_active, said.rows, said.is_recovering) == (False, (), False)


def test_says_when_it_seeks_a_way_around(story: RobotHarness) -> None:
    assert not summary(story, 0.0, 0.3).is_recovering
    assert summary(story, 0.0, 0.3, recovery=True).is_recovering


def test_says_what_its_scalar_sensors_told(story: RobotHarness) -> None:
    told = {"battery": 0.71, "yaw": -1.5, "odd": math.nan}
    story.robot.on_readings(told)
    assert story.status.readings == {"battery": 0.71, "yaw": -1.5}
    assert decode(encode(story.status)).readings == story.status.readings
