"""`swarmctl zenoh`: the configuration with which any program of Zenoh joins the swarm."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import click
from msgspec.structs import replace

from swarmd.core.errors import ConfigError, NetworkError
from swarmd.operator.cli.options import FILE, CommonOptions, common_options
from swarmd.operator.cli.output import print_json, warn
from swarmd.operator.cli.send import known_members
from swarmd.operator.session.session import unreachable
from swarmd.operator.texts.values import counted


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

    The configuration is JSON, a subset of the JSON5 that Zenoh reads. The session is a peer that
    finds the robots by scouting (multicast queries), also robots that start later. With --dial, or
    if the robots answer no scouts, the peer dials the robots that are known now. Robots of a
    secured swarm answer scouts only in profile dev, or with `discoverable: true`. In profile routed
    the session is a client of the routers.

    In a secured swarm the configuration names the files of your identity. It also has Zenoh's
    access rules for your name, except in profile routed.
    """
    from swarmd.link.carriers.session import foreign_options

    with options.operator() as operator:
        settings = operator.settings
        known_members(options, operator, needs_status=False)
        identity = operator.identity  # after the query, which may have brought a newer roster
        endpoints = operator.endpoints()  # the Zenoh endpoints of each robot
        is_routed = settings.profile == "routed"  # the session dials routers, not robots
        if not endpoints and not is_routed:
            raise unreachable(operator)
    if identity is not None:
        if not is_routed:
            endpoints = _without_ipv6(endpoints)  # with an identity the session uses TLS
        # The configuration names files of this folder, and may be read from another folder.
        identity = replace(identity, folder=identity.folder.absolute())
    # A session that scouts dials no endpoint.
    scouts = not dial and settings.answers_scouts(is_secured=identity is not None)
    dialled = [] if scouts else sorted(set(endpoints.values()))
    config = foreign_options(settings, dialled, identity, scouts=scouts)
    text = json.dumps(config, indent=2)
    if out is not None:
        _write(out, text)
    if options.is_json:
        content = {"swarm": settings.swarm, "robots": endpoints, "config": config}
        print_json("Zenoh", content)
    elif out is None:
        click.echo(text)
    else:
        click.echo(
            f"{out}: a session to {counted(len(endpoints), 'robot')} of swarm {settings.swarm}"
        )


def _write(out: Path, text: str) -> None:
    try:
        out.write_text(f"{text}\n", encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"--out {out}: {error.strerror}; expected a file to write") from error


def _without_ipv6(endpoints: Mapping[str, str]) -> dict[str, str]:
    """The endpoints, by robot, that Zenoh can dial by TLS; NetworkError if none is left."""
    by_ipv6 = sorted(name for name, url in endpoints.items() if url.startswith("tcp/["))
    if by_ipv6:
        warn(f"{', '.join(by_ipv6)}: left out: Zenoh dials no IPv6 address by TLS")
    left = {name: url for name, url in endpoints.items() if name not in by_ipv6}
    if by_ipv6 and not left:
        raise NetworkError("no robot is left; give robots an IPv4 address to `listen` at")
    return left
