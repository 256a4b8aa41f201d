"""`swarmctl patterns` and `mission`: the patterns on this machine, and checks of missions."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Collection
from pathlib import Path
from typing import Any

import click

from swarmd.core.errors import PluginError
from swarmd.core.verbs import shortened
from swarmd.operator.cli import completion
from swarmd.operator.cli.options import CommonOptions, VerbGroup, local_options, plugin_dir_option
from swarmd.operator.cli.output import line_width, print_json, print_section, print_table, warn
from swarmd.operator.cli.plugin_check import (
    DESCRIBE_TIMEOUT,
    Record,
    check_mission,
    describe_patterns,
)
from swarmd.operator.texts.values import NOTHING, printable, short_number
from swarmd.plugins import find_pattern, place_of_pattern

# columns on a terminal
NEEDS_WIDTH = 22
FROM_WIDTH = 16

_platform = click.option(
    "--platform",
    shell_complete=completion.platforms,
    default="waffle_pi",
    help="The platform, on which defaults and bounds depend [waffle_pi].",
)


@click.group(cls=VerbGroup, invoke_without_command=True)
@local_options
def patterns(options: CommonOptions) -> None:
    """Print the patterns on this machine, or one with its parameters."""
    ctx = click.get_current_context()
    if ctx.invoked_subcommand is None:
        ctx.invoke(list_patterns)


@patterns.command("list")
@plugin_dir_option
@_platform
@local_options
def list_patterns(options: CommonOptions, plugin_dir: Path | None, platform: str) -> None:
    """Print all patterns, a line each. `--timeout` is for each pattern [15s].

    On a terminal, NEEDS, FROM and SUMMARY are cut to its width; in a pipe or a file they are whole.
    FROM is left out if all patterns come with swarmd.
    """
    rows = describe_patterns((), plugin_dir, platform, options.timeout or DESCRIBE_TIMEOUT)
    width = line_width()  # None in a pipe or a file
    uncut = 0 if width else sys.maxsize
    if options.is_json:
        print_json("Patterns", {"patterns": rows})
        return
    has_others = any(not row["source"].startswith("swarmd") for row in rows)
    table = [
        (
            row["name"],
            row.get("kind", NOTHING),
            shortened(", ".join(row.get("needs", ())), max(NEEDS_WIDTH, uncut)) or NOTHING,
            *([shortened(row["source"], max(FROM_WIDTH, uncut))] if has_others else []),
            f"cannot be loaded: {row['error']}" if "error" in row else row["summary"],
        )
        for row in rows
    ]
    header = ("NAME", "KIND", "NEEDS", *(["FROM"] if has_others else []), "SUMMARY")
    print_table(header, table, width=width)


@patterns.command("show")
@click.argument("name", shell_complete=completion.patterns)
@plugin_dir_option
@_platform
@local_options
def show_pattern(options: CommonOptions, name: str, plugin_dir: Path | None, platform: str) -> None:
    """Print what pattern NAME needs and sends, and its parameters; NAME may be your file's path."""
    timeout = options.timeout or DESCRIBE_TIMEOUT
    name, plugin_dir = place_of_pattern(name, plugin_dir)
    find_pattern(name, plugin_dir)
    (row,) = describe_patterns((name,), plugin_dir, platform, timeout)
    if "error" in row:
        raise PluginError(row["error"])
    if options.is_json:
        print_json("Pattern", {"pattern": row})
        return
    text = inspect.cleandoc(f"{name}: {row['text']}")
    click.echo("\n".join(map(printable, text.splitlines())) + "\n")
    print_section("Pattern", _about(row))
    click.echo(f"Parameters on {row['platform']}")
    header = ("NAME", "DEFAULT", "EXPECTED", "MEANING", "SOURCE")
    print_table(header, [_param(spec) for spec in row["params"]])


@click.group(cls=VerbGroup)
def mission() -> None:
    """Patterns composed of others in a YAML file."""


@mission.command()
@click.argument("file", type=click.Path(path_type=Path))
@_platform
@plugin_dir_option
@local_options
def check(options: CommonOptions, file: Path, platform: str, plugin_dir: Path | None) -> None:
    """Check the mission in FILE; moves nothing and needs no network.

    Without --plugin-dir, patterns of your own are those in the folder of FILE. Prints each fault
    with file, line and key. The exit code is 2 if the mission has a fault.
    """
    if not file.is_file():
        raise click.UsageError(f"{file} is no file; expected the YAML file of a mission")
    faults = check_mission(file, platform, plugin_dir or file.parent)
    report_mission(file, faults, platform, is_json=options.is_json)


def report_mission(file: Path, faults: Collection[str], platform: str, *, is_json: bool) -> None:
    """Print the faults of a mission on `platform`; end the verb with exit code 2 if it has one."""
    if is_json:
        print_json("Mission", {"file": str(file), "platform": platform, "faults": list(faults)})
    elif not faults:
        click.echo(f"{file}: ok on {platform}")
    else:
        for line in faults:
            warn(line)
    if faults:
        click.get_current_context().exit(2)


def _about(row: Record) -> list[tuple[str, str]]:
    channels = (f"{name} ({kind})" for name, kind in row["channels"].items())
    units = [f"{name} in {unit}" for name, unit in row["report_units"].items()]
    return [
        ("kind", row["kind"]),
        ("from", row["source"]),
        ("needs", ", ".join(row["needs"]) or NOTHING),
        *([("refused", row["lacks"])] if row["lacks"] else []),
        ("sends", ", ".join(channels) or NOTHING),
        ("rate", f"{row['rate']:g} Hz"),
        *([("reports", ", ".join(units))] if units else []),
        ("touches", f"{row['touches']}, if granted" if row["touches"] else NOTHING),
        *([("refused", f"{row['refused']} (on {row['platform']})")] if row["refused"] else []),
    ]


def _param(spec: dict[str, Any]) -> tuple[str, ...]:
    default = "required" if spec["is_required"] else short_number(spec["default"])
    source = "platform" if spec["is_derived"] else spec["source"]
    return (spec["name"], default, spec["wanted"], spec["description"], source or NOTHING)
