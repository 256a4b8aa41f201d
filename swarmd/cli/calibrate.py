"""`swarmctl calibrate`: one robot measures its brakes, delays and scales by a few short drives."""

from __future__ import annotations

import datetime
import math
import os
import signal
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

import click

from swarmd.calibration.figures import DONE, PATTERN, Figure
from swarmd.cli import completion
from swarmd.cli.consent import need_consent
from swarmd.cli.options import FILE, CommonOptions, Failure, common_options
from swarmd.cli.output import print_json, print_table, rewrite, warn
from swarmd.cli.send import known_members
from swarmd.client.targets import check_known
from swarmd.core.clock import boottime
from swarmd.core.messages import Presence, Reason, State, Status
from swarmd.core.verbs import ResetRequest, RunRequest
from swarmd.network.operator.exit_codes import FAILED, REFUSED, TIMEOUT

if TYPE_CHECKING:
    from collections.abc import Mapping

    from swarmd.network.operator.operator import Operator

LONGEST = 600.0
"""Seconds after which the robot ends the run by itself, whatever becomes of swarmctl."""

_PERIOD = 0.5  # s between two queries of the robot
_SILENCE = 5.0  # s without an answer after which the robot counts as lost
_QUERY_TIME = 1.0  # s that a query may take
_NO_HOLD = (None, Reason.PROTECTION, Reason.NO_REQUESTED_COMMAND)


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
    one to three minutes, under protection. The measured figures are printed beside the values of
    the platform file, with a new platform file that has the measured values. All other robots
    within the range of the lidar must stand: moving objects make the figures less exact. Ctrl-C
    stops the robot.
    """
    if floor is not None and math.isnan(floor):
        raise click.UsageError("--floor nan is no length; give metres, such as 2.5")
    _check_file(write)
    with options.operator() as operator:
        view = known_members(options, operator)
        check_known(robot, view.members, view.roster)
        member = view.members[robot]
        is_alive = member.presence is Presence.ALIVE
        status = _resting_status(robot, member.status if is_alive else None)
        _check_wheels(robot, status)
        side_m = _floor(status) if floor is None else floor
        statuses = {name: other_member.status for name, other_member in view.members.items()}
        if moving := running_beside(statuses, robot):
            names = ", ".join(moving)
            warn(f"running: {names}; robots that move in sight make figures less exact")
        _confirm(robot, status.platform, side_m, yes)
        params = {"floor": side_m, "repeats": repeats}
        issued = options.began if yes else boottime()  # of the user's last word
        report, status = _measure(operator, robot, params, issued)
        _end_findings(operator, robot, status, report)
        _show(options, robot, status, report, write)


def _resting_status(robot: str, status: Status | None) -> Status:
    """The status of a robot that may be calibrated; Failure unless the robot answers and rests.

    `status`: the last status; None if the robot is not alive or has sent none.
    """
    if status is None:
        raise Failure(f"{robot} does not answer; see `swarmctl members`", TIMEOUT)
    if status.state not in (State.IDLE, State.STOPPED):
        activity = f"runs {status.pattern}" if status.pattern else f"is {status.state}"
        raise Failure(f"{robot} {activity}; nothing was sent; it must be idle or stopped", REFUSED)
    return status


def _check_wheels(robot: str, status: Status) -> None:
    """Failure for a drone, as far as its platform is known here."""
    from swarmd.settings.platforms import load_platform, platform_names

    if status.platform in platform_names() and load_platform(status.platform).is_drone:
        raise Failure(
            f"{robot} is a drone: the drives of a calibration are over before it has taken off;"
            f" nothing was sent; see swarmctl acceptance {robot}",
            REFUSED,
        )


def running_beside(statuses: Mapping[str, Status | None], robot: str) -> list[str]:
    """The robots other than `robot` that run a pattern."""
    return [
        name
        for name, status in statuses.items()
        if name != robot and status is not None and status.state is State.RUNNING
    ]


def _check_file(write: Path | None) -> None:
    """Ask before a file is overwritten, before anything moves."""
    if write is None:
        return
    if write.suffix != ".yaml":
        raise click.UsageError(f"--write {write}: a platform file must end in .yaml")
    if not write.parent.is_dir():
        raise click.UsageError(f"--write {write}: there is no folder {write.parent}")
    if not os.access(write if write.exists() else write.parent, os.W_OK):
        raise click.UsageError(f"--write {write}: cannot be written; check its permissions")
    if write.exists():
        if not sys.stdin.isatty():
            raise click.UsageError(f"{write} exists, and there is no terminal to ask; remove it")
        if not click.confirm(f"Overwrite {write}?", err=True):
            raise click.ClickException("nothing was sent")


def _floor(status: Status) -> float:
    """The side in m of the free floor that the robot needs, with the measured delay of scans."""
    from swarmd.calibration.floor import needed_floor
    from swarmd.settings.platforms import load_platform, platform_names

    platform, delay = status.platform, status.scan_delay
    if platform not in platform_names():
        raise click.UsageError(
            f"the platform file of {platform} is not known here; give --floor METRES, at least 2"
        )
    return needed_floor(load_platform(platform), 0.0 if delay is None else delay.added)


def _confirm(robot: str, platform: str, floor: float, yes: bool) -> None:
    square = f"{floor:g} x {floor:g} m"
    if yes:
        return
    warn(
        f"{robot} ({platform}) will drive to and fro, to both sides if its base moves sideways, and"
        " turn on the spot, for one to three minutes."
    )
    question = f"Is the floor free, {square} with {robot} in the middle, and does it stay free?"
    need_consent("calibrate", f"a floor of {square} around {robot} is free", question)


def _measure(
    operator: Operator, robot: str, params: dict[str, float], issued: float
) -> tuple[Mapping[str, object], Status]:
    """Run the calibration pattern; returns its report with the figures, and the last status.

    `issued`: when the user typed the command or said yes, in s on the clock since boot: a robot
    that was stopped since then refuses.
    Failure if the robot refuses, is lost or does not finish. The robot is stopped if it may still
    run the pattern when this function ends, for instance after Ctrl-C.
    """
    # These signals then raise KeyboardInterrupt, as Ctrl-C does, so that the robot is stopped.
    for signal_number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(signal_number, signal.default_int_handler)
    epochs = operator.members(timeout=_QUERY_TIME, needs_status=False).epochs((robot,))
    may_run = True  # until a reply or status shows that the robot does not run the pattern
    try:
        outcome = operator.request(
            RunRequest, epochs, issued=issued, pattern=PATTERN, params=params, seconds=LONGEST
        )
        if not outcome.applied:
            reply = outcome.replies.get(robot)
            may_run = reply is None  # the request may have arrived without its reply
            answer = "did not answer" if reply is None else f"{reply.code}: {reply.text}"
            raise Failure(f"{robot} {answer}", outcome.exit_code)
        status = _follow_on_terminal(operator, robot)
        may_run = False
        return _report(robot, status), status
    finally:
        if may_run:
            _stop(operator, robot)


def _follow_on_terminal(operator: Operator, robot: str) -> Status:
    """As `_follow`; then ends the line of `_print_step`, also after an error."""
    try:
        return _follow(operator, robot)
    finally:
        if sys.stderr.isatty():
            click.echo(err=True)


def _follow(operator: Operator, robot: str) -> Status:
    """The first status after the drives have ended; prints each step and each hold."""
    last_line, heard = "", time.monotonic()
    while True:
        member = operator.members(timeout=_QUERY_TIME).members.get(robot)
        now = time.monotonic()
        if member is not None and member.presence is Presence.FAILED:
            raise Failure(f"{robot} is lost: its daemon failed or its link is cut", TIMEOUT)
        status = None if member is None or member.presence is not Presence.ALIVE else member.status
        if status is None:
            if now - heard > _SILENCE:
                raise Failure(f"{robot} has not answered for {_SILENCE:g} s", TIMEOUT)
        else:
            heard = now
            if status.state is not State.RUNNING or status.pattern != PATTERN:
                return status
            is_held = status.reason not in _NO_HOLD
            line = f"held: {status.reason}" if is_held else str(status.report.get("step", "loads"))
            if line != last_line:
                _print_step(f"{robot}: {line}")
                last_line = line
        time.sleep(_PERIOD)


def _print_step(line: str) -> None:
    """Print the line on stderr; on a terminal it replaces the one before."""
    if sys.stderr.isatty():
        rewrite(line)
    else:
        warn(line)


def _report(robot: str, status: Status) -> Mapping[str, object]:
    """The report of a finished run; Failure, with the reason, for any other end."""
    from swarmd.calibration.report import usable_report

    if status.state is State.RUNNING:
        text = f"{robot} runs {status.pattern} now, by {status.changed_by}; no figures"
        raise Failure(text, FAILED)
    if status.state is not State.IDLE or status.reason is not Reason.FINISHED:
        detail = f": {status.detail}" if status.detail else ""
        text = f"{robot} did not finish: {status.state}, {status.reason}{detail}; no figures"
        raise Failure(text, FAILED)
    if status.report.get("state") != DONE:
        raise Failure(f"{robot}: {status.report.get('why', status.detail)}; no figures", REFUSED)
    report = usable_report(status.report, status.decision)
    if report is None:
        raise Failure(
            f"{robot}: protection limited {status.decision.duty:.1%} of the decisions, so that the"
            " figures are not those of the base; no figures; repeat it on a larger floor",
            FAILED,
        )
    return report


def _end_findings(
    operator: Operator, robot: str, status: Status, report: Mapping[str, object]
) -> None:
    """End those findings of the assumption monitor that the calibration disproves.

    A finding is a doubt of the robot, in words, such as that the brakes of an axis are weaker than
    its platform file says. `report`: the measured figures.
    """
    figure_texts = _disproved(robot, status, report)
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


def _disproved(robot: str, status: Status, report: Mapping[str, object]) -> dict[str, str]:
    """The disproved findings of a robot, each with the measured figure that disproves it, as text.

    Warns of each finding that is not disproved. The measured braking (m/s^2 or rad/s^2), less 2
    standard deviations, disproves a finding on brakes if this difference exceeds 85 % (SOUND) of
    the braking in the platform file.
    """
    from swarmd.protection.assumption_monitor import SOUND, axis_of

    figure_texts: dict[str, str] = {}
    for finding in status.findings:
        axis = axis_of(finding)
        if axis is None:  # the finding is not about brakes
            warn(
                f"{robot} keeps the finding: {finding}; a calibration does not measure it;"
                " see `swarmctl reset --findings`"
            )
            continue
        braking = Figure.parse(str(report[f"braking_{axis}"]))
        sure_braking = braking.value - 2.0 * braking.spread
        if braking.is_measured and sure_braking > SOUND * braking.assumed:
            figure_texts[finding] = f"{braking.value:.3g} +- {braking.spread:.2g}"
        else:
            warn(f"{robot} keeps the finding: {finding}; give it the platform file that follows")
    return figure_texts


def _stop(operator: Operator, robot: str) -> None:
    outcome = operator.send_stop("stop", select=lambda names: (), names=(robot,))
    reply = outcome.replies.get(robot)
    text = "no answer to the stop; use its switch" if reply is None else f"stopped: {reply.text}"
    warn(f"{robot}: {text}")


def _show(
    options: CommonOptions,
    robot: str,
    status: Status,
    report: Mapping[str, object],
    write: Path | None,
) -> None:
    """Print the measured figures, and print or write a platform file that has these figures.

    `report`: the report of the calibration pattern after its drives. `write`: the file to write;
    None: the platform file is printed. Failure if another version of swarmd made the report.
    """
    from swarmd.calibration.report import figures_of, sweep_of

    try:
        figures, sweep = figures_of(report), sweep_of(report)
        file_text = platform_text(robot, status, report)
    except ValueError as error:
        raise Failure(f"{robot} has another version of the calibration: {error}", FAILED) from None
    if options.is_json:
        figures_json = {name: _figure_json(figure) for name, figure in figures.items()}
        print_json("Calibration", {"robot": robot, "figures": figures_json, "file": file_text})
    else:
        _print_figures(figures)
        if sweep is not None:
            click.echo(f"scan.sweep: {sweep.value or f'not measured: {sweep.why}'}")
        if write is None:
            heading = "A platform file that follows (--write FILE writes it):"
            click.echo(f"\n{heading}\n\n{file_text}", nl=False)
    if write is not None:
        write.write_text(file_text)
        warn(f"wrote {write}; use it as `platform: {write.name}` in the robot's file")


def platform_text(robot: str, status: Status, report: Mapping[str, object]) -> str:
    """A platform file with the figures of a report, which extends the present file of the robot.

    ValueError if another version of swarmd made the report.
    """
    from swarmd.calibration.report import figures_of, platform_file, settings, sweep_of
    from swarmd.settings.platforms import platform_names

    platform, figures = status.platform, figures_of(report)
    fastest_speeds = tuple(map(float, str(report.get("drove")).split()))  # m/s, rad/s
    new_values = settings(figures, fastest_speeds, sweep_of(report))
    extends = platform if platform in platform_names() else f"./{platform}.yaml"
    today = datetime.date.today().isoformat()
    return platform_file(robot, extends, today, figures, new_values)


def _print_figures(figures: Mapping[str, Figure]) -> None:
    from swarmd.calibration.report import rows

    print_table(("FIGURE", "MEASURED", "SD", "SAMPLES", "PLATFORM"), rows(figures))
    for name, figure in figures.items():
        # The margin follows from the other figures, and is never measured.
        is_computed = name == "margin"
        if figure.why and not is_computed:
            click.echo(f"{name} is not measured: {figure.why}")


def _figure_json(figure: Figure) -> dict[str, object]:
    return {
        "value": _finite(figure.value),
        "sd": _finite(figure.spread),
        "samples": figure.samples,
        "assumed": _finite(figure.assumed),
        "why": figure.why,
    }


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
