"""`swarmctl mission`: checks missions before any robot is told to run them."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import click

from swarmd.cli.options import CommonOptions, common_options
from swarmd.cli.output import print_json, warn
from swarmd.core.errors import PluginError
from swarmd.core.processes import how_it_ended

_PATIENCE = 30.0  # s: it imports every pattern that the mission names


@click.group()
def mission() -> None:
    """Patterns composed of others in a YAML file."""


@mission.command()
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--platform", default="waffle_pi", help="For which robots [waffle_pi].")
@click.option(
    "--plugin-dir",
    type=click.Path(exists=True, file_okay=False, path_type=Path),
    envvar="SWARM_PLUGIN_DIR",
    help="Folder of one-file patterns [$SWARM_PLUGIN_DIR, else the folder of FILE].",
)
@common_options
def check(options: CommonOptions, file: Path, platform: str, plugin_dir: Path | None) -> None:
    """Check the mission in FILE as a whole; moves nothing and needs no network.

    Every fault is a line with file, line and key. Exit code 2 if there is one.
    """
    if not file.is_file():
        raise click.UsageError(f"{file} is no file; wanted is a mission's YAML file")
    faults = _ask(file, platform, plugin_dir or file.parent)
    if options.is_json:
        print_json("Mission", {"file": str(file), "platform": platform, "faults": faults})
    elif not faults:
        click.echo(f"{file}: ok on {platform}")
    else:
        for line in faults:
            warn(line)
    if faults:
        click.get_current_context().exit(2)


def _ask(file: Path, platform: str, plugin_dir: Path) -> list[str]:
    """The faults, from a process of its own: swarmctl imports no plugin code."""
    # -P: a random.py where this is called is not to shadow a module.
    command = [sys.executable, "-P", "-m", "swarmd.pattern_host.inspect_mission", str(file)]
    command += ["--platform", platform, "--plugin-dir", str(plugin_dir)]
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, env=environment, timeout=_PATIENCE, check=False
        )
    except subprocess.TimeoutExpired as error:
        text = f"a pattern of {file} is not imported after {_PATIENCE:.0f} s; look at its code"
        raise PluginError(text) from error
    if not done.stdout.strip():
        text = f"the process that imports the patterns of {file} {how_it_ended(done.returncode)}"
        raise PluginError(text)
    answer = json.loads(done.stdout)
    if "error" in answer:
        raise PluginError(answer["error"])
    return list(answer["faults"])
