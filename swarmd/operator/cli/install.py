"""`swarmd install`: takes a bundle on the robot that it was made for."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import TYPE_CHECKING

import click

from swarmd.core.errors import ConfigError
from swarmd.operator.cli.options import FILE, root_option
from swarmd.operator.texts.keys import end_of_certificate
from swarmd.operator.texts.values import counted

if TYPE_CHECKING:
    from collections.abc import Mapping

    from swarmd.link.keys.identity import Identity
    from swarmd.link.keys.roster import Roster
    from swarmd.settings.installed import DraftedFile

DAEMON_FILE = "swarmd.yaml"
_EXAMPLES = {"platform": "burger", "driver": "ros2dds"}


@click.command()
@click.argument("file", type=FILE)
@root_option
@click.option("--interface", metavar="NAME", help="This robot's interface, if it has another.")
@click.option("--platform", metavar="NAME", help="The robot's platform, such as burger.")
@click.option("--driver", metavar="NAME", help="The driver of its base, such as ros2dds.")
@click.option("--replace", is_flag=True, help="Replace another platform or driver in swarmd.yaml.")
@click.option("--force", is_flag=True, help="Replace an identity of another robot or authority.")
def install(
    file: Path,
    root: Path | None,
    interface: str | None,
    platform: str | None,
    driver: str | None,
    replace: bool,
    force: bool,
) -> None:
    """Take the bundle FILE: this machine becomes the robot that FILE names.

    Writes the identity and swarmd.yaml, as root into /etc/swarmd, else into ~/.config/swarmd, and
    starts nothing. Keys of swarmd.yaml that belong to the robot are kept, such as platform and
    driver. The same command changes nothing when it is repeated.
    """
    from swarmd.daemon.systemd import UNIT_FILE
    from swarmd.link.keys.bundle import read_bundle
    from swarmd.link.keys.installation import check_replaces, installed, is_same, replaced_identity
    from swarmd.link.keys.roster import Role
    from swarmd.operator.cli.service_files import give_to_service, keep_for_root
    from swarmd.plugins import load_driver
    from swarmd.settings.installed import checked_settings, draft_daemon_file
    from swarmd.settings.platforms import load_platform

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
    given = {"interface": interface, "platform": platform, "driver": driver}
    if is_this_machine:  # another machine may have other plugins
        if platform:
            load_platform(platform)
        if driver:
            load_driver(driver)
    drafted = draft_daemon_file(config, info.name, settings, given)
    folder = base / "identities" / info.swarm
    present = installed(folder)
    check_replaces(opened, present, is_forced=force)
    if not force:
        _check_file(config, info.swarm, info.name)
    if not replace:
        _check_kept(drafted, {key: given[key] for key in ("platform", "driver")})
    base.mkdir(parents=True, exist_ok=True)
    if present is not None and is_same(opened, present) and drafted.is_present:
        click.echo(f"{info.name} has this identity and these settings already: nothing is changed")
    else:
        # An error in this block gives the folder of the identity its former content.
        with replaced_identity(folder, opened) as identity:
            drafted.write()
        report_identity(identity, opened.roster)
        _report_file(config, drafted)
    if is_of_service:
        give_to_service(machine_root)
    _report_missing(config, drafted)
    if is_of_service and is_this_machine:
        has_service = UNIT_FILE.exists()
        next_step = "systemctl restart swarmd" if has_service else "swarmd service install"
        click.echo(f"next: {next_step}")
    elif is_this_machine:
        click.echo(f"next: swarmd --config {config}")


def _report_file(config: Path, drafted: DraftedFile) -> None:
    """Print what was written into swarmd.yaml."""
    click.echo(f"wrote {config}")
    for verb, keys in (("kept", drafted.kept), ("dropped", drafted.dropped)):
        if keys:
            click.echo(f"{verb} of the file that was there: {', '.join(keys)}")


def _report_missing(config: Path, drafted: DraftedFile) -> None:
    """Print which options a real robot needs and the file lacks."""
    if unset := [key for key in ("platform", "driver") if key not in drafted.data]:
        options = " ".join(f"--{key} {_EXAMPLES[key]}" for key in unset)
        click.echo(
            f"note: {config} has no {' and no '.join(unset)}; on a real robot repeat the command"
            f" with them, such as {options}"
        )


def _check_kept(drafted: DraftedFile, given: Mapping[str, str | None]) -> None:
    """ConfigError if the present file has another value of an option."""
    for key, value in given.items():
        present = drafted.before.get(key, value)
        if value and present != value:
            raise ConfigError(
                f"{drafted.path} has {key} {present}, and --{key} is {value}; add --replace to"
                " replace it, or leave the option out"
            )


def report_identity(identity: Identity, roster: Roster) -> None:
    """Print what was written and how long it is valid."""
    info = identity.info
    counts = {"robot": roster.robots, "operator": roster.operators, "viewer": roster.viewers}
    if roster.permits:
        counts["permit"] = tuple(roster.permits)
    names = (counted(len(of), role) for role, of in counts.items())
    click.echo(
        f"{info.role} {info.name} of swarm {info.swarm}, roster of generation {roster.generation}:"
        f" {', '.join(names)}"
    )
    if permit := roster.permits.get(info.name):
        from swarmd.link.keys.key_permit import permit_text

        click.echo(f"{info.name} ({permit.role}) may {permit_text(permit)}")
    click.echo(f"wrote {identity.folder}")
    if warning := end_of_certificate(info.expires, time.time()):
        click.echo(f"warning: {warning}", err=True)


def _base(root: Path | None) -> Path:
    """The folder in which daemons of this user look for settings and identities."""
    from swarmd.link.keys.identity import user_folder

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
