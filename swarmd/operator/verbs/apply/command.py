"""`swarmctl diff` and `apply`: labels, goal and parameters of a swarm file."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import click

from swarmd.core.clock import boottime
from swarmd.core.verbs import LabelRequest, ParamRequest
from swarmd.operator.cli.consent import need_consent
from swarmd.operator.cli.options import FILE, CommonOptions, Failure, common_options
from swarmd.operator.cli.output import print_json, print_table, warn
from swarmd.operator.cli.send import known_members, session_of, show
from swarmd.operator.session.exit_codes import APPLIED, NO_TARGET, PARTIAL
from swarmd.operator.session.outcome import Outcome, joined
from swarmd.operator.session.session import next_goal, signed_goals
from swarmd.operator.verbs.goal.ask import resume_on
from swarmd.operator.verbs.run.send_goal import check_sets_goals, send_goal

if TYPE_CHECKING:
    from swarmd.core.messages import Epoch
    from swarmd.operator.session.members_view import MembersView
    from swarmd.operator.session.operator import Operator
    from swarmd.operator.verbs.apply.ask import Plan
    from swarmd.settings.swarmfile import SwarmFile

_file = click.argument("file", type=FILE)


@click.command()
@_file
@common_options
def diff(options: CommonOptions, file: Path) -> None:
    """Print what `apply FILE` would change: labels, the goal and parameters of robots.

    The exit code is 0 if nothing differs, 3 if something differs or is not known.
    """
    with replace(options, config=file).operator() as operator:
        check_sets_goals(operator, "apply")
        view = known_members(options, operator)
        plan = _plan(operator, view)
        _print(options, plan)
        if options.is_json:
            print_json("Plan", _as_json(plan))
        is_same = plan.is_empty and not plan.left and not plan.unknown
        click.get_current_context().exit(APPLIED if is_same else PARTIAL)


@click.command()
@_file
@click.option(
    *("-y", "--yes"),
    is_flag=True,
    help="Do not ask before robots move; required without a terminal.",
)
@common_options
def apply(options: CommonOptions, file: Path, yes: bool) -> None:
    """Bring robots to what FILE wants: labels first, then the goal, then parameters.

    Asks before robots move. A second apply changes nothing. Robots whose run has ended stay as they
    are: `swarmctl resume` runs the goal again.
    """
    with replace(options, config=file).operator() as operator:
        check_sets_goals(operator, "apply")
        view = known_members(options, operator)
        plan = _plan(operator, view)
        _print(options, plan)
        if plan.moves and not yes:
            need_consent("apply lets robots move and", "they may move", "Apply? Robots will move.")
            options = replace(options, began=boottime())  # the yes is the user's last word
        outcomes = _carry_out(options, operator, view, plan)
        if options.is_json:
            replies = {
                name: reply.code for outcome in outcomes for name, reply in outcome.replies.items()
            }
            missing = joined(outcomes).missing
            print_json("Apply", {**_as_json(plan), "replies": replies, "missing": missing})
        elif outcomes:
            show(options, joined(outcomes))
        _end(plan, outcomes)


def _plan(operator: Operator, view: MembersView) -> Plan:
    from swarmd.operator.verbs.apply.ask import plan_of

    plan = plan_of(cast("SwarmFile", operator.settings), signed_goals(view, operator.identity))
    if plan.goal is not None and not plan.targets:
        raise Failure("goal.targets: no robot that answers is targeted", NO_TARGET)
    return plan


def _carry_out(
    options: CommonOptions, operator: Operator, view: MembersView, plan: Plan
) -> list[Outcome]:
    """Send the changes of `plan`: labels, then goal or resume, then parameters.

    A robot raises its epoch with each change. A request quotes the epoch that the operator has seen
    of each robot, and a robot refuses any other epoch. The robots are therefore queried again after
    each step. Returns an outcome per request.
    """
    if plan.is_empty:
        return []

    def queried_again() -> MembersView:
        return operator.members(timeout=options.timeout)

    outcomes = [  # robots with equal labels share a request
        operator.request(LabelRequest, view.epochs(robots), labels=labels)
        for labels, robots in _grouped(plan.labels, tuple).items()
    ]
    run_epochs = _run_epochs(view, plan, outcomes)
    if outcomes:
        view = queried_again()
    if plan.goal is not None:
        goal = next_goal(operator, view, **plan.goal)
        outcomes.append(send_goal(session_of(options, operator), run_epochs, goal))
        view = queried_again()
    if plan.resume:
        # `timeout` None: the usual time for replies, as for the requests before.
        session = session_of(options, operator)
        outcomes.append(resume_on(session, view, plan.resume, timeout=None))
        view = queried_again()
    return outcomes + _send_remaining_params(operator, view)


def _run_epochs(
    view: MembersView, plan: Plan, label_outcomes: list[Outcome]
) -> dict[str, Epoch | None]:
    """By robot, the epoch to quote with the new goal of `plan`.

    The epochs are those of `view`, the query before the labels were sent: a robot that somebody
    stopped or changed since that query refuses the goal. A robot that took new labels has raised
    its epoch by these labels, and the epoch in its reply counts.
    """
    epochs = view.epochs(plan.targets)
    for outcome in label_outcomes:
        for name, reply in outcome.replies.items():
            if name in epochs and reply.epoch:
                epochs[name] = reply.epoch
    return epochs


def _send_remaining_params(operator: Operator, view: MembersView) -> list[Outcome]:
    """Send the parameters in which robots still differ from the swarm file.

    `view`: a query after all other changes, since a run that has just begun may have the parameters
    already. Robots with equal changes share a request.
    """
    params_by_robot = _plan(operator, view).params
    by_params = _grouped(params_by_robot, lambda params: tuple(sorted(params.items())))
    return [
        operator.request(ParamRequest, view.epochs(robots), params=dict(items))
        for items, robots in by_params.items()
    ]


def _grouped(by_robot: Any, key: Callable[[Any], Any]) -> dict[Any, list[str]]:
    """By key of a value, the names of the robots whose values have this key.

    Robots with equal keys get one request together.
    """
    names_by_key: dict[Any, list[str]] = defaultdict(list)
    for name, value in by_robot.items():
        names_by_key[key(value)].append(name)
    return names_by_key


def _end(plan: Plan, outcomes: list[Outcome]) -> None:
    """End with the exit code of the outcomes; PARTIAL if they differ or a robot is unknown."""
    codes = {outcome.exit_code for outcome in outcomes}
    if codes - {APPLIED}:
        click.get_current_context().exit(codes.pop() if len(codes) == 1 else PARTIAL)
    click.get_current_context().exit(PARTIAL if plan.unknown else APPLIED)


def _print(options: CommonOptions, plan: Plan) -> None:
    if not options.is_json:
        if plan.lines:
            print_table(("WHAT", "ROBOTS", "CHANGE"), plan.lines)
        else:
            click.echo("nothing to change")
    for name, text in plan.left.items():
        warn(f"{name}: not as desired, and left so: {text}")
    for name, text in plan.unknown.items():
        warn(f"{name}: not compared: {text}")


def _as_json(plan: Plan) -> dict[str, Any]:
    changes = [{"kind": kind, "robots": who, "text": text} for kind, who, text in plan.lines]
    return {"changes": changes, "left": dict(plan.left), "unknown": dict(plan.unknown)}
