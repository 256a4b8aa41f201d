"""The daemon as a service of systemd: notices (sd_notify), levels of the journal, unit and account.

`swarmd.service` beside this file is the unit.
"""

from __future__ import annotations

import logging
import os
import re
import socket
from collections.abc import Mapping
from contextlib import suppress
from importlib.resources import files
from pathlib import Path
from typing import IO

from swarmd.core.clock import TICK
from swarmd.core.errors import ConfigError
from swarmd.core.files import as_text

DECISION_TIMEOUT = 4 * TICK
"""Seconds without a decision of protection after which systemd's watchdog is not fed."""
_LEVELS = {logging.DEBUG: 7, logging.INFO: 6, logging.WARNING: 4, logging.ERROR: 3}


class Notifier:
    """Sends notices to systemd by `$NOTIFY_SOCKET`; does nothing if the variable is not set."""

    def __init__(self) -> None:
        address = os.environ.get("NOTIFY_SOCKET", "")
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._is_watched = bool(os.environ.get("WATCHDOG_USEC"))

    def __call__(self, message: str) -> None:
        """Send one line such as `READY=1`."""
        kind = socket.SOCK_DGRAM | socket.SOCK_NONBLOCK
        if self._address:
            with socket.socket(socket.AF_UNIX, kind) as notify, suppress(OSError):
                notify.sendto(message.encode(), self._address)

    def feed_watchdog(self, decided_at: float, now: float) -> None:
        """Feed systemd's watchdog if protection has decided recently (`decided_at`, s).

        A loop that runs without decisions of protection must count as dead.
        """
        if self._is_watched and now - decided_at <= DECISION_TIMEOUT:
            self("WATCHDOG=1")

    def status(self, text: str) -> None:
        """Send the line that `systemctl status` shows."""
        self(f"STATUS={' '.join(text.split())}")


class JournalFormatter(logging.Formatter):
    """Formats for the journal: `<level>` before each line, without time and host."""

    def format(self, record: logging.LogRecord) -> str:
        """The lines of a record, each with its level (sd-daemon(3))."""
        level = _LEVELS.get(record.levelno, 2)
        return "\n".join(f"<{level}>{line}" for line in super().format(record).splitlines())


def is_journal(stream: IO[str], environ: Mapping[str, str] = os.environ) -> bool:
    """True if the stream leads to the journal: `$JOURNAL_STREAM` has its device and inode."""
    try:
        found = os.fstat(stream.fileno())
    except (OSError, ValueError):  # closed, or no file
        return False
    return environ.get("JOURNAL_STREAM") == f"{found.st_dev}:{found.st_ino}"


SERVICE = "swarmd"
UNIT_FILE = Path("/etc/systemd/system/swarmd.service")
SYSUSERS_FILE = Path("/etc/sysusers.d/swarmd.conf")
CONFIG_FOLDER = Path("/etc/swarmd")
CONFIG_FILE = CONFIG_FOLDER / "swarmd.yaml"
STATE_FOLDER = Path("/var/lib/swarmd")
USER = "swarmd"
SERIAL_GROUP = "dialout"
"""Debian's and Ubuntu's group of serial devices."""

SYSUSERS = f"""# Written by `swarmd service install`.
u {USER} - "swarmd, the daemon of a robot" {STATE_FOLDER}
m {USER} {SERIAL_GROUP}
"""


def unit_text(program: Path, config: Path = CONFIG_FILE) -> str:
    """The unit `swarmd.service` of this package, for the absolute path `program` of `swarmd`.

    ConfigError if systemd starts no program at such a path.
    """
    text = (files("swarmd.daemon") / "swarmd.service").read_text()
    text = text.replace("@PROGRAM@", _program(program))
    return text.replace(str(CONFIG_FILE), _argument(config))


_REFUSED = re.compile(r"""['"\\\x00-\x1f\x7f]""")
"""What systemd refuses in the path of a program, quoted or not ("special characters")."""
_PLAIN = re.compile(r"[\w/.,:=+@-]+", re.ASCII)
"""What means itself in a unit. A `%` begins a specifier, a `;` alone ends a command."""


def _program(path: Path) -> str:
    """The path of a program as the first word of a line of a unit; `$` means itself there."""
    text = as_text(path)
    if found := _REFUSED.search(text):
        raise ConfigError(
            f"{text!r}: systemd starts no program with {found[0]!r} in its path; make a link to its"
            " folder at another path, such as ln -s FOLDER /opt/swarmd-bin, and give --program"
            " /opt/swarmd-bin/swarmd"
        )
    text = text.replace("%", "%%")
    return text if _PLAIN.fullmatch(text) else f'"{text}"'


def _argument(path: Path) -> str:
    """The path as a further word of a line that starts a program (systemd.service(5))."""
    text = as_text(path)
    if _PLAIN.fullmatch(text):
        return text
    text = re.sub(r"""(["\\])""", r"\\\1", text.replace("%", "%%").replace("$", "$$"))
    text = re.sub(r"[\x01-\x1f\x7f]", lambda sign: f"\\x{ord(sign[0]):02x}", text)
    return f'"{text}"'
