"""`swarmctl acceptance`: a guided acceptance test of one robot, and the file that remains of it."""

from __future__ import annotations

import datetime
import platform as machine
import socket
import time
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

import click
import msgspec

from swarmd.operator.cli import completion
from swarmd.operator.cli.consent import has_terminal
from swarmd.operator.cli.dialogue import Talk, Terminal, say
from swarmd.operator.cli.options import (
    EXISTING_FILE,
    FOLDER,
    CommonOptions,
    common_options,
)
from swarmd.operator.cli.output import print_json, signals_end
from swarmd.operator.session.exit_codes import FAILED

if TYPE_CHECKING:
    from swarmd.operator.acceptance.result_file import AcceptanceRecord
    from swarmd.operator.acceptance.step import Step
    from swarmd.operator.acceptance.verdict import Verdict
    from swarmd.operator.cli.acceptance_robot import TestedRobot


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
    record = _test(options, robot, folder, only, daemon_config, keep_names)
    from swarmd.operator.acceptance.verdict import Result

    click.get_current_context().exit(FAILED if record.counts[Result.FAIL] else 0)


def _test(
    options: CommonOptions,
    robot: str,
    folder: Path,
    only: str | None,
    config: Path | None,
    keep_names: bool,
) -> AcceptanceRecord:
    """Carry the test out, and write the file; the record of all steps so far."""
    from swarmd.operator.acceptance.dialogue import Dialogue
    from swarmd.operator.acceptance.result_file import record_for
    from swarmd.operator.acceptance.steps import steps_of
    from swarmd.operator.cli.acceptance_robot import TestedRobot

    _platform_name(options, robot)
    folder.mkdir(parents=True, exist_ok=True)
    # These signals end the program as Ctrl-C does, so that the robot is stopped.
    with signals_end(), TestedRobot(options, robot, folder, config) as tested:
        say(f"{robot}: a short recording tells its platform ...", err=True)
        tested.open()
        steps = steps_of(tested.platform)
        results = Results(folder, record_for(folder, _new_record(tested)), steps)
        _keep_platform(results.record.platform, folder / "platform-before.yaml")
        wanted = _wanted(steps, only)
        known = results.known
        known.pop(only or "", None)
        Talk(Dialogue(wanted, known), tested, Terminal(), results).run()
    record = results.record
    path = _write_file(folder, record, keep_names)
    say(record.headline + ("" if record.is_whole else "; the same command goes on"))
    say(f"The results: {path}; open report.html in it, or swarmctl acceptance --show {path}")
    return record


def _wanted(steps: Sequence[Step], only: str | None) -> list[Step]:
    """The steps of a part, or the step of this id and those that read what it measures.

    UsageError if there is none.
    """
    wanted = [
        one
        for one in steps
        if only is None or only in (one.id, one.id[0]) or (len(only) > 1 and one.reads(only))
    ]
    if not wanted:
        raise click.UsageError(f"--only {only}: no such part or step; parts are A, B, C and D")
    return wanted


def _keep_platform(name: str, path: Path) -> None:
    """Write the platform file with which a test begins; nothing if it is there, or not known."""
    from swarmd.settings.platforms import platform_names, platform_sources
    from swarmd.settings.yamlfile import text_of

    if name in platform_names() and not path.exists():
        _, content = platform_sources(name)[0]
        path.write_text(text_of(content), encoding="utf-8")


def _new_record(tested: TestedRobot) -> AcceptanceRecord:
    """A record without steps."""
    from swarmd.operator.acceptance.result_file import AcceptanceRecord, subject_of
    from swarmd.operator.session.operator_text import operator_name

    setup = tested.head.identity.setup
    platform = tested.head.identity.platform
    status = tested.status()
    versions = {
        "swarmd": setup.version,
        "swarmctl": version("swarmd"),
        "kernels": setup.kernels,
        "python": machine.python_version(),
        "system": machine.platform(),
    }
    return AcceptanceRecord(
        robot=tested.robot,
        platform=platform.name,
        driver=setup.driver,
        began=datetime.datetime.now(datetime.UTC).date().isoformat(),
        versions=versions,
        private=(
            *operator_name().split("@"),
            socket.gethostname(),
            *(() if status is None else (status.host,)),
        ),
        subject=subject_of(tested.head),
    )


class Results:
    """The results of a test in a folder, on the disk at once."""

    def __init__(self, folder: Path, record: AcceptanceRecord, steps: Sequence[Step]) -> None:
        self._folder = folder
        self.record = record
        self._steps = steps
        self._write()

    @property
    def known(self) -> dict[str, Verdict]:
        """The verdicts that count now."""
        return self.record.verdicts_on(self._steps, time.time())

    def outdated(self, step: Step) -> str:
        """The step whose pass is too old to let `step` move the robot; empty without one."""
        known = self.known
        return next((id for id in step.needs if id not in known), "")

    def keep(self, step: Step, verdict: Verdict) -> None:
        """Keep the verdict of a step."""
        from swarmd.operator.acceptance.result_file import recordings_in, result_of, with_step

        names = [path.name for path in recordings_in(self._folder, step.id)]
        result = result_of(step, verdict, names, time.time(), self.record.subject)
        self.record = with_step(self.record, result, [one.id for one in self._steps])
        self._write()

    def end(self, *, is_whole: bool) -> None:
        """Note whether all steps were asked, by this dialogue and those before."""
        asked = {step.id for step in self.record.steps}
        is_whole = is_whole and asked >= {step.id for step in self._steps}
        self.record = msgspec.structs.replace(self.record, is_whole=is_whole)
        self._write()

    def _write(self) -> None:
        from swarmd.operator.acceptance.result_file import write_record

        write_record(self._folder, self.record)


def _write_file(folder: Path, record: AcceptanceRecord, keep_names: bool) -> Path:
    """Write the one file beside the folder; its path."""
    from swarmd.daemon.recording.reader import read_file
    from swarmd.operator.acceptance.html_report import page
    from swarmd.operator.acceptance.redaction import Mask
    from swarmd.operator.acceptance.result_file import RECORDINGS, write_file
    from swarmd.operator.acceptance.samples import read_samples

    path = folder.with_name(f"acceptance-{record.robot}-{record.began}.zip")
    recordings = folder / RECORDINGS
    samples = {
        step.id: read_samples(read_file(recordings / name) for name in step.recordings)
        for step in record.steps
        if step.recordings
    }
    write_file(folder, path, page(record, samples), Mask(record.private, is_on=not keep_names))
    return path


def _print_checklist(options: CommonOptions, robot: str, only: str | None) -> None:
    """Print the steps for a robot of this platform, as a page for the hall."""
    from swarmd.operator.acceptance.steps import PARTS, steps_of
    from swarmd.settings.platforms import load_platform

    part = ""
    for step in _wanted(steps_of(load_platform(_platform_name(options, robot))), only):
        if step.id[0] != part:
            part = step.id[0]
            say(f"\nPart {part}: {PARTS[part]}")
        say(f"\n[ ] {step.id} {step.name}. {step.why}")
        say(step.prepare, "    ")
        if step.motion is not None:
            say(f"Moves: {step.motion.text}. {step.question}", "    ")


def _platform_name(options: CommonOptions, robot: str) -> str:
    """The platform of a robot; Failure if it is not known, or does not answer."""
    from swarmd.operator.cli.acceptance_robot import status_of

    with options.operator() as operator:
        return status_of(options, operator, robot).platform


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
