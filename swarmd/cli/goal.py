"""`swarmctl goal`: what robots are to do beside what they do; `resume` lets robots take it up."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING, Any

import click
from msgspec import to_builtins

from swarmd.cli.options import CommonOptions, Failure, common_options
from swarmd.cli.output import fields, print_json, print_table, warn
from swarmd.cli.run_start import send_goal
from swarmd.cli.send import asking, known_members, report, stop_names, time_left
from swarmd.cli.targets import Targets, robots_of, takes_targets
from swarmd.core.verbs import ResumeRequest
from swarmd.network.exit_codes import APPLIED, NO_TARGET, PARTIAL, TIMEOUT
from swarmd.network.operator.outcome import Outcome, joined
from swarmd.network.spread.operator_goals import next_goal, signed_goals
from swarmd.texts.goal import (
    Difference,
    content_of,
    describe_goal,
    differences,
    goals_of,
    present_goals,
    set_apart,
)
from swarmd.texts.values import NOTHING, printable, seconds

if TYPE_CHECKING:
    from swarmd.core.messages import Epoch
    from swarmd.network.operator.members_view import MembersView
    from swarmd.network.operator.operator import Operator


@click.command()
@takes_targets(is_required=False)
@common_options
def goal(options: CommonOptions, targets: Targets) -> None:
    """Print what TARGETS, or all robots, are to do beside what they do.

    Each `run` sets a goal, and robots hand the latest one on. A robot that joined later is offered
    it; `swarmctl resume` takes it up. The exit code is 0 only if each robot does what its goal
    wants.
    """
    with options.operator() as operator:
        view = signed_goals(known_members(options, operator), operator.identity)
        found = differences(view, robots_of(view, targets))
        code = _exit_code(view, _counted(view, found))
        if options.is_json:
            print_json("Goal", _as_json(view, found, code))
        else:
            _print(view, found)
        click.get_current_context().exit(code)


@click.command()
@takes_targets(is_required=True)
@common_options
def resume(options: CommonOptions, targets: Targets) -> None:
    """Let TARGETS run the goal that they were offered, or whose run has ended.

    A robot refuses if its goal has changed since swarmctl looked, and if the goal is of a run with
    `--lease` whose operator is not heard.
    """
    with asking(options, targets, needs_status=True) as asked:
        wait = time_left(options, asked.view)
        asked.report(resume_on(asked.operator, asked.view, asked.names, timeout=wait))


@click.command()
@common_options
def undo(options: CommonOptions) -> None:
    """Set the goal before the present one again, from any machine: robots keep both.

    Robots run it at once. Robots that only the present goal is for are stopped. A second undo takes
    the first one back. A run with `--lease` is not set again.
    """
    with options.operator() as operator:
        look = known_members(options, operator, is_request_next=True)
        view = signed_goals(look, operator.identity)
        present, before = present_goals(view)
        if present is None or before is None:
            what = "no goal is set" if present is None else f"no goal precedes {present.text}"
            raise Failure(f"nothing to undo: {what}", NO_TARGET)
        if before.lease is not None:
            text = f"nothing to undo: {before.text} had a run lease, which undo cannot renew"
            raise Failure(text, NO_TARGET)
        goal = next_goal(operator, view, **content_of(before), undoes=present.id)
        run, stand = set_apart(view, present, before)
        warn(f"sends {describe_goal(goal)}, in place of {present.text}")
        outcomes = []
        if stand:
            outcomes.append(stop_names(operator, stand))
        if run:
            wait = time_left(options, view)
            outcomes.append(send_goal(operator, view.epochs(run), goal, timeout=wait))
        report(options, joined(outcomes))


def resume_on(
    operator: Operator, view: MembersView, names: tuple[str, ...], *, timeout: float | None
) -> Outcome:
    """Ask robots to run their own goals, as `view` shows them."""
    by_digest: dict[str, dict[str, Epoch | None]] = defaultdict(dict)
    for name, epoch in view.epochs(names).items():
        status = view.members[name].status if name in view.members else None
        own = status.goal.own if status is not None and status.goal is not None else None
        by_digest[own.digest if own is not None else ""][name] = epoch
    return joined(
        operator.request(ResumeRequest, epochs, timeout=timeout, digest=digest)
        for digest, epochs in by_digest.items()
    )


def _counted(view: MembersView, found: list[Difference]) -> list[Difference]:
    """The lines of robots that are expected: not of those that left in order."""
    return [one for one in found if one.robot in view.expected]


def _exit_code(view: MembersView, found: list[Difference]) -> int:
    if all(one.is_as_desired for one in found):
        return APPLIED
    return PARTIAL if view.answered & {one.robot for one in found} else TIMEOUT


def _print(view: MembersView, found: list[Difference]) -> None:
    rows = [
        (
            one.robot,
            NOTHING if one.goal is None else f"{one.goal.generation} of {one.goal.issuer}",
            one.desired,
            one.actual,
            one.reason or one.note or ("as desired" if one.goal else NOTHING),
        )
        for one in found
    ]
    print_table(("NAME", "GOAL", "DESIRED", "ACTUAL", "DIFFERENCE"), rows)
    if not goals_of(view):
        click.echo("# no goal is set; `swarmctl run` sets one")
        return
    wanted = {one.goal.id for one in found if one.goal is not None}
    for known in reversed(goals_of(view).values()):
        if known.goal.id in wanted:
            age = "of unknown age" if known.age is None else f"set {seconds(known.age)} ago"
            click.echo(printable(f"# {describe_goal(known.goal)}, {age}"))
    counted = _counted(view, found)
    differing = [one.robot for one in counted if not one.is_as_desired]
    rest = f"; not: {', '.join(differing)}" if differing else ""
    click.echo(f"# {len(counted) - len(differing)}/{len(counted)} as desired{rest}")


def _as_json(view: MembersView, found: list[Difference], code: int) -> dict[str, Any]:
    known = goals_of(view)
    digests = {one.goal.id: digest for digest, one in known.items()}
    return {
        "robots": {
            one.robot: {
                "goal": None if one.goal is None else digests.get(one.goal.id),
                "desired": None if one.goal is None else one.desired,
                **fields(one, "actual", "is_as_desired", "reason", "note"),
            }
            for one in found
        },
        "goals": {
            digest: {**to_builtins(one.goal), "signature": None, "age": one.age}
            for digest, one in known.items()
        },
        "missing": sorted(view.expected - view.answered),
        "exit_code": code,
    }
