"""`swarmctl keys router`: the configuration of a Zenoh router of a secured swarm."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from swarmd.core.errors import ConfigError
from swarmd.security.identity import Identity, choose_identity


@click.command()
@click.option("--swarm", metavar="NAME", required=True, help="The swarm of the identity.")
@click.option(
    "--identity",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="FOLDER",
    help="The router's identity [that of this user or machine for the swarm].",
)
@click.option("--listen", default="tls/[::]:7447", show_default=True, metavar="ENDPOINT")
def router(swarm: str, identity: Path | None, listen: str) -> None:
    """Print the configuration of a Zenoh router (zenohd) with the identity of this machine.

    Make it a name of its own, such as the viewer `router`. The configuration lists the names of the
    roster: print it again after `keys add` or `keys revoke`, and start the router again.
    """
    found = choose_identity(swarm, identity, insecure=False)
    if found is None:
        raise ConfigError(
            f"no identity of swarm {swarm!r} is here; install a bundle for the router"
        )
    click.echo(json.dumps(router_configuration(found, listen), indent=2))


def router_configuration(identity: Identity, listen: str) -> dict[str, Any]:
    """The configuration of zenohd: links by TLS only, and what each name may send and hear."""
    from swarmd.network.access import router_access
    from swarmd.network.session import tls_options

    flat = {
        **tls_options(identity),
        "mode": "router",
        "listen/endpoints": [listen],
        "scouting/multicast/enabled": False,
        "access_control": router_access(identity.roster, identity.name),
    }
    nested: dict[str, Any] = {}
    for path, value in flat.items():
        *parents, last = path.split("/")
        place = nested
        for parent in parents:
            place = place.setdefault(parent, {})
        place[last] = value
    return nested
