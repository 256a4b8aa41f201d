"""`swarmctl mission`: checks missions before robots run them."""

from __future__ import annotations

from pathlib import Path

import click

from swarmd.cli.options import CommonOptions, common_options
from swarmd.cli.output import print_json, warn


@click.group()
def mission() -> None:
    """Patterns composed of others in a YAML file."""


@mission.command()
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--platform", default="waffle_pi", help="The platform to check for [waffle_pi].")
@click.option(
    "--plugin-dir",
    type=click.Path(exists=True, file_okay=False, path_type=Path),
    envvar="SWARM_PLUGIN_DIR",
    help="Folder of one-file patterns [$SWARM_PLUGIN_DIR, else the folder of FILE].",
)
@common_options
def check(options: CommonOptions, file: Path, platform: str, plugin_dir: Path | None) -> None:
    """Check the mission in FILE; moves nothing and needs no network.

    Prints each fault with file, line and key. Exit code 2 if there is a fault.
    """
    from swarmd.cli.inspect import check_mission

    if not file.is_file():
        raise click.UsageError(f"{file} is no file; wanted the YAML file of a mission")
    faults = check_mission(file, platform, plugin_dir or file.parent)
    if options.is_json:
        print_json("Mission", {"file": str(file), "platform": platform, "faults": faults})
    elif not faults:
        click.echo(f"{file}: ok on {platform}")
    else:
        for line in faults:
            warn(line)
    if faults:
        click.get_current_context().exit(2)
