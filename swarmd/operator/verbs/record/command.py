"""`swarmctl record`: starts, stops, lists and fetches the recordings of robots."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from swarmd.core.errors import NetworkError
from swarmd.core.verbs import RecordRequest
from swarmd.operator.cli.fetched import print_fetched, tell_bytes
from swarmd.operator.cli.options import FOLDER, CommonOptions, VerbGroup, common_options
from swarmd.operator.cli.output import fields, print_json, print_table, warn
from swarmd.operator.cli.record_merge import merge
from swarmd.operator.cli.send import send_to, session_of
from swarmd.operator.cli.targets import takes_targets
from swarmd.operator.session.targets import Targets, targets_of
from swarmd.operator.texts.values import NOTHING, counted, megabytes, seconds
from swarmd.operator.verbs.record.ask import ask_of, code_of_fetch, fetch_files

if TYPE_CHECKING:
    from swarmd.core.verbs import RecordingFile, RecordingsReply
    from swarmd.operator.session.session import Session


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
        replies, without_answer = _recordings(session_of(options, operator), targets)
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
        click.get_current_context().exit(code_of_fetch(replies, without_answer))


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
        session = session_of(options, operator)
        replies, failed_robots = _recordings(session, targets)
        files = {robot: reply.files for robot, reply in replies.items()}
        fetched = fetch_files(session, files, failed_robots, folder, on_bytes=tell_bytes)
        print_fetched(options, fetched)


record.add_command(merge)


def _recordings(session: Session, targets: Targets) -> tuple[dict[str, RecordingsReply], list[str]]:
    """The recordings of each target, and the targets that did not answer."""
    from swarmd.daemon.recording.fetch import recordings_of

    ask = ask_of(session)
    recordings = {}
    failed = []
    for robot in targets_of(session.look(), targets):
        try:
            recordings[robot] = recordings_of(ask, robot)
        except NetworkError as error:
            session.tell(str(error))
            failed.append(robot)
    return recordings, failed


def _times(file: RecordingFile, now: float) -> tuple[str, str]:
    if file.is_open:
        return NOTHING, "records"
    if file.begin is None or file.end is None:
        return NOTHING, "cut off"
    return seconds(file.end - file.begin), f"{seconds(max(now - file.end, 0.0))} ago"
