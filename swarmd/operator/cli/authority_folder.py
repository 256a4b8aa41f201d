"""Finds and opens the folder of a swarm's authority."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

import click

from swarmd.core.errors import ConfigError, unknown
from swarmd.link.keys.identity import user_folder
from swarmd.operator.cli.consent import has_terminal
from swarmd.operator.cli.options import CommonOptions

if TYPE_CHECKING:
    from swarmd.link.keys.authority import Authority

PASSPHRASE = "SWARMD_PASSPHRASE"
_WHERE = "use the machine that keeps it; for a new swarm `swarmctl keys init` makes one"
DAYS = click.FloatRange(min=0.01, max=3650.0)
days_option = click.option(
    "--days", type=DAYS, metavar="N", help="The life of the certificate [that of `keys init`]."
)


def configuration() -> Path:
    """The folder of this user's configuration. ConfigError without a home."""
    folder = user_folder()
    if folder is None:
        raise ConfigError("there is no $HOME to keep keys in; set HOME or XDG_CONFIG_HOME")
    return folder


def authority_folder(swarm: str) -> Path:
    """The folder of a swarm's authority, whether or not it exists."""
    return configuration() / "authorities" / swarm


def open_authority(swarm: str | None) -> Authority:
    """The authority (signing folder) of a swarm; asks for the passphrase if the folder has one.

    `swarm` None: the swarm is that of the options before the verb, of $SWARM, of the context in use
    or of the file of --config. If none of these names a swarm, the only signing folder is taken.
    ConfigError without a folder, or with several folders and no name.
    """
    from swarmd.link.keys.authority import Authority, is_encrypted

    folder = authority_folder(_chosen(swarm))
    return Authority(folder, ask_passphrase() if is_encrypted(folder) else None)


def ask_passphrase(*, is_new: bool = False) -> bytes:
    """The passphrase of $SWARMD_PASSPHRASE, else typed without echo; twice for a new one."""
    given = os.environ.get(PASSPHRASE)
    if given:
        return given.encode()
    if not has_terminal():
        raise ConfigError(
            f"the authority needs its passphrase; run on a terminal or set ${PASSPHRASE}"
        )
    text = click.prompt(
        "passphrase of the authority", hide_input=True, confirmation_prompt=is_new, err=True
    )
    return str(text).encode()


def _chosen(swarm: str | None) -> str:
    above = (click.get_current_context().find_object(CommonOptions) or CommonOptions()).in_context()
    found = sorted(path.parent.name for path in configuration().glob("authorities/*/authority.key"))
    name = swarm or above.swarm or os.environ.get("SWARM")
    if name is None and above.config is not None:
        from swarmd.settings.swarmfile import DaemonFile, check, layered

        name = layered(above.config, {}, os.environ).build(DaemonFile, check).swarm
    if name is not None and name not in found:
        text = unknown("authority for swarm", name, found)
        raise ConfigError(f"{text}; {_WHERE}")
    if name is None and len(found) != 1:
        which = f"authorities of {', '.join(found)}; name one with --swarm" if found else ""
        raise ConfigError(which or f"no authority of this user; {_WHERE}")
    return name or found[0]
