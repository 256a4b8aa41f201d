"""Robots in lockstep measure how late their scans arrive."""

from __future__ import annotations

import math
from typing import Any

import pytest

from studies.safety.scenes import Scene, scenario
from swarmd.core.messages import DelayFigure, ScanDelaySummary
from swarmd.sim.lockstep.lockstep import Lockstep
from swarmd.sim.scenarios.scenariofile import scenario_of
from tests.support.broken_assumptions import lose_rays
from tests.support.examples import part

STEP = 0.01  # s of the world, to which arrivals are rounded


def measured(seconds: float, **lidar: float) -> list[ScanDelaySummary]:
    """What three Burgers that walk randomly in a room of 4 m measure, with realistic noise."""
    data: dict[str, Any] = {
        "duration": seconds,
        "realism": {"preset": "realistic", "lidar": lidar},
        "arena": {"size": [4.0, 4.0]},
        "groups": {"all": {"platform": "burger", "count": 3, "pattern": "random_walk"}},
        "start": {"layout": "random", "clearance": 0.3},
    }
    lab = Lockstep(scenario_of(data), 1)
    lab.advance(seconds)
    statuses = [shell.robot.status(lab.world.time) for shell in lab.shells if shell is not None]
    return [status.scan_delay for status in statuses if status.scan_delay is not None]


def figures(summaries: list[ScanDelaySummary], method: str) -> list[DelayFigure]:
    return [one for summary in summaries for one in summary.figures if one.method == method]


def test_delay_as_declared_adds_nothing() -> None:
    assert [summary.added for summary in measured(8.0)] == [0.0] * 3


def test_stamps_tell_an_undeclared_delay_within_a_step() -> None:
    for summary in measured(8.0, delay=0.2):
        assert summary.added == pytest.approx(0.2, abs=1.5 * STEP)


@pytest.mark.evidence
def test_turns_tell_an_undeclared_delay_within_a_tenth_of_a_second() -> None:
    found = [one for one in figures(measured(40.0, delay=0.2), "turns") if one.delay is not None]
    assert len(found) >= 1
    for one in found:
        assert one.delay == pytest.approx(0.3, abs=0.1)


def test_jitter_counts_as_delay() -> None:
    for summary in measured(10.0, delay=0.05, jitter=0.1):
        assert 0.1 <= summary.added <= 0.15 + 1.5 * STEP


@pytest.mark.parametrize(("seed", "seconds"), part([(7210, 12.0)], [(7233, 12.0), (7001, 60.0)]))
def test_rays_lost_among_moving_robots_do_not_make_scans_late(seed: int, seconds: float) -> None:
    """A third of the rays within 30 degrees of ahead; others move by themselves, for seconds."""
    lab = Lockstep(scenario(Scene("lead", "burger", duration=seconds)), seed)
    lose_rays(lab, share=0.3, half=math.radians(30.0), seed=seed)
    robots = [shell.robot for shell in lab.shells if shell is not None]
    added = set[float]()
    lab.advance(seconds, lambda now: added.update(one._sensors.scan_delay.added for one in robots))
    assert added == {0.0}
