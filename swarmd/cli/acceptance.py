"""`swarmctl acceptance`: a guided acceptance test of one robot, and the file that remains of it."""

from __future__ import annotations

import datetime
import os
import platform as machine
import select
import socket
import sys
import termios
import textwrap
import time
import tty
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import msgspec

from swarmd.cli import completion
from swarmd.cli.options import (
    EXISTING_FILE,
    FOLDER,
    CommonOptions,
    Failure,
    common_options,
)
from swarmd.cli.output import print_json, rewrite, signals_end, terminal_width, warn
from swarmd.client.input_watch import TOO_LATE, InputWatch
from swarmd.core.clock import boottime
from swarmd.network.operator.exit_codes import FAILED

if TYPE_CHECKING:
    from swarmd.acceptance.dialogue import Action, Dialogue, Input
    from swarmd.acceptance.result_file import AcceptanceRecord
    from swarmd.acceptance.step import Step
    from swarmd.cli.acceptance_robot import TestedRobot

_PERIOD = 0.05  # s between two looks at the keyboard and at the robot
_WIDEST = 78  # columns of a line


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
    if not sys.stdin.isatty():
        raise click.UsageError("acceptance asks before each motion, and there is no terminal")
    folder = folder or Path(f"acceptance-{robot}")
    record = _test(options, robot, folder, only, daemon_config, keep_names)
    from swarmd.acceptance.verdict import Result

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
    from swarmd.acceptance.dialogue import Dialogue
    from swarmd.acceptance.result_file import record_for, write_record
    from swarmd.acceptance.steps import steps_of
    from swarmd.cli.acceptance_robot import TestedRobot

    _platform_name(options, robot)
    folder.mkdir(parents=True, exist_ok=True)
    # These signals end the program as Ctrl-C does, so that the robot is stopped.
    with signals_end(), TestedRobot(options, robot, folder, config) as tested:
        _say(f"{robot}: a short recording tells its platform ...")
        tested.open()
        steps = steps_of(tested.head.identity.platform)
        record = record_for(folder, _new_record(tested))
        _keep_platform(record.platform, folder / "platform-before.yaml")
        write_record(folder, record)
        wanted = _wanted(steps, only)
        known = record.verdicts_on(steps, time.time())
        known.pop(only or "", None)
        dialogue = Dialogue(wanted, known)
        talk = _Talk(dialogue, tested, folder, record, [step.id for step in steps])
        talk.run()
    path = _write_file(folder, talk.record, keep_names)
    _say(talk.record.headline + ("" if talk.record.is_whole else "; the same command goes on"))
    _say(f"The results: {path}; open report.html in it, or swarmctl acceptance --show {path}")
    return talk.record


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
        path.write_text(text_of(content))


def _new_record(tested: TestedRobot) -> AcceptanceRecord:
    """A record without steps."""
    from swarmd.acceptance.result_file import AcceptanceRecord, subject_of

    setup, platform = tested.head.identity.setup, tested.head.identity.platform
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
        private=(*_own_names(), *(() if status is None else (status.host,))),
        subject=subject_of(tested.head),
    )


def _own_names() -> tuple[str, ...]:
    """The names of this user and machine."""
    from swarmd.network.operator.operator_text import operator_name

    return (*operator_name().split("@"), socket.gethostname())


class _Talk:
    """Carries out the actions of a dialogue on a terminal."""

    def __init__(
        self,
        dialogue: Dialogue,
        robot: TestedRobot,
        folder: Path,
        record: AcceptanceRecord,
        order: list[str],
    ) -> None:
        self.record = record
        self._dialogue, self._robot, self._folder, self._order = dialogue, robot, folder, order
        self._terminal = _Terminal()
        self._end = ""
        self._told_at = 0.0  # s of the last line of progress

    def run(self) -> None:
        """Talk until the dialogue ends; Ctrl-C, signals and errors stop a robot that may move."""
        from swarmd.acceptance.dialogue import Closed, Tick

        self._carry_out(self._dialogue.begin(time.monotonic()))
        try:
            while not self._end:
                self._take(self._terminal.read(self._is_asked, _PERIOD))
                while not self._robot.inputs.empty():
                    self._take(self._robot.inputs.get())
                self._take(Tick())
                self._robot.check()
                self._tell_progress()
        except (KeyboardInterrupt, SystemExit):
            rewrite("")
        finally:
            self._take(Closed())  # stops a robot that may move, after any error
            self._terminal.close()
            self._robot.wait_for_stop()

    @property
    def _is_asked(self) -> bool:
        return self._dialogue.phase == "asked"

    def _take(self, input: Input | None) -> None:
        if input is not None:
            self._carry_out(self._dialogue.take(input, time.monotonic()))

    def _carry_out(self, actions: Sequence[Action]) -> None:
        from swarmd.acceptance import dialogue

        for action in actions:
            match action:
                case dialogue.Ask(step=step):
                    self._ask(step)
                case dialogue.Tell(text=text):
                    _say(text)
                case dialogue.Begin(step=step):
                    if not step.is_asked:
                        self._head(step)
                    self._begin(step)
                case dialogue.Bring(end=end):
                    self._robot.bring(end)
                case dialogue.Stop():
                    self._robot.stop()
                case dialogue.Judge(step=step):
                    self._robot.judge(step, self._dialogue.verdicts)
                case dialogue.Keep(step=step):
                    self._keep(step)
                case dialogue.Finish(text=text, is_whole=is_whole):
                    self._finish(text, is_whole)

    def _head(self, step: Step) -> None:
        left = round(self._dialogue.seconds_left / 60.0)
        _say(f"\n{step.id} {step.name} ({self._dialogue.place}, {left} min left)")
        _say(step.why, "  ")

    def _begin(self, step: Step) -> None:
        """Begin a step, unless a pass that it needs is not of the last day any more."""
        known = self.record.verdicts_on(self._dialogue.steps, time.time())
        if old := [id for id in step.needs if id not in known]:
            from swarmd.acceptance.dialogue import Refused

            why = f"the pass of {old[0]} is not of the last day: the same command asks it again"
            self._robot.inputs.put(Refused(why))
            return
        self._robot.begin(step)

    def _ask(self, step: Step) -> None:
        self._head(step)
        _say(step.prepare, "  ")
        if step.motion is not None:
            _say(f"MOVES: {step.motion.text}. Any key stops it.", "  ")
        _say(f"{step.question or 'Ready?'} [y/N]", "  ")
        self._terminal.discard()

    def _tell_progress(self) -> None:
        """Rewrite the line of progress each second, unless a question is open."""
        now = time.monotonic()
        if self._is_asked or self._end or now - self._told_at < 1.0:
            return
        self._told_at = now
        words = {"measuring": "measures", "moving": "MOVES", "resting": "waits for rest"}
        rewrite(f"  {words.get(self._dialogue.phase, 'reads the recording')}; any key ends it")

    def _keep(self, step: Step) -> None:
        """Keep the verdict of a step on disk, and show it."""
        from swarmd.acceptance.result_file import result_of, with_step, write_record

        verdict = self._dialogue.verdicts[step.id]
        names = [path.name for path in self._robot.files(step.id)]
        result = result_of(step, verdict, names, time.time(), self.record.subject)
        self.record = with_step(self.record, result, self._order)
        write_record(self._folder, self.record)
        rewrite("")
        bound = f" (bound {verdict.bound})" if verdict.bound else ""
        figure = f" {verdict.figure}{bound}:" if verdict.figure else ""
        _say(f"{step.id} {verdict.result.upper()}{figure} {verdict.reason}", "  ")

    def _finish(self, text: str, is_whole: bool) -> None:
        from swarmd.acceptance.result_file import write_record

        self._end = text
        asked = {step.id for step in self.record.steps}
        self.record = msgspec.structs.replace(
            self.record, is_whole=is_whole and asked >= set(self._order)
        )
        write_record(self._folder, self.record)
        _say(f"\n{text}")


class _Terminal:
    """The keyboard: lines while a question is open, else single keys."""

    def __init__(self) -> None:
        self._descriptor = sys.stdin.fileno()
        self._before: list[Any] = termios.tcgetattr(self._descriptor)
        self._gives_lines = True
        self._watch = InputWatch(boottime())

    def read(self, gives_lines: bool, seconds: float) -> Input | None:
        """What was typed, within `seconds`; None for nothing.

        A line that may have waited for this program while it stood still is no answer.
        """
        from swarmd.acceptance.dialogue import Closed, Key, Line

        if gives_lines is not self._gives_lines:
            self._gives_lines = gives_lines
            if gives_lines:
                self.close()
            else:
                tty.setcbreak(self._descriptor)
        now = boottime()
        if not select.select([self._descriptor], [], [], seconds)[0]:
            self._watch.look(now)
            return None
        try:
            data = os.read(self._descriptor, 1024)
        except OSError:  # the terminal has gone
            return Closed()
        if not data:
            return Closed()
        if gives_lines and self._watch.arrival(boottime()) < 0.0:
            self.discard()
            _say(f"No answer was taken: {TOO_LATE}")
            return None
        return Line(data.decode(errors="replace")) if gives_lines else Key()

    def discard(self) -> None:
        """Discard what was typed before now."""
        termios.tcflush(self._descriptor, termios.TCIFLUSH)

    def close(self) -> None:
        """The terminal as it was; what was typed is discarded."""
        termios.tcsetattr(self._descriptor, termios.TCSAFLUSH, self._before)


def _write_file(folder: Path, record: AcceptanceRecord, keep_names: bool) -> Path:
    """Write the one file beside the folder; its path."""
    from swarmd.acceptance.html_report import page
    from swarmd.acceptance.redaction import Mask
    from swarmd.acceptance.result_file import RECORDINGS, write_file
    from swarmd.acceptance.samples import read_samples
    from swarmd.recording.reader import read_file

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
    from swarmd.acceptance.steps import PARTS, steps_of
    from swarmd.settings.platforms import load_platform

    part = ""
    for step in _wanted(steps_of(load_platform(_platform_name(options, robot))), only):
        if step.id[0] != part:
            part = step.id[0]
            _say(f"\nPart {part}: {PARTS[part]}")
        _say(f"\n[ ] {step.id} {step.name}. {step.why}")
        _say(step.prepare, "    ")
        if step.motion is not None:
            _say(f"Moves: {step.motion.text}. {step.question}", "    ")


def _platform_name(options: CommonOptions, robot: str) -> str:
    """The platform of a robot; Failure if it is not known, or does not answer."""
    from swarmd.client.session import Session
    from swarmd.client.targets import check_known

    with options.operator() as operator:
        view = Session(operator, options.timeout, warn).look()
    check_known(robot, view.members, view.roster)
    status = view.members[robot].status
    if status is None:
        raise Failure(f"{robot} does not answer; see `swarmctl members`", FAILED)
    return status.platform


def _show(options: CommonOptions, path: Path) -> None:
    """Print the results in a file."""
    from swarmd.acceptance.result_file import read_record

    record = read_record(path)
    if options.is_json:
        print_json("Acceptance", msgspec.to_builtins(record))
        return
    _say(f"{record.robot} ({record.platform}, {record.driver}), {record.began}")
    _say(record.headline)
    for step in record.steps:
        verdict = step.verdict
        figure = f" {verdict.figure}:" if verdict.figure else ""
        _say(f"{step.id} {step.name}: {verdict.result.upper()}{figure} {verdict.reason}")


def _say(text: str, indent: str = "") -> None:
    """Print a text, wrapped to the terminal; nothing for an empty text."""
    if not text:
        return
    from swarmd.texts.values import printable

    width = min(terminal_width(), _WIDEST)
    begin = "\n" if text.startswith("\n") else ""
    lines = textwrap.wrap(
        printable(text.strip()), width, initial_indent=indent, subsequent_indent=indent + "  "
    )
    click.echo(begin + "\n".join(lines))
