"""What a robot says of itself, put together from its parts."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import msgspec

from swarmd.core.host_messages import Layers
from swarmd.core.messages import DecisionSummary, Health, Param, Reason, Status
from swarmd.core.messages import Scalar as BoundedScalar
from swarmd.core.values import Platform, Scalar, TouchZone
from swarmd.protection.decision import Decision
from swarmd.robot.lifecycle import Lifecycle
from swarmd.robot.sensors import Sensors

REPORTED = 16
ROWS = 4
SCALAR: Any = BoundedScalar  # the type as msgspec reads it, with its bounds
WORD = 64
TEXT = 256


@dataclass(frozen=True, slots=True, eq=False)
class RobotSettings:
    """What a robot knows of itself.

    `layers`: the configured parameters of a pattern by name; `touch`: where which pattern may
    touch what is near.
    """

    driver: str
    layers: Callable[[str], Layers]
    host: str = ""
    profile: str = "dev"
    is_secured: bool = False
    labels: tuple[str, ...] = ()
    touch: Mapping[str, TouchZone] = field(default_factory=dict)


@dataclass(slots=True, eq=False)
class Duty:
    """Ticks in `running` since the last run, and in how many of them protection was active."""

    decisions: int = 0
    active: int = 0

    @property
    def share(self) -> float:
        """Between 0 and 1; 0 before the first tick."""
        return self.active / self.decisions if self.decisions else 0.0


def make_status(
    robot: str,
    platform: Platform,
    settings: RobotSettings,
    conduct: Lifecycle,
    senses: Sensors,
    decision: Decision,
    duty: Duty,
    born: float,
    now: float,
) -> Status:
    """The status at `now`; the daemon adds what only it can know of its health."""
    supervisor, running = conduct.supervisor, conduct.hosting.running
    loading = conduct.hosting.loading
    values = {} if running is None else running.values
    detail = supervisor.detail
    if loading is not None:
        detail = f"loading {loading.pattern}"
    return Status(
        robot=robot,
        instance=conduct.epoch.instance,
        platform=platform.name,
        driver=settings.driver,
        host=settings.host,
        profile=settings.profile,
        is_secured=settings.is_secured,
        state=supervisor.state,
        reason=standing_reason(conduct, decision),
        detail=detail,
        pattern=None if running is None else running.pattern,
        generation=conduct.hosting.generation,
        since=max(now - supervisor.since, 0.0),
        epoch=conduct.epoch,
        changed_by=conduct.changed_by,
        latches=dict(conduct.latches.held),
        labels=settings.labels,
        params={name: Param(value=value, source=src) for name, (value, src) in values.items()},
        report=_clean(conduct.report),
        decision=_summary(decision, duty),
        health=Health(
            scan_rate=senses.scan_rate(now),
            host_restarts=conduct.hosting.restarts,
            driver=senses.driver_text[:TEXT],
            driver_up=senses.is_driver_up,
            dropped=_dropped(conduct, senses),
        ),
        uptime=max(now - born, 0.0),
        readings=_clean(senses.readings),
        events=tuple(conduct.events),
    )


def standing_reason(conduct: Lifecycle, decision: Decision) -> Reason | None:
    """The one reason why the robot stands; None while it moves."""
    return decision.reason if conduct.is_running else conduct.supervisor.reason


def _summary(decision: Decision, duty: Duty) -> DecisionSummary:
    return DecisionSummary(
        mode=decision.mode,
        is_active=decision.is_active,
        requested_linear=decision.requested.linear,
        requested_angular=decision.requested.angular,
        safe_linear=decision.safe.linear,
        safe_angular=decision.safe.angular,
        min_gap=decision.min_gap,
        scan_age=decision.scan_age,
        rows=decision.rows[:ROWS],
        is_recovering=decision.is_recovering,
        duty=duty.share,
        decisions=duty.decisions,
    )


def _dropped(conduct: Lifecycle, senses: Sensors) -> dict[str, int]:
    """What of the messages between patterns was dropped here, by kind."""
    counts = {
        "msg:inbox_full": senses.overflowed,
        "msg:wrong_type": conduct.mistyped,
        "msg:too_much_said": conduct.outbox.dropped,
    }
    return {kind: count for kind, count in counts.items() if count}


def _clean(report: Mapping[str, Scalar]) -> dict[str, Scalar]:
    """What of a report, or of readings, peers can read: bounded, finite, not too much."""
    cleaned: dict[str, Scalar] = {}
    for name, value in list(report.items())[:REPORTED]:
        short = value[:TEXT] if isinstance(value, str) else value
        try:
            cleaned[name[:WORD]] = msgspec.convert(short, SCALAR)
        except msgspec.ValidationError:
            continue
    return cleaned


def with_health(
    status: Status, loop_p99: float, loop_stalls: int, dropped: Mapping[str, int]
) -> Status:
    """The status with what its daemon knows: of its loop in s, and inputs dropped by cause."""
    health = msgspec.structs.replace(
        status.health, loop_p99=loop_p99, loop_stalls=loop_stalls, dropped=dropped
    )
    return msgspec.structs.replace(status, health=health)
