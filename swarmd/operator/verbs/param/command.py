"""`swarmctl param`: parameters of running patterns."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NoReturn

import click

from swarmd.core.messages import Member, Param
from swarmd.operator.cli.options import CommonOptions, VerbGroup, common_options
from swarmd.operator.cli.output import print_json, print_table
from swarmd.operator.cli.send import asking, exit_code_of, known_members
from swarmd.operator.cli.targets import read_targets, takes_targets, target_options
from swarmd.operator.session.targets import Targets, robots_of
from swarmd.operator.texts.assignments import read_assignments
from swarmd.operator.texts.values import NOTHING, number
from swarmd.operator.verbs.param.ask import params_of
from swarmd.operator.verbs.param.ask import set_params as change

if TYPE_CHECKING:
    from swarmd.operator.session.members_view import MembersView


@click.group(cls=VerbGroup)
def param() -> None:
    """Get or set parameters of running patterns."""


@param.command("get")
@takes_targets(is_required=False)
@common_options
def get_params(options: CommonOptions, targets: Targets) -> None:
    """Print the parameters in force on TARGETS, or on all robots, and the source of each."""
    with options.operator() as operator:
        view = known_members(options, operator)
        _show(options, view, targets)


def _show(options: CommonOptions, view: MembersView, targets: Targets) -> NoReturn:
    """Print the parameters of running patterns, and end with the exit code.

    `view`: the answers of the robots to a query. `targets` without names: all members. The exit
    code is 0 if all targets have answered; robots that left the swarm do not count.
    """
    targeted = robots_of(view, targets, view.members)
    params_by_robot = {robot: params_of(view.members[robot]) for robot in targeted}
    if options.is_json:
        robots = {robot: {"params": _as_json(params)} for robot, params in params_by_robot.items()}
        print_json("Params", {"robots": robots})
    else:
        _print_table(view, params_by_robot)
        answered = params_by_robot.keys() & view.answered
        idle = sorted(robot for robot in answered if not params_by_robot[robot])
        if idle:
            click.echo(f"# no pattern is running on {', '.join(idle)}")
    expected = params_by_robot.keys() & view.expected  # without robots that left the swarm
    click.get_current_context().exit(exit_code_of(view, expected))


def _as_json(params: Mapping[str, Param]) -> dict[str, Any]:
    return {key: {"value": param.value, "source": param.source} for key, param in params.items()}


def _print_table(view: MembersView, params_by_robot: Mapping[str, Mapping[str, Param]]) -> None:
    """Print a row for each robot and parameter."""
    rows = [
        (robot, _pattern(view.members[robot]), key, number(param.value), param.source)
        for robot, params in params_by_robot.items()
        for key, param in params.items()
    ]
    print_table(("NAME", "PATTERN", "PARAMETER", "VALUE", "FROM"), rows)


@param.command("set")
@target_options
@click.option("-p", "params", multiple=True, metavar="KEY=VALUE", help="May be repeated.")
@common_options
def set_params(
    options: CommonOptions,
    names: tuple[str, ...],
    is_all: bool,
    exclude: tuple[str, ...],
    labels: tuple[str, ...],
    params: tuple[str, ...],
) -> None:
    """Change parameters on TARGETS, as KEY=VALUE words or with -p, until the next run.

    For example: swarmctl param set --all speed=0.15. `swarmctl patterns show NAME` lists the
    parameters of a pattern with their bounds.
    """
    words = [*params, *(name for name in names if "=" in name)]
    robots = tuple(name for name in names if "=" not in name)
    if not words:
        raise click.UsageError("param set needs values; add KEY=VALUE, such as speed=0.15")
    values = read_assignments(words)
    targets = read_targets("param set", robots, is_all, exclude, labels, is_required=True)
    with asking(options, targets, needs_status=False) as asked:
        asked.report(change(asked.targeted, values))


def _pattern(member: Member) -> str:
    return (member.status.pattern if member.status is not None else None) or NOTHING
