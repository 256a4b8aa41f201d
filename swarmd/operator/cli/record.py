"""`swarmctl record`: starts, stops, lists and fetches the recordings of robots."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from swarmd.core.errors import CodecError, NetworkError
from swarmd.core.verbs import RecordRequest
from swarmd.operator.cli.options import FOLDER, CommonOptions, Failure, VerbGroup, common_options
from swarmd.operator.cli.output import fields, print_json, print_table, rewrite, warn
from swarmd.operator.cli.record_merge import merge
from swarmd.operator.cli.send import known_members, send_to
from swarmd.operator.cli.targets import takes_targets
from swarmd.operator.session.ask_robots import ASK_TIME
from swarmd.operator.session.exit_codes import NO_TARGET, PARTIAL, TIMEOUT
from swarmd.operator.session.targets import Targets, targets_of
from swarmd.operator.texts.values import NOTHING, counted, megabytes, seconds

if TYPE_CHECKING:
    from swarmd.core.verbs import RecordingFile, RecordingsReply
    from swarmd.daemon.recording.fetch import Ask, Copy, Source
    from swarmd.operator.session.operator import Operator


@click.group(cls=VerbGroup)
def record() -> None:
    """Record robots, each to its own disk, and fetch the recordings.

    A recording is a folder of MCAP files with ROS 2 messages, which Foxglove and PlotJuggler read.
    """


@record.command(epilog="Example: swarmctl record start --all")
@takes_targets(is_required=True)
@common_options
def start(options: CommonOptions, targets: Targets) -> None:
    """Start to record TARGETS: names, globs such as 'tb3-*', or --all.

    The robot writes to its own disk until `record stop`, also without swarmctl.
    """
    send_to(options, RecordRequest, targets, action="start")


@record.command(epilog="Example: swarmctl record stop --all")
@takes_targets(is_required=True)
@common_options
def stop(options: CommonOptions, targets: Targets) -> None:
    """Stop the recording of TARGETS and finish its file."""
    send_to(options, RecordRequest, targets, action="stop")


@record.command("list", epilog="Example: swarmctl record list")
@takes_targets(is_required=False)
@common_options
def list_(options: CommonOptions, targets: Targets) -> None:
    """List the recordings of TARGETS, or of all robots, with their sizes and times."""
    with options.operator() as operator:
        replies, without_answer = _recordings(options, operator, targets)
        faults = {robot: reply.fault for robot, reply in replies.items() if reply.fault}
        if options.is_json:
            # Times are in s on the clock of the robot, whose present time is `now`.
            robots = {
                robot: [
                    {
                        "file": file.name,
                        "bytes": file.size,
                        **fields(file, "is_open", "dropped", "begin", "end"),
                        "now": reply.now,
                    }
                    for file in reply.files
                ]
                for robot, reply in replies.items()
            }
            content = {"robots": robots, "faults": faults, "missing": without_answer}
            print_json("Recordings", content)
        else:
            rows = []
            for robot, reply in replies.items():
                for file in reply.files:
                    size = megabytes(file.size, 2)
                    times = _times(file, reply.now)
                    rows.append((robot, file.name, size, *times, str(file.dropped)))
            print_table(("NAME", "FILE", "SIZE", "LENGTH", "ENDED", "DROPPED"), rows)
            click.echo(f"{counted(len(rows), 'file')} of {counted(len(replies), 'robot')}")
            for robot, fault in faults.items():
                warn(f"{robot} ended its recording: {fault}")
        _exit_if_failed(replies.keys(), without_answer)


@record.command(epilog="Example: swarmctl record fetch --all -d evening")
@takes_targets(is_required=True)
@click.option(
    "-d",
    "--folder",
    type=FOLDER,
    default=Path("recordings"),
    help="Where to copy to; a folder for each robot is made in it [recordings].",
)
@common_options
def fetch(options: CommonOptions, targets: Targets, folder: Path) -> None:
    """Copy the recordings of TARGETS to this machine.

    A fetch that was interrupted continues where it ended. Robots record on while their files are
    copied; the copy of a file that is being written ends in `.partial`. Exit code 4 if TARGETS have
    no recordings.
    """
    with options.operator() as operator:
        replies, failed_robots = _recordings(options, operator, targets)
        files = {robot: reply.files for robot, reply in replies.items()}
        fetch_files(options, operator, files, failed_robots, folder)


def fetch_files(
    options: CommonOptions,
    operator: Operator,
    files: Mapping[str, Sequence[RecordingFile]],
    failed_robots: list[str],
    folder: Path,
    source: Source | None = None,
) -> None:
    """Copy files of robots into `folder`, print the copies, and exit if a robot failed.

    `failed_robots`: the robots that have failed before. `source`: None for recordings.
    """
    ask = partial(_ask, options, operator)
    rows = []  # (robot, path, size, state of the copy)
    for robot, listed in files.items():
        copies, is_complete = _copied(ask, robot, listed, folder, source)
        for copy in copies:
            # "so far": the robot still writes the file.
            state = copy.fault or ("whole" if copy.is_whole else "so far")
            rows.append((robot, str(copy.path), megabytes(copy.size, 2), state))
        if not is_complete:
            failed_robots.append(robot)
    if sys.stderr.isatty():
        rewrite("")  # clears the line of progress
    if not rows and not failed_robots:
        raise Failure(f"{', '.join(files)}: no recording to fetch", NO_TARGET)
    if options.is_json:
        copied = [{"robot": robot, "path": path, "state": state} for robot, path, _, state in rows]
        print_json("Fetched", {"files": copied, "missing": failed_robots})
    else:
        print_table(("NAME", "FILE", "SIZE", "COPY"), rows)
    _exit_if_failed(files.keys(), failed_robots)


def _copied(
    ask: Ask, robot: str, files: Sequence[RecordingFile], folder: Path, source: Source | None
) -> tuple[list[Copy], bool]:
    """Copy files of a robot into `folder`; the copies, and True if no file is missing."""
    from swarmd.daemon.recording.fetch import RECORDING, check_sizes, note_clock
    from swarmd.daemon.recording.fetch import fetch as copy_file

    copies: list[Copy] = []
    try:
        check_sizes(robot, files, folder, source or RECORDING)
        note_clock(ask, robot, folder)  # the offset of its clock, for `record merge`
        for file in files:
            progress = partial(_tell, robot, file.name)
            copy = copy_file(ask, robot, file, folder, progress, source=source or RECORDING)
            copies.append(_readable(copy))
    except NetworkError as error:  # the remaining files are left out
        warn(str(error))
        return copies, False
    except OSError as error:
        raise click.ClickException(
            f"{folder}: {error.strerror}; what came is kept; make room and fetch again"
        ) from error
    return copies, not any(copy.fault for copy in copies)


def _readable(copy: Copy) -> Copy:
    """The copy; of an incident the recording that is written beside it."""
    from swarmd.daemon.recording.incident_file import SUFFIX, to_recording

    if not copy.is_whole or copy.path.suffix != SUFFIX:
        return copy
    try:
        return copy._replace(path=to_recording(copy.path))
    except CodecError as error:
        return copy._replace(fault=str(error))


record.add_command(merge)


def _recordings(
    options: CommonOptions, operator: Operator, targets: Targets
) -> tuple[dict[str, RecordingsReply], list[str]]:
    """The recordings of each target, and the targets that did not answer."""
    from swarmd.daemon.recording.fetch import recordings_of

    view = known_members(options, operator)
    recordings = {}
    failed = []
    for robot in targets_of(view, targets):
        try:
            recordings[robot] = recordings_of(partial(_ask, options, operator), robot)
        except NetworkError as error:
            warn(str(error))
            failed.append(robot)
    return recordings, failed


def _ask(
    options: CommonOptions, operator: Operator, robot: str, name: str, payload: bytes
) -> bytes | None:
    return operator.ask(robot, name, payload, timeout=options.timeout or ASK_TIME)


def _exit_if_failed(answered: object, failed: list[str]) -> None:
    """Exit with code PARTIAL if a robot failed, or TIMEOUT if no robot answered; else return."""
    if failed:
        click.get_current_context().exit(PARTIAL if answered else TIMEOUT)


def _tell(robot: str, name: str, received: int, size: int) -> None:
    if sys.stderr.isatty():
        rewrite(f"{robot} {name}: {megabytes(received, 2)} of {megabytes(size, 2)}")


def _times(file: RecordingFile, now: float) -> tuple[str, str]:
    if file.is_open:
        return NOTHING, "records"
    if file.begin is None or file.end is None:
        return NOTHING, "cut off"
    return seconds(file.end - file.begin), f"{seconds(max(now - file.end, 0.0))} ago"
