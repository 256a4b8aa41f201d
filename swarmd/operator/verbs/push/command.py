"""`swarmctl plugin push`, `remove` and `list`: the patterns that robots have by the network."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import click

from swarmd.core.keys import is_id
from swarmd.operator.cli.canary import canaries_of, read_canary
from swarmd.operator.cli.options import EXISTING, CommonOptions, Duration, common_options
from swarmd.operator.cli.output import fields, print_json, print_table, warn
from swarmd.operator.cli.send import asking, session_of
from swarmd.operator.cli.targets import takes_targets
from swarmd.operator.session.exit_codes import code_of_answers
from swarmd.operator.session.session import gap
from swarmd.operator.session.targets import Targets, targets_of
from swarmd.operator.verbs.push.ask import (
    CANARY_TIME,
    Push,
    carry_out,
    check_keys,
    differing,
    pushed_patterns_of,
    read_source,
    remove_from,
)
from swarmd.operator.verbs.push.words import HEADER, row

if TYPE_CHECKING:
    from swarmd.core.verbs import PushedPatternsReply


@click.command("push", epilog="Example: swarmctl plugin push shy.py --all --canary 1")
@click.argument("file", type=EXISTING)
@takes_targets(is_required=True)
@click.option("--version", default="", help="Shown beside the hash [that of the wheel].")
@click.option(
    "--canary",
    metavar="ROBOT",
    help="First to this robot, or to so many; then to the others if all is well.",
)
@click.option(
    "--canary-time",
    type=Duration(),
    default=CANARY_TIME,
    help="How long a canary that runs it may take until it is held [90s].",
)
@click.option("--replace", is_flag=True, help="Also in place of a pattern that a robot has itself.")
@click.option("--rerun", is_flag=True, help="Stop and run it again where it runs.")
@common_options
def push(
    options: CommonOptions,
    file: Path,
    targets: Targets,
    version: str,
    canary: str | None,
    canary_time: float,
    replace: bool,
    rerun: bool,
) -> None:
    """Send the pattern in FILE, a .py, its folder or a wheel, to TARGETS; starts no run.

    At most 1 MiB of pure Python. A folder is sent with all files that it holds. With keys, your
    identity signs the pattern. Each robot tries the code in a process of its own, and the next run
    of the pattern uses the code. The code is provisional until it has run for 60 s without a fault;
    after a fault the robot stands and returns to the version before. Robots that join later and
    match TARGETS get the pattern from other robots.
    """
    read_canary(canary)
    source = read_source(file)
    settings, _, identity = options.network()
    check_keys(settings, identity)
    asked_for = Push(source, version, canary_time=canary_time, replace=replace, rerun=rerun)
    with asking(options, targets, needs_status=False) as asked:
        canaries = () if canary is None else canaries_of(canary, asked.names)
        asked.report(carry_out(asked_for, asked.targeted, targets, canaries))


@click.command("remove", epilog="Example: swarmctl plugin remove shy --all")
@click.argument("name")
@takes_targets(is_required=True)
@common_options
def remove(options: CommonOptions, name: str, targets: Targets) -> None:
    """Remove the pushed pattern NAME from TARGETS; a run of it goes on until it ends."""
    if not is_id(name):
        raise click.UsageError(f"{name!r} is no pattern name; see `swarmctl plugin list`")
    with asking(options, targets, needs_status=False) as asked:
        asked.report(remove_from(asked.targeted, targets, name))


@click.command("list", epilog="Example: swarmctl plugin list --all")
@takes_targets(is_required=False)
@common_options
def list_pushed(options: CommonOptions, targets: Targets) -> None:
    """List the pushed patterns of TARGETS, or all robots: version, hash and standing.

    `!` marks a pattern whose hash differs from its most frequent hash in the swarm.
    """
    with options.operator() as operator:
        session = session_of(options, operator)
        # The labels of robots are in their statuses.
        view = session.look(needs_status=bool(targets.labels))
        robots = targets_of(view, targets)
        replies = pushed_patterns_of(session, view, robots)
        missing = [robot for robot in robots if robot not in replies]
        exit_code = code_of_answers(robots, replies)
        marked = differing(replies)  # pairs (robot, pattern)
        if options.is_json:
            _print_list_json(replies, missing, marked, exit_code)
        else:
            rows = [
                (robot, *row(pattern), "!" if (robot, pattern.name) in marked else "")
                for robot, reply in replies.items()
                for pattern in reply.patterns
            ]
            print_table(HEADER, rows)
        for robot in missing:
            warn(f"no answer: {gap(view, robot)}")
        click.get_current_context().exit(exit_code)


def _print_list_json(
    reply_by_robot: Mapping[str, PushedPatternsReply],
    missing: Collection[str],
    marked: Collection[tuple[str, str]],
    code: int,
) -> None:
    robots = {
        robot: [
            {
                **fields(report, "name", "version"),
                "hash": report.digest,
                **fields(report, "pushed", "standing"),
                "ran": round(report.ran, 1),
                **fields(report, "issuer", "generation", "source", "text"),
                "differs": (robot, report.name) in marked,
            }
            for report in reply.patterns
        ]
        for robot, reply in reply_by_robot.items()
    }
    answer = {"robots": robots, "missing": list(missing), "exit_code": code}
    print_json("PushedPatterns", answer)
