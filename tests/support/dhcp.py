"""A DHCP server (dnsmasq) and a client (udhcpc) in network namespaces."""

from __future__ import annotations

import contextlib
import shutil
import subprocess
from pathlib import Path
from types import TracebackType
from typing import Self

from tests.support.field import Field

_SCRIPT = """#!/bin/sh
case "$1" in
deconfig)
    ip -4 addr flush dev "$interface"
    ip link set "$interface" up
    ;;
bound|renew)
    ip addr replace "$ip/$mask" dev "$interface"
    ;;
esac
"""


def lacks() -> str:
    """Why there can be no DHCP on this machine; empty if there can."""
    missing = [name for name in ("dnsmasq", "udhcpc") if shutil.which(name) is None]
    if not missing:
        return ""
    return f"{' and '.join(missing)} missing; on Debian: apt install dnsmasq-base udhcpc"


class Dhcp:
    """A server on the host `server` of a field, and clients on others; a context manager."""

    def __init__(self, folder: Path, field: Field, server: str) -> None:
        self._folder, self._field, self._host = folder, field, server
        self._script = folder / "udhcpc.sh"
        self._script.write_text(_SCRIPT)
        self._script.chmod(0o755)
        self._leases: dict[str, str] = {}
        self._server: subprocess.Popen[bytes] | None = None
        self._clients: dict[str, subprocess.Popen[bytes]] = {}
        self._left = contextlib.ExitStack()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        for client in self._clients.values():
            _end(client)
        if self._server is not None:
            _end(self._server)
        self._left.close()

    def offer(self, host: str, address: str) -> None:
        """From now on this host gets this address; a client asks at once."""
        self._leases[self._field.mac(host)] = address
        if self._server is not None:
            _end(self._server)
        hosts = [f"--dhcp-host={mac},{one}" for mac, one in self._leases.items()]
        (self._folder / "leases").unlink(missing_ok=True)
        self._server = self._start(
            self._host,
            *("dnsmasq", "--keep-in-foreground", "--conf-file=/dev/null", "--port=0"),
            *("--user=root", "--pid-file=", "--interface=eth0", "--bind-interfaces"),
            *("--dhcp-authoritative", "--no-ping", f"--dhcp-leasefile={self._folder}/leases"),
            *("--dhcp-range=10.80.0.100,static,255.255.255.0,2m", *hosts),
        )
        if host in self._clients:  # as after the end of a lease
            _end(self._clients.pop(host))
            self.ask(host)

    def ask(self, host: str) -> None:
        """Run a client on a host."""
        self._clients[host] = self._start(
            host, "udhcpc", "-f", "-i", "eth0", "-s", str(self._script), "-t", "50", "-T", "1"
        )

    def _start(self, host: str, *command: str) -> subprocess.Popen[bytes]:
        log = self._left.enter_context((self._folder / "dhcp.log").open("ab"))
        return subprocess.Popen(
            [*self._field.prefix(host), *command], stdout=log, stderr=log, stdin=subprocess.DEVNULL
        )


def _end(process: subprocess.Popen[bytes]) -> None:
    process.terminate()
    try:
        process.wait(10.0)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
