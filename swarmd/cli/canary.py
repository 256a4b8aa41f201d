"""Robots that try something before the others do: whether they run well for some time."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

import click

from swarmd.cli.options import Failure
from swarmd.core.clock import boottime
from swarmd.core.keys import is_id
from swarmd.core.messages import STATUS_SILENCE, Reason, State, Status
from swarmd.network.exit_codes import NO_TARGET

if TYPE_CHECKING:
    from swarmd.network.operator.operator import Operator

CANARY_TIME = 10.0
"""How long canaries must run well, in s, unless stated otherwise."""
MAX_DUTY_RISE = 0.3
"""By how much the share of ticks in which protection acts may rise over the run before."""
MIN_DECISIONS = 60
"""Ticks after which that share is judged: 3 s."""


def read_canary(text: str | None) -> int | str | None:
    """A number of robots, or the name of one. UsageError for anything else."""
    if text is None:
        return None
    if text.isdecimal() and int(text) > 0:
        return int(text)
    if not is_id(text) or text.isdecimal():
        raise click.UsageError(f"--canary {text}: expected a number of robots, or a robot's name")
    return text


def canaries_of(text: str, names: Iterable[str]) -> tuple[str, ...]:
    """The canaries among the targets: the first so many, or the one of that name.

    UsageError if no target is left for afterwards.
    """
    wanted, known = read_canary(text), tuple(names)
    if not isinstance(wanted, int) and text not in known:
        targets = ", ".join(known) or "none"
        raise Failure(f"--canary {text} is not among the targets: {targets}", NO_TARGET)
    if len(known) <= (wanted if isinstance(wanted, int) else 1):
        raise click.UsageError(f"--canary {text}: {len(known)} targeted, no other robot is left")
    return known[:wanted] if isinstance(wanted, int) else (text,)


def fault_of(before: Status | None, first: Status, now: Status) -> str:
    """Why a canary does not run well; empty if it does. Pure.

    `before`: its status before the run, `first`: the first one of the run.
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
    operator: Operator,
    names: Iterable[str],
    seconds: float,
    before: Mapping[str, Status | None] | None = None,
) -> dict[str, str]:
    """Watch robots for `seconds`; returns those that do not run well, with the reason.

    It ends at the first fault. A robot that sends no status is one.
    """
    from swarmd.cli.ask_robots import next_status, statuses_of  # most runs have no canary

    heard, until = dict.fromkeys(names, boottime()), boottime() + seconds
    first: dict[str, Status] = {}
    faults: dict[str, str] = {}
    with statuses_of(operator) as news:
        while not faults and (left := until - boottime()) > 0:
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
