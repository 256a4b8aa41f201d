"""`swarmd service`: runs the daemon as a service of systemd."""

from __future__ import annotations

import shutil
import subprocess
import sys
import sysconfig
import time
from pathlib import Path

import click

from swarmd.core.clock import FIRST_WALL
from swarmd.core.errors import ConfigError, SwarmError
from swarmd.daemon.systemd import (
    CONFIG_FILE,
    CONFIG_FOLDER,
    SERVICE,
    STATE_FOLDER,
    SYSUSERS,
    SYSUSERS_FILE,
    UNIT_FILE,
    USER,
    unit_text,
)
from swarmd.operator.cli.options import VerbGroup, output_option
from swarmd.operator.cli.output import print_json, print_section
from swarmd.operator.cli.service_files import Steps, check_may_write, give_to_service
from swarmd.operator.texts.keys import DAY, UNSET_CLOCK, day

NOT_ACTIVE = 3  # the exit code of `systemctl status` for a unit that does not run
_TIMEOUT = 5.0  # s for systemctl and journalctl
_LOG_LINES = "5"
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
def install(root: Path, dry_run: bool, program: Path | None) -> None:
    """Write the unit and the account of the service, enable the service, and start it.

    Each step is printed. The command needs no network. Without a running systemd the service starts
    with the machine. A daemon that runs already keeps running as it is.
    """
    steps = Steps(root, dry_run)  # prints each step, and carries it out below `root`
    check_may_write(steps)
    unit = unit_text(_program(steps, program))
    # 1. The account. `otherwise`: the line to print if the program is not installed.
    steps.write(SYSUSERS_FILE, SYSUSERS)
    steps.run(
        "systemd-sysusers",
        SYSUSERS_FILE.name,
        otherwise=f"make the account: useradd --system --groups dialout {USER}",
    )
    if not dry_run and give_to_service(root):
        click.echo(f"give {steps.within(CONFIG_FILE.parent)} to {USER}")
    # 2. The unit.
    steps.write(UNIT_FILE, unit)
    has_systemctl = steps.run(
        "systemctl", "enable", SERVICE, otherwise=f"enable it there: systemctl enable {SERVICE}"
    )
    has_config = steps.within(CONFIG_FILE).exists()
    if not has_config:
        click.echo(f"next: there is no {steps.within(CONFIG_FILE)} yet: swarmd install BUNDLE")
    # 3. Start the service, if systemd runs on this machine and the daemon has its file. `otherwise`
    #    is empty, since systemctl is on this machine.
    if not has_systemctl or not steps.manages_services():
        click.echo("note: systemd does not run here; the service starts with the machine")
        return
    steps.run("systemctl", "daemon-reload", otherwise="")
    if has_config:
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
@output_option
def status(root: Path, output: str | None) -> None:
    """Show unit, settings, identity and the last lines of the log; 3 if it is not active."""
    steps = _steps(root)
    found = status_rows(steps)
    log = last_lines(steps)
    active = is_active(steps)
    if output == "json":
        print_json("ServiceStatus", {**dict(found), "is_active": active, "log": log})
    else:
        print_section("service", found)
        for line in log:
            click.echo(line)
    if not active:
        click.get_current_context().exit(NOT_ACTIVE)


def status_rows(steps: Steps) -> list[tuple[str, str]]:
    """Name and value of each line."""
    unit = steps.within(UNIT_FILE)
    if not unit.exists():
        absent = f"absent: {unit}; run swarmd service install"
        return [("unit", absent), *_settings_rows(steps)]
    return [
        ("unit", str(unit)),
        ("enabled", _asked(steps, "is-enabled", SERVICE) or "not known: no systemctl here"),
        ("active", _active_text(steps)),
        *_settings_rows(steps),
    ]


def is_active(steps: Steps) -> bool:
    """True if systemd runs here and reports the service as active."""
    return steps.manages_services() and _asked(steps, "is-active", SERVICE) == "active"


def last_lines(steps: Steps) -> list[str]:
    """The last lines of the service in the journal; the newest last."""
    if not steps.manages_services() or shutil.which("journalctl") is None:
        return []
    words = ("-u", SERVICE, "-n", _LOG_LINES, "--no-pager", "--output=short-iso")
    return _output("journalctl", *words).splitlines()


def _active_text(steps: Steps) -> str:
    if not steps.manages_services():
        return "not known: systemd does not run here"
    names = "ActiveState,SubState,StatusText,StateChangeTimestamp,NRestarts,Result"
    lines = _asked(steps, "show", SERVICE, "-p", names).splitlines()
    found = dict(line.partition("=")[::2] for line in lines)
    text = f"{found.get('ActiveState')} ({found.get('SubState')})"
    if since := found.get("StateChangeTimestamp"):
        text += f", since {since}"
    if found.get("NRestarts", "0") != "0":
        text += f", restarted {found['NRestarts']} times"
    if found.get("Result", "success") != "success":
        text += f", ended with {found['Result']}"
    if status := found.get("StatusText"):
        text += f"; {status}"
    return text


def _settings_rows(steps: Steps) -> list[tuple[str, str]]:
    """Rows (title, text) of the status: the daemon's file, and its identity.

    A file that is absent or faulty gives a single row with the fault.
    """
    from swarmd.settings.settings import load_daemon_settings

    config = steps.within(CONFIG_FILE)
    if not config.exists():
        return [("settings", f"absent: {config}; run swarmd install BUNDLE, or write it")]
    # Read the settings as the service does: with the state folder that systemd names in
    # STATE_DIRECTORY, and with the identity below `etc` of the root, not that of this user.
    service_environ = {
        "STATE_DIRECTORY": str(STATE_FOLDER),
        "XDG_CONFIG_HOME": str(steps.within(Path("/etc"))),
    }
    try:
        settings = load_daemon_settings(config, {}, service_environ)
    except SwarmError as error:
        return [("settings", str(error))]
    network = settings.network
    text = f"{config}: {settings.id} of swarm {network.swarm}, profile {network.profile}"
    settings_row = ("settings", text)
    identity = settings.identity
    if identity is None:
        return [settings_row, ("identity", "absent: the swarm is insecure")]
    validity = _validity(identity.info.expires, time.time())
    generation = identity.roster.generation
    text = f"{identity.folder}: certificate {validity}, roster of generation {generation}"
    return [settings_row, ("identity", text)]


def _validity(expires: float, now: float) -> str:
    """When a certificate ends, in words; as a date if the clock of this machine is not set yet."""
    if now < FIRST_WALL:
        return f"until {day(expires)} ({UNSET_CLOCK})"
    days_left = (expires - now) / DAY
    return (
        f"ends in {days_left:.0f} days" if days_left >= 0 else "has ended by this machine's clock"
    )


def _asked(steps: Steps, *words: str) -> str:
    """What systemctl answers; empty without systemctl."""
    if shutil.which("systemctl") is None:
        return ""
    root = () if steps.manages_services() else ("--root", str(steps.root))
    return _output("systemctl", *root, *words)


def _output(*command: str) -> str:
    """The output of a program, also if it ends with an error."""
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=_TIMEOUT, check=False
        )
    except subprocess.TimeoutExpired:
        return f"{command[0]} has not answered for {_TIMEOUT:g} s"
    return (done.stdout or done.stderr).strip()


def _steps(root: Path) -> Steps:
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
