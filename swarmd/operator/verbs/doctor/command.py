"""`swarmctl doctor`: checks this machine and each robot, and prints what to do."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

from swarmd.core.errors import ConfigError, NetworkError
from swarmd.core.finding import Finding, warning
from swarmd.core.machine import measure_machine
from swarmd.daemon.systemd import CONFIG_FILE
from swarmd.link.carriers.network_facts import measure_network
from swarmd.operator.cli.findings import HERE, Line, exit_code_of, print_findings
from swarmd.operator.cli.options import CommonOptions, common_options
from swarmd.operator.cli.output import print_json
from swarmd.operator.cli.targets import takes_targets
from swarmd.operator.session.session import ASK_TIME, in_reach
from swarmd.operator.session.targets import Targets, remember, robots_of
from swarmd.operator.texts import doctor as findings_of
from swarmd.operator.texts.doctor import worst
from swarmd.operator.verbs.doctor.ask import LISTEN_TIME, findings_of_robot
from swarmd.settings.yamlfile import read

if TYPE_CHECKING:
    from swarmd.operator.session.operator import Operator


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
    lines: list[Line] = [Line(HERE, one) for one in findings_of.of_machine(measure_machine(()))]
    lines += [Line(HERE, one) for one in _of_daemon_file(CONFIG_FILE)]
    try:
        with options.operator() as operator:
            lines += _of_this_network(operator)
            lines += _of_robots(options, operator, targets)
    except (ConfigError, NetworkError) as error:
        lines.append(Line(HERE, Finding("network", False, str(error))))
    if options.is_json:
        level = worst(line.finding for line in lines)
        print_json("Doctor", {"worst": level.value, "findings": [_record(line) for line in lines]})
    else:
        print_findings(lines, only_problems=problems)
    click.get_current_context().exit(exit_code_of(lines))


def _of_daemon_file(path: Path) -> Iterator[Finding]:
    """Yields a fault if the file of a daemon on this machine is no YAML."""
    try:
        if os.access(path, os.R_OK):
            read(path)
    except ConfigError as error:
        yield Finding("settings", False, str(error), "mend the file: the daemon starts only then")


def _of_this_network(operator: Operator) -> Iterator[Line]:
    facts = measure_network(operator.settings.interface_name)
    for finding in findings_of.of_network(facts, is_robot=False):
        yield Line(HERE, finding)
    if operator.identity is not None:
        expires = float(operator.identity.info.expires)
        yield Line(HERE, findings_of.identity(expires, time.time()))


def _of_robots(options: CommonOptions, operator: Operator, targets: Targets) -> Iterator[Line]:
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
        yield Line("swarm", warning("robots", text, remedy))
        return
    robots = robots_of(view, targets)
    # Each robot sends a beacon a second. The findings tell by which ways the beacons arrive here.
    time.sleep(LISTEN_TIME)
    reachable = in_reach(view, robots)
    for robot in robots:
        timeout = (options.timeout or ASK_TIME) if robot in reachable else None
        for finding in findings_of_robot(operator, view, robot, timeout):
            yield Line(robot, finding)


def _record(line: Line) -> dict[str, str]:
    finding = line.finding
    return {
        "level": finding.level.value,
        "where": line.where,
        "what": finding.subject,
        "finding": finding.text,
        "remedy": finding.remedy,
    }
