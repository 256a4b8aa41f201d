"""`swarmctl goal`: what robots are to do beside what they do; `resume` lets robots take it up."""

from __future__ import annotations

from typing import Any

import click
from msgspec import to_builtins

from swarmd.operator.cli.options import CommonOptions, common_options
from swarmd.operator.cli.output import fields, print_json, print_table
from swarmd.operator.cli.send import asking, known_members, report, session_of
from swarmd.operator.cli.targets import takes_targets
from swarmd.operator.session.exit_codes import APPLIED, PARTIAL, TIMEOUT
from swarmd.operator.session.members_view import MembersView
from swarmd.operator.session.session import signed_goals
from swarmd.operator.session.targets import Targets, robots_of
from swarmd.operator.texts.values import NOTHING, printable, seconds
from swarmd.operator.verbs.goal.ask import resume_on
from swarmd.operator.verbs.goal.ask import undo as set_before
from swarmd.operator.verbs.goal.words import Difference, describe_goal, differences, goals_of


@click.command()
@takes_targets(is_required=False)
@common_options
def goal(options: CommonOptions, targets: Targets) -> None:
    """Print the goal of each of TARGETS, or of all robots, beside its present run.

    Each `run` sets a goal, and robots hand the latest goal on. A robot that joined later is offered
    the goal; `swarmctl resume` runs it. The exit code is 0 only if each robot does what its goal
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

    A robot refuses if its goal has changed since swarmctl looked. A robot also refuses the goal of
    a run with `--lease` while the operator of that run is not heard.
    """
    with asking(options, targets, needs_status=True) as asked:
        wait = asked.targeted.time_left
        asked.report(resume_on(asked.targeted.session, asked.view, asked.names, timeout=wait))


@click.command()
@common_options
def undo(options: CommonOptions) -> None:
    """Set the previous goal again, from any machine: robots keep the present and previous goal.

    The robots of the previous goal run it at once. Robots that only the present goal targets are
    stopped. A second undo reverses the first. The goal of a run with `--lease` is not set again.
    """
    with options.operator() as operator:
        report(options, set_before(session_of(options, operator)))


def _counted(view: MembersView, found: list[Difference]) -> list[Difference]:
    """The lines of the robots that are expected: robots that left in order are left out."""
    return [difference for difference in found if difference.robot in view.expected]


def _exit_code(view: MembersView, found: list[Difference]) -> int:
    if all(difference.is_as_desired for difference in found):
        return APPLIED
    return PARTIAL if view.answered & {difference.robot for difference in found} else TIMEOUT


def _print(view: MembersView, found: list[Difference]) -> None:
    rows = [
        (
            difference.robot,
            NOTHING
            if difference.goal is None
            else f"{difference.goal.generation} of {difference.goal.issuer}",
            difference.desired,
            difference.actual,
            difference.reason or difference.note or ("as desired" if difference.goal else NOTHING),
        )
        for difference in found
    ]
    print_table(("NAME", "GOAL", "DESIRED", "ACTUAL", "DIFFERENCE"), rows)
    if not goals_of(view):
        click.echo("# no goal is set; `swarmctl run` sets one")
        return
    wanted = {difference.goal.id for difference in found if difference.goal is not None}
    for known in reversed(goals_of(view).values()):
        if known.goal.id in wanted:
            age = "of unknown age" if known.age is None else f"set {seconds(known.age)} ago"
            click.echo(printable(f"# {describe_goal(known.goal)}, {age}"))
    counted = _counted(view, found)
    differing = [difference.robot for difference in counted if not difference.is_as_desired]
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
