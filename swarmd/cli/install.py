"""`swarmd install`: takes a bundle on the robot that it was made for."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import TYPE_CHECKING

import click

from swarmd.cli.options import FILE, root_option
from swarmd.core.errors import ConfigError
from swarmd.texts.keys import end_of_certificate
from swarmd.texts.values import counted

if TYPE_CHECKING:
    from swarmd.security.identity import Identity
    from swarmd.security.roster import Roster
    from swarmd.settings.installed import DraftedFile

DAEMON_FILE = "swarmd.yaml"


@click.command()
@click.argument("file", type=FILE)
@root_option
@click.option("--interface", metavar="NAME", help="This robot's interface, if it has another.")
@click.option("--force", is_flag=True, help="Replace an identity of another robot or authority.")
def install(file: Path, root: Path | None, interface: str | None, force: bool) -> None:
    """Take the bundle FILE: this machine becomes the robot that FILE names.

    Writes the identity and swarmd.yaml, as root into /etc/swarmd, else into ~/.config/swarmd, and
    starts nothing. Keys of swarmd.yaml that belong to the robot are kept, such as platform and
    driver.
    """
    from swarmd.cli.service_files import give_to_service, keep_for_root
    from swarmd.daemon.systemd import UNIT_FILE
    from swarmd.security.bundle import read_bundle
    from swarmd.security.installation import check_replaces, installed, replaced_identity
    from swarmd.security.roster import Role
    from swarmd.settings.installed import checked_settings, draft_daemon_file

    opened = read_bundle(file)
    info = opened.bundle.info
    if info.role is not Role.ROBOT:
        raise ConfigError(
            f"{file} is the bundle of {info.role} {info.name};"
            f" take it with `swarmctl keys install {file}`"
        )
    base = _base(root)
    machine_root = root or Path("/")
    is_of_service = base == machine_root / "etc/swarmd"  # False: the identity is of this user
    is_this_machine = machine_root == Path("/")  # False: a mounted file system, such as an SD card
    if is_of_service:
        keep_for_root(machine_root)
    # All is checked before the first write.
    settings = checked_settings(str(file), info.swarm, opened.bundle.settings)
    config = base / DAEMON_FILE
    drafted = draft_daemon_file(config, info.name, settings, {"interface": interface})
    folder = base / "identities" / info.swarm
    check_replaces(opened, installed(folder), is_forced=force)
    if not force:
        _check_file(config, info.swarm, info.name)
    base.mkdir(parents=True, exist_ok=True)
    # An error in this block gives the folder of the identity its former content.
    with replaced_identity(folder, opened) as identity:
        drafted.write()
    if is_of_service:
        give_to_service(machine_root)
    report_identity(identity, opened.roster)
    _report_file(config, drafted)
    if is_of_service and is_this_machine:
        has_service = UNIT_FILE.exists()
        next_step = "systemctl restart swarmd" if has_service else "swarmd service install"
        click.echo(f"next: {next_step}")
    elif is_this_machine:
        click.echo(f"next: swarmd --config {config}")


def _report_file(config: Path, drafted: DraftedFile) -> None:
    """Print what was written into swarmd.yaml, and what is missing in it."""
    click.echo(f"wrote {config}")
    for verb, keys in (("kept", drafted.kept), ("dropped", drafted.dropped)):
        if keys:
            click.echo(f"{verb} of the file that was there: {', '.join(keys)}")
    if unset := [key for key in ("platform", "driver") if key not in drafted.data]:
        click.echo(
            f"note: {config} has no {' and no '.join(unset)}; on a real robot add them, such as"
            " `platform: burger` and `driver: ros2dds`"
        )


def report_identity(identity: Identity, roster: Roster) -> None:
    """Print what was written and how long it is valid."""
    info = identity.info
    counts = {"robot": roster.robots, "operator": roster.operators, "viewer": roster.viewers}
    names = (counted(len(of), role) for role, of in counts.items())
    click.echo(
        f"{info.role} {info.name} of swarm {info.swarm}, roster of generation {roster.generation}:"
        f" {', '.join(names)}"
    )
    click.echo(f"wrote {identity.folder}")
    if warning := end_of_certificate(info.expires, time.time()):
        click.echo(f"warning: {warning}", err=True)


def _base(root: Path | None) -> Path:
    """The folder in which daemons of this user look for settings and identities."""
    from swarmd.security.identity import user_folder

    if root is not None:
        if not root.is_dir():
            raise ConfigError(f"--root {root}: no such folder; mount the card, or make it first")
        return root / "etc/swarmd"
    if os.geteuid() == 0:
        return Path("/etc/swarmd")
    folder = user_folder()
    if folder is None:
        raise ConfigError("there is no $HOME to install into; set it, or run as root")
    return folder


def _check_file(config: Path, swarm: str, robot: str) -> None:
    """ConfigError if the daemon's file is of another robot or swarm."""
    from swarmd.settings.yamlfile import read

    old = read(config) if config.exists() else {}
    if old.get("id", robot) != robot or old.get("swarm", swarm) != swarm:
        raise ConfigError(
            f"{config} is of {old.get('id', robot)} in swarm {old.get('swarm', swarm)}, the bundle"
            f" of {robot} in swarm {swarm}; --force replaces it"
        )
