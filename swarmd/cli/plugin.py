"""`swarmctl plugin`: write a pattern, check it, and replace its code while robots run."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import click

from swarmd.cli import completion
from swarmd.cli.arguments import Targets, takes_targets
from swarmd.cli.options import (
    EXISTING_FILE,
    FOLDER,
    CommonOptions,
    VerbGroup,
    common_options,
    local_options,
)
from swarmd.cli.output import print_json
from swarmd.cli.plugin_push import list_pushed, push, remove
from swarmd.cli.send import send_to
from swarmd.core.keys import is_id
from swarmd.core.verbs import ReloadRequest
from swarmd.texts.values import printable

# A trial on a robot may take 10 s, and loading again 3 s more.
RELOAD_TIMEOUT = 15.0
CHECK_TIMEOUT = 30.0  # s for one point
_MARKS = {"ok": "ok  ", "fault": "FAIL", "skipped": "skip"}
_NAME_WIDTH = 43


@click.group(cls=VerbGroup)
def plugin() -> None:
    """Patterns of your own, a file each."""


@plugin.command("new")
@click.argument("name")
@click.option(
    "--dir", "folder", type=FOLDER, default=Path(), help="The folder to write to [the current one]."
)
@click.option(
    "--kind",
    type=click.Choice(["movement", "voting", "pattern"]),
    default="movement",
    help="The kind of pattern [movement].",
)
@local_options
def new(options: CommonOptions, name: str, folder: Path, kind: str) -> None:
    """Write a pattern, NAME.py, and its test, test_NAME.py: both pass as they are."""
    from swarmd.cli.plugin_template import write_plugin

    written = write_plugin(name, folder, kind)
    steps = [
        (f"swarmctl plugin check {written[0]}", "the contract of all patterns"),
        (f"pytest {written[1]}", "the same, and tests of its own"),
        (f"swarmctl demo --pattern {name} --plugin-dir {folder}", "simulated robots run it"),
    ]
    if options.is_json:
        files = [str(path) for path in written]
        print_json("Plugin", {"name": name, "files": files, "next": [line for line, _ in steps]})
        return
    click.echo(f"wrote {written[0]} and {written[1]}; next:\n")
    width = max(len(line) for line, _ in steps)
    for line, text in steps:
        click.echo(f"  {line.ljust(width)}  # {text}")
    click.echo(f"\nOn a robot, put {name}.py into the folder that its plugin_dir names.")


@plugin.command("check")
@click.argument("file", type=EXISTING_FILE)
@local_options
def check(options: CommonOptions, file: Path) -> None:
    """Check the pattern in FILE against the contract: a line for each point, each fault once.

    The file is imported in a process of its own. `--timeout` is for each point [30s].
    """
    from swarmd.cli.plugin_check import check_file

    if file.suffix != ".py":
        raise click.UsageError(
            f"{file} is no .py; a mission is checked by `swarmctl mission check`"
        )
    points = []
    for point in check_file(file, options.timeout or CHECK_TIMEOUT):
        points.append(point)
        if not options.is_json and point.result != "repeated":
            line = f"{_MARKS[point.result]}  {point.name.ljust(_NAME_WIDTH)}  {point.text}"
            click.echo(printable(line.rstrip()))
    results = Counter(point.result for point in points)
    bad = len(points) - results["ok"]
    if options.is_json:
        rows = [
            {"point": point.name, "result": point.result, "text": point.text} for point in points
        ]
        print_json("Check", {"file": str(file), "is_well": bad == 0, "points": rows})
    else:
        how = f"{results['fault']} faults" if results["fault"] != 1 else "1 fault"
        if results["repeated"]:
            count = results["repeated"]
            how += f", repeated at {count} other point{'s' if count > 1 else ''}"
        click.echo(f"{len(points)} checked, {how if bad else 'all ok'}")
    click.get_current_context().exit(1 if bad else 0)


@plugin.command("reload")
@click.argument("name", shell_complete=completion.patterns)
@takes_targets(is_required=True)
@click.option("--run", "is_run", is_flag=True, help="Run again where it ran, with its parameters.")
@common_options
def reload(options: CommonOptions, name: str, targets: Targets, is_run: bool) -> None:
    """Replace the code of pattern NAME on TARGETS: names, globs such as 'tb3-*', or --all.

    Each robot first tries the new code in a process of its own. If that fails, the robot refuses
    with the reason and keeps running the old code. Else a robot that runs NAME stops, and its
    pattern host is replaced. Other patterns keep running.
    """
    if not is_id(name):
        raise click.UsageError(f"{name!r} is no pattern name; see `swarmctl patterns`")
    fields = {"pattern": name, "is_rerun": is_run}
    send_to(options, ReloadRequest, targets, least=RELOAD_TIMEOUT, **fields)


plugin.add_command(push)
plugin.add_command(list_pushed)
plugin.add_command(remove)
