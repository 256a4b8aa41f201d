"""Periodic jobs and alarms on the grid of steps."""

from __future__ import annotations

import numpy as np
import pytest

from swarmd.sim.lockstep.schedules import Alarms, Schedules

DT = 0.01


@pytest.mark.parametrize("rate", [0.7, 5.0, 20.0, 33.0, 100.0])
def test_each_job_comes_at_its_rate_and_no_two_in_step(rate: float) -> None:
    rhythm = Schedules(np.full(3, rate), np.array([0.11, 0.42, 0.83]))
    seen: list[list[float]] = [[], [], []]
    for step in range(2001):
        for row in rhythm.due(step * DT):
            seen[row].append(step * DT)
    for times in seen:
        assert len(times) == pytest.approx(20.0 * rate, abs=1.0)
        assert np.abs(np.diff(times) - 1.0 / rate).max() <= DT + 1e-9
    if rate < 10.0:
        assert len({times[0] for times in seen}) == 3


def test_all_jobs_begin_at_once_by_default() -> None:
    rhythm = Schedules(np.array([10.0, 10.0]))
    assert [len(rhythm.due(step * DT)) for step in range(11)] == [2, *[0] * 9, 2]


def test_a_job_never_drifts() -> None:
    rhythm = Schedules(np.array([30.0]))
    count = sum(len(rhythm.due(step * DT)) for step in range(100 * 600))
    assert count == 30 * 600


def test_an_alarm_rings_once_in_the_first_step_that_is_not_before_it() -> None:
    wakes = Alarms(2, DT)
    wakes.set(1, 0.1)
    wakes.set(0, 0.095)
    assert [wakes.due(step) for step in range(13)] == [*[[]] * 10, [0, 1], [], []]


def test_a_later_call_replaces_or_removes_an_alarm() -> None:
    wakes = Alarms(2, DT)
    wakes.set(0, 0.05)
    wakes.set(0, 0.08)
    wakes.set(1, 0.03)
    wakes.set(1, None)
    assert [step for step in range(12) if wakes.due(step)] == [8]


def test_an_alarm_for_now_rings_in_the_next_step() -> None:
    wakes = Alarms(1, DT)
    assert wakes.due(5) == []
    wakes.set(0, 0.05)
    assert wakes.due(6) == [0]
