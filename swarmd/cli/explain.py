"""Why a robot stands, in one sentence that ends with what to do."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

from swarmd.cli.output import seconds
from swarmd.core.messages import Condition, DecisionSummary, Member, Reason, Row, State, Status

_SAME_OBSTACLE = math.radians(10.0)

_SENTENCES = {
    Reason.NEVER_ASKED: "it was never asked to run; `swarmctl run PATTERN {robot}` starts it",
    Reason.FINISHED: "its pattern has finished{detail}; `swarmctl run` starts one again",
    Reason.RESET: "it was reset{detail}; `swarmctl run PATTERN {robot}` starts it",
    Reason.OPERATOR: "an operator stopped it{detail}; `swarmctl run PATTERN {robot}` starts it",
    Reason.RELOADED: "its pattern's code was replaced{detail}; `swarmctl run` starts it",
    Reason.ESTOP: "it was emergency-stopped{latches}; `swarmctl reset {robot}` clears that",
    Reason.LOOP_STALLED: "its daemon was held up for over 1 s{detail}; look at its host, then run",
    Reason.LOAD_FAILED: "its pattern could not be loaded{detail}; correct it, then run",
    Reason.DUPLICATE_ID: "another daemon holds its id{detail}; stop one of them, then reset",
    Reason.QUARANTINED: "its pattern failed again and again{detail}; correct it, then reset",
    Reason.LEAVING: "its daemon is ending",
    Reason.NO_SCAN: "no scan has come from its sensor{detail}; look at the driver{driver}",
    Reason.INVALID_SCAN: "its scans lack too many rays{detail}; look at the sensor",
    Reason.STALE_SCAN: "its last scan is too old{age}; look at the sensor and the driver{driver}",
    Reason.FROZEN_SCAN: "its scans repeat themselves{detail}; look at the sensor",
    Reason.STALE_ODOMETRY: "its odometry is too old{detail}; look at the driver{driver}",
    Reason.COMMAND_EXPIRED: "its pattern has fallen silent{detail}; it is replaced if that lasts",
    Reason.DRIVER_LOST: "its base is out of reach{driver}; look at the driver",
    Reason.PATTERN_RESTARTING: "its pattern failed and is being loaded again{detail}",
    Reason.NO_REQUESTED_COMMAND: "its pattern wishes to stand",
    Reason.PROTECTION: "protection holds it{gap}",
}

# The same once such a hold has lasted and the robot was stopped for it: what was, may be over.
_HOLDS = {
    Reason.NO_SCAN: "no scan came from its sensor",
    Reason.INVALID_SCAN: "its scans lacked too many rays",
    Reason.STALE_SCAN: "scans stopped coming",
    Reason.FROZEN_SCAN: "its scans repeated themselves",
    Reason.STALE_ODOMETRY: "odometry stopped coming",
    Reason.COMMAND_EXPIRED: "its pattern fell silent",
    Reason.DRIVER_LOST: "its base was out of reach",
    Reason.PATTERN_RESTARTING: "its pattern failed and did not come back",
}


def why(member: Member) -> str:
    """One sentence: what the robot does, and if it stands, why and what to do."""
    status = member.status
    if member.condition is not Condition.ALIVE:
        last = f"; last known: {status.state}" if status is not None else ""
        forget = f"`swarmctl members forget {member.robot}` takes it off the list"
        return f"{member.condition} {seconds(member.age)} ago{last}; {forget}"
    if status is None:
        return "alive, but it has not told how it is yet; ask again"
    reason = status.reason
    if reason is None:
        way = " around what blocks it" if status.decision.is_recovering else ""
        moves = f"moves{way}{_bounded(status.decision)}"
        return f"{status.state} {status.pattern or 'no pattern'}, and {moves}"
    sentence = _SENTENCES[reason].format(
        robot=member.robot,
        detail=f" ({status.detail})" if status.detail else "",
        latches=_latches(status),
        age=_age(status),
        driver=f" ({status.health.driver})" if status.health.driver else "",
        gap=_gap(status.decision),
    )
    if status.state is State.RUNNING:
        return f"running {status.pattern}, and stands: {sentence}"
    if reason in _HOLDS:
        why_stopped, again = (
            _HOLDS[reason],
            f"`swarmctl run PATTERN {member.robot}` starts it again",
        )
        lasted = f" ({status.detail})" if status.detail else ""
        return f"{status.state}: {why_stopped}{lasted}; when that is mended, {again}"
    return f"{status.state}: {sentence}"


def _latches(status: Status) -> str:
    issuers = sorted({latch.issuer for latch in status.latches.values()})
    return f" by {', '.join(issuers)}" if issuers else ""


def _age(status: Status) -> str:
    age = status.decision.scan_age
    return f" ({seconds(age)})" if age is not None else ""


def obstacles(rows: Iterable[Row]) -> Iterator[tuple[str, Row]]:
    """Each obstacle once, as `an obstacle at -30 deg, 0.21 m`, with its tightest row."""
    told: list[Row] = []
    for row in rows:
        if not any(_is_alike(row, other) for other in told):
            told.append(row)
            degrees = round(math.degrees(row.bearing)) or 0  # no -0
            yield f"an obstacle at {degrees} deg, {max(row.gap, 0.0):.2f} m", row


def _is_alike(row: Row, other: Row) -> bool:
    """Whether a reader would take both for one obstacle."""
    return math.cos(row.bearing - other.bearing) > math.cos(_SAME_OBSTACLE)


def activity(decision: DecisionSummary) -> str:
    """Whether the arbiter changes what the pattern wishes: `clear`, `active`, `recovering`."""
    if decision.is_recovering:
        return "recovering"
    return "active" if decision.is_active else "clear"


def _bounded(decision: DecisionSummary) -> str:
    return next((f", limited by {text}" for text, _ in obstacles(decision.rows)), "")


def _gap(decision: DecisionSummary) -> str:
    if decision.rows:
        return _bounded(decision)
    gap = decision.min_gap
    return f": the nearest obstacle is {gap:.2f} m away" if gap is not None else ""
