"""`swarmctl record merge`: the recordings of several robots as one file with one timeline."""

from __future__ import annotations

from pathlib import Path

import click

from swarmd.core.files import real_path
from swarmd.operator.cli.options import CommonOptions, recordings_argument
from swarmd.operator.cli.output import print_json, print_table, warn
from swarmd.operator.texts.values import clock_cells, counted
from swarmd.plugins import need


@click.command(epilog="Example: swarmctl record merge evening -o evening.mcap")
@recordings_argument
@click.option(
    "-o",
    "--output",
    "outputs",
    multiple=True,
    metavar="OUT.mcap|json",
    help="The file to write; with a second -o json the table of clocks as JSON.",
)
@click.option(
    "--reference", metavar="NAME", help="The robot whose clock is the timeline [the first]."
)
@click.option(
    "--unaligned",
    is_flag=True,
    help="Place robots whose clocks cannot be compared by their own wall clocks.",
)
def merge(
    files: tuple[Path, ...], outputs: tuple[str, ...], reference: str | None, unaligned: bool
) -> None:
    """Merge recordings of several robots into one file with one timeline.

    FILE: a recording (.mcap, .partial), or a folder of recordings, such as `record fetch` makes.
    The offsets of the robots' clocks are estimated from the queries that robots exchange while they
    record; the table states the bound of each error. The topic /scan of tb3-01 becomes
    /tb3-01/scan.
    """
    need("mcap", "rosbags", extra="record")
    from swarmd.daemon.recording.merge import place, rows, survey, write_merged

    parent_options = click.get_current_context().find_object(CommonOptions) or CommonOptions()
    # `-o` may be given twice: with the file to write, and with json for the printed table.
    is_json = "json" in outputs or parent_options.is_json
    target = _target(outputs)
    # 1. Read all recordings once: topics, times, and exchanges between clocks.
    recordings = survey(parts_of(files))
    if not recordings.sources:
        raise click.UsageError(f"{files[0]}: no messages in this recording")
    for fault in recordings.faults:
        warn(fault)
    # 2. Align the clock of each recording with the clock of the reference robot (by default the
    #    robot of the first file), whose recording comes first in `aligned`.
    aligned = place(recordings, reference)
    reference_robot = aligned[0].source.robot
    without_exchange = sorted({part.source.robot for part in aligned if part.alignment is None})
    if without_exchange and not unaligned:
        raise click.UsageError(
            f"{', '.join(without_exchange)}: no exchange with the clock of {reference_robot} was"
            " recorded; record the robots at the same time, leave them out, or give --unaligned to"
            " place them by their own wall clocks"
        )
    # 3. Write the merged file, and print the clocks.
    try:
        message_count = write_merged(aligned, target)
    except OSError as error:
        raise click.ClickException(f"{target}: {error.strerror}; nothing was written") from error
    clocks = rows(aligned)
    if is_json:
        content = {"file": str(target), "messages": message_count, "clocks": clocks}
        print_json("Merged", {**content, "reference": reference_robot})
        return
    cells = [(clock["robot"], clock["clock"], *clock_cells(clock)) for clock in clocks]
    print_table(("NAME", "CLOCK", "OFFSET", "DRIFT", "ERROR", "VIA"), cells)
    robot_count = len({clock["robot"] for clock in clocks})
    click.echo(f"{message_count} messages of {counted(robot_count, 'robot')} in {target}")


def _target(outputs: tuple[str, ...]) -> Path:
    """The file to write; UsageError if it cannot be, or is there already."""
    named = [name for name in outputs if name not in ("json", "table")]
    if len(named) != 1 or not named[0].endswith(".mcap"):
        raise click.UsageError("expected one -o OUT.mcap, the file to write")
    target = Path(named[0])
    if target.exists():
        raise click.UsageError(f"{target} exists; give another name, or remove it")
    if not target.parent.is_dir():
        raise click.UsageError(f"{target.parent}: no such folder; make it first")
    return target


def parts_of(files: tuple[Path, ...]) -> list[Path]:
    """The recordings in files and folders; UsageError for a folder without any."""
    parts: dict[Path, None] = {}
    for one in files:
        inside = sorted([*one.rglob("*.mcap"), *one.rglob("*.mcap.partial")])
        if one.is_dir() and not inside:
            raise click.UsageError(f"{one}: no recording (.mcap) in this folder; fetch it again")
        parts |= dict.fromkeys(real_path(path) for path in (inside if one.is_dir() else [one]))
    return list(parts)
