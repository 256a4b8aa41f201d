"""How strongly a WiFi radio receives other robots: the signal in dBm of each station, by address.

The tool `iw` prints it for the stations of an ad-hoc network or mesh, and on an access point for
its clients; a client of an access point sees the access point alone. Stations are matched with
robots by the kernel's table of neighbours (/proc/net/arp).
"""

from __future__ import annotations

import asyncio
import logging
import re
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

log = logging.getLogger(__name__)

PERIOD = 2.0  # s between two readings
TIMEOUT = 1.0  # s for one
KEPT = 3  # readings without an answer after which nothing is known
_STATION = re.compile(r"^Station ([0-9a-f:]{17}) ", re.MULTILINE)
_SIGNAL = re.compile(r"^\s*signal(?: avg)?:\s*(-?\d+)", re.MULTILINE)
_ARP = Path("/proc/net/arp")


def parse_stations(text: str) -> dict[str, float]:
    """The signal in dBm by hardware address, from the output of `iw dev NAME station dump`."""
    found: dict[str, float] = {}
    _, *parts = _STATION.split(text)
    for station, figures in zip(parts[::2], parts[1::2], strict=True):
        if signal := _SIGNAL.search(figures):
            found[station] = float(signal[1])
    return found


def parse_arp(text: str) -> dict[str, str]:
    """The IPv4 address by hardware address, from the text of /proc/net/arp."""
    rows = (line.split() for line in text.splitlines()[1:])
    return {row[3].lower(): row[0] for row in rows if len(row) >= 6 and row[2] != "0x0"}


class RadioSignal:
    """Reads the signal of the stations of `interface` until `close`."""

    def __init__(self, loop: asyncio.AbstractEventLoop, interface: str) -> None:
        self._interface = interface
        self._by_host: Mapping[str, float] = {}
        self._task = loop.create_task(self._run())

    def of(self, host: str) -> float | None:
        """The signal in dBm of the robot at an IPv4 address; None if it is not known."""
        return self._by_host.get(host)

    def close(self) -> None:
        """End."""
        self._task.cancel()

    async def _run(self) -> None:
        failures = 0
        while True:
            try:
                text = await self._ask()
                hosts = parse_arp(_ARP.read_text())
                signals = parse_stations(text).items()
                self._by_host = {hosts[one]: value for one, value in signals if one in hosts}
                failures = 0
            except (OSError, TimeoutError) as error:
                failures += 1
                if failures == 1:
                    log.warning("the signal of other robots is not known: iw: %s", error)
                if failures >= KEPT:
                    self._by_host = {}
            await asyncio.sleep(PERIOD)

    async def _ask(self) -> str:
        command = ("iw", "dev", self._interface, "station", "dump")
        process = await asyncio.create_subprocess_exec(
            *command, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.DEVNULL
        )
        try:
            out, _ = await asyncio.wait_for(process.communicate(), TIMEOUT)
        except BaseException:
            with suppress(ProcessLookupError):
                process.kill()
            raise
        if process.returncode:
            raise OSError(f"{self._interface} has no stations (exit code {process.returncode})")
        return out.decode("ascii", "replace")
