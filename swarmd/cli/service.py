"""`swarmd service`: runs the daemon as a service of systemd."""

from __future__ import annotations

import shutil
import sys
import sysconfig
from pathlib import Path
from typing import TYPE_CHECKING

import click

from swarmd.cli.options import VerbGroup, output_option
from swarmd.core.errors import ConfigError

if TYPE_CHECKING:
    from swarmd.cli.service_files import Steps

NOT_ACTIVE = 3  # as systemctl status
_ARCHIVE_PROGRAM = Path("/opt/swarmd/bin/swarmd")

_root = click.option(
    "--root",
    type=click.Path(file_okay=False, resolve_path=True, path_type=Path),
    metavar="DIR",
    default=Path("/"),
    help="The root of another file system, such as that of an SD card.",
)
_dry_run = click.option("--dry-run", is_flag=True, help="Print the steps, and change nothing.")


@click.group(cls=VerbGroup)
def service() -> None:
    """Run the daemon as a service of systemd, from the start of the machine."""


@service.command()
@_root
@_dry_run
@click.option(
    "--program",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="swarmd on the robot [the running program; with --root that of the archive].",
)
@click.option("--no-start", is_flag=True, help="Do not start it now.")
def install(root: Path, dry_run: bool, program: Path | None, no_start: bool) -> None:
    """Write the unit and the account of the service, enable the service, and start it.

    Each step is printed. It needs no network. Without a running systemd the service starts with
    the machine. A daemon that runs already keeps running as it is.
    """
    from swarmd.cli.service_files import Steps, check_may_write, give_to_service
    from swarmd.daemon.systemd import (
        CONFIG_FILE,
        SERVICE,
        SYSUSERS,
        SYSUSERS_FILE,
        UNIT_FILE,
        USER,
        unit_text,
    )

    steps = Steps(root, dry_run)
    check_may_write(steps)
    text = unit_text(_program(steps, program))
    steps.write(SYSUSERS_FILE, SYSUSERS)
    steps.run(
        "systemd-sysusers",
        SYSUSERS_FILE.name,
        otherwise=f"make the account: useradd --system --groups dialout {USER}",
    )
    if not dry_run and give_to_service(root):
        click.echo(f"give {steps.within(CONFIG_FILE.parent)} to {USER}")
    steps.write(UNIT_FILE, text)
    has_systemctl = steps.run(
        "systemctl", "enable", SERVICE, otherwise=f"enable it there: systemctl enable {SERVICE}"
    )
    has_config = steps.within(CONFIG_FILE).exists()
    if not has_config:
        click.echo(f"next: there is no {steps.within(CONFIG_FILE)} yet: swarmd install BUNDLE")
    if not has_systemctl or not steps.manages_services():
        click.echo("note: systemd does not run here; the service starts with the machine")
        return
    steps.run("systemctl", "daemon-reload", otherwise="")
    if has_config and not no_start:
        steps.run("systemctl", "start", SERVICE, otherwise="")
        click.echo("next: swarmd service status")
    else:
        click.echo(f"next: systemctl start {SERVICE}")


@service.command()
@_root
@_dry_run
@click.option("--purge", is_flag=True, help="Remove settings, identities, latches and recordings.")
def uninstall(root: Path, dry_run: bool, purge: bool) -> None:
    """Stop the service and remove its unit; settings, latches and recordings stay."""
    from swarmd.cli.service_files import Steps, check_may_write
    from swarmd.daemon.systemd import (
        CONFIG_FOLDER,
        SERVICE,
        STATE_FOLDER,
        SYSUSERS_FILE,
        UNIT_FILE,
        USER,
    )

    steps = Steps(root, dry_run)
    check_may_write(steps)
    if steps.within(UNIT_FILE).exists():
        if steps.manages_services():
            steps.run("systemctl", "stop", SERVICE, otherwise="")
        steps.run("systemctl", "disable", SERVICE, otherwise="nothing is disabled")
        steps.remove(UNIT_FILE)
        if steps.manages_services():
            steps.run("systemctl", "daemon-reload", otherwise="")
    else:
        click.echo(f"skip {steps.within(UNIT_FILE)}: it is absent")
    steps.remove(SYSUSERS_FILE)
    kept = [steps.within(path) for path in (CONFIG_FOLDER, STATE_FOLDER)]
    if purge:
        for path in (CONFIG_FOLDER, STATE_FOLDER):
            steps.remove(path)
    elif there := [str(path) for path in kept if path.exists()]:
        click.echo(f"keep {' and '.join(there)}; --purge removes them")
    click.echo(f"keep the account {USER}, if there is one: userdel {USER}")


@service.command()
@_root
@click.option(
    "-n", "--lines", type=click.IntRange(0, 1000), default=5, help="Lines of the log [5]."
)
@output_option
def status(root: Path, lines: int, output: str | None) -> None:
    """Show unit, settings, identity and the last lines of the log; 3 if it is not active."""
    from swarmd.cli.output import print_json, print_section
    from swarmd.cli.service_status import is_active, last_lines, rows

    steps = _steps(root)
    found, log, active = rows(steps), last_lines(steps, lines), is_active(steps)
    if output == "json":
        print_json("ServiceStatus", {**dict(found), "is_active": active, "log": log})
    else:
        print_section("service", found)
        for line in log:
            click.echo(line)
    if not active:
        click.get_current_context().exit(NOT_ACTIVE)


def _steps(root: Path) -> Steps:
    from swarmd.cli.service_files import Steps

    if not root.is_dir():
        raise ConfigError(f"--root {root}: no such folder; mount the card, or make it first")
    return Steps(root)


def _own_program() -> Path:
    """This program as it was called, which may be a link that leads to each new version."""
    own = Path(sysconfig.get_path("scripts")) / "swarmd"
    called = Path(shutil.which(sys.argv[0]) or own).absolute()
    return called if called.exists() and own.exists() and called.samefile(own) else own


def _program(steps: Steps, given: Path | None) -> Path:
    """The absolute path of swarmd as the robot sees it; ConfigError if it is not there."""
    if given is None and steps.root != Path("/"):
        given = _ARCHIVE_PROGRAM
    program = given or _own_program()
    if not program.is_absolute() or not steps.within(program).exists():
        where = steps.within(program.absolute())
        first = "" if steps.root == Path("/") else "install the archive in that image, or "
        text = f"{where}: no such file; {first}give --program, the absolute path of swarmd"
        raise ConfigError(f"{text} on the robot")
    return program
