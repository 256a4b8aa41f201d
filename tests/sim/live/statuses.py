"""Statuses of robots for tests of the view, the summary and the demo."""

from __future__ import annotations

from typing import Any

from msgspec.structs import replace

from swarmd.core.messages import DecisionSummary, Epoch, Health, State, Status

_STATUS = Status(
    robot="a",
    instance="abc",
    platform="waffle_pi",
    driver="simulated",
    host="here",
    profile="dev",
    is_secured=False,
    state=State.RUNNING,
    reason=None,
    detail="",
    pattern="attraction",
    generation=1,
    since=0.0,
    epoch=Epoch("abc", 1),
    changed_by="",
    latches={},
    labels=(),
    params={},
    report={},
    decision=DecisionSummary(min_gap=0.62),
    health=Health(scan_rate=5.0, loop_p99=0.0031),
    uptime=1.0,
)


def status(robot: str, **changes: Any) -> Status:
    """A running robot's status, with changes."""
    return replace(_STATUS, robot=robot, **changes)
