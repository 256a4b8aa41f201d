"""`swarmctl replay`: repeats a recorded run without a robot, and compares its commands."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from swarmd.cli import completion
from swarmd.cli.options import FOLDER, CommonOptions, local_options, recordings_argument
from swarmd.cli.output import fields, print_json, print_table, warn
from swarmd.cli.record_merge import parts_of
from swarmd.core.errors import ConfigError
from swarmd.network.operator.exit_codes import FAILED
from swarmd.texts.values import NOTHING

if TYPE_CHECKING:
    from swarmd.core.values import Platform
    from swarmd.recording.head import RecordingHead
    from swarmd.recording.reader import RecordedFile
    from swarmd.replay.replay import Parity


@click.command()
@recordings_argument
@click.option(
    "--platform",
    shell_complete=completion.platforms,
    metavar="NAME|FILE",
    help="Another platform for the replay: what would its settings have commanded?",
)
@click.option("--plugin-dir", type=FOLDER, help="The folder of patterns of your own.")
@local_options
def replay(
    options: CommonOptions, files: tuple[Path, ...], platform: str | None, plugin_dir: Path | None
) -> None:
    """Repeat a recorded run without a robot, and compare its commands with the recorded commands.

    FILE: a recording (.mcap), its parts in their order, or the folder of one robot. If the daemon
    was restarted, the recordings of its processes are repeated one after the other. `safe` compares
    what protection commanded, `requested` what the pattern asked for. The exit code is 0 only if
    all commands are equal to the bit.
    """
    from swarmd.plugins import check_single, need, pattern_names, places_of

    need("mcap", "rosbags", extra="record")
    from swarmd.replay.replay import recordings_of, total
    from swarmd.settings.platforms import load_platform

    recordings = recordings_of(_files(files))
    robots = {parts[0].about.get("robot") for parts in recordings}  # heads of their first files
    if len(robots) > 1:
        raise click.UsageError(f"the files are of {len(robots)} robots; give those of one")
    origins = pattern_names(plugin_dir)
    for name, origin in origins.items():
        check_single(name, origin)  # PluginError for two patterns of one name
    other_platform = None if platform is None else load_platform(platform)
    results = _repeated(recordings, places_of(origins), other_platform)
    head, _ = results[0]  # robot and platform of a recording
    parity = total(parity for _, parity in results)
    is_equal = parity.safe.is_equal and parity.requested.is_equal
    if options.is_json:
        _print_json(head.identity.robot, parity, is_equal)
    else:
        click.echo(f"{head.identity.robot} ({head.identity.platform.name}), {parity.seconds:.1f} s")
        _print_table(parity)
    for note in parity.notes:
        warn(note)
    if not is_equal:
        click.get_current_context().exit(FAILED)


def _repeated(
    recordings: Sequence[list[RecordedFile]],
    places: Mapping[str, tuple[str, bool]],
    platform: Platform | None,
) -> list[tuple[RecordingHead, Parity]]:
    """Repeat recordings; warns of each recording that cannot be repeated.

    `recordings`: the files of each recording. `places`: where the code of each pattern is.
    `platform` replaces the platform of the recordings; None: no change. ConfigError, with the fault
    of the last recording, if no recording can be repeated.
    """
    from swarmd.replay.replay import repeat

    results = []
    for number, parts in enumerate(recordings, start=1):
        try:
            results.append(repeat(parts, places, platform))
        except ConfigError as error:
            is_last = number == len(recordings)
            if is_last and not results:
                raise
            warn(f"{error}; it is left out")
    return results


def _files(given: tuple[Path, ...]) -> list[RecordedFile]:
    from swarmd.recording.reader import read_file

    files = [read_file(path) for path in parts_of(given)]
    for file in files:
        if file.fault:
            warn(f"{file.path}: {file.fault}; what is whole is repeated")
    return files


def _print_json(robot: str, parity: Parity, is_equal: bool) -> None:
    content = {
        name: fields(commands, "count", "equal", "largest", "first")
        for name, commands in (("safe", parity.safe), ("requested", parity.requested))
    }
    more = {"robot": robot, "seconds": parity.seconds, "notes": list(parity.notes)}
    print_json("Replay", {**more, **content, "is_equal": is_equal})


def _print_table(parity: Parity) -> None:
    rows = [
        (
            name,
            str(commands.count),
            f"{math.floor(1e4 * commands.share) / 1e2:.2f}%",  # 100 % only if all are equal
            f"{commands.largest:.3g}",
            NOTHING if commands.first is None else f"{commands.first:.2f} s",
        )
        for name, commands in (("safe", parity.safe), ("requested", parity.requested))
    ]
    print_table(("COMMANDS", "COMPARED", "EQUAL", "LARGEST DIFFERENCE", "FIRST"), rows)
