"""Canaries: robots that run something before all others, and are watched for some time."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

from swarmd.core.clock import boottime
from swarmd.core.errors import ConfigError, RequestError
from swarmd.core.messages import STATUS_SILENCE, Reason, State, Status
from swarmd.network.operator.exit_codes import NO_TARGET

if TYPE_CHECKING:
    from swarmd.client.session import Session

CANARY_TIME = 10.0
"""How long canaries must run well, in s, unless stated otherwise."""
MAX_DUTY_RISE = 0.3
"""By how much the share of ticks in which protection acts may rise over the run before."""
MIN_DECISIONS = 60
"""Ticks after which that share is judged: 3 s."""


def choose_canaries(
    wanted: int | str, names: Iterable[str], option: str = "canary"
) -> tuple[str, ...]:
    """The canaries among the targets: the first `wanted` robots, or the robot with that name.

    RequestError if that robot is no target. ConfigError for a number below 1, and if no target is
    left for the run after the canaries. Each error names `option`.
    """
    known = tuple(names)
    is_wrong = isinstance(wanted, bool) or not isinstance(wanted, int | str)
    if is_wrong or (isinstance(wanted, int) and wanted < 1):
        raise ConfigError(f"{option} {wanted}: expected a number of robots, or a robot's name")
    if not isinstance(wanted, int) and wanted not in known:
        targets = ", ".join(known) or "none"
        raise RequestError(f"{option} {wanted} is not among the targets: {targets}", NO_TARGET)
    if len(known) <= (wanted if isinstance(wanted, int) else 1):
        raise ConfigError(f"{option} {wanted}: {len(known)} targeted, no other robot is left")
    return known[:wanted] if isinstance(wanted, int) else (wanted,)


def fault_of(before: Status | None, first: Status, now: Status) -> str:
    """Why a canary does not run well; empty if it does. Pure.

    `before`: its status before the run. `first`: its first status in the run.
    """
    if now.state is not State.RUNNING:
        if now.reason is Reason.FINISHED:
            return ""
        return f"{now.state} ({now.reason}) {now.detail}".rstrip()
    if now.reason is Reason.PATTERN_RESTARTING:
        return f"the pattern failed: {now.detail}".rstrip(": ")
    if now.health.host_restarts > first.health.host_restarts:
        return "the pattern failed and was restarted"
    was_running = before is not None and before.state is State.RUNNING
    usual = before.decision.duty if before is not None and was_running else 0.0
    rise = now.decision.duty - usual
    if now.decision.decisions >= MIN_DECISIONS and rise > MAX_DUTY_RISE:
        earlier = f"{usual:.0%} in its run before" if was_running else "it did not run before"
        return f"protection acts {now.decision.duty:.0%} of the time; {earlier}"
    return ""


def watch_canary(
    session: Session,
    names: Iterable[str],
    seconds: float,
    before: Mapping[str, Status | None] | None = None,
) -> dict[str, str]:
    """Watch canaries for `seconds`; returns those that do not run well, with the reason.

    It ends at the first fault, and when the session is cancelled. A robot that sends no status has
    a fault.
    """
    from swarmd.client.ask_robots import next_status, statuses_of  # most runs have no canary

    heard, until = dict.fromkeys(names, boottime()), boottime() + seconds
    first: dict[str, Status] = {}
    faults: dict[str, str] = {}
    with statuses_of(session.operator) as news:
        while not (faults or session.is_cancelled()) and (left := until - boottime()) > 0:
            status = next_status(news, min(left, 0.5))
            if status is not None and (robot := status.robot) in heard:
                heard[robot] = boottime()
                earlier = (before or {}).get(robot)
                if fault := fault_of(earlier, first.setdefault(robot, status), status):
                    faults[robot] = fault
            for robot, at in heard.items():
                if (silence := boottime() - at) > STATUS_SILENCE and robot not in faults:
                    faults[robot] = f"sent no status for {silence:.0f} s"
    return faults
