"""Start-up of a fleet by an operator's requests: wait for the robots, then start their patterns."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from itertools import combinations
from typing import Any

from swarmd.core.clock import boottime
from swarmd.core.errors import ConfigError, NetworkError, SwarmError
from swarmd.core.messages import Code, Presence, State, Status
from swarmd.core.verbs import RunRequest
from swarmd.operator.session.members_view import MembersView
from swarmd.operator.session.operator import Operator
from swarmd.operator.session.outcome import Outcome
from swarmd.operator.texts.values import counted
from swarmd.robot.status import MAX_NEIGHBORS
from swarmd.sim.live.fleet import Fleet
from swarmd.sim.scenarios.scenario import ScheduledEvent

# s between two queries of all robots while they start. Without a pause the queries take up to half
# a second of processor time from seven daemons that start on two cores.
UP_PERIOD = 0.02
TELL_PERIOD = 5.0  # s between two progress lines
# s, and s more per robot: slow machines, cold disks
UP_TIMEOUT = 20.0
UP_TIMEOUT_EACH = 1.0
# Twelve Burgers on a busy machine: four needed more than the 3 s in which a pattern must load.
RUN_ATTEMPTS = 3


def await_robots(
    operator: Operator, fleet: Fleet, tell: Callable[[str], object] | None = None
) -> MembersView:
    """Wait until all robots of the fleet are up; returns their members and statuses.

    A robot is up when its daemon reaches its base. The robots must also be neighbors of each other.
    The wait ends after UP_TIMEOUT s and UP_TIMEOUT_EACH s per robot, also if only some robots are
    up. `tell` is called each TELL_PERIOD s with the number of robots that are up. SwarmError if a
    process of the fleet ends. NetworkError if no robot is up in time.
    """
    robots = fleet.robots
    timeout = UP_TIMEOUT + UP_TIMEOUT_EACH * len(robots)
    start_time = last_told = time.monotonic()
    deadline = start_time + timeout
    while True:
        fleet.check()
        view = operator.members()
        up = {name for name, status in statuses_of(view).items() if status.health.driver_up}
        is_timed_out = time.monotonic() > deadline
        are_all_up = up.issuperset(robots)
        if are_all_up and know_each_other(view, robots, fleet.spec.all_hear_all):
            return view
        if up and is_timed_out:
            return view
        if is_timed_out:
            raise NetworkError(f"no robot is up after {timeout:.0f} s (logs: {fleet.spec.folder})")
        if tell is not None and time.monotonic() - last_told > TELL_PERIOD:
            last_told = time.monotonic()
            tell(
                f"{len(up)} of {counted(len(robots), 'robot')} up after"
                f" {last_told - start_time:.0f} s"
            )
        time.sleep(UP_PERIOD)


def know_each_other(view: MembersView, robots: Sequence[str], all_hear_all: bool) -> bool:
    """True if robots that hear each other know this, as far as their statuses show.

    With `all_hear_all` each robot must list all others as neighbors: a robot that has just started
    lists none. Otherwise robots may be out of reach, so it is enough that of each pair both robots
    list each other, or neither. `view` must have a status of each of `robots`. True for more than
    MAX_NEIGHBORS robots, since a status lists no more neighbors.
    """
    if len(robots) > MAX_NEIGHBORS:
        return True
    neighbors_of = {robot: status.neighbors for robot, status in statuses_of(view).items()}
    return all(
        (b in neighbors_of[a]) == (a in neighbors_of[b])
        and (b in neighbors_of[a] or not all_hear_all)
        for a, b in combinations(robots, 2)
    )


def statuses_of(view: MembersView) -> dict[str, Status]:
    """The statuses of the robots that are alive and have answered."""
    return {
        name: member.status
        for name, member in view.members.items()
        if member.presence is Presence.ALIVE and member.status is not None
    }


def start_pattern(operator: Operator, view: MembersView, run: ScheduledEvent) -> dict[str, str]:
    """Start the pattern of a run event on its robots; returns why robots do not run it, by robot.

    There are at most RUN_ATTEMPTS requests. Each after the first goes to the robots that do not run
    the pattern yet. `view`: the
    members, with their epochs for the first request. (An epoch counts the changes of a robot. A
    robot refuses a request that names an earlier epoch.) ConfigError if all robots refuse the first
    request. SwarmError if no robot runs the pattern after the last request.
    """
    began = boottime()  # of all requests: a stop between two of them is later than the run
    outcome = operator.request(RunRequest, view.epochs(run.robots), issued=began, **run_fields(run))
    if len(outcome.refused) == len(run.robots):
        raise ConfigError(why_not("run", outcome))
    started = set(outcome.applied)
    for _ in range(RUN_ATTEMPTS - 1):
        if started.issuperset(run.robots):
            break
        # A robot may run the pattern although its acknowledgement was late or lost.
        view = operator.members()
        started |= _running(view, run.pattern)
        # If all robots run by now, `targets` is empty, and the request goes to no robot. So the
        # last outcome has no reasons: earlier outcomes have reasons of robots that run by now.
        targets = tuple(name for name in run.robots if name not in started)
        outcome = operator.request(
            RunRequest, view.epochs(targets), issued=began, **run_fields(run)
        )
        started.update(outcome.applied)
    if not started:
        raise SwarmError(why_not("run", outcome))
    return _texts(outcome)


def _running(view: MembersView, pattern: str) -> set[str]:
    """The robots whose status shows that they run `pattern`."""
    return {
        name
        for name, status in statuses_of(view).items()
        if status.state is State.RUNNING and status.pattern == pattern
    }


def run_fields(run: ScheduledEvent) -> dict[str, Any]:
    """The fields of a request for a run event."""
    return {
        "pattern": run.pattern,
        "params": dict(run.parameters),
        "seconds": run.seconds,
        "until": tuple(run.until),
    }


def _texts(outcome: Outcome) -> dict[str, str]:
    """Why each robot did not apply a request."""
    texts = {
        name: reply.text or reply.code.value
        for name, reply in outcome.replies.items()
        if reply.code is not Code.APPLIED
    }
    return texts | dict.fromkeys(outcome.missing, "no answer")


def why_not(verb: str, outcome: Outcome) -> str:
    """Why a request failed, in one line: counts of robots, then each reason with its robots.

    If all robots have the same reason, no names are given.
    """
    by_text: dict[str, list[str]] = {}
    for name, text in sorted(_texts(outcome).items()):
        by_text.setdefault(text, []).append(name)
    if len(by_text) == 1 and not outcome.applied:
        return f"{verb}: all {outcome.targeted} robots: {next(iter(by_text))}"
    reasons = [f"{', '.join(names)}: {text}" for text, names in by_text.items()]
    counts = {"applied": len(outcome.applied), "refused": len(outcome.refused),
              "failed": len(outcome.failed), "no answer": len(outcome.missing)}  # fmt: skip
    parts = [f"{outcome.targeted} targeted", *(f"{n} {what}" for what, n in counts.items() if n)]
    return "; ".join([f"{verb}: {', '.join(parts)}", *reasons])
