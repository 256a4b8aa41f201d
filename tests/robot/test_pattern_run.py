"""The deadlines of a pattern's load and run."""

from __future__ import annotations

import math
from typing import Any

import pytest

from swarmd.core.host_messages import Loaded
from swarmd.robot.issue_time import IssueTime
from swarmd.robot.pattern_load import Loading, Wish
from swarmd.robot.pattern_run import PatternRun
from swarmd.robot.timeouts import LOAD_TIMEOUT, MIN_EXPIRY, STEP_TIMEOUT


def loading(seconds: float | None = None, since: float = 10.0) -> Loading:
    return Loading(1, "drive", {}, seconds, since, None, Wish(IssueTime(since), "alice"))


def running(seconds: float | None = None) -> PatternRun:
    """A run at 10 Hz since 10 s that has stepped once."""
    run = PatternRun()
    run.loading = loading(seconds)
    run.ready(Loaded(1, 10.0, frozenset(), {}), 10.0)
    run.stepping(10.0)
    return run


def with_values(run: PatternRun, **values: Any) -> PatternRun:
    for name, value in values.items():
        setattr(run, name, value)
    return run


@pytest.mark.parametrize(
    ("run", "expected"),
    [
        (PatternRun(), []),
        (with_values(PatternRun(), loading=loading()), [10.0 + LOAD_TIMEOUT]),
        (running(), [10.0 + MIN_EXPIRY, 10.0 + STEP_TIMEOUT]),
        (with_values(running(), awaiting_since=math.inf), [10.1, 10.0 + MIN_EXPIRY]),
        (running(seconds=0.7), [10.0 + MIN_EXPIRY, 10.7, 10.0 + STEP_TIMEOUT]),
        (with_values(running(), restart_at=10.2, awaiting_since=math.inf), [10.1, 10.2, 10.3]),
        # While the next pattern is being loaded, no step is due.
        (
            with_values(running(), loading=loading(since=10.1), awaiting_since=math.inf),
            [10.0 + MIN_EXPIRY, 10.1 + LOAD_TIMEOUT],
        ),
    ],
    ids=["nothing", "load", "step", "between steps", "seconds", "restart", "load during a run"],
)
def test_deadlines_come_in_order(run: PatternRun, expected: list[float]) -> None:
    found, now = [], 10.0
    while (now := run.next_deadline(now)) < math.inf:
        found.append(now)
    assert found == pytest.approx(expected)


def test_step_knows_the_time_since_the_last_step_of_its_run() -> None:
    run = running()
    assert run.stepping(10.25) == pytest.approx(0.25)
    run.loading = loading()
    run.ready(Loaded(2, 10.0, frozenset(), {}), 12.0)
    assert run.stepping(12.0) == 0.0
