"""`swarmctl zenoh`: the configuration with which any program of Zenoh joins the swarm."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import click

from swarmd.cli.options import FILE, CommonOptions, common_options
from swarmd.cli.output import print_json, warn
from swarmd.cli.send import known_members
from swarmd.client.session import unreachable
from swarmd.core.errors import ConfigError, NetworkError


@click.command()
@click.option("--out", type=FILE, metavar="FILE", help="Write the configuration to this file.")
@click.option(
    "--dial",
    is_flag=True,
    help="Name the endpoints of the robots that are found now, for networks without multicast.",
)
@common_options
def zenoh(options: CommonOptions, out: Path | None, dial: bool) -> None:
    """Print the configuration of a Zenoh session to the robots.

    JSON, which Zenoh reads as JSON5: a peer that finds the robots by scouting, also those that
    start later; with --dial, or where robots answer no scouts, one that dials each robot found now;
    a client of the routers in profile routed. In a secured swarm it names the files of your
    identity, and has its access rules.
    """
    from swarmd.network.carriers.session import foreign_options

    with options.operator() as operator:
        settings = operator.settings
        known_members(options, operator, needs_status=False)
        identity = operator.identity  # the look may have taken a newer roster
        robots = operator.endpoints()
        if not robots and settings.profile != "routed":
            raise unreachable(operator)
    if identity is not None:
        undialled = sorted(name for name, one in robots.items() if one.startswith("tcp/["))
        if undialled and settings.profile != "routed":
            warn(f"{', '.join(undialled)}: left out: Zenoh dials no IPv6 address by TLS")
            robots = {name: one for name, one in robots.items() if name not in undialled}
            if not robots:
                raise NetworkError("no robot is left; give robots an IPv4 address to `listen` at")
        identity = replace(identity, folder=identity.folder.absolute())
    scouts = not dial and settings.answers_scouts(is_secured=identity is not None)
    endpoints = [] if scouts else sorted(set(robots.values()))
    config = foreign_options(settings, endpoints, identity, scouts=scouts)
    text = json.dumps(config, indent=2)
    if out is not None:
        try:
            out.write_text(f"{text}\n", encoding="utf-8")
        except OSError as error:
            raise ConfigError(f"--out {out}: {error.strerror}; expected a file to write") from error
    if options.is_json:
        content = {"swarm": settings.swarm, "robots": robots, "config": config}
        print_json("Zenoh", content)
    elif out is None:
        click.echo(text)
    else:
        click.echo(f"{out}: a session to {len(robots)} robots of swarm {settings.swarm}")
