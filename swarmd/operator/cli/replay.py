"""`swarmctl replay`: repeats a recorded run without a robot, and compares its commands."""

from __future__ import annotations

import math
import shlex
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from swarmd.core.errors import ConfigError
from swarmd.core.pin import restart_pinned
from swarmd.core.verbs import shortened
from swarmd.operator.cli import completion
from swarmd.operator.cli.options import (
    FOLDER,
    CommonOptions,
    Duration,
    local_options,
    recordings_argument,
)
from swarmd.operator.cli.output import fields, print_json, print_table, warn
from swarmd.operator.cli.record_merge import parts_of
from swarmd.operator.session.exit_codes import FAILED
from swarmd.operator.texts.values import NOTHING, printable
from swarmd.plugins import check_single, need, pattern_names, places_of

if TYPE_CHECKING:
    from swarmd.core.values import Platform
    from swarmd.daemon.recording.reader import RecordedFile
    from swarmd.operator.replay.absent import Absent
    from swarmd.operator.replay.replay import Difference, Last, Life, Parity


@click.command()
@recordings_argument
@click.option(
    "--platform",
    shell_complete=completion.platforms,
    metavar="NAME|FILE",
    help="Another platform for the replay: what would its settings have commanded?",
)
@click.option("--plugin-dir", type=FOLDER, help="The folder of patterns of your own.")
@click.option("--until", type=Duration(), metavar="SECONDS", help="End the replay at this instant.")
@click.option(
    "--why",
    metavar="NAME",
    help="Print the incident, and what changed for this robot or what others knew of it, first.",
)
@click.option(
    "-v",
    "--verbose",
    "is_raw",
    is_flag=True,
    help="With --why: also the last inputs and decisions, each with its commands.",
)
@click.option(
    "--life",
    "number",
    type=click.IntRange(min=1),
    metavar="N",
    help="Only the N-th recording of each robot; a restart of its daemon begins another.",
)
@local_options
def replay(
    options: CommonOptions,
    files: tuple[Path, ...],
    platform: str | None,
    plugin_dir: Path | None,
    until: float | None,
    why: str | None,
    is_raw: bool,
    number: int | None,
) -> None:
    """Repeat a recorded run without robots, and compare its commands with the recorded commands.

    FILE: a recording (.mcap), its parts in their order, or a folder with those of one robot or of
    several, whose inputs are then repeated in the order of one timeline. `safe` compares what
    protection commanded, `requested` what the pattern asked for. The exit code is 0 only if all
    commands are equal to the bit. Recordings that a pinned process made are repeated in one, those
    of a daemon with the mathematical functions of this processor.
    """

    need("mcap", "rosbags", extra="record")
    from swarmd.operator.replay.changes import Changes
    from swarmd.operator.replay.replay import are_pinned, recordings_of, total
    from swarmd.operator.replay.swarm import first_difference, place_lives, repeat_together
    from swarmd.settings.platforms import load_platform

    paths = parts_of(files)
    recordings = recordings_of(_files(paths))
    if number is not None:
        recordings = _picked(recordings, number)
    if options.is_program and are_pinned(recordings):
        restart_pinned()
    origins = pattern_names(plugin_dir)
    for name, origin in origins.items():
        check_single(name, origin)  # PluginError for two patterns of one name
    other_platform = None if platform is None else load_platform(platform)
    lives = _prepared(recordings, places_of(origins), other_platform)
    is_swarm = len({life.about.get("robot") for life in lives}) > 1
    if is_swarm:
        place_lives(lives, paths)
    if len(swarms := {life.head.swarm for life in lives}) > 1:
        warn(f"recordings of {len(swarms)} swarms; robots of one name share a row")
    watched = [life for life in lives if life.head.identity.robot == why]
    for life in watched:
        life.replay.changes = Changes()
    absent = None if why is None or watched else _absent(why, recordings, lives)
    repeat_together(lives, until)
    # Whether each recording with decisions was repeated to its end.
    is_whole = not any(life.fault for life in lives) and len(lives) == sum(
        any(one.topic == "/decision" for file in parts for one in file.messages)
        for parts in recordings
    )
    if until is not None:
        lives = [life for life in lives if life.fault or life.replay.safe.count]
        if not lives:
            raise click.UsageError(f"--until {until:g}: no decision is compared until then")
    by_robot = {robot: total(parities) for robot, parities in _compared(lives).items()}
    difference = first_difference(lives)
    is_equal = is_whole and all(
        parity.safe.is_equal and parity.requested.is_equal for parity in by_robot.values()
    )
    # The largest error of each robot's place on the timeline, in s; inf: not known.
    errors = {
        robot: max(life.error for life in lives if life.head.identity.robot == robot)
        for robot in by_robot
    }
    lines = [printable(line) for life in watched for line in _why(life, is_raw=is_raw)]
    if absent is not None:
        lines = [printable(line) for line in absent.lines(_folder(files))]
    if options.is_json:
        _print_json(by_robot, errors, difference, is_equal, lines)
    else:
        for line in lines:
            click.echo(line)
        _print_table(by_robot, errors, lives, is_swarm=is_swarm)
    if difference is not None and not options.is_json:
        life, found = difference
        click.echo(
            printable(
                f"first difference: {life.head.identity.robot} at {found.at:.3f} s:"
                f" {found.field} {found.recorded}, here {found.replayed}"
            )
        )
    for robot, parity in by_robot.items():
        for note in parity.notes:
            warn(f"{robot}: {note}" if is_swarm else note)
    if not is_equal:
        click.get_current_context().exit(FAILED)


def _picked(recordings: Sequence[list[RecordedFile]], number: int) -> list[list[RecordedFile]]:
    """The recording with `number` (from 1) of each robot; UsageError if no robot has so many."""
    by_robot: dict[str | None, list[list[RecordedFile]]] = defaultdict(list)
    for parts in recordings:
        by_robot[parts[0].about.get("robot")].append(parts)
    picked = [own[number - 1] for own in by_robot.values() if len(own) >= number]
    if not picked:
        raise click.UsageError(f"--life {number}: at most {max(map(len, by_robot.values()))}")
    return picked


def _prepared(
    recordings: Sequence[list[RecordedFile]],
    places: Mapping[str, tuple[str, bool]],
    platform: Platform | None,
) -> list[Life]:
    """Prepare to repeat recordings; warns of each recording that cannot be repeated.

    `recordings`: the files of each recording. `places`: where the code of each pattern is.
    `platform` replaces the platform of the recordings; None: no change. ConfigError, with the fault
    of the last recording, if no recording can be repeated.
    """
    from swarmd.operator.replay.replay import prepare

    lives = []
    for number, parts in enumerate(recordings, start=1):
        try:
            lives.append(prepare(parts, places, platform))
        except ConfigError as error:
            if number == len(recordings) and not lives:
                raise
            warn(f"{error}; it is left out")
    return lives


def _compared(lives: Sequence[Life]) -> Mapping[str, list[Parity]]:
    """The comparisons of each robot; warns of a life that compared nothing or failed.

    ConfigError, with the fault of the last life, if no life compared anything.
    """
    found: dict[str, list[Parity]] = defaultdict(list)
    for life in lives:
        try:
            found[life.head.identity.robot] += [life.parity()]
        except ConfigError as error:
            if life is lives[-1] and not any(found.values()):
                raise
            warn(f"{error}; it is left out")
    return {robot: parities for robot, parities in found.items() if parities}


def _files(paths: Sequence[Path]) -> list[RecordedFile]:
    from swarmd.daemon.recording.reader import read_file

    files = [read_file(path) for path in paths]
    for file in files:
        if file.fault:
            warn(f"{file.path}: {file.fault}; what is whole is repeated")
    return files


def _print_json(
    by_robot: Mapping[str, Parity],
    errors: Mapping[str, float],
    difference: tuple[Life, Difference] | None,
    is_equal: bool,
    why: Sequence[str],
) -> None:
    rows = [
        {
            "robot": robot,
            "seconds": parity.seconds,
            "notes": list(parity.notes),
            "safe": fields(parity.safe, "count", "equal", "largest", "first"),
            "requested": fields(parity.requested, "count", "equal", "largest", "first"),
            "clock_error": errors[robot] if math.isfinite(errors[robot]) else None,
        }
        for robot, parity in by_robot.items()
    ]
    first: dict[str, object] | None = None
    if difference is not None:
        life, found = difference
        where = {"robot": life.head.identity.robot, "at": found.at}
        first = {**where, **fields(found, "field", "recorded", "replayed")}
    content = {"robots": rows, "first_difference": first, "is_equal": is_equal}
    print_json("Replay", {**content, "why": list(why)})


def _print_table(
    by_robot: Mapping[str, Parity],
    errors: Mapping[str, float],
    lives: Sequence[Life],
    *,
    is_swarm: bool,
) -> None:
    platforms = {life.head.identity.robot: life.head.identity.platform.name for life in lives}
    for robot, parity in by_robot.items():
        error = errors[robot]
        clock = "by its wall clock" if math.isinf(error) else f"clock within {1e3 * error:.3f} ms"
        words = (f"{robot} ({platforms[robot]})", f"{parity.seconds:.1f} s", clock)
        click.echo(printable(", ".join(words if is_swarm else words[:2])))
    rows = [
        (
            robot,
            name,
            str(commands.count),
            # 100 % only if all are equal.
            f"{math.floor(1e4 * commands.share) / 1e2:.2f}%" if commands.count else NOTHING,
            f"{commands.largest:.3g}" if commands.count else NOTHING,
            NOTHING if commands.first is None else f"{commands.first:.2f} s",
        )
        for robot, parity in by_robot.items()
        for name, commands in (("safe", parity.safe), ("requested", parity.requested))
    ]
    names = ("NAME", "COMMANDS", "COMPARED", "EQUAL", "LARGEST DIFFERENCE", "FIRST")
    begin = 0 if is_swarm else 1  # one robot needs no column for its name
    print_table(names[begin:], [row[begin:] for row in rows])


def _why(life: Life, *, is_raw: bool) -> Iterator[str]:
    """The incident of a recording, if it has one, and what changed for its robot.

    `is_raw`: also the last inputs and decisions. They are the last ones before its first
    difference, else before the incident, else before the end.
    """
    replay = life.replay
    name = Path(life.where).name
    robot = life.head.identity.robot
    # A file may name others of the same minute: its name begins with the id of its own incident.
    own = sorted(replay.incidents, key=lambda one: name.startswith(one.incident.id))[-1:]
    yield from (one.incident.line(one.at) for one in own)
    last, until = (own[0].last, "the incident") if own else (tuple(replay.last), "the end")
    end = math.inf
    if replay.difference is not None:
        last = replay.difference.last
        until = f"{replay.difference.field} differs"
        end = replay.difference.at
    if replay.changes is not None:
        yield f"{robot}, what changed{'' if math.isinf(end) else f' before {until}'}:"
        yield from (f"  {one.at:.3f} s  {one.text}" for one in replay.changes.lines(end))
    if is_raw:
        yield f"{robot}, the last inputs and decisions before {until}:"
        yield from _raw(last)


def _raw(last: Last) -> Iterator[str]:
    """Inputs and decisions, a line each."""
    from swarmd.operator.replay.changes import input_text
    from swarmd.operator.replay.replay import decision_text

    for what, at in last:
        is_input = hasattr(what, "__struct_config__")
        yield f"  {at:.6f} s  {input_text(what) if is_input else decision_text(what)}"


def _folder(files: Sequence[Path]) -> str:
    """The folder to fetch to, as the user typed it, if it is a single one."""
    return shlex.quote(str(files[0])) if len(files) == 1 and files[0].is_dir() else "FOLDER"


def _absent(robot: str, recordings: Sequence[list[RecordedFile]], lives: Sequence[Life]) -> Absent:
    """What the recordings of others know of a robot; UsageError if they do not name it."""
    from swarmd.operator.replay.absent import absent

    is_here = any(parts[0].about.get("robot") == robot for parts in recordings)
    found = absent(robot, lives, is_here=is_here)
    if found is None:
        names = sorted({life.head.identity.robot for life in lives})
        raise click.UsageError(
            f"--why {robot}: no recording here is of it, and none names it; expected one of"
            f" {shortened(', '.join(names))}"
        )
    return found
