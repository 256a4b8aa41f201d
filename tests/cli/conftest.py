"""Members of a swarm, as daemons describe them."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from msgspec.structs import replace

from swarmd.core.messages import (
    Condition,
    DecisionSummary,
    Epoch,
    Health,
    Latch,
    LoggedEvent,
    Member,
    Param,
    Reason,
    State,
    Status,
)

MakeMember = Callable[..., Member]

RUNNING = Status(
    robot="r1",
    instance="0123456789ab",
    platform="waffle_pi",
    driver="simulated",
    host="bench",
    profile="dev",
    is_secured=False,
    state=State.RUNNING,
    reason=None,
    detail="",
    pattern="drive",
    generation=42,
    since=3.0,
    epoch=Epoch(instance="0123456789ab", revision=7),
    changed_by="ann@desk (run drive)",
    latches={},
    labels=("red",),
    params={"speed": Param(value=0.2, source="runtime"), "turn": Param(value=0.0, source="robot")},
    report={"opinion": 2},
    decision=DecisionSummary(requested_linear=0.2, safe_linear=0.1, is_active=True, min_gap=0.61),
    health=Health(scan_rate=4.96, loop_p99=0.0041, driver="answers", driver_up=True),
    uptime=100.0,
    events=(LoggedEvent(at=97.0, text="loading drive"),),
)


@pytest.fixture
def make_member() -> MakeMember:
    """A member by name; keywords change its condition, age or parts of its status."""

    def make(
        robot: str = "r1",
        condition: Condition = Condition.ALIVE,
        age: float = 0.0,
        **changes: object,
    ) -> Member:
        status = replace(RUNNING, robot=robot, **changes)
        return Member(
            robot=robot, instance=status.instance, condition=condition, age=age, status=status
        )

    return make


@pytest.fixture
def estopped(make_member: MakeMember) -> Member:
    """A robot that holds one emergency stop."""
    return make_member(
        "r2",
        state=State.ESTOPPED,
        reason=Reason.ESTOP,
        latches={"e1": Latch(issuer="bob@desk", scope="swarm", reason="smoke")},
    )
