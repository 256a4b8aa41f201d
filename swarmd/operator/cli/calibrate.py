"""`swarmctl calibrate`: the calibration step of the acceptance test, and what follows from it."""

from __future__ import annotations

import datetime
import math
import os
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from swarmd.core.messages import State, Status
from swarmd.core.verbs import ResetRequest
from swarmd.operator.cli import completion
from swarmd.operator.cli.consent import has_terminal
from swarmd.operator.cli.dialogue import GivenYes, Terminal, sessions_of
from swarmd.operator.cli.options import FILE, CommonOptions, Failure, common_options
from swarmd.operator.cli.output import print_json, signals_end, warn
from swarmd.operator.cli.send import session_of
from swarmd.operator.session.exit_codes import FAILED, REFUSED

if TYPE_CHECKING:
    from collections.abc import Mapping

    from swarmd.core.values import Platform
    from swarmd.operator.acceptance.verdict import Verdict
    from swarmd.operator.calibration.figures import Figure
    from swarmd.operator.session.operator import Operator
    from swarmd.operator.verbs.acceptance.tested_robot import TestedRobot


@click.command()
@click.argument("robot", shell_complete=completion.robots)
@click.option(
    "--floor",
    type=click.FloatRange(0.5, 50.0),
    metavar="METRES",
    help="Side of the free square floor around the robot [what its platform needs, at least 2].",
)
@click.option(
    "--repeats",
    type=click.IntRange(1, 20),
    default=4,
    help="Drives to and fro at each of two speeds [4]; fewer are less exact.",
)
@click.option(
    "-w",
    "--write",
    type=FILE,
    metavar="FILE",
    help="Write the platform file that follows, which must end in .yaml.",
)
@click.option(
    "-y", "--yes", is_flag=True, help="Do not ask for the floor; required without a terminal."
)
@common_options
def calibrate(
    options: CommonOptions,
    robot: str,
    floor: float | None,
    repeats: int,
    write: Path | None,
    yes: bool,
) -> None:
    """Measure brakes, delays and scales of ROBOT by a few short drives.

    The robot stands in the middle of a free floor. The robot first checks that the floor is free.
    Then it drives to and fro, to both sides if its base moves sideways, and turns on the spot, for
    one to three minutes, under protection. A new platform file with the measured figures is
    printed. All other robots within the range of the lidar must stand: moving objects make the
    figures less exact. Any key stops the robot; with --yes, Ctrl-C. Exit code 7 if nothing was
    measured, 1 if a drive failed.
    """
    if floor is not None and math.isnan(floor):
        raise click.UsageError("--floor nan is no length; give metres, such as 2.5")
    if not yes and not has_terminal():
        raise click.UsageError(
            "calibrate asks before the robot moves, and there is no terminal; nothing was sent;"
            " check that the floor is free, and add --yes"
        )
    _check_file(write)
    from swarmd.operator.verbs.acceptance.ask import status_of
    from swarmd.operator.verbs.acceptance.tested_robot import TestedRobot

    with (
        signals_end(),
        options.operator() as operator,
        tempfile.TemporaryDirectory() as folder,
        sessions_of(options) as sessions,
        TestedRobot(sessions, robot, Path(folder)) as tested,
    ):
        status = status_of(session_of(options, operator), robot)
        if status.state not in (State.IDLE, State.STOPPED):
            activity = f"runs {status.pattern}" if status.pattern else f"is {status.state}"
            text = f"{robot} {activity}; nothing was sent; it must be idle or stopped"
            raise Failure(text, REFUSED)
        verdict = _ask_and_drive(tested, status, floor, repeats, options.began if yes else None)
        if verdict is None:
            raise click.Abort
        from swarmd.operator.acceptance.verdict import Result

        if verdict.result is not Result.PASS:
            code = FAILED if verdict.result is Result.FAIL else REFUSED
            raise Failure(f"{robot}: {verdict.reason}", code)
        _show(options, robot, status.platform, verdict.values, write)
        if (last_status := tested.status()) is not None:
            _end_findings(operator, robot, last_status, tested.platform, verdict)


def _ask_and_drive(
    tested: TestedRobot, status: Status, floor: float | None, repeats: int, said_at: float | None
) -> Verdict | None:
    """The verdict of the calibration step, which the dialogue asks; None if it was interrupted.

    `status`: before the step. `floor`: the side of the free floor in m; None: what the robot needs.
    `said_at`: when the person said yes, in s on the clock since boot; None: the dialogue asks.
    """
    from swarmd.operator.acceptance.dialogue import Dialogue
    from swarmd.operator.acceptance.step import Work
    from swarmd.operator.acceptance.steps import calibration_step
    from swarmd.operator.calibration.floor import needed_floor
    from swarmd.operator.verbs.acceptance.talk import Talk
    from swarmd.settings.platforms import load_platform, platform_names

    name = status.platform
    tested.open(load_platform(name) if name in platform_names() else None)
    if tested.platform.is_drone:
        raise Failure(
            f"{tested.robot} is a drone: the drives of a calibration are over before it has taken"
            f" off; nothing was sent; see swarmctl acceptance {tested.robot}",
            REFUSED,
        )
    late = 0.0 if status.scan_delay is None else status.scan_delay.added
    step = calibration_step(tested.platform, floor or needed_floor(tested.platform, late), repeats)
    step = replace(step, work=Work.NOTHING, needs=())
    dialogue = Dialogue([step], {})
    Talk(dialogue, tested, Terminal() if said_at is None else GivenYes(said_at)).run()
    return dialogue.verdicts.get(step.id)


def _check_file(write: Path | None) -> None:
    """Ask before a file is overwritten, before anything moves."""
    if write is None:
        return
    if write.suffix != ".yaml":
        raise click.UsageError(f"--write {write}: a platform file must end in .yaml")
    if not os.access(write if write.exists() else write.parent, os.W_OK):
        raise click.UsageError(f"--write {write}: cannot be written; check folder and permissions")
    if write.exists():
        if not has_terminal():
            raise click.UsageError(f"{write} exists, and there is no terminal to ask; remove it")
        click.confirm(f"Overwrite {write}?", err=True, abort=True)


def _end_findings(
    operator: Operator, robot: str, status: Status, platform: Platform, calibrated: Verdict
) -> None:
    """End those findings of the assumption monitor that the calibration disproves.

    A finding is a doubt of the robot, in words, such as that the brakes of an axis are weaker than
    its platform file says. The step of the brakes in the acceptance test tells whether the measured
    ones disprove it. Warns of each finding that stays.
    """
    from swarmd.operator.acceptance.calibrated import brakes
    from swarmd.operator.acceptance.evidence import Evidence
    from swarmd.operator.acceptance.verdict import Result
    from swarmd.robot.protection.assumption_monitor import axis_of

    evidence = Evidence(platform, earlier={"C2": calibrated})
    figure_texts: dict[str, str] = {}
    for finding in status.findings:
        axis = axis_of(finding)
        remedy = "give it the new platform file"
        if axis is None:  # the finding is not about brakes
            remedy = "a calibration does not measure it; see `swarmctl reset --findings`"
        elif (verdict := brakes("C2", f"braking_{axis}")(evidence)).result is Result.PASS:
            figure_texts[finding] = verdict.figure
            continue
        warn(f"{robot} keeps the finding: {finding}; {remedy}")
    if not figure_texts:
        return
    outcome = operator.request(
        ResetRequest,
        {robot: status.epoch},
        findings=tuple(figure_texts),
        reason=f"calibrated: {', '.join(figure_texts.values())}",
    )
    result = "ended"
    if not outcome.applied:
        reply = outcome.replies.get(robot)
        result = f"not ended ({'no answer' if reply is None else reply.text})"
    for finding, figure_text in figure_texts.items():
        warn(f"{robot}: {result}: {finding}; now {figure_text}")


def _show(
    options: CommonOptions,
    robot: str,
    platform: str,
    report: Mapping[str, object],
    write: Path | None,
) -> None:
    """Print or write a platform file with the measured figures.

    `platform`: the name of the present file. `report`: the report of the calibration pattern after
    its drives. `write`: the file to write; None: the platform file is printed. Failure if another
    version of swarmd made the report.
    """
    from swarmd.operator.calibration.report import figures_of, measured_file

    try:
        figures = {name: _figure_json(figure) for name, figure in figures_of(report).items()}
        file_text = measured_file(robot, platform, datetime.date.today().isoformat(), report)
    except ValueError as error:
        raise Failure(f"{robot} has another version of the calibration: {error}", FAILED) from None
    if options.is_json:
        print_json("Calibration", {"robot": robot, "figures": figures, "file": file_text})
    elif write is None:
        click.echo(file_text, nl=False)
    if write is not None:
        write.write_text(file_text)
        warn(f"wrote {write}; use it as `platform: {write.name}` in the robot's file")


def _figure_json(figure: Figure) -> dict[str, object]:
    """The figure as in JSON, which has no NaN."""
    values = {"value": figure.value, "sd": figure.spread, "assumed": figure.assumed}
    finite = {name: one if math.isfinite(one) else None for name, one in values.items()}
    return {**finite, "samples": figure.samples, "why": figure.why}
