"""Step deadlines and staggered jobs, with the time as an argument."""

from __future__ import annotations

import numpy as np
import pytest

from swarmd.sim.live.pacing import MAX_CATCH_UP, Staggered, StepPacer


def test_nothing_is_due_before_the_deadline() -> None:
    pacer = StepPacer(0.01, now=5.0)
    assert pacer.steps(5.009) == 0
    assert pacer.steps(5.0101) == 1
    assert pacer.deadline == pytest.approx(5.02)
    assert pacer.overruns == 0


def test_deadlines_do_not_drift_with_lateness() -> None:
    pacer = StepPacer(0.01, now=0.0)
    for k in range(1, 101):
        assert pacer.steps(k * 0.01 + 0.003) == 1
    assert pacer.deadline == pytest.approx(1.01)


def test_late_steps_are_caught_up_and_counted() -> None:
    pacer = StepPacer(0.01, now=0.0)
    assert pacer.steps(0.0551) == 5
    assert pacer.overruns == 4
    assert pacer.deadline == pytest.approx(0.06)


def test_a_long_delay_is_dropped_and_counted() -> None:
    pacer = StepPacer(0.01, now=0.0)
    late = MAX_CATCH_UP + 9.0
    assert pacer.steps(late) == 1
    assert pacer.deadline == pytest.approx(late + 0.01)
    assert pacer.overruns > 900


def test_real_time_factor_is_that_of_the_last_second() -> None:
    pacer = StepPacer(0.01, now=0.0)
    assert pacer.real_time_factor() == 0.0
    for k in range(1, 301):
        pacer.steps(k * 0.01 + 1e-6)
    assert pacer.real_time_factor() == pytest.approx(1.0, abs=0.02)
    pacer.steps(3.0 + 10.0)  # frozen for ten seconds
    assert pacer.real_time_factor() < 0.2
    for k in range(1, 201):
        pacer.steps(13.0 + k * 0.01 + 1e-6)
    assert pacer.real_time_factor() == pytest.approx(1.0, abs=0.02)


def test_jobs_are_spread_over_the_period_and_keep_their_rate() -> None:
    jobs = Staggered(np.full(5, 5.0), now=0.0)
    due = [jobs.due(k * 0.01) for k in range(1, 1001)]
    assert max(len(each) for each in due) == 1
    counts = np.bincount(np.concatenate(due))
    assert counts.tolist() == [50, 50, 50, 50, 50]


def test_a_missed_turn_is_left_out_not_repeated() -> None:
    jobs = Staggered(np.array([10.0]), now=0.0)
    jobs.due(1.0)
    assert len(jobs.due(1.01)) == 0
    assert len(jobs.due(1.101)) == 1


def test_jobs_are_due_in_the_given_order() -> None:
    jobs = Staggered(np.full(3, 1.0), 0.0, np.array([2, 0, 1]))
    seen = [row for step in range(100) for row in jobs.due(0.01 * step).tolist()]
    assert seen == [2, 0, 1]
