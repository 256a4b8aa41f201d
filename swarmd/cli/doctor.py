"""`swarmctl doctor`: checks this machine and each robot, and prints what to do."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import click

from swarmd.cli.options import CommonOptions, common_options
from swarmd.cli.output import print_json, print_table
from swarmd.cli.targets import takes_targets
from swarmd.client.ask_robots import ASK_TIME, MAX_ANSWER, in_reach
from swarmd.client.known_robots import remember
from swarmd.client.targets import Targets, robots_of
from swarmd.core.codec import Decoder
from swarmd.core.errors import CodecError, ConfigError, NetworkError
from swarmd.core.finding import Finding, Level, warning
from swarmd.core.machine import measure_machine
from swarmd.core.verbs import DOCTOR
from swarmd.daemon.systemd import CONFIG_FILE
from swarmd.network.carriers.network_facts import measure_network
from swarmd.settings.yamlfile import read
from swarmd.texts import doctor as findings_of
from swarmd.texts.doctor import worst
from swarmd.texts.values import counted

if TYPE_CHECKING:
    from swarmd.network.operator.operator import Operator

LISTEN_TIME = 1.5  # s: each robot sends a beacon a second
HERE = "this machine"
_ORDER = (Level.FAULT, Level.WARNING, Level.UNKNOWN, Level.OK)
HEADER = ("LEVEL", "WHERE", "WHAT", "FINDING, AND WHAT TO DO")


class _Line(NamedTuple):
    where: str
    finding: Finding


@click.command()
@takes_targets(is_required=False)
@click.option("--problems", is_flag=True, help="Only what is not ok.")
@common_options
def doctor(options: CommonOptions, targets: Targets, problems: bool) -> None:
    """Check this machine, and TARGETS or all robots: network, clocks, keys, disks, load.

    The worst findings come first; robots with an equal finding share a line. If no robot is heard,
    this machine is checked alone. Exit code 1 if there is a fault; a warning is no fault, nor is a
    figure that could not be measured.
    """
    lines: list[_Line] = [_Line(HERE, one) for one in findings_of.of_machine(measure_machine(()))]
    lines += [_Line(HERE, one) for one in _of_daemon_file(CONFIG_FILE)]
    try:
        with options.operator() as operator:
            lines += _of_this_network(operator)
            lines += _of_robots(options, operator, targets)
    except (ConfigError, NetworkError) as error:
        lines.append(_Line(HERE, Finding("network", False, str(error))))
    level = worst(line.finding for line in lines)
    if options.is_json:
        print_json("Doctor", {"worst": level.value, "findings": [_record(line) for line in lines]})
    else:
        _print(lines, only_problems=problems)
    click.get_current_context().exit(1 if level is Level.FAULT else 0)


def _of_daemon_file(path: Path) -> Iterator[Finding]:
    """Yields a fault if the file of a daemon on this machine is no YAML."""
    try:
        if os.access(path, os.R_OK):
            read(path)
    except ConfigError as error:
        yield Finding("settings", False, str(error), "mend the file: the daemon starts only then")


def _of_this_network(operator: Operator) -> Iterator[_Line]:
    facts = measure_network(operator.settings.interface_name)
    for finding in findings_of.of_network(facts, is_robot=False):
        yield _Line(HERE, finding)
    if operator.identity is not None:
        expires = float(operator.identity.info.expires)
        yield _Line(HERE, findings_of.identity(expires, time.time()))


def _of_robots(options: CommonOptions, operator: Operator, targets: Targets) -> Iterator[_Line]:
    """Yields the findings about the targeted robots, from the answers to a query of each.

    A robot without a readable answer gets a single finding. Without any robot: a warning.
    """
    view = operator.members(timeout=options.timeout)
    remember(operator.settings, view)
    if not view.members and not view.roster and targets.is_whole_swarm:
        text = f"no robot of swarm {operator.settings.swarm!r} is heard"
        if other_swarms := ", ".join(operator.swarms()):
            text += f"; swarms: {other_swarms}"
        remedy = "start swarmd; see --swarm, --profile and --interface"
        yield _Line("swarm", warning("robots", text, remedy))
        return
    robots = robots_of(view, targets)
    # Each robot sends a beacon a second. The findings tell by which ways the beacons arrive here.
    time.sleep(LISTEN_TIME)
    reachable = in_reach(view, robots)
    for robot in robots:
        other_robots = set(view.alive) - {robot}  # robots that `robot` should hear
        timeout = (options.timeout or ASK_TIME) if robot in reachable else None
        for finding in findings_of_robot(operator, robot, len(other_robots), timeout):
            yield _Line(robot, finding)


def findings_of_robot(
    operator: Operator, robot: str, others: int, timeout: float | None
) -> Iterator[Finding]:
    """Yields the findings about a robot, from its answer to a query.

    `others`: how many other robots `robot` should hear. `timeout`: the longest wait for the answer
    in s; None for a robot out of reach, which is not queried.
    """
    answer = None
    sent_at = time.time()
    if timeout is not None:
        answer = operator.ask(robot, DOCTOR.name, timeout=timeout)
    returned_at = time.time()
    if answer is None:
        remedy = "see swarmctl members; look at its power, its network and its daemon"
        yield Finding("answer", False, "it does not answer", remedy)
        return
    try:
        reply = Decoder(DOCTOR.answer, MAX_ANSWER)(answer)
    except CodecError as error:
        remedy = "install the same version everywhere"
        yield Finding("answer", False, f"unreadable: {error}", remedy)
        return
    # The robot read its clock between `sent_at` and `returned_at`: in their middle, within half of
    # the time between them.
    answered_at = 0.5 * (sent_at + returned_at)
    yield from findings_of.of_robot(
        reply,
        skew=reply.machine.wall - answered_at,
        error=0.5 * (returned_at - sent_at),
        version=version("swarmd"),
        ways=operator.ways(robot),
        others=others,
        now=returned_at,
        roster=None if operator.identity is None else operator.identity.roster.generation,
    )


def _print(lines: list[_Line], *, only_problems: bool) -> None:
    print_table(HEADER, rows_of(lines, only_problems=only_problems))
    count = {level: sum(line.finding.level is level for line in lines) for level in Level}
    faults, warnings = (counted(count[level], level) for level in (Level.FAULT, Level.WARNING))
    click.echo(f"{len(lines)} checked: {faults}, {warnings}, {count[Level.UNKNOWN]} not known")


def rows_of(
    lines: Sequence[tuple[str, Finding]], *, only_problems: bool
) -> list[tuple[str, str, str, str]]:
    """The cells below HEADER, the worst first; equal findings of several robots are one row."""
    where_of: dict[Finding, list[str]] = {}
    for where, finding in lines:
        if not only_problems or finding.level is not Level.OK:
            where_of.setdefault(finding, []).append(where)
    everywhere = len({where for where, _ in lines} - {HERE})
    rows = []
    for finding, places in sorted(where_of.items(), key=lambda item: _ORDER.index(item[0].level)):
        robots = [place for place in places if place != HERE]
        is_all = len(robots) == everywhere > 1
        names = [f"all {everywhere} robots"] if is_all else robots
        where = ", ".join([*([HERE] if HERE in places else []), *names])
        text = finding.text + (f"; {finding.remedy}" if finding.remedy else "")
        rows.append((finding.level.value, where, finding.subject, text))
    return rows


def _record(line: _Line) -> dict[str, str]:
    finding = line.finding
    return {
        "level": finding.level.value,
        "where": line.where,
        "what": finding.subject,
        "finding": finding.text,
        "remedy": finding.remedy,
    }
