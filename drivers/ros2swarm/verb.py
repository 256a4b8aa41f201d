"""`swarmctl import ros2swarm FILE`: a parameter file of ROS2swarm as a run of a pattern."""

from __future__ import annotations

import json
import shlex
from pathlib import Path

import click

from swarmd.core.errors import ConfigError
from swarmd.drivers.ros2swarm.parameter_file import Conversion, read_parameter_file
from swarmd.operator.cli.options import EXISTING_FILE, CommonOptions, VerbGroup, local_options
from swarmd.operator.cli.output import print_json, warn
from swarmd.operator.cli.plugin_check import check_parameters

_PLATFORM = "waffle_pi"  # bounds are those of all platforms


@click.group(
    "import", cls=VerbGroup, epilog="Example: swarmctl import ros2swarm attraction_pattern.yaml"
)
def import_group() -> None:
    """Read files of other programs."""


@import_group.command()
@click.argument("file", type=EXISTING_FILE)
@local_options
def ros2swarm(options: CommonOptions, file: Path) -> None:
    """Print the run of a pattern that a parameter file of ROS2swarm describes.

    Names without a counterpart are printed with the reason. Moves nothing; the printed line runs
    the pattern. To run the node of ROS2swarm itself: the pattern ros2_nodes (docs/ros2_nodes.md).
    """
    converted = read_parameter_file(file)
    try:
        check_parameters(converted.pattern, converted.parameters, None, _PLATFORM)
    except ConfigError as error:
        raise ConfigError(f"{file}: {error}") from error
    if options.is_json:
        content = {
            "file": str(file),
            "pattern": converted.pattern,
            "parameters": converted.parameters,
            "left_out": converted.left_out,
            "notes": converted.notes,
        }
        print_json("Import", content)
        return
    for name, reason in converted.left_out.items():
        warn(f"{name}: left out: {reason}")
    for note in converted.notes:
        warn(note)
    click.echo(run_line(converted))


def run_line(converted: Conversion) -> str:
    """The command line of swarmctl that runs a converted file on all robots."""
    words = ["swarmctl", "run", converted.pattern, "--all"]
    for name, value in converted.parameters.items():
        words += ["-p", f"{name}={value if isinstance(value, str) else json.dumps(value)}"]
    return shlex.join(words)
