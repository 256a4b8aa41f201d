"""The status of a running robot, and its members in each presence."""

from __future__ import annotations

from typing import Any

from msgspec.structs import replace

from swarmd.core.messages import (
    DecisionSummary,
    Epoch,
    Health,
    Latch,
    LoggedEvent,
    Param,
    Presence,
    Reason,
    State,
    Status,
)
from swarmd.operator.session.members_view import Contact, SeenMember

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
    params={"speed": Param(value=0.2, source="request"), "turn": Param(value=0.0, source="robot")},
    report={"opinion": 2},
    decision=DecisionSummary(requested_linear=0.2, safe_linear=0.1, is_active=True, min_gap=0.61),
    health=Health(scan_rate=4.96, loop_p99=0.0041, driver="answers", driver_up=True),
    uptime=100.0,
    events=(LoggedEvent(at=97.0, text="loading drive"),),
    version="1.2.3",
)


def status(robot: str = "r1", **changes: Any) -> Status:
    """A running robot's status, with changes."""
    return replace(RUNNING, robot=robot, **changes)


def make_member(
    robot: str = "r1", presence: Presence = Presence.ALIVE, age: float = 0.0, **changes: Any
) -> SeenMember:
    """A member with the status of a running robot, with changes; one that is gone without it."""
    seen = status(robot, **changes)
    is_alive = presence is Presence.ALIVE
    return SeenMember(
        robot=robot,
        instance=seen.instance,
        presence=presence,
        age=age,
        status=seen if is_alive else None,
        contact=Contact.ANSWERED if is_alive else Contact.GONE,
    )


ESTOPPED = make_member(
    "r2",
    state=State.ESTOPPED,
    reason=Reason.ESTOP,
    latches={"e1": Latch(issuer="bob@desk", scope="swarm", reason="smoke", age=12.0)},
)
