"""Statuses of a live run in the trace of its world."""

from __future__ import annotations

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from swarmd.core.messages import LimitingObstacle, LoggedEvent, Reason, State, Status
from swarmd.settings.platforms import load_platform
from swarmd.sim.live.recording import StatusLog
from swarmd.sim.trace import Trace, TraceBuilder
from tests.support.robot_harness import RobotHarness


@pytest.fixture
def trace() -> Trace:
    """Two robots that stand for 2 s."""
    recorder = TraceBuilder(("a", "b"), [load_platform("burger")] * 2, {})
    for k in range(21):
        recorder.add(0.1 * k, np.zeros((2, 3)), np.zeros((2, 3)))
    return recorder.trace()


@pytest.fixture
def status() -> Status:
    return RobotHarness().status


def say(status: Status, robot: str, opinion: int, *, is_active: bool) -> Status:
    rows = (
        (LimitingObstacle(-0.5, 0.21, 0.05), LimitingObstacle(0.5, 0.4, 0.1)) if is_active else ()
    )
    decision = msgspec.structs.replace(
        status.decision,
        is_active=is_active,
        is_recovering=is_active,
        rows=rows,
        min_gap=0.2 if is_active else None,
        scan_age=0.1,
    )
    return msgspec.structs.replace(
        status,
        robot=robot,
        state=State.RUNNING,
        reason=Reason.PROTECTION,
        decision=decision,
        report={"opinion": opinion, "mood": "calm"},
    )


def test_a_status_holds_until_the_next(trace: Trace, status: Status) -> None:
    statements = StatusLog()
    statements.add(0.5, {"a": say(status, "a", 1, is_active=True)})
    statements.add(
        1.0,
        {
            "a": say(status, "a", 2, is_active=False),
            "b": say(status, "b", 2, is_active=False),
            "stranger": say(status, "stranger", 7, is_active=True),
        },
    )
    told = statements.merged_into(trace)
    assert told.state is not None
    assert told.active is not None
    assert told.state[:, 0].tolist() == [*[""] * 5, *["running"] * 16]
    assert told.state[:, 1].tolist() == [*[""] * 10, *["running"] * 11]
    assert told.active[:, 0].tolist() == [*[False] * 5, *[True] * 5, *[False] * 11]
    np.testing.assert_array_equal(told.report["opinion"][[4, 5, 10], 0], [np.nan, 1.0, 2.0])
    assert told.words["mood"][20, 1] == "calm"
    assert told.requested is None


def test_the_tightest_constraint_is_in_the_trace(trace: Trace, status: Status) -> None:
    statements = StatusLog()
    statements.add(0.5, {"a": say(status, "a", 1, is_active=True)})
    statements.add(1.0, {"a": say(status, "a", 1, is_active=False)})
    told = statements.merged_into(trace)
    assert told.gap is not None
    assert told.scan_age is not None
    assert told.bound is not None
    assert told.recovering is not None
    np.testing.assert_array_equal(told.gap[[4, 5, 9, 10], 0], [np.nan, 0.2, 0.2, np.nan])
    np.testing.assert_array_equal(told.scan_age[[4, 5, 20], 0], [np.nan, 0.1, 0.1])
    np.testing.assert_array_equal(told.bound[[5, 9], 0], [[-0.5, 0.21, 0.05]] * 2)
    assert np.isnan(told.bound[[4, 10], 0]).all()
    assert np.isnan(told.bound[:, 1]).all()
    assert told.recovering[:, 0].tolist() == [*[False] * 5, *[True] * 5, *[False] * 11]


def test_what_robots_logged_is_in_the_trace_of_a_run_with_faults(
    trace: Trace, status: Status
) -> None:
    event = LoggedEvent(at=4.0, text="stopped (frozen_scan)")
    statements = StatusLog()
    for time in (0.5, 1.0):  # 0.5 s after the event, then 1 s: one event
        uptime = 4.0 + time
        said = msgspec.structs.replace(status, robot="a", uptime=uptime, events=(event,))
        statements.add(time, {"a": said})
    assert "said" not in statements.merged_into(trace).meta
    meta = {"events": [{"at": 0.0, "action": "fault scan frozen", "robots": ["a"]}]}
    merged = statements.merged_into(replace(trace, meta=meta))
    assert merged.meta["said"] == [(0.0, "a", "stopped (frozen_scan)")]


def test_without_statuses_the_trace_is_unchanged(trace: Trace) -> None:
    assert StatusLog().merged_into(trace) is trace


def test_readings_hold_until_a_status_leaves_them_out(trace: Trace, status: Status) -> None:
    statements = StatusLog()
    for time, readings in ((0.5, {"light": 0.25}), (1.0, {"light": 0.5}), (1.5, {})):
        said = msgspec.structs.replace(status, robot="a", readings=readings)
        statements.add(time, {"a": said})
    light = statements.merged_into(trace).readings["light"]
    assert light[[5, 9, 10, 14], 0].tolist() == [0.25, 0.25, 0.5, 0.5]
    assert np.isnan(light[[4, 15], 0]).all()
    assert np.isnan(light[:, 1]).all()


def test_a_robot_without_a_daemon_is_not_present_and_reports_nothing(
    trace: Trace, status: Status
) -> None:
    statements = StatusLog()
    said = {name: say(status, name, 1, is_active=False) for name in ("a", "b")}
    statements.add_present(0.2, ("a", "b"))
    statements.add(0.5, said)
    whole = statements.merged_into(trace)
    assert whole.present is None
    statements.add_present(1.0, ("a",))
    merged = statements.merged_into(trace)
    assert merged.present is not None
    assert merged.present[:, 0].all()
    assert merged.present[:10, 1].all()
    assert not merged.present[10:, 1].any()
    assert merged.state is not None
    assert (merged.state[9, 1], merged.state[10, 1]) == ("running", "")
    assert np.isnan(merged.report["opinion"][10:, 1]).all()
