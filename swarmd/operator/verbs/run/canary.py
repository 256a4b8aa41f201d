"""Canaries: robots that run something before all others, and are watched for some time.

Who they are, when one does not run well, and a run with canaries.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

from swarmd.core.clock import boottime
from swarmd.core.errors import ConfigError, RequestError
from swarmd.core.messages import STATUS_SILENCE, Reason, State, Status
from swarmd.operator.session.exit_codes import FAILED, NO_TARGET, PARTIAL
from swarmd.operator.session.session import next_generation, signed_again
from swarmd.operator.verbs.run import words
from swarmd.operator.verbs.run.send_goal import send_goal
from swarmd.operator.verbs.stop.ask import stop_names, stop_on_interrupt

if TYPE_CHECKING:
    from swarmd.core.goal import Goal
    from swarmd.operator.session.outcome import Outcome
    from swarmd.operator.session.session import Session, TargetedView

CANARY_TIME = 10.0
"""s for which canaries must run well by default."""
MAX_DUTY_RISE = 0.3
"""The greatest rise, over the run before, of the share of ticks in which protection acts."""
MIN_DECISIONS = 60
"""Ticks of a run, 3 s, before its share of ticks is judged."""
MAX_STATUS_WAIT = 0.5  # s of one wait for a status


def choose_canaries(
    wanted: int | str, names: Iterable[str], option: str = "canary"
) -> tuple[str, ...]:
    """Choose the canaries (robots that run a pattern first) among the targets `names`.

    `wanted`: the number of canaries, which are then the first of `names`; or the name of the only
    canary. RequestError if the named robot is no target. ConfigError for a number below 1, and if
    no target is left for the run after the canaries. `option`: the option's name, for errors.
    """
    all_names = tuple(names)
    is_wrong = isinstance(wanted, bool) or not isinstance(wanted, int | str)
    if is_wrong or (isinstance(wanted, int) and wanted < 1):
        raise ConfigError(f"{option} {wanted}: expected a number of robots, or a robot's name")
    if not isinstance(wanted, int) and wanted not in all_names:
        targets = ", ".join(all_names) or "none"
        raise RequestError(f"{option} {wanted} is not among the targets: {targets}", NO_TARGET)
    if len(all_names) <= (wanted if isinstance(wanted, int) else 1):
        raise ConfigError(f"{option} {wanted}: {len(all_names)} targeted, no other robot is left")
    return all_names[:wanted] if isinstance(wanted, int) else (wanted,)


def fault_of(before: Status | None, first: Status, now: Status) -> str:
    """The reason why a canary does not run well; empty if it runs well. Pure.

    `before`: the canary's status before the run; None (unknown) counts as no run. `first`, `now`:
    its first and its newest status in the run. A canary runs well if

    - it runs or has finished,
    - its pattern host has not restarted since `first`,
    - after MIN_DECISIONS ticks, the share of ticks in which protection acts exceeds the share in
      `before` (0 without a run) by at most MAX_DUTY_RISE.
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
    """Watch canaries (the robots that run a pattern before all others) for `seconds`.

    `before`: the status of each canary before the run. Returns the canaries that do not run well,
    with the reason; empty if all run well. A robot that sends no status does not run well. The
    watch ends at the first fault, and when the session is cancelled.
    """
    from swarmd.operator.session.session import (  # most runs have no canary
        next_status,
        statuses_of,
    )

    loops = session.operator.loops
    watch_end = boottime() + seconds
    last_heard = dict.fromkeys(names, boottime())
    first_status: dict[str, Status] = {}
    faults: dict[str, str] = {}
    loops.begin(boottime())
    with statuses_of(session.operator) as status_queue:
        while not faults and not session.is_cancelled():
            time_left = watch_end - boottime()
            if time_left <= 0:
                break
            # 1. Judge the next status.
            status = next_status(status_queue, min(time_left, MAX_STATUS_WAIT))
            stood = loops.turn(boottime(), MAX_STATUS_WAIT)
            if stood:  # this program heard no robot: not a silence of robots
                last_heard = {robot: heard_at + stood for robot, heard_at in last_heard.items()}
            if status is not None and status.robot in last_heard:
                robot = status.robot
                last_heard[robot] = boottime()
                first = first_status.setdefault(robot, status)
                fault = fault_of((before or {}).get(robot), first, status)
                if fault:
                    faults[robot] = fault

            # 2. Find silent canaries.
            for robot, heard_at in last_heard.items():
                silence = boottime() - heard_at
                if silence > STATUS_SILENCE and robot not in faults:
                    faults[robot] = f"sent no status for {silence:.0f} s"
    return faults


def run_with_canary(
    targeted: TargetedView, goal: Goal, canaries: tuple[str, ...], seconds: float | None
) -> tuple[Outcome, Mapping[str, list[str]]]:
    """Run a goal on canaries for `seconds`, then on all robots of `targeted`.

    `seconds` None: CANARY_TIME. Returns the outcome, and the names of the canaries and of the other
    robots. If a canary does not start, the canaries are stopped, and the outcome of their start is
    returned without names. If a canary fails later, all canaries are stopped, and RequestError is
    raised.
    """
    session = targeted.session
    operator = targeted.operator
    view = targeted.view
    # This goal targets only the canaries, so that it ends no run of another robot.
    canary_goal = signed_again(operator, goal, targets=canaries)
    canary_epochs = view.epochs(canaries)
    outcome = send_goal(session, canary_epochs, canary_goal, timeout=targeted.time_left)
    if len(outcome.applied) < len(canaries):
        stop_names(operator, canaries)
        session.tell(words.canaries_not_started(canaries))
        return outcome, {}
    before = {name: view.members[name].status for name in canaries if name in view.members}
    faults = _canary_faults(session, canaries, seconds or CANARY_TIME, before)
    others = tuple(name for name in targeted.names if name not in canaries)
    if faults:
        stopped = stop_names(operator, canaries)
        text = words.canaries_failed(faults, stopped.missing, len(others))
        raise RequestError(text, PARTIAL if stopped.missing else FAILED)

    # A robot that was stopped or changed while the canaries ran has another epoch, and refuses.
    epochs = view.epochs(others) | {name: outcome.replies[name].epoch for name in canaries}
    present_view = operator.members(timeout=session.timeout)
    # Newer than any goal that was issued meanwhile.
    goal = signed_again(operator, goal, generation=next_generation(operator, present_view))
    try:
        outcome = send_goal(session, epochs, goal, timeout=session.timeout)
    except RequestError as error:  # a standstill: a stop might end what its user ordered meanwhile
        text = words.started_before(error, canaries)
        raise RequestError(text, error.exit_code) from error
    return outcome, {"canary": list(canaries), "others": list(others)}


def _canary_faults(
    session: Session,
    canaries: tuple[str, ...],
    seconds: float,
    before: Mapping[str, Status | None],
) -> Mapping[str, str]:
    """Watch running canaries for `seconds`; the fault of each canary that does not run well.

    `before`: the status of each canary before its run. If the session is cancelled, each canary
    gets the cancellation as its fault. After Ctrl-C the canaries are stopped.
    """
    session.tell(words.canaries_begin(canaries, seconds))
    try:
        faults = watch_canary(session, canaries, seconds, before)
    except (KeyboardInterrupt, SystemExit):
        stop_on_interrupt(session, canaries)
        raise
    if session.is_cancelled():
        return dict.fromkeys(canaries, "the run was cancelled")
    return faults
