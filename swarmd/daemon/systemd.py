"""Notifies systemd that the daemon is ready, alive or stopping (sd_notify)."""

from __future__ import annotations

import os
import socket
from contextlib import suppress


class Notifier:
    """Writes to `$NOTIFY_SOCKET`, if that is set. `pings`: systemd's watchdog expects pings."""

    def __init__(self) -> None:
        address = os.environ.get("NOTIFY_SOCKET", "")
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self.pings = bool(os.environ.get("WATCHDOG_USEC"))

    def __call__(self, message: str) -> None:
        """Send one line such as `READY=1`."""
        kind = socket.SOCK_DGRAM | socket.SOCK_NONBLOCK
        if self._address:
            with socket.socket(socket.AF_UNIX, kind) as notify, suppress(OSError):
                notify.sendto(message.encode(), self._address)

    def status(self, text: str) -> None:
        """Send the line that `systemctl status` shows."""
        self(f"STATUS={' '.join(text.split())}")
