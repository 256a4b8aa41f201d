"""`swarmctl acceptance`: a guided acceptance test of one robot, and the file that remains of it."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click
import msgspec

from swarmd.operator.cli import completion
from swarmd.operator.cli.consent import has_terminal
from swarmd.operator.cli.dialogue import Terminal, say, sessions_of
from swarmd.operator.cli.options import EXISTING_FILE, FOLDER, CommonOptions, common_options
from swarmd.operator.cli.output import print_json, signals_end
from swarmd.operator.cli.send import session_of

if TYPE_CHECKING:
    from swarmd.core.finding import Finding
    from swarmd.operator.verbs.acceptance.ask import Accepted


@click.command()
@click.argument("robot", required=False, shell_complete=completion.robots)
@click.option("--only", metavar="PART", help="Only this part, such as B, or this step, such as B1.")
@click.option("--print", "prints", is_flag=True, help="Print the checklist; nothing is asked.")
@click.option(
    "--show", type=EXISTING_FILE, metavar="FILE", help="Show the results in a file of this test."
)
@click.option(
    "-d",
    "--folder",
    type=FOLDER,
    help="Where the results gather; a test in it goes on [acceptance-ROBOT].",
)
@click.option(
    "--daemon-config",
    type=EXISTING_FILE,
    metavar="FILE",
    help="On the robot itself: the file of its daemon, for the step of swarmd --check.",
)
@click.option(
    "--keep-names", is_flag=True, help="Keep host names, users and addresses in the file."
)
@common_options
def acceptance(
    options: CommonOptions,
    robot: str | None,
    only: str | None,
    prints: bool,
    show: Path | None,
    folder: Path | None,
    daemon_config: Path | None,
    keep_names: bool,
) -> None:
    """Guide a person through the acceptance test of ROBOT, and write one file with its results.

    Part A moves nothing, B tests stops on lifted wheels, C calibrates, D drives towards a box. Each
    step says why it is asked and what to prepare. Before each motion the test says what moves, how
    far and how fast, and asks. Any key stops the robot. The test can be interrupted (q, Ctrl-C) and
    goes on with the same line. Exit code 1 if a step has failed.
    """
    if show is not None:
        _show(options, show)
        return
    if robot is None:
        raise click.UsageError("acceptance needs a ROBOT, or --show FILE")
    if prints:
        _print_checklist(options, robot, only)
        return
    if not has_terminal():
        raise click.UsageError("acceptance asks before each motion, and there is no terminal")
    folder = folder or Path(f"acceptance-{robot}")
    accepted = _test(options, robot, folder, only, daemon_config, keep_names)
    click.get_current_context().exit(accepted.exit_code)


def _test(
    options: CommonOptions,
    robot: str,
    folder: Path,
    only: str | None,
    config: Path | None,
    keep_names: bool,
) -> Accepted:
    """Carry the test out at this terminal; what it has found."""
    from swarmd.operator.verbs.acceptance.ask import accept

    _platform_name(options, robot)
    say(f"{robot}: a short recording tells its platform ...", err=True)
    # These signals end the program as Ctrl-C does, so that the robot is stopped.
    with signals_end(), sessions_of(options) as sessions:
        accepted = accept(
            sessions,
            robot,
            _rows(only),
            folder,
            Terminal(),
            check=None if config is None else partial(_check_daemon, config),
            keep_names=keep_names,
        )
    record = accepted.record
    path = accepted.file
    say(record.headline + ("" if record.is_whole else "; the same command goes on"))
    say(f"The results: {path}; open report.html in it, or swarmctl acceptance --show {path}")
    return accepted


def _rows(only: str | None) -> tuple[str, ...]:
    return () if only is None else (only,)


def _check_daemon(config: Path) -> Sequence[Finding]:
    """The findings of `swarmd --check` on this machine."""
    from swarmd.operator.cli.preflight import findings_of
    from swarmd.settings.settings import load_daemon_settings

    return findings_of(load_daemon_settings(config, {}))


def _print_checklist(options: CommonOptions, robot: str, only: str | None) -> None:
    """Print the steps for a robot of this platform, as a page for the hall."""
    from swarmd.operator.acceptance.steps import PARTS, steps_of
    from swarmd.operator.verbs.acceptance.results import wanted_steps
    from swarmd.settings.platforms import load_platform

    part = ""
    steps = steps_of(load_platform(_platform_name(options, robot)))
    for step in wanted_steps(steps, _rows(only)):
        if step.id[0] != part:
            part = step.id[0]
            say(f"\nPart {part}: {PARTS[part]}")
        say(f"\n[ ] {step.id} {step.name}. {step.why}")
        say(step.prepare, "    ")
        if step.motion is not None:
            say(f"Moves: {step.motion.text}. {step.question}", "    ")


def _platform_name(options: CommonOptions, robot: str) -> str:
    """The platform of a robot; RequestError if it is not known, or does not answer."""
    from swarmd.operator.verbs.acceptance.ask import status_of

    with options.operator() as operator:
        return status_of(session_of(options, operator), robot).platform


def _show(options: CommonOptions, path: Path) -> None:
    """Print the results in a file."""
    from swarmd.operator.acceptance.result_file import read_record

    record = read_record(path)
    if options.is_json:
        print_json("Acceptance", msgspec.to_builtins(record))
        return
    say(f"{record.robot} ({record.platform}, {record.driver}), {record.began}")
    say(record.headline)
    for step in record.steps:
        verdict = step.verdict
        figure = f" {verdict.figure}:" if verdict.figure else ""
        say(f"{step.id} {step.name}: {verdict.result.upper()}{figure} {verdict.reason}")
