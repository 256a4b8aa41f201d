"""Notifies systemd that the daemon is ready, alive or stopping (sd_notify)."""

from __future__ import annotations

import os
import socket


class Notifier:
    """Writes to `$NOTIFY_SOCKET`, if that is set. `pings`: systemd's watchdog expects pings."""

    def __init__(self, environ: dict[str, str] | None = None) -> None:
        env = dict(os.environ) if environ is None else environ
        address = env.get("NOTIFY_SOCKET", "")
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self.pings = bool(env.get("WATCHDOG_USEC"))

    def __call__(self, message: str) -> None:
        """Send one line such as `READY=1`."""
        if not self._address:
            return
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK) as notify:
            try:
                notify.sendto(message.encode(), self._address)
            except OSError:
                return
