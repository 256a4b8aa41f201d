"""Selects the neighbors of a robot among the members: by radio signal, by distance, or all."""

from __future__ import annotations

import asyncio
import logging
import re
from collections.abc import Callable, Collection, Iterable, Mapping
from contextlib import suppress
from pathlib import Path

from swarmd.core.values import Neighbor
from swarmd.link.members.neighbor_settings import NeighborSettings
from swarmd.link.members.neighborhood import Link, Neighborhood, PlaceNeighbors

log = logging.getLogger(__name__)

PERIOD = 2.0  # s between two readings of signals
TIMEOUT = 1.0  # s for one reading
KEPT = 3  # readings without an answer after which all signals are forgotten
_STATION = re.compile(r"^Station ([0-9a-f:]{17}) ", re.MULTILINE)
_SIGNAL = re.compile(r"^\s*signal(?: avg)?:\s*(-?\d+)", re.MULTILINE)
_ARP = Path("/proc/net/arp")


def parse_stations(text: str) -> dict[str, float]:
    """By hardware address, the signal in dBm; `text` is from `iw dev NAME station dump`."""
    found: dict[str, float] = {}
    _, *parts = _STATION.split(text)
    for station, figures in zip(parts[::2], parts[1::2], strict=True):
        if signal := _SIGNAL.search(figures):
            found[station] = float(signal[1])
    return found


def parse_arp(text: str) -> dict[str, str]:
    """By hardware address, the IPv4 address; the text is that of /proc/net/arp."""
    rows = (line.split() for line in text.splitlines()[1:])
    return {row[3].lower(): row[0] for row in rows if len(row) >= 6 and row[2] != "0x0"}


class RadioSignal:
    """Reads the radio signal of each station at `interface` every PERIOD, until `close`."""

    def __init__(self, loop: asyncio.AbstractEventLoop, interface: str) -> None:
        self._interface = interface
        self._by_host: Mapping[str, float] = {}
        self._task = loop.create_task(self._run())

    def of(self, host: str) -> float | None:
        """The signal in dBm of the robot at an IPv4 address; None if unknown."""
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


class NeighborSelection:
    """Selects neighbors as `settings` say.

    `place`: as for `Neighborhood`.
    `heard` returns, for each robot, its id, its host, and the share of its beacons that arrive.
    """

    def __init__(
        self,
        settings: NeighborSettings,
        place: PlaceNeighbors,
        heard: Callable[[], Iterable[tuple[str, str, float]]],
        interface: str,
        loop: asyncio.AbstractEventLoop,
    ) -> None:
        self._neighborhood = Neighborhood(settings, place)
        self._heard = heard
        self._needs_links = settings.neighborhood == "link"
        self._signal = None if settings.signal is None else RadioSignal(loop, interface)

    def select(self, candidates: Collection[Neighbor], now: float) -> tuple[Neighbor, ...]:
        """The candidates, each marked as in reach or not."""
        links = self._links() if self._needs_links else None
        return self._neighborhood.select(candidates, now, links)

    def close(self) -> None:
        """End the reading of signals."""
        if self._signal is not None:
            self._signal.close()

    def _links(self) -> dict[str, Link]:
        signal = self._signal
        return {
            robot: Link(quality, None if signal is None else signal.of(host))
            for robot, host, quality in self._heard()
        }
