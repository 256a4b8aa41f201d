"""What `swarmd service status` shows of the unit, the settings, the identity and the log."""

from __future__ import annotations

import shutil
import subprocess
import time
from pathlib import Path

from swarmd.cli.service_files import Steps
from swarmd.core.clock import FIRST_WALL
from swarmd.core.errors import SwarmError
from swarmd.daemon.systemd import CONFIG_FILE, SERVICE, STATE_FOLDER, UNIT_FILE
from swarmd.texts.keys import UNSET_CLOCK, day

_ETC = Path("/etc")
_TIMEOUT = 5.0
_DAY = 86400.0
_UNKNOWN = "not known: systemd does not run here"


def rows(steps: Steps) -> list[tuple[str, str]]:
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


def last_lines(steps: Steps, count: int) -> list[str]:
    """The last lines of the service in the journal; the newest last."""
    if not count or not steps.manages_services() or shutil.which("journalctl") is None:
        return []
    words = ("-u", SERVICE, "-n", str(count), "--no-pager", "--output=short-iso")
    return _output("journalctl", *words).splitlines()


def _active_text(steps: Steps) -> str:
    if not steps.manages_services():
        return _UNKNOWN
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
    """The daemon's file and the identity, or the one line on what is wrong with them."""
    from swarmd.settings.settings import load_daemon_settings

    config = steps.within(CONFIG_FILE)
    if not config.exists():
        return [("settings", f"absent: {config}; run swarmd install BUNDLE, or write it")]
    # The service's places, and not those of this user; identities are in etc/swarmd/identities.
    environ = {"STATE_DIRECTORY": str(STATE_FOLDER), "XDG_CONFIG_HOME": str(steps.within(_ETC))}
    try:
        settings = load_daemon_settings(config, {}, environ)
    except SwarmError as error:
        return [("settings", str(error))]
    network = settings.network
    where = f"{config}: {settings.id} of swarm {network.swarm}, profile {network.profile}"
    identity = settings.identity
    if identity is None:
        return [("settings", where), ("identity", "absent: the swarm is insecure")]
    days = (identity.info.expires - time.time()) / _DAY
    ends = f"ends in {days:.0f} days" if days >= 0 else "has ended by this machine's clock"
    if time.time() < FIRST_WALL:
        ends = f"until {day(identity.info.expires)} ({UNSET_CLOCK})"
    generation = identity.roster.generation
    text = f"{identity.folder}: certificate {ends}, roster of generation {generation}"
    return [("settings", where), ("identity", text)]


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
