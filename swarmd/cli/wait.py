"""`swarmctl wait`: wait until robots are as they are wanted."""

from __future__ import annotations

import time
from collections.abc import Collection, Iterable
from typing import TYPE_CHECKING

import click

from swarmd.cli.options import CommonOptions, Failure, common_options
from swarmd.cli.output import print_json
from swarmd.cli.send import unreachable
from swarmd.cli.targets import Targets, labels_of, takes_targets
from swarmd.core.clock import boottime
from swarmd.network.exit_codes import APPLIED, TIMEOUT
from swarmd.network.spread.operator_goals import signed_goals
from swarmd.texts.awaited import meeting, read_awaited, unmet

if TYPE_CHECKING:
    from swarmd.network.operator.members_view import MembersView
    from swarmd.network.operator.operator import Operator

TIME = 30.0
PERIOD = 0.3  # s between looks


@click.command()
@takes_targets(is_required=False)
@click.option(
    "--for",
    "wanted",
    multiple=True,
    required=True,
    metavar="CONDITION",
    help="state=STATE, pattern=PATTERN, presence=PRESENCE, goal, or count=NUMBER; repeated: all.",
)
@common_options
def wait(options: CommonOptions, targets: Targets, wanted: tuple[str, ...]) -> None:
    """Wait until TARGETS, or all robots, meet each condition; for --timeout, or 30 s.

    goal: each does what its goal wants. count=5: at least five of them are alive and meet the other
    conditions. A robot of the roster, or that is named, is waited for until it is there. The exit
    code is 5 if the time ends before.
    """
    conditions = read_awaited(wanted)
    limit = TIME if options.timeout is None else options.timeout
    with options.operator() as operator:
        until = boottime() + limit
        missing: dict[str, str] = {}
        while True:
            view = operator.members(cap=max(until - boottime(), 0.05))
            view = signed_goals(view, operator.identity) if conditions.goal else view
            names = _names(view, targets)
            missing, met = unmet(view, names, conditions), meeting(view, names, conditions)
            if not missing or boottime() >= until:
                break
            time.sleep(min(PERIOD, max(until - boottime(), 0.0)))
        _end(options, operator, view, names, met, missing, limit)


def _end(
    options: CommonOptions,
    operator: Operator,
    view: MembersView,
    names: Iterable[str],
    met: Collection[str],
    missing: dict[str, str],
    limit: float,
) -> None:
    if missing and not view.members:
        raise unreachable(operator)
    if options.is_json:
        code = TIMEOUT if missing else APPLIED
        content = {"robots": list(names), "met": list(met), "missing": missing, "exit_code": code}
        print_json("Wait", content)
    if missing:
        why = "; ".join(f"{name} {text}".strip() for name, text in missing.items())
        raise Failure(f"after {limit:g} s still not: {why}", TIMEOUT)
    if not options.is_json:
        others = ", ".join(name for name in names if name not in met)
        click.echo(f"{', '.join(met)}: as wanted{f'; not: {others}' if others else ''}")


def _names(view: MembersView, targets: Targets) -> tuple[str, ...]:
    """The targets so far; a glob or label without a robot stands for itself, so that no robot
    meets it."""
    known = view.expected | set(targets.full_names)
    by_name = Targets(targets.names, targets.exclude)
    found = set(by_name.matching(known)) if targets.names or not targets.labels else set[str]()
    for label in targets.labels:
        with_label = [name for name, labels in labels_of(view).items() if label in labels]
        found |= {*Targets((), targets.exclude).matching(with_label)} or {f"label {label}"}
    lacking = [
        glob for glob in targets.names if not Targets((glob,)).matching(known) and glob not in known
    ]
    return tuple(sorted(found | set(lacking)))
